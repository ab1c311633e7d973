"""Velocities of YARP clients: repeated while they last, then zero for a moment."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NamedTuple

from bridge.client.manual import ManualControl
from bridge.client.velocity import STOP_SECONDS
from bridge.modules.host import Host
from bridge.modules.loop import Timer
from bridge.modules.velocity import velocity_publisher
from navigation.gateway.choice import RequestError
from navigation.gateway.stop import OVERRIDE_SECONDS

CLIENT = "a YARP client"

LONGEST_SECONDS = 1.0
"""Maximum duration of a velocity command; clients repeat their command to keep driving."""

_PAUSE_SECONDS = 0.3
_STOPPED = f"the robot was stopped; first send no velocity for the command's time-out, at least {_PAUSE_SECONDS:g} s"

_LOG_SECONDS = 5.0  # a refusal is logged again if the one before it was earlier
_PERIOD = 0.05  # seconds between two messages of a command
_ZEROS = round(STOP_SECONDS / _PERIOD)  # after a velocity


class YarpVelocity(NamedTuple):
    """A velocity as YARP commands it: m/s, m/s, deg/s."""

    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0


class VelocityCommander:
    """Repeats a velocity on the base's topic for a limited time, then zero for `STOP_SECONDS`. Not thread-safe.

    To others, the client is a person who drives manually (`bridge.client.manual.ManualControl`).

    Args:
        topic: the topic of the base's velocities.
        busy: whether a planner commands the base. Zeros would slow it, or a person who drives manually; a new command
            ends the zeros, too.
    """

    def __init__(self, host: Host, topic: str, busy: Callable[[], bool]) -> None:
        self._host, self._busy = host, busy
        self._publisher = velocity_publisher(host, topic)
        self._control = ManualControl(host.node.hub, topic)
        self._refused, self._refused_at = "", -math.inf  # the reason for the last refusal, and its time
        self._velocity, self._until = YarpVelocity(), 0.0
        self._override = False  # whether the zeros of `halt` are being published
        self._stopped = False  # whether a client that drives has to pause
        self._drives_until = 0.0  # when the client has paused, unless it sends another velocity before
        self._zeros = 0  # still to be published; not a time, because this process may be starved
        self._timer: Timer | None = None
        self._ended: Callable[[], None] | None = None
        self._ending = False

    @property
    def last(self) -> YarpVelocity | None:
        """The current command; None when its time is over."""
        return self._velocity if time.monotonic() <= self._until else None

    def command(self, velocity: YarpVelocity, seconds: float, *, planner_drives: bool = False) -> None:
        """Command a velocity for this time, at most `LONGEST_SECONDS`.

        Raises `RequestError` after `end`, after `stop_client` until the client has paused, and while the planner drives
        or another person drives manually.
        """
        if self._ending:
            raise RequestError("the gateway is shutting down")
        reason = self._stop_holds(velocity, seconds) or ("" if planner_drives else self._control.rival())
        if reason:
            self._log_refusal(reason)
            raise RequestError(reason)
        if planner_drives:
            raise RequestError("the planner drives; stop or suspend it first")
        self._begin(velocity, seconds)

    def _stop_holds(self, velocity: YarpVelocity, seconds: float) -> str:
        """Return why the client may not drive yet; "" if it may. Zeros count as a pause."""
        if not any(velocity):
            return ""
        now = time.monotonic()
        self._stopped = self._stopped and now <= self._drives_until
        self._drives_until = now + max(_limited(seconds), _PAUSE_SECONDS)
        return _STOPPED if self._stopped else ""

    def _log_refusal(self, reason: str) -> None:
        """Log a refusal, because YARP's reply cannot contain the reason; not again while the client repeats itself."""
        now = time.monotonic()
        if reason != self._refused or now - self._refused_at > _LOG_SECONDS:
            self._host.log.warning("a velocity of %s is refused: %s", CLIENT, reason)
        self._refused, self._refused_at = reason, now

    def _begin(self, velocity: YarpVelocity, seconds: float, *, override: bool = False) -> None:
        if any(velocity):
            self._control.begin(f"{CLIENT} ({self._host.name})")
        else:
            self._control.end()
        self._velocity, self._until = velocity, time.monotonic() + _limited(seconds)
        self._override = override
        if self._timer is None:
            self._timer = self._host.loop.every(_PERIOD, self._repeat)
        self._send(velocity)

    def stop(self) -> None:
        """End the command; a base that followed the command stops. Raises nothing: the caller stops the goals, too."""
        if self._until:
            self._until = 0.0
            try:
                self._send(YarpVelocity())
            except Exception:
                self._host.log.exception("zero velocity could not be published; it is repeated")
            self._control.end()

    def stop_client(self) -> None:
        """Stop for a person: a client that repeats its velocity must pause before it drives again."""
        self._stopped = True
        self.stop()

    def end(self, done: Callable[[], None]) -> None:
        """Stop, accept no further commands of clients, and call ``done`` after the last zero."""
        self._ending = True
        if self._timer is None:
            done()
        else:
            self._ended = done
            self.stop()

    def halt(self) -> None:
        """Command zero for `OVERRIDE_SECONDS`, to override any other source of velocities."""
        self._begin(YarpVelocity(), OVERRIDE_SECONDS, override=True)

    def _repeat(self) -> None:
        if self.last is not None and (self._override or not self._control.rival()):
            self._send(self._velocity)
        elif self._until:
            self.stop()
        elif self._zeros and not self._busy() and not self._control.rival():
            self._send(YarpVelocity())
        else:
            self._close()

    def _close(self) -> None:
        assert self._timer is not None
        self._timer.close()
        self._timer, self._zeros = None, 0
        ended, self._ended = self._ended, None
        if ended is not None:
            ended()

    def _send(self, velocity: YarpVelocity) -> None:
        self._zeros = _ZEROS if any(velocity) else max(0, self._zeros - 1)
        self._publisher.publish(velocity.x, velocity.y, math.radians(velocity.turn))


def _limited(seconds: float) -> float:
    return min(max(seconds, 0.0), LONGEST_SECONDS)
