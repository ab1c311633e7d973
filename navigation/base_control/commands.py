"""A base's velocity commands: the forms in which they come, who commands, and until when.

As in robotology/navigation's ``baseControl2``: inputs have ranks; one that falls silent counts as zero and keeps its
rank for 100 periods, so that a base does not leap from a joystick to an old goal, and then gives back.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple


class Velocity(NamedTuple):
    """A velocity in the base's own frame: x forward, y to the left, turning counterclockwise."""

    x: float = 0.0  #: metres per second
    y: float = 0.0  #: metres per second
    turn: float = 0.0  #: radians per second

    @property
    def speed(self) -> float:
        """Metres per second, whatever the direction."""
        return math.hypot(self.x, self.y)


STILL = Velocity()

PERCENT, POLAR, CARTESIAN = 1, 2, 3
"""What a command Bottle's first word says of the rest (robotology/navigation, ``baseControl``)."""


class CommandError(ValueError):
    """A command that is not obeyed; the text says why."""


class FullControl(NamedTuple):
    """What a joystick's 100 percent mean: metres and degrees per second (the group ``JOYSTICK``)."""

    linear: float
    angular: float


def of_bottle(values: Sequence[object], full: FullControl) -> Velocity:
    """The velocity of ``(type a b c gain)``, as joysticks and RobotGoto write it to ``control:i`` and ``joystick1:i``.

    Type 1 is ``(1 direction_deg linear_percent angular_percent gain_percent)`` of what ``full`` says, 2 ``(2
    direction_deg m/s deg/s gain_percent)``, 3 ``(3 x_m/s y_m/s deg/s gain_percent)``. A missing gain is 100. Raises
    `CommandError` for another type or form, or a gain that is not within 0 and 100.
    """
    numbers = [value for value in values if isinstance(value, (int, float)) and not isinstance(value, bool)]
    if len(numbers) != len(values) or len(numbers) not in (4, 5):
        raise CommandError(f"a command is (type a b c gain), five numbers; this is {_shown(values)}")
    kind, first, second, third, *rest = (float(number) for number in numbers)
    gain = rest[0] if rest else 100.0
    if not 0.0 <= gain <= 100.0:
        raise CommandError(f"a command's gain is 0 to 100 percent; this is {gain:g}")
    share = gain / 100.0
    if kind == PERCENT:
        if not (abs(second) <= 100.0 and abs(third) <= 100.0):
            raise CommandError(f"percent are within -100 and 100; these are {second:g} and {third:g}")
        made = _polar(first, second / 100.0 * full.linear, third / 100.0 * full.angular)
    elif kind == POLAR:
        made = _polar(first, second, third)
    elif kind == CARTESIAN:
        made = Velocity(first, second, math.radians(third))
    else:
        raise CommandError(f"a command's type is 1 (percent), 2 (polar) or 3 (Cartesian); this is {kind:g}")
    return Velocity(made.x * share, made.y * share, made.turn * share)


def of_degrees(x: float, y: float, turn: float) -> Velocity:
    """The velocity of YARP's ``MobileBaseVelocity``: m/s, m/s, deg/s."""
    return Velocity(x, y, math.radians(turn))


def _polar(direction: float, linear: float, angular: float) -> Velocity:
    if not math.isfinite(direction):
        raise CommandError(f"a command's direction is an angle in degrees; this is {direction}")
    angle = math.radians(direction)
    return Velocity(linear * math.cos(angle), linear * math.sin(angle), math.radians(angular))


def _shown(values: Sequence[object]) -> str:
    text = " ".join(str(value) for value in values)
    return f"'{text[:80]}{'...' if len(text) > 80 else ''}'"


KEPT_PERIODS = 100
DEFAULT_TIMEOUT = 0.1  # seconds after which an input is silent where its section does not say (``max_timeout``)
ABSURD = 10.0
"""No base of ours drives (m/s) or turns (rad/s) faster: such a command is an error in its units or its sender."""


class CommandInput:
    """One input with its last command, which is zero after ``timeout`` seconds. Commands come from any thread."""

    def __init__(self, name: str, timeout: float = DEFAULT_TIMEOUT) -> None:
        self.name, self.timeout = name, timeout
        self.commands = 0
        self.refused = 0
        self._lock = threading.Lock()
        self.last: tuple[Velocity, float, float] | None = None

    def command(self, velocity: Velocity, now: float, timeout: float | None = None) -> None:
        """Take a command at seconds of `Arbiter.choose`'s clock; a shorter time-out may come with it.

        Raises `CommandError` for NaN, infinity or an absurd value. The last good one goes on until its time-out.
        """
        if not all(map(math.isfinite, velocity)):
            self.refused += 1
            raise CommandError(f"{self.name}: a command of NaN or infinity is not obeyed: {_words(velocity)}")
        if velocity.speed > ABSURD or abs(velocity.turn) > ABSURD:
            self.refused += 1
            raise CommandError(
                f"{self.name}: a command above {ABSURD:g} m/s or {ABSURD:g} rad/s is not obeyed: {_words(velocity)}; "
                "are its units metres, and degrees or radians, per second as this input expects?"
            )
        until = now + min(self.timeout, timeout if timeout is not None and timeout > 0.0 else self.timeout)
        with self._lock:
            self.commands += 1
            self.last = (velocity, now, until)

    def forget(self) -> None:
        """Forget what was commanded: the clock was set back, or all is to stop."""
        with self._lock:
            self.last = None


@dataclass(frozen=True)
class CommandChoice:
    """What one period drives by."""

    velocity: Velocity = STILL  #: what is commanded; zero where nobody commands or who does is silent
    input: str = ""  #: whose it is, "" for nobody's
    fresh: bool = False  #: whether it is a command, rather than a silent input's zero


NOBODY = CommandChoice()


class Arbiter:
    """Chooses among inputs, the highest rank first, once each period (seconds)."""

    def __init__(self, inputs: Sequence[CommandInput], period: float) -> None:
        self.inputs = tuple(inputs)
        self.kept_seconds = KEPT_PERIODS * period

    def choose(self, now: float) -> CommandChoice:
        """What to drive by at this time, seconds."""
        for candidate in self.inputs:
            last = candidate.last
            if last is None:
                continue
            velocity, _, until = last
            if now <= until:
                return CommandChoice(velocity, candidate.name, fresh=True)
            if now <= until + self.kept_seconds:
                return CommandChoice(STILL, candidate.name)
        return NOBODY

    def forget(self) -> None:
        """Forget all commands."""
        for each in self.inputs:
            each.forget()


def _words(velocity: Velocity) -> str:
    return f"({velocity.x:g} {velocity.y:g} m/s, {velocity.turn:g} rad/s)"
