"""A mobile base: its inputs, limits and odometry, and the commands of its RPC port."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from navigation.base_control.commands import NO_CHOICE, STILL, Arbiter, CommandInput, FullControl
from navigation.base_control.kinematics import Array, Traveled, WheelOdometry, kinematics
from navigation.base_control.limits import Limiter, low_pass
from navigation.base_control.section import FILTERS, BaseControlSection
from navigation.base_control.settings import limits
from navigation.yarp import Commands

MAX_STEP = 0.1  # the longest step in seconds, so that the base does not catch up on accelerations after a stall
_PUSHED = 1.5  # a wheel of a pushed base may turn this many times faster than its maximum velocity
SETTLED, REPEAT = 0.5, 0.04
"""Seconds of zero commands after which the base counts as stopped, and the seconds between two commands from then on,
which are less than half the time-out of the wheels' driver."""


class DrivenBase:
    """Computes the wheels' velocities in each period, and their odometry."""

    def __init__(self, section: BaseControlSection) -> None:
        self.section, self.most = section, limits(section)
        base = kinematics(section.kind, section.wheel_radius, section.wheel_distance)
        # in the order of their ranks
        self.inputs = {source.name: CommandInput(source.name, source.timeout) for source in section.inputs}
        self._arbiter = Arbiter(list(self.inputs.values()), section.period)
        self.limiter = Limiter(base, self.most)
        self.odometry = WheelOdometry(base, _PUSHED * self.most.wheel)
        self.full = FullControl(section.joystick_linear_vel, section.joystick_angular_vel)
        self.motors_filter: int = section.motors_filter
        self.choice = NO_CHOICE  # the command of the current period
        self.idle = False  # whether the base ignores its inputs and stays stopped
        self._still = 0  # consecutive periods with a command of zero
        self._last: float | None = None
        self._smoothed = STILL
        self._measured: float | None = None

    def step(self, now: float) -> Array:
        """Return the wheels' velocities for the next period, rad/s; ``now`` is in seconds of the commands' clock."""
        seconds = self.section.period if self._last is None else min(max(now - self._last, 0.0), MAX_STEP)
        self._last = now
        self.choice = self._arbiter.choose(now)
        self.limiter.step(STILL if self.idle else self.choice.velocity, seconds)
        return self.limiter.wheels()

    def measured(self, angles: Sequence[float], now: float, rates: Sequence[float] | None = None) -> Traveled:
        """Add an encoder reading, and return the pose with a smoothed velocity.

        ``angles`` are in rad, read at the time ``now`` in seconds; ``rates`` are in rad/s, None if the encoders do not
        measure them. Raises `ValueError` unless there is one finite angle for each wheel.
        """
        traveled = self.odometry.update(angles, now, rates)
        seconds = 0.0 if self._measured is None else now - self._measured
        self._measured = now
        if seconds > 0.0:
            self._smoothed = low_pass(self._smoothed, traveled.velocity, self.motors_filter, seconds)
        return traveled if self._smoothed is traveled.velocity else replace(traveled, velocity=self._smoothed)

    def due(self, velocities: Array) -> bool:
        """Return whether to send the result of `step` to the wheels: always while they turn, else at intervals."""
        self._still = 0 if velocities.any() else self._still + 1
        period = self.section.period
        return self._still * period < SETTLED or self._still % max(1, round(REPEAT / period)) == 0

    def stop(self) -> None:
        """Discard all commands; the base brakes."""
        self._arbiter.clear()

    def restart(self) -> None:
        """Discard all times but keep the pose; called after the clock has jumped back."""
        self._arbiter.clear()
        self.odometry.restart()
        self._last = self._measured = None


HELP = (
    "help: list the commands",
    "run: follow the inputs",
    "idle: stop and ignore the inputs",
    "reset_odometry: set the odometry to zero",
    "set_prefilter 0|1|2|4|8: cut-off frequency of the commands' filter, Hz; 0 for no filter",
    "set_motors_filter 0|1|2|4|8: cut-off frequency of the measured velocities' filter, Hz; 0 for no filter",
    "set_max_lin_vel V: meters per second",
    "set_max_ang_vel V: degrees per second",
    "set_max_joy_lin_vel V: meters per second at 100 percent of a joystick",
    "set_max_joy_ang_vel V: degrees per second at 100 percent of a joystick",
)

_ELSEWHERE = {
    "change_pid": "the controllers are in the driver of the motors; nothing was changed",
    "change_ctrl_mode": "the wheels are driven by velocity; nothing was changed",
    "set_debug_mode": "use midspan status instead; nothing was changed",
}
"""Commands of robotology's baseControl for parts that this module does not have, and the reply to each."""


class BaseCommands(Commands):
    """Responds to commands of the RPC port, on the module's thread."""

    def __init__(self, base: DrivenBase) -> None:
        self._base = base
        super().__init__(HELP, {
            "run": lambda _arguments: self._idle("Following the inputs.", on=False),
            "idle": lambda _arguments: self._idle("Stopped; 'run' follows the inputs again.", on=True),
            "reset_odometry": self._reset,
            "set_prefilter": self._prefilter,
            "set_motors_filter": self._motors_filter,
            "set_max_lin_vel": partial(self._limit, "linear"),
            "set_max_ang_vel": partial(self._limit, "angular"),
            "set_max_joy_lin_vel": partial(self._stick, "linear"),
            "set_max_joy_ang_vel": partial(self._stick, "angular"),
            **{command: partial(_refuse, command) for command in _ELSEWHERE},
        })  # fmt: skip

    def _idle(self, reply: str, *, on: bool) -> str:
        self._base.idle = on
        return reply

    def _reset(self, _arguments: list[Any]) -> str:
        self._base.odometry.reset()
        return "Odometry reset done."

    def _prefilter(self, arguments: list[Any]) -> str:
        limiter = self._base.limiter
        limiter.limits = replace(limiter.limits, filter_hz=_filter(arguments))
        return "Prefilter set."

    def _motors_filter(self, arguments: list[Any]) -> str:
        self._base.motors_filter = _filter(arguments)
        return "Motors filter set."

    def _limit(self, axis: str, arguments: list[Any]) -> str:
        limiter, value = self._base.limiter, self._number(axis, arguments)
        new: dict[str, Any] = {axis: value if axis == "linear" else math.radians(value)}
        limiter.limits = replace(limiter.limits, **new)
        return f"Max {axis} velocity set."

    def _stick(self, axis: str, arguments: list[Any]) -> str:
        self._base.full = self._base.full._replace(**{axis: self._number(axis, arguments)})
        return f"Max joystick {axis} velocity set."

    def _number(self, axis: str, arguments: list[Any]) -> float:
        """Return the velocity in the arguments, m/s or deg/s; raises `ValueError` if it exceeds the robot's maximum."""
        limit = self._base.most
        most, unit = (limit.linear, "m/s") if axis == "linear" else (math.degrees(limit.angular), "deg/s")
        value = arguments[0] if len(arguments) == 1 else None
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value <= most + 1e-9:
            received = " ".join(map(str, arguments)) or "nothing"
            raise ValueError(
                f"the command needs one number above 0 and at most {most:g} {unit}, the robot's maximum, not {received}"
            )
        return min(float(value), most)


def _refuse(command: str, _arguments: list[Any]) -> str:
    raise ValueError(f"{command}: {_ELSEWHERE[command]}")


def _filter(arguments: list[Any]) -> int:
    value = arguments[0] if len(arguments) == 1 else None
    if value not in FILTERS or isinstance(value, bool):
        raise ValueError(f"a filter must be one of {', '.join(map(str, FILTERS))} Hz, not {value}")
    return int(value)
