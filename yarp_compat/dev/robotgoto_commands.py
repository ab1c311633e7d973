"""The commands on the RPC port of robotGoto: its service (`robotGotoMsgs.thrift`, 2026), and its older text commands.

The text commands are ``reset_params``, ``approach DIRECTION SPEED TIME``, ``set linear_tol 0.05`` and
``get navigation_status`` (`robotGotoDev.cpp`); robotPathPlanner sends them even to a newer robotGoto, which does not
support them.
"""

# mypy: disable-error-code="empty-body"
# ruff: noqa: D102 - the names are those of YARP's .thrift file

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from yarp_compat.dev.returnvalue import CallFailed, ReturnValue
from yarp_compat.dev.service import Service, rpc
from yarp_compat.overriding import override
from yarp_compat.wire.values import Vocab

_NUMBERS = {
    "linear_tol": ("SetLinearTolerance", "m"),
    "angular_tol": ("SetAngularTolerance", "deg"),
    "max_lin_speed": ("SetMaxLinearSpeed", "m/s"),
    "max_ang_speed": ("SetMaxAngularSpeed", "deg/s"),
    "min_lin_speed": ("SetMinLinearSpeed", "m/s"),
    "min_ang_speed": ("SetMinAngularSpeed", "deg/s"),
    "lin_speed_gain": ("SetLinearSpeedGain", "gain"),
    "ang_speed_gain": ("SetAngularSpeedGain", "gain"),
}
_SWITCHES = {
    "obstacle_stop": ("SetObstacoleStop", "enable_obstacle_stop"),
    "obstacle_avoidance": ("SetObstacoleAvoidance", "enable_obstacles_avoidance"),
}


@rpc
class RobotGotoMsgs(Service):
    """The methods of robotGoto's RPC port; the text commands call the same methods."""

    def ResetParams(self) -> ReturnValue: ...  # to their initial values
    def Approach(self, dir: float, speed: float, time: float) -> ReturnValue: ...  # noqa: A002 - degrees, m/s, seconds
    def SetLinearTolerance(self, tol: float) -> ReturnValue: ...  # meters
    def SetAngularTolerance(self, tol: float) -> ReturnValue: ...  # degrees
    def SetMaxLinearSpeed(self, maxLin: float) -> ReturnValue: ...  # m/s
    def SetMaxAngularSpeed(self, maxAng: float) -> ReturnValue: ...  # deg/s
    def SetMinLinearSpeed(self, minLin: float) -> ReturnValue: ...
    def SetMinAngularSpeed(self, minAng: float) -> ReturnValue: ...
    def SetLinearSpeedGain(self, LinGain: float) -> ReturnValue: ...  # m/s per meter of distance
    def SetAngularSpeedGain(self, AngGain: float) -> ReturnValue: ...  # deg/s per degree of error
    def SetObstacoleAvoidance(self, enable: bool) -> ReturnValue: ...
    def SetObstacoleStop(self, enable: bool) -> ReturnValue: ...
    def GetNavigationStatus(self) -> tuple[ReturnValue, str]: ...  # ``navigation_status_moving``

    @override
    def command(self, words: list[Any]) -> Sequence[Any] | None:
        verb, *arguments = [str(word) if isinstance(word, str) else word for word in words] or [""]
        if verb == "help":
            return [Vocab("many"), *self._help()]
        if verb == "reset_params":
            _check(self.ResetParams())
            return ["params reset done"]
        if verb == "approach":
            direction, speed, seconds = _numbers(arguments, 3, "approach DIRECTION SPEED TIME")
            _check(self.Approach(direction, speed, seconds))
            return ["approach command received"]
        if verb == "set":
            return [self._set(arguments)]
        if verb == "get":
            return [self._status() if arguments == ["navigation_status"] else "Unknown get."]
        return None

    def _set(self, words: list[Any]) -> str:
        name = words[0] if words and isinstance(words[0], str) else ""
        if name in _NUMBERS:
            (value,) = _numbers(words[1:], 1, f"set {name} NUMBER")
            _check(getattr(self, _NUMBERS[name][0])(value))
            return f"{name} set."
        if name in _SWITCHES:
            method, label = _SWITCHES[name]
            (value,) = _numbers(words[1:], 1, f"set {name} 0|1")
            _check(getattr(self, method)(value != 0))
            return f"{label}={'true' if value else 'false'}"
        return "Unknown set."

    def _status(self) -> str:
        outcome, status = self.GetNavigationStatus()
        _check(outcome)
        return status

    def _help(self) -> list[str]:
        return [
            "Available commands are:",
            "approach <angle in degrees> <linear velocity> <time>",
            "reset_params",
            *(f"set {name} <{unit}>" for name, (_, unit) in _NUMBERS.items()),
            *(f"set {name} <0/1>" for name in _SWITCHES),
            "get navigation_status",
            *type(self).calls(),
        ]


def _numbers(values: list[Any], count: int, usage: str) -> list[float]:
    if len(values) != count or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        raise ValueError(f"usage: {usage}")
    return [float(value) for value in values]


def _check(outcome: ReturnValue) -> None:
    if not outcome:
        raise CallFailed(outcome.code)
