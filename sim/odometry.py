"""Where the base believes to be, from its wheels' encoders alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bridge.config.sections.sim import EncodersSection
from sim.base import Base, Encoders, Floats, Pose, Twist


class Sensed:
    """The encoders as they are read: with the errors that were set, drawn from one source.

    Args:
        base: whose wheels.
        section: the errors.
        rng: where noise comes from.

    Attributes:
        frozen: whether they do not notice that the wheels turn.
    """

    def __init__(self, base: Base, section: EncodersSection, rng: np.random.Generator) -> None:
        self._base, self._noise, self._rng = base, section.noise, rng
        scale = section.scale or (0.0,) * len(base.names)
        self._scale = 1.0 + np.resize(np.array(scale, float), len(base.names))
        self._last = base.joints()[0]
        self._said = np.zeros(len(base.names))
        self.frozen = False

    def read(self, time_ns: int) -> Encoders:
        """What they say now; to be called at a steady rate."""
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
        return Encoders(time_ns, self._said.copy(), velocities * self._scale)


@dataclass(frozen=True)
class Estimate:
    """Odometry.

    Attributes:
        time_ns: when, on the simulation's clock.
        pose: since the start, in its own frame.
        twist: in the base's frame.
        travelled: metres.
        turned: radians, either way.
    """

    time_ns: int
    pose: Pose
    twist: Twist
    travelled: float
    turned: float


class Odometry:
    """Adds up what the wheels turned, with the wheels as the robot believes them to be."""

    def __init__(self, base: Base) -> None:
        believed = base.robot.believed
        self._inverse = np.linalg.pinv(base.matrix(believed.radius, believed.separation))
        self._last: Floats | None = None
        self.now = Estimate(0, Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0), 0.0, 0.0)

    def add(self, encoders: Encoders) -> Estimate:
        """Take up what the encoders say."""
        last = encoders.positions if self._last is None else self._last
        dx, dy, turned = (float(v) for v in self._inverse @ (encoders.positions - last))
        self._last = encoders.positions
        x, y, yaw = self.now.pose
        c, s = math.cos(yaw + turned / 2), math.sin(yaw + turned / 2)
        pose = Pose(x + c * dx - s * dy, y + s * dx + c * dy, math.remainder(yaw + turned, 2 * math.pi))
        vx, vy, turning = (float(v) for v in self._inverse @ encoders.velocities)
        way, round_ = self.now.travelled + math.hypot(dx, dy), self.now.turned + abs(turned)
        self.now = Estimate(encoders.time_ns, pose, Twist(vx, vy, turning), way, round_)
        return self.now

    def reset(self) -> None:
        """Begin at zero again."""
        self.now = Estimate(self.now.time_ns, Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0), 0.0, 0.0)
