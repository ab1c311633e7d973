"""Manual driving: publishes a velocity while a page repeats it, then zero once."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from bridge.client.velocity import VelocityPublisher
from bridge.modules.host import Host
from bridge.modules.loop import Timer
from bridge.modules.velocity import velocity_publisher

HOLD_SECONDS = 0.3
"""A page's hold ends after this time without a message from the page."""

_PERIOD = 0.05
_ZERO = (0.0, 0.0, 0.0)

Velocity = tuple[float, float, float]


class HandDriver(Protocol):
    """A page, or a client of the Foxglove app's server, that drives; called on the module's thread."""

    who: str

    def held(self, x: float, y: float, turn: float) -> None:
        """Report the velocity that is commanded for the page."""

    def refuse(self, why: str) -> None:
        """Report why the page may not drive."""


class HandDriving:
    """Publishes the velocity that a page holds, 20 times a second, then zero once. Used on the module's thread.

    Args:
        host: the worker's node and thread.
        topic: topic of the base's velocities.
        most: maximum speed and angular velocity, m/s and rad/s.
        busy: returns why manual driving is refused; "" if it is allowed.
        on_begin: called when a page starts to drive.

    A planner that starts meanwhile ends the hold once the gateway's status shows it.
    """

    def __init__(
        self,
        host: Host,
        topic: str,
        most: tuple[float, float],
        busy: Callable[[], str],
        on_begin: Callable[[], None] = lambda: None,
    ) -> None:
        self._host, self._topic, self._most, self._busy, self._on_begin = host, topic, most, busy, on_begin
        self._holder: HandDriver | None = None
        self._velocity: Velocity = _ZERO
        self._until = 0.0
        self._timer: Timer | None = None
        self._out: VelocityPublisher | None = None

    def hold(self, page: HandDriver, x: float, y: float, turn: float, arrived: float) -> None:
        """Drive at this velocity for a page, whose message arrived at ``arrived`` (monotonic seconds)."""
        now = time.monotonic()
        if now - arrived > HOLD_SECONDS:
            return
        holder = self._holder
        reason = self._busy() if holder in (None, page) else f"{holder.who} drives manually"
        if not self._topic:
            reason = "no velocity topic is configured (navigation.velocity)"
        if reason:
            self.release(page)
            page.refuse(reason)
            return
        if self._holder is None:
            self._host.log.info("%s drives manually", page.who)
            self._holder = page
            self._out = self._out or velocity_publisher(self._host, self._topic)
            self._timer = self._host.loop.every(_PERIOD, self._repeat)
            self._on_begin()
        speed, most_turn = self._most
        self._velocity = (_within(x, speed), _within(y, speed), _within(turn, most_turn))
        self._until = arrived + HOLD_SECONDS
        self._publish()

    def release(self, page: HandDriver) -> None:
        """Stop driving for a page."""
        if page is self._holder:
            self.stop()

    def stop(self) -> None:
        """Command zero once, whichever page holds."""
        if self._holder is None:
            return
        page, self._holder, self._velocity = self._holder, None, _ZERO
        if self._timer is not None:
            self._timer.close()
            self._timer = None
        self._publish()
        page.held(*_ZERO)
        self._host.log.info("%s no longer drives manually", page.who)

    def _repeat(self) -> None:
        if time.monotonic() > self._until:
            self.stop()
        else:
            self._publish()

    def _publish(self) -> None:
        x, y, turn = self._velocity
        assert self._out is not None
        self._out.publish(x, y, turn)
        if self._holder is not None:
            self._holder.held(x, y, turn)


def _within(value: float, most: float) -> float:
    return min(max(value, -most), most)
