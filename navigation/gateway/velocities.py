"""Velocities of YARP clients: repeated while they last, then zero for a moment."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from bridge.client.manual import ManualControl
from bridge.client.velocity import STOP_SECONDS, VelocityPublisher
from bridge.modules.host import Host
from bridge.modules.loop import Timer
from bridge.modules.velocity import velocity_publisher
from bridge.state_machine import Machine
from navigation.gateway.choice import RequestError
from navigation.gateway.machine import SENDER, VELOCITY, SenderEvent, SenderState, VelocityEvent, VelocityState
from navigation.gateway.motion import STALL_SECONDS
from navigation.gateway.stop import OVERRIDE_SECONDS

CLIENT = "a YARP client"

LONGEST_SECONDS = 1.0
"""Maximum duration of a velocity command; clients repeat their command to keep driving."""

_PAUSE_SECONDS = 0.3
_PAUSE = f"first send no velocity for the command's time-out, at least {_PAUSE_SECONDS:g} s"
_REFUSALS = {
    SenderState.DISPLACED: f"the planner or a person drove; {_PAUSE}",
    SenderState.STOPPED: f"the robot was stopped; {_PAUSE}",
    SenderState.ENDED: "the gateway is shutting down",
}
_HAS_TO_PAUSE = (SenderState.DISPLACED, SenderState.STOPPED)
_PLANNER_DRIVES = "the planner drives; stop or suspend it first"

_LOG_SECONDS = 5.0  # a refusal is logged again if the one before it was earlier
_PERIOD = 0.05  # seconds between two messages of a command
_ZEROS = round(STOP_SECONDS / _PERIOD)  # after a velocity


class YarpVelocity(NamedTuple):
    """A velocity as YARP commands it: m/s, m/s, deg/s."""

    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0


ZERO = YarpVelocity()


class _PauseFile:
    """The file that contains the state of `VelocitySender` while YARP clients have to pause.

    Without it, a client that was stopped would drive by itself after a restart of the gateway. It is written in the
    background, because a slow disk must not delay a stop.
    """

    def __init__(self, host: Host) -> None:
        self._file, self._submit = host.folder / "pause", host.background.submit
        self._state = SenderState.SILENT

    def read(self) -> SenderState:
        """Return the state at the end of the last gateway; STOPPED if the file is unreadable."""
        try:
            state = SenderState(self._file.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return SenderState.SILENT
        except (OSError, ValueError):
            return SenderState.STOPPED
        return state if state is SenderState.DISPLACED else SenderState.STOPPED

    def write(self, state: SenderState) -> None:
        """Store a state in which clients have to pause, or that they have paused."""
        self._state = state
        self._submit(lambda: partial(self._store, self._state), lambda _: None)

    def _store(self, state: SenderState) -> None:
        if state is SenderState.SILENT:
            self._file.unlink(missing_ok=True)
        else:
            self._file.write_text(state.value, encoding="utf-8")


class VelocitySender:
    """The YARP clients that command velocities: whether they may drive, or have to pause first.

    A client that was stopped or refused repeats its velocity, and must not drive by itself later, nor after a restart
    of the gateway. It has paused if no velocity but zero has arrived for the time-out of its last one, and at least
    `_PAUSE_SECONDS`. Silence is counted in calls of `tick`, because nothing is read while this process stands still.
    """

    def __init__(self, host: Host) -> None:
        self._log, self._file = host.log, _PauseFile(host)
        self._machine = Machine(SENDER, self._file.read())
        # the calls of `tick` until the client has paused, from its last velocity, and now
        self._pause = self._left = _ticks(LONGEST_SECONDS)  # the time-out of a velocity before the start is unknown
        self._ticked_at = time.monotonic()
        self._refused, self._refused_at = "", -math.inf  # the reason for the last refusal, and its time

    @property
    def silent(self) -> bool:
        """Whether `tick` need not be called."""
        return self._machine.state in (SenderState.SILENT, SenderState.ENDED)

    def on_velocity(self, velocity: YarpVelocity, seconds: float) -> None:
        """Note that a velocity for this time has arrived; zero counts as a pause."""
        if any(velocity):
            self._pause = self._left = _ticks(max(_limited(seconds), _PAUSE_SECONDS))
            self._ticked_at = time.monotonic()
            self._on(SenderEvent.VELOCITY)

    def check(self, velocity: YarpVelocity, other: str) -> None:
        """Raise `RequestError` if a velocity is refused; ``other``: who else drives, "" for nobody."""
        reason = self._refusal(velocity, other)
        if reason:
            self._log_refusal(reason)
            raise RequestError(reason)

    def _refusal(self, velocity: YarpVelocity, other: str) -> str:
        moves = any(velocity)
        if moves and other:
            self.displace()
        state = self._machine.state
        held = _REFUSALS.get(state, "") if moves or state is SenderState.ENDED else ""
        return (other or held) if state is SenderState.DISPLACED else (held or other)

    def _log_refusal(self, reason: str) -> None:
        """Log a refusal, because YARP's reply cannot contain the reason; not again while the client repeats itself."""
        now = time.monotonic()
        if reason != self._refused or now - self._refused_at > _LOG_SECONDS:
            self._log.warning("a velocity of %s is refused: %s", CLIENT, reason)
        self._refused, self._refused_at = reason, now

    def displace(self) -> None:
        """Require a pause if velocities arrive, because the planner or a person drives."""
        self._on(SenderEvent.DISPLACE)

    def stop(self) -> None:
        """Require a pause if velocities arrive."""
        self._on(SenderEvent.STOP)

    def end(self) -> None:
        """Refuse all further velocities."""
        self._on(SenderEvent.END)

    def tick(self) -> None:
        """Count a period without a velocity; after a stall count from the beginning, because messages are unread."""
        now = time.monotonic()
        self._left = self._pause if now > self._ticked_at + STALL_SECONDS else self._left - 1
        self._ticked_at = now
        if self._left <= 0:
            self._on(SenderEvent.PAUSE)

    def _on(self, event: SenderEvent) -> None:
        had_to_pause = self._machine.state in _HAS_TO_PAUSE
        if self._machine.on(event) and event is not SenderEvent.END:  # the next gateway needs the state before the end
            state = self._machine.state
            if had_to_pause or state in _HAS_TO_PAUSE:
                self._file.write(state)


