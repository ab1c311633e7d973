"""A base that is driven: its inputs, its limits and its odometry, without any port or topic."""

from __future__ import annotations

from dataclasses import replace

from bridge.config.sections.base_control import BaseInput
from navigation.base_control.inputs import NOBODY, Arbiter, Input
from navigation.base_control.kinematics import Array
from navigation.base_control.limits import Limiter, smoothed
from navigation.base_control.odometry import Odometry, Travelled
from navigation.base_control.settings import Settings
from navigation.base_control.velocity import STILL

MAX_STEP = 0.1
"""Seconds that one step may count for: after a standstill the base does not catch up on accelerations."""


class Base:
    """Decides each period what the wheels do, and adds up what they did.

    Args:
        settings: what it is and may do.

    Attributes:
        inputs: by name; their ranks are those of the settings.
        limiter: what keeps it within its limits.
        odometry: where it has come to.
        choice: what it drives by.
        idle: whether it is told to stand still, whatever the inputs command.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.inputs = {one.name: Input(one.name, one.timeout) for one in settings.inputs}
        self._arbiter = Arbiter(list(self.inputs.values()), settings.period)
        self.limiter = Limiter(settings.kinematics, settings.limits)
        self.odometry = Odometry(settings.kinematics)
        self.full = settings.full
        self.motors_filter = settings.motors_filter
        self.choice = NOBODY
        self.idle = False
        self._last: float | None = None
        self._told = STILL
        self._measured: float | None = None

    def step(self, now: float) -> Array:
        """The wheels' velocities for the next period, rad/s.

        Args:
            now: seconds, of the clock by which the inputs' commands came.
        """
        seconds = self.settings.period if self._last is None else min(max(now - self._last, 0.0), MAX_STEP)
        self._last = now
        self.choice = self._arbiter.choose(now)
        self.limiter.step(STILL if self.idle else self.choice.velocity, seconds)
        return self.limiter.wheels()

    def measured(self, angles: Array, now: float) -> Travelled:
        """Take the wheels' angles, rad, at a time in seconds; where the base has come to, its velocity smoothed.

        Raises:
            ValueError: they are no angles of these wheels.
        """
        found = self.odometry.update(angles, now)
        seconds = 0.0 if self._measured is None else now - self._measured
        self._measured = now
        if seconds > 0.0:
            self._told = smoothed(self._told, found.velocity, self.motors_filter, seconds)
        return replace(found, velocity=self._told)

    def stop(self) -> None:
        """Forget all commands; the base brakes."""
        self._arbiter.forget()

    def forget(self) -> None:
        """The clock was set back: forget what hangs on it. The pose is kept."""
        self._arbiter.forget()
        self.odometry.restart()
        self._last = self._measured = None

    def input_of(self, one: BaseInput) -> Input:
        """The input of a section."""
        return self.inputs[one.name]
