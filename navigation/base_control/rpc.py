"""The words that ``/baseControl/rpc`` understands, as robotology/navigation's ``baseControl2`` does."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from navigation.base_control.base import Base
from navigation.base_control.limits import FILTERS

HELP = (
    "help: these lines",
    "run: obey the inputs",
    "idle: stand still, whatever the inputs command",
    "reset_odometry: begin at zero from here",
    "set_prefilter 0|1|2|4|8: filter commands at so many Hz; 0 for no filter",
    "set_motors_filter 0|1|2|4|8: filter the velocities that are told at so many Hz; 0 for no filter",
    "set_max_lin_vel V: metres per second",
    "set_max_ang_vel V: degrees per second",
    "set_max_joy_lin_vel V: metres per second of a joystick's 100 percent",
    "set_max_joy_ang_vel V: degrees per second of a joystick's 100 percent",
)

_ELSEWHERE = {
    "change_pid": "the motors' own driver has their controllers; nothing was changed",
    "change_ctrl_mode": "the wheels are driven by velocity; nothing was changed",
    "set_debug_mode": "midspan status shows what debug mode did; nothing was changed",
}
"""Words of upstream's that speak of what is not BaseControl's here."""


class Words:
    """Answers what is asked on the port. Called on the module's thread.

    Args:
        base: what is commanded.
    """

    def __init__(self, base: Base) -> None:
        self._base = base
        self._most = base.settings.limits
        self._known: Mapping[str, Callable[[list[Any]], str]] = {
            "run": self._run,
            "idle": self._idle,
            "reset_odometry": self._reset,
            "set_prefilter": self._prefilter,
            "set_motors_filter": self._motors_filter,
            "set_max_lin_vel": self._linear,
            "set_max_ang_vel": self._angular,
            "set_max_joy_lin_vel": self._stick_linear,
            "set_max_joy_ang_vel": self._stick_angular,
        }

    def answer(self, values: list[Any]) -> list[Any]:
        """What a Bottle is answered with.

        Raises:
            ValueError: it is no such command, or its value cannot be; the text says why.
        """
        word, *rest = (str(values[0]) if values else "", *values[1:])
        if word in ("help", "[help]"):
            return ["[many]", *HELP]
        if word in _ELSEWHERE:
            raise ValueError(f"{word}: {_ELSEWHERE[word]}")
        if word not in self._known:
            raise ValueError(f"'{word}' is no command; 'help' tells which there are")
        return [self._known[word](rest)]

    def _run(self, _rest: list[Any]) -> str:
        self._base.idle = False
        return "Now obeying the inputs."

    def _idle(self, _rest: list[Any]) -> str:
        self._base.idle = True
        return "Standing still; 'run' ends it."

    def _reset(self, _rest: list[Any]) -> str:
        self._base.odometry.reset()
        return "Odometry reset done."

    def _prefilter(self, rest: list[Any]) -> str:
        limiter = self._base.limiter
        limiter.limits = replace(limiter.limits, filter_hz=_filter(rest))
        return "Prefilter set."

    def _motors_filter(self, rest: list[Any]) -> str:
        self._base.motors_filter = _filter(rest)
        return "Motors filter set."

    def _linear(self, rest: list[Any]) -> str:
        limiter = self._base.limiter
        limiter.limits = replace(limiter.limits, linear=_number(rest, self._most.linear, "m/s"))
        return "Max linear velocity set."

    def _angular(self, rest: list[Any]) -> str:
        limiter = self._base.limiter
        most = math.degrees(self._most.angular)
        limiter.limits = replace(limiter.limits, angular=math.radians(_number(rest, most, "deg/s")))
        return "Max angular velocity set."

    def _stick_linear(self, rest: list[Any]) -> str:
        self._base.full = self._base.full._replace(linear=_number(rest, self._most.linear, "m/s"))
        return "Max joystick linear velocity set."

    def _stick_angular(self, rest: list[Any]) -> str:
        most = math.degrees(self._most.angular)
        self._base.full = self._base.full._replace(angular=_number(rest, most, "deg/s"))
        return "Max joystick angular velocity set."


def _number(rest: list[Any], most: float, unit: str) -> float:
    value = rest[0] if len(rest) == 1 else None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value <= most + 1e-9:
        told = " ".join(map(str, rest)) or "nothing"
        raise ValueError(
            f"one number is needed, above 0 and at most {most:g} {unit}, the robot's own maximum; not {told}"
        )
    return min(float(value), most)


def _filter(rest: list[Any]) -> int:
    value = rest[0] if len(rest) == 1 else None
    if value not in FILTERS or isinstance(value, bool):
        raise ValueError(f"a filter is one of {', '.join(map(str, FILTERS))} Hz, not {value}")
    return int(value)
