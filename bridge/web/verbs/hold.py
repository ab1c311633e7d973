"""Manual driving: publishes a velocity while a page repeats it, then zero for a moment."""

from __future__ import annotations

import math
from collections.abc import Callable
from threading import Event
from typing import Protocol

from bridge.client.manual import ManualControl
from bridge.client.velocity import STOP_SECONDS, VelocityPublisher
from bridge.clock import steady
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
    """Publishes the velocity that a page holds, 20 times a second, then zero for `STOP_SECONDS`.

    Used on the module's thread.

    Args:
        host: the worker's node and thread.
        topic: topic of the base's velocities.
        most: maximum speed and angular velocity, m/s and rad/s.
        busy: returns why manual driving is refused; "" if it is allowed.
        on_begin: called when a page starts to drive.

    Only one person on the hub drives, whichever program they use (`bridge.client.manual.ManualControl`). A planner that
    starts meanwhile ends the hold, and the repetition of zero, once the gateway's status shows it.

    Attributes:
        stopped: set while neither a velocity nor zero is being published.
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
        self.stopped = Event()
        self.stopped.set()
        self._control = ManualControl(host.node.hub, topic)
        self._holder: HandDriver | None = None
        self._refused: dict[HandDriver, float] = {}  # when their controls were pressed
        self._halted_at = -math.inf
        self._ended = False
        self._velocity: Velocity = _ZERO
        self._until = 0.0
        self._zeros = 0  # still to be published; not a time, because this process may be starved
        self._timer: Timer | None = None
        self._out: VelocityPublisher | None = None

    def hold(self, page: HandDriver, x: float, y: float, turn: float, arrived: float, pressed: float) -> None:
        """Drive at this velocity for a page.

        Args:
            page: the page that drives.
            x: velocity forward, m/s.
            y: velocity to the left, m/s.
            turn: angular velocity, rad/s.
            arrived: when the page's message arrived, seconds of `bridge.clock.steady`: no hold outlasts a suspension.
            pressed: when the first message since the page's last release arrived.
        """
        if self._ended or steady() - arrived > HOLD_SECONDS:
            return
        reason = self._refusal(page, pressed)
        if reason:
            self.release(page)
            self._refused[page] = pressed
            page.refuse(reason)
            return
        if self._holder is None:
            self._out = self._out or velocity_publisher(self._host, self._topic)
            self._control.begin(f"{page.who} ({self._host.name})")
            self._host.log.info("%s drives manually", page.who)
            self._holder = page
            self.stopped.clear()
            self._timer = self._timer or self._host.loop.every(_PERIOD, self._repeat)
            self._on_begin()
        speed, most_turn = self._most
        self._velocity = (_within(x, speed), _within(y, speed), _within(turn, most_turn))
        self._until = arrived + HOLD_SECONDS
        self._publish()

    def _refusal(self, page: HandDriver, pressed: float) -> str:
        """Return why a page may not drive; "" if it may. Once refused, a control drives only if it is pressed again."""
        holder = self._holder
        if pressed <= self._halted_at:
            return "the robot was stopped; release the control first"
        if not self._topic:
            return "no velocity topic is configured (navigation.velocity)"
        if holder is not None and holder is not page:
            return f"{holder.who} drives manually"
        held = pressed <= self._refused.get(page, -math.inf)
        return self._others() or ("release the control first" if held else "")

    def block(self, page: HandDriver, pressed: float) -> None:
        """Refuse this press of a page's control, which was refused on another connection."""
        self._refused[page] = pressed

    def release(self, page: HandDriver) -> None:
        """Stop driving for a page."""
        self._refused.pop(page, None)
        if page is self._holder:
            self.stop()

    def halt(self) -> None:
        """Stop driving; pages whose control is pressed now must release it before they drive again."""
        self._halted_at, page = steady(), self._holder
        self.stop()
        if page is not None:
            page.refuse("the robot was stopped")

    def end(self) -> None:
        """Stop driving, and ignore pages from now on."""
        self._ended = True
        self.halt()

    def stop(self) -> None:
        """Command zero, and repeat it for `STOP_SECONDS`, whichever page holds."""
        if self._holder is None:
            return
        page, self._holder, self._velocity = self._holder, None, _ZERO
        self._zeros = round(STOP_SECONDS / _PERIOD)
        try:
            self._publish()
        finally:
            self._control.end()
        page.held(*_ZERO)
        self._host.log.info("%s no longer drives manually", page.who)

    def _others(self) -> str:
        """Return which other program or planner drives; "" if none does."""
        return self._control.rival() or self._busy()

    def _repeat(self) -> None:
        if self._holder is not None:
            if steady() > self._until:
                self.stop()
            else:
                self._publish()
        elif self._zeros and not self._others():  # zeros would slow a planner or another driver
            self._zeros -= 1
            self._publish()
        else:
            assert self._timer is not None
            self._timer.close()
            self._timer = None
            self.stopped.set()

    def _publish(self) -> None:
        x, y, turn = self._velocity
        assert self._out is not None
        self._out.publish(x, y, turn)
        if self._holder is not None:
            self._holder.held(x, y, turn)


def _within(value: float, most: float) -> float:
    return min(max(value, -most), most)
