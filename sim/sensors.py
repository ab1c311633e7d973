"""What the robot senses of itself: odometry, battery, and the faults that a client asks for."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from bridge.config.sections.sim import EncodersSection
from sim.base import Base, BasePose, Encoders, Floats, Twist
from sim.environment import SimError
from sim.robot import BatteryDescription

_ROUNDING = 1e-9
"""rad/s below which a wheel's velocity is a rounding error of the physics: encoders of wheels that stand report 0."""


class Sensed:
    """The encoders as they are read: with the errors that were set, drawn from one source."""

    def __init__(self, base: Base, section: EncodersSection, rng: np.random.Generator) -> None:
        self._base, self._noise, self._rng = base, section.noise, rng
        scale = section.scale or (0.0,) * len(base.names)
        self._scale = 1.0 + np.resize(np.array(scale, float), len(base.names))
        self._last = base.joints()[0]
        self._said = np.zeros(len(base.names))
        self.frozen = False  # whether they do not notice that the wheels turn
        self._unchanged: Encoders | None = None

    def read(self, time_ns: int, *, rests: bool = False) -> Encoders:
        """What they say now; to be called at a steady rate. ``rests``: nothing has moved since the last call."""
        if rests and self._unchanged is not None and not self.frozen:
            if self._noise:
                self._rng.normal(0.0, 1.0, len(self._said))  # a rest changes no number of what comes after it
            return Encoders(time_ns, self._unchanged.positions, self._unchanged.velocities)
        self._unchanged = None
        positions, velocities = self._base.joints()
        if self.frozen:
            # such encoders count steps: those that they miss are lost
            self._last = positions
            return Encoders(time_ns, self._said.copy(), np.zeros(len(velocities)))
        turned = (positions - self._last) * self._scale
        self._last = positions
        if self._noise:
            turned += self._rng.normal(0.0, 1.0, len(turned)) * self._noise * np.sqrt(np.abs(turned))
        self._said = self._said + turned
        velocities = np.where(np.abs(velocities) < _ROUNDING, 0.0, velocities)
        self._unchanged = Encoders(time_ns, self._said.copy(), velocities * self._scale)
        return self._unchanged


@dataclass(frozen=True)
class Estimate:
    """Odometry."""

    time_ns: int  #: when, on the simulation's clock
    pose: BasePose  #: since the start, in its own frame
    twist: Twist  #: in the base's frame
    travelled: float  #: metres
    turned: float  #: radians, either way


class Odometry:
    """Adds up what the wheels turned, with the wheels as the robot believes them to be."""

    def __init__(self, base: Base) -> None:
        believed = base.robot.believed
        self._inverse = np.linalg.pinv(base.matrix(believed.radius, believed.separation))
        self._last: Floats | None = None
        self.now = Estimate(0, BasePose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0), 0.0, 0.0)

    def add(self, encoders: Encoders) -> Estimate:
        """Take up what the encoders say."""
        last = encoders.positions if self._last is None else self._last
        dx, dy, turned = (float(v) for v in self._inverse @ (encoders.positions - last))
        self._last = encoders.positions
        x, y, yaw = self.now.pose
        c, s = math.cos(yaw + turned / 2), math.sin(yaw + turned / 2)
        pose = BasePose(x + c * dx - s * dy, y + s * dx + c * dy, math.remainder(yaw + turned, 2 * math.pi))
        vx, vy, turning = (float(v) for v in self._inverse @ encoders.velocities)
        way, round_ = self.now.travelled + math.hypot(dx, dy), self.now.turned + abs(turned)
        self.now = Estimate(encoders.time_ns, pose, Twist(vx, vy, turning), way, round_)
        return self.now

    def rest(self, time_ns: int) -> None:
        """The encoders say what they said last, at a later time."""
        self.now = replace(self.now, time_ns=time_ns)

    def reset(self) -> None:
        """Begin at zero again."""
        self.now = Estimate(self.now.time_ns, BasePose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0), 0.0, 0.0)


_EFFICIENCY = 0.7  # of the motors: what they put out of what they take


@dataclass(frozen=True)
class Charge:
    """Its state."""

    voltage: float  #: volts
    current: float  #: amperes, negative while it gives
    share: float  #: 0 to 1
    capacity: float  #: ampere hours when full


class Battery:
    """Runs down with time and with what the motors take; at zero it stays there, and the base goes on."""

    def __init__(self, described: BatteryDescription) -> None:
        self._described = described
        self._left = described.capacity
        self._power = described.idle

    def use(self, motors: float, seconds: float) -> None:
        """The motors put out so many watts for so long."""
        self._power = self._described.idle + motors / _EFFICIENCY
        self._left = max(0.0, self._left - self._power * seconds / 3600.0)

    @property
    def charge(self) -> Charge:
        """Its state now."""
        share = self._left / self._described.capacity
        full, empty = self._described.full, self._described.empty
        voltage = empty + (full - empty) * share
        capacity = self._described.capacity / ((full + empty) / 2)
        return Charge(voltage, -self._power / voltage, share, capacity)


KINDS = {
    "laser_silent": "no scans come",
    "laser_blind": "each beam of a scan is NaN",
    "camera_silent": "no depth pictures come",
    "camera_blind": "each pixel of a depth picture is NaN",
    "encoders_silent": "no joint states come, and no odometry",
    "encoders_frozen": "the encoders say that the wheels stand still, whatever they do",
}


class Faults:
    """The faults that a client has asked for, so that those who drive the robot can be seen to notice."""

    def __init__(self) -> None:
        self._now: set[str] = set()

    def __contains__(self, name: str) -> bool:
        return name in self._now

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._now))

    def set(self, name: str, *, on: bool) -> str:
        """Have something fail, or work again; what it means, in words. Raises `SimError` if there is no such fault."""
        if name not in KINDS:
            raise SimError(f"there is no fault {name!r}; there are {', '.join(KINDS)}")
        (self._now.add if on else self._now.discard)(name)
        return f"{name}: {KINDS[name]}" if on else f"{name} is mended"