class _Output:
    """Publishes velocities, and counts the zeros that have to follow."""

    def __init__(self, publisher: VelocityPublisher) -> None:
        self._publisher = publisher
        self.zeros = 0  # not a time, because this process may be starved

    def send(self, velocity: YarpVelocity) -> None:
        self.zeros = _ZEROS if any(velocity) else max(0, self.zeros - 1)
        self._publisher.publish(velocity.x, velocity.y, math.radians(velocity.turn))


class _Command(NamedTuple):
    """What is published while DRIVING or HALTING, and until when (monotonic seconds)."""

    velocity: YarpVelocity
    until: float


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
        self._output = _Output(velocity_publisher(host, topic))
        self._control = ManualControl(host.node.hub, topic)
        self._sender = VelocitySender(host)
        self._machine = Machine(VELOCITY, VelocityState.SILENT)
        self._command = _Command(ZERO, 0.0)
        self._timer: Timer | None = None  # while velocities are published or arrive
        self._ended: Callable[[], None] | None = None
        if not self._sender.silent:
            self._start_timer()

    @property
    def last(self) -> YarpVelocity | None:
        """The current command; None when its time is over."""
        return self._command.velocity if self._commands and time.monotonic() <= self._command.until else None

    @property
    def _commands(self) -> bool:
        return self._machine.state in (VelocityState.DRIVING, VelocityState.HALTING)

    def command(self, velocity: YarpVelocity, seconds: float, *, planner_drives: bool = False) -> None:
        """Command a velocity for this time, at most `LONGEST_SECONDS`.

        Raises `RequestError` after `end`, while the planner drives or another person drives manually, and after that or
        `stop_client` until the client has paused.
        """
        self.note(velocity, seconds)
        self._sender.check(velocity, _PLANNER_DRIVES if planner_drives else self._control.rival())
        self._begin(VelocityEvent.COMMAND, velocity, seconds)

    def note(self, velocity: YarpVelocity, seconds: float) -> None:
        """Note that a client sends a velocity, and so does not pause, although the velocity is not executed."""
        self._sender.on_velocity(velocity, seconds)
        self._start_timer()

    def stop(self) -> None:
        """End the command; a base that followed the command stops. Raises nothing: the caller stops the goals, too."""
        if self._machine.on(VelocityEvent.END):
            try:
                self._output.send(ZERO)
            except Exception:
                self._host.log.exception("zero velocity could not be published; it is repeated")
            self._control.end()

    def displace(self) -> None:
        """Stop because the planner or a person drives: a client that repeats its velocity must pause, too."""
        self._sender.displace()
        self.stop()

    def stop_client(self) -> None:
        """Stop for a person: a client that repeats its velocity must pause before it drives again."""
        self._sender.stop()
        self.stop()

    def end(self, done: Callable[[], None]) -> None:
        """Stop, accept no further commands of clients, and call ``done`` after the last zero."""
        self._sender.end()
        if self._machine.state is VelocityState.SILENT:
            done()
        else:
            self._ended = done
            self.stop()

    def halt(self) -> None:
        """Command zero for `OVERRIDE_SECONDS`, to override any other source of velocities."""
        self._begin(VelocityEvent.HALT, ZERO, OVERRIDE_SECONDS)

    def _begin(self, event: VelocityEvent, velocity: YarpVelocity, seconds: float) -> None:
        if any(velocity):
            self._control.begin(f"{CLIENT} ({self._host.name})")
        else:
            self._control.end()
        self._machine.on(event)
        self._command = _Command(velocity, time.monotonic() + _limited(seconds))
        self._start_timer()
        self._output.send(velocity)

    def _start_timer(self) -> None:
        if self._timer is None:
            self._timer = self._host.loop.every(_PERIOD, self._tick)

    def _tick(self) -> None:
        self._sender.tick()
        if self._commands:
            displaced = self._machine.state is VelocityState.DRIVING and bool(self._control.rival())
            if displaced:
                self.displace()
            elif self.last is None:
                self.stop()
            else:
                self._output.send(self._command.velocity)
        elif self._output.zeros and not self._busy() and not self._control.rival():
            self._output.send(ZERO)
        else:
            self._rest()

    def _rest(self) -> None:
        """Publish nothing; end the timer if no velocities arrive."""
        self._machine.on(VelocityEvent.DONE)
        self._output.zeros = 0
        if self._sender.silent and self._timer is not None:
            self._timer.close()
            self._timer = None
        ended, self._ended = self._ended, None
        if ended is not None:
            ended()


def _ticks(seconds: float) -> int:
    """Return after how many calls of `VelocitySender.tick` this time has surely passed."""
    return math.ceil(seconds / _PERIOD) + 1


def _limited(seconds: float) -> float:
    return min(max(seconds, 0.0), LONGEST_SECONDS)
