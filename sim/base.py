"""What a base is to the simulation, and the motor interface by which its wheels are driven."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.errors import SimError
from sim.robot import Robot

Floats = NDArray[np.float64]

STEP_NS = 1_000_000
"""One step of DART."""


class Pose(NamedTuple):
    """Where something is: metres, radians."""

    x: float
    y: float
    yaw: float


class Twist(NamedTuple):
    """How fast it moves, in its own frame: metres per second, radians per second."""

    x: float
    y: float
    yaw: float


@dataclass(frozen=True)
class Encoders:
    """What the wheels' encoders say.

    Attributes:
        time_ns: when, on the simulation's clock.
        positions: radians.
        velocities: radians per second.
    """

    time_ns: int
    positions: Floats
    velocities: Floats


class Base(ABC):
    """A base with its wheels, as bodies in DART.

    Attributes:
        names: of the wheels' joints.
        skeleton: DART's.
        wheels: DART's bodies that roll, which touch the floor and nothing else.
        body: DART's body that meets walls.
    """

    skeleton: Any
    body: Any
    wheels: tuple[Any, ...] = ()

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.names = robot.wheels.names

    @abstractmethod
    def turn(self, velocities: Sequence[float]) -> None:
        """Let the motors aim at these velocities (radians per second), until told otherwise."""

    @abstractmethod
    def joints(self) -> tuple[Floats, Floats]:
        """How far the wheels turned, in radians, and how fast they do."""

    @abstractmethod
    def load(self) -> float:
        """What the motors put out, watts."""

    @abstractmethod
    def pose(self) -> Pose:
        """Where it truly is."""

    @abstractmethod
    def twist(self) -> Twist:
        """How it truly moves."""

    @abstractmethod
    def place(self, pose: Pose) -> None:
        """Stand it elsewhere, at rest. Its wheels keep their angles."""

    @abstractmethod
    def matrix(self, radius: float, separation: float) -> Floats:
        """Wheel velocities of a twist: (wheels, 3), for wheels that are as believed."""


def clipped(velocities: Sequence[float], names: Sequence[str], greatest: float) -> list[float]:
    """Wheel velocities within what the joints take.

    Raises:
        SimError: they are not as many as the wheels, or no finite numbers.
    """
    if len(velocities) != len(names):
        msg = f"the base has {len(names)} wheels, not {len(velocities)}"
        raise SimError(msg)
    if not all(math.isfinite(v) for v in velocities):
        msg = f"wheel velocities {list(velocities)} are not finite"
        raise SimError(msg)
    return [min(greatest, max(-greatest, float(v))) for v in velocities]


def power(joint: Any, axis: int) -> float:
    """What a servo puts out about an axis of its joint, watts; DART tells its force as the impulse of a step."""
    return abs(float(joint.getConstraintImpulse(axis) * joint.getVelocity(axis))) * 1e9 / STEP_NS


def make_base(robot: Robot) -> Base:
    """The base that a robot's description says."""
    if robot.kinematics == "differential":
        from sim.differential import Differential

        return Differential(robot)
    from sim.holonomic import Holonomic

    return Holonomic(robot)
