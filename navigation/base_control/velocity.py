"""A base's velocity, and the forms in which YARP and ROS command it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple


class Velocity(NamedTuple):
    """A velocity in the base's own frame: x forward, y to the left, turning counterclockwise.

    Attributes:
        x: metres per second.
        y: metres per second.
        turn: radians per second.
    """

    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0

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

    Type 1 is ``(1 direction_deg linear_percent angular_percent gain_percent)``, 2 ``(2 direction_deg m/s deg/s
    gain_percent)``, 3 ``(3 x_m/s y_m/s deg/s gain_percent)``. A missing gain is 100.

    Args:
        values: the Bottle's plain values.
        full: what 100 percent of type 1 are.

    Raises:
        CommandError: it has another type or form, or a gain that is not within 0 and 100.
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
