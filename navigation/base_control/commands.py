"""Velocity commands of a base: their formats, priorities and time-outs.

As in robotology/navigation's ``baseControl2``, inputs have ranks. A silent input counts as zero and keeps its rank for
100 periods, so that a base does not jump from a joystick's command to an old goal.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple


class Velocity(NamedTuple):
    """A velocity in the base's own frame: x forward, y to the left, turning counterclockwise."""

    x: float = 0.0  #: m/s
    y: float = 0.0  #: m/s
    turn: float = 0.0  #: rad/s

    @property
    def speed(self) -> float:
        """The speed in any direction, m/s."""
        return math.hypot(self.x, self.y)


STILL = Velocity()

PERCENT, POLAR, CARTESIAN = 1, 2, 3
"""Types of a command Bottle, which its first value gives (robotology/navigation, ``baseControl``)."""


class CommandError(ValueError):
    """A command is rejected; the text gives the reason."""


class FullControl(NamedTuple):
    """The velocities at 100 percent of a joystick: m/s and deg/s (the group ``JOYSTICK``)."""

    linear: float
    angular: float


def of_bottle(values: Sequence[object], full: FullControl) -> Velocity:
    """Parse ``(type a b c gain)``, as joysticks and RobotGoto write it to ``control:i`` and ``joystick1:i``.

    Type 1 is ``(1 direction_deg linear_percent angular_percent gain_percent)`` of ``full``, type 2 ``(2 direction_deg
    m/s deg/s gain_percent)``, type 3 ``(3 x_m/s y_m/s deg/s gain_percent)``. A missing gain is 100. Raises
    `CommandError` for another type or form, or a gain outside 0 to 100.
    """
    numbers = [value for value in values if isinstance(value, (int, float)) and not isinstance(value, bool)]
    if len(numbers) != len(values) or len(numbers) not in (4, 5):
        raise CommandError(f"a command must be (type a b c gain), five numbers, not {_shown(values)}")
    kind, first, second, third, *gains = (float(number) for number in numbers)
    gain = gains[0] if gains else 100.0
    if not 0.0 <= gain <= 100.0:
        raise CommandError(f"a command's gain must be 0 to 100 percent, not {gain:g}")
    share = gain / 100.0
    if kind == PERCENT:
        if not (abs(second) <= 100.0 and abs(third) <= 100.0):
            raise CommandError(f"percentages must be within -100 and 100, not {second:g} and {third:g}")
        velocity = _polar(first, second / 100.0 * full.linear, third / 100.0 * full.angular)
    elif kind == POLAR:
        velocity = _polar(first, second, third)
    elif kind == CARTESIAN:
        velocity = Velocity(first, second, math.radians(third))
    else:
        raise CommandError(f"a command's type must be 1 (percent), 2 (polar) or 3 (Cartesian), not {kind:g}")
    return Velocity(velocity.x * share, velocity.y * share, velocity.turn * share)


def of_degrees(x: float, y: float, turn: float) -> Velocity:
    """Convert the values of a ``MobileBaseVelocity``: m/s, m/s, deg/s."""
    return Velocity(x, y, math.radians(turn))


def _polar(direction: float, linear: float, angular: float) -> Velocity:
    if not math.isfinite(direction):
        raise CommandError(f"a command's direction must be a finite angle in degrees, not {direction}")
    angle = math.radians(direction)
    return Velocity(linear * math.cos(angle), linear * math.sin(angle), math.radians(angular))


def _shown(values: Sequence[object]) -> str:
    text = " ".join(str(value) for value in values)
    return f"'{text[:80]}{'...' if len(text) > 80 else ''}'"


KEPT_PERIODS = 100
DEFAULT_TIMEOUT = 0.1  # the default of ``max_timeout``: seconds after which an input is silent
ABSURD = 10.0
"""Faster commands (m/s or rad/s) are rejected: no supported base is as fast, so units or sender must be wrong."""


class CommandInput:
    """One input with its last command, which counts as zero after ``timeout`` seconds. Any thread may send commands."""

    def __init__(self, name: str, timeout: float = DEFAULT_TIMEOUT) -> None:
        self.name, self.timeout = name, timeout
        self.commands = 0
        self.refused = 0
        self._lock = threading.Lock()
        self.last: tuple[Velocity, float, float] | None = None

    def command(self, velocity: Velocity, now: float, timeout: float | None = None) -> None:
        """Store a command that arrived at ``now``, seconds of `Arbiter.choose`'s clock; ``timeout`` may end it earlier.

        Raises `CommandError` for NaN, infinity or a value above `ABSURD`; the last valid command then stays until its
        time-out.
        """
        if not all(map(math.isfinite, velocity)):
            self.refused += 1
            raise CommandError(f"{self.name}: rejected a command with NaN or infinity: {_text(velocity)}")
        if velocity.speed > ABSURD or abs(velocity.turn) > ABSURD:
            self.refused += 1
            raise CommandError(
                f"{self.name}: rejected a command above {ABSURD:g} m/s or {ABSURD:g} rad/s: {_text(velocity)}; "
                "check that its units are those of this input: m/s, and deg/s or rad/s"
            )
        until = now + min(self.timeout, timeout if timeout is not None and timeout > 0.0 else self.timeout)
        with self._lock:
            self.commands += 1
            self.last = (velocity, now, until)

    def clear(self) -> None:
        """Discard the command, after a clock jump or for a stop."""
        with self._lock:
            self.last = None


@dataclass(frozen=True)
class CommandChoice:
    """The command of one period."""

    velocity: Velocity = STILL  #: zero without a command, or if the input is silent
    input: str = ""  #: the name of the active input, "" for none
    fresh: bool = False  #: whether the input commanded it; False for the zero of a silent input


NO_CHOICE = CommandChoice()


class Arbiter:
    """Chooses among inputs, the highest rank first, once per period (seconds)."""

    def __init__(self, inputs: Sequence[CommandInput], period: float) -> None:
        self.inputs = tuple(inputs)
        self.kept_seconds = KEPT_PERIODS * period

    def choose(self, now: float) -> CommandChoice:
        """Return the command for a time in seconds."""
        for candidate in self.inputs:
            last = candidate.last
            if last is None:
                continue
            velocity, _, until = last
            if now <= until:
                return CommandChoice(velocity, candidate.name, fresh=True)
            if now <= until + self.kept_seconds:
                return CommandChoice(STILL, candidate.name)
        return NO_CHOICE

    def clear(self) -> None:
        for source in self.inputs:
            source.clear()


def _text(velocity: Velocity) -> str:
    return f"({velocity.x:g} {velocity.y:g} m/s, {velocity.turn:g} rad/s)"
