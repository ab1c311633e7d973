"""Encoders, odometry and battery of the simulated robot, and the faults that a client can inject."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sim.base import Base, BasePose, Encoders, Floats, Twist
from sim.environment import SimError
from sim.robot import BatteryDescription
from sim.section import EncodersSection

_ROUNDING = 1e-9
"""Wheel velocities below this, rad/s, are rounding errors of the physics: encoders of standing wheels report 0."""


class WheelEncoders:
    """The wheels' encoders, with the configured errors."""

    def __init__(self, base: Base, section: EncodersSection, rng: np.random.Generator) -> None:
        self._base, self._noise, self._rng = base, section.noise, rng
        scale = section.scale or (0.0,) * len(base.names)
        self._scale = 1.0 + np.array(scale, float)
        self._last = base.joints()[0]
        self._reading = np.zeros(len(base.names))
        self.frozen = False  # whether the encoders miss the wheels' rotation
        self._unchanged: Encoders | None = None

    def read(self, time_ns: int, *, rests: bool = False) -> Encoders:
        """Return a reading; call it at a steady rate. ``rests``: nothing has moved since the last call."""
        if rests and self._unchanged is not None and not self.frozen:
            if self._noise:
                # draw random numbers as in motion, because later noise must not depend on whether the base rested
                self._rng.normal(0.0, 1.0, len(self._reading))
            return Encoders(time_ns, self._unchanged.positions, self._unchanged.velocities)
        self._unchanged = None
        positions, velocities = self._base.joints()
        if self.frozen:
            # the encoders are incremental, so they lose the steps that they miss while they are frozen
            self._last = positions
            return Encoders(time_ns, self._reading.copy(), np.zeros(len(velocities)))
        turned = (positions - self._last) * self._scale
        self._last = positions
        if self._noise:
            turned += self._rng.normal(0.0, 1.0, len(turned)) * self._noise * np.sqrt(np.abs(turned))
        self._reading = self._reading + turned
        velocities = np.where(np.abs(velocities) < _ROUNDING, 0.0, velocities)
        self._unchanged = Encoders(time_ns, self._reading.copy(), velocities * self._scale)
        return self._unchanged


@dataclass(frozen=True)
class Estimate:
    """An estimate of the odometry."""

    time_ns: int  #: on the simulation's clock
    pose: BasePose  #: the pose since the start or the last `Odometry.reset`, in the odometry frame
    twist: Twist  #: the velocity in the base's frame
    traveled: float  #: meters
    turned: float  #: radians, the sum of turns to both sides


class Odometry:
    """Integrates encoder readings, with the wheel geometry that the robot assumes."""

    def __init__(self, base: Base) -> None:
        believed = base.robot.believed
        self._inverse = np.linalg.pinv(base.matrix(believed.radius, believed.separation))
        self._last: Floats | None = None
        self.now = Estimate(0, BasePose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0), 0.0, 0.0)

    def add(self, encoders: Encoders) -> Estimate:
        """Add a reading of the wheels' encoders, and return the new estimate."""
        last = encoders.positions if self._last is None else self._last
        dx, dy, turned = (float(v) for v in self._inverse @ (encoders.positions - last))
        self._last = encoders.positions
        x, y, yaw = self.now.pose
        c, s = math.cos(yaw + turned / 2), math.sin(yaw + turned / 2)
        pose = BasePose(x + c * dx - s * dy, y + s * dx + c * dy, math.remainder(yaw + turned, 2 * math.pi))
        vx, vy, turning = (float(v) for v in self._inverse @ encoders.velocities)
        traveled, round_ = self.now.traveled + math.hypot(dx, dy), self.now.turned + abs(turned)
        self.now = Estimate(encoders.time_ns, pose, Twist(vx, vy, turning), traveled, round_)
        return self.now

    def repeat(self, time_ns: int) -> None:
        """Repeat the last estimate with a later time."""
        self.now = replace(self.now, time_ns=time_ns)

    def reset(self) -> None:
        """Set the pose and the distances to zero."""
        self.now = Estimate(self.now.time_ns, BasePose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0), 0.0, 0.0)


_EFFICIENCY = 0.7  # ratio of the motors' mechanical to electrical power


@dataclass(frozen=True)
class Charge:
    """The state of a battery."""

    voltage: float  #: volts
    current: float  #: amperes, negative while it discharges
    share: float  #: 0 to 1
    capacity: float  #: ampere hours when full


class Battery:
    """Discharges with time and with the motors' power. The base also drives on an empty battery."""

    def __init__(self, description: BatteryDescription) -> None:
        self._description = description
        self._left = description.capacity
        self._power = description.idle

    def use(self, motors: float, seconds: float) -> None:
        """Discharge by the motors' mechanical power (watts) over a time in seconds."""
        self._power = self._description.idle + motors / _EFFICIENCY
        self._left = max(0.0, self._left - self._power * seconds / 3600.0)

    @property
    def charge(self) -> Charge:
        share = self._left / self._description.capacity
        full, empty = self._description.full, self._description.empty
        voltage = empty + (full - empty) * share
        capacity = self._description.capacity / ((full + empty) / 2)
        return Charge(voltage, -self._power / voltage, share, capacity)


KINDS = {
    "laser_silent": "no scans are published",
    "laser_blind": "each beam of a scan is NaN",
    "camera_silent": "no depth pictures are published",
    "camera_blind": "each pixel of a depth picture is NaN",
    "encoders_silent": "no joint states and no odometry are published",
    "encoders_frozen": "the encoders report that the wheels stand still",
}


class Faults:
    """The injected faults; tests use them to show that the software that drives the robot detects such faults."""

    def __init__(self) -> None:
        self._now: set[str] = set()

    def __contains__(self, name: str) -> bool:
        return name in self._now

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._now))

    def set(self, name: str, *, on: bool) -> str:
        """Inject or remove a fault, and return a description. Raises `SimError` for an unknown name."""
        if name not in KINDS:
            raise SimError(f"unknown fault {name!r}; the faults are {', '.join(KINDS)}")
        (self._now.add if on else self._now.discard)(name)
        return f"{name}: {KINDS[name]}" if on else f"{name}: removed"
