"""What a base is to the simulation, and the motor interface by which its wheels are driven."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.bodies import attach, isometry, yaw_of
from sim.environment import SimError, dartpy
from sim.robot import RobotDescription

Floats = NDArray[np.float64]

STEP_NS = 1_000_000
"""One step of DART."""


class BasePose(NamedTuple):
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
    """What the wheels' encoders say."""

    time_ns: int  #: when, on the simulation's clock
    positions: Floats  #: radians
    velocities: Floats  #: radians per second


class Base(ABC):
    """A base with its wheels, as bodies in DART."""

    skeleton: Any  #: DART's
    body: Any  #: DART's body that meets walls
    wheels: tuple[Any, ...] = ()  #: DART's bodies that roll, which touch the floor and nothing else

    def __init__(self, robot: RobotDescription) -> None:
        self.robot = robot
        self.names = robot.wheels.names  # of the wheels' joints

    def _put_on(self, middle: float) -> None:
        """Give the body what stands on its hull; its own middle is so many metres above the floor."""
        for part in self.robot.body.upper:
            shape = dartpy().dynamics.CylinderShape(part.radius, part.high - part.low)
            attach(self.body, shape, isometry(0.0, 0.0, (part.low + part.high) / 2 - middle), self.robot.body.friction)

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
    def pose(self) -> BasePose:
        """Where it truly is."""

    @abstractmethod
    def twist(self) -> Twist:
        """How it truly moves."""

    @abstractmethod
    def place(self, pose: BasePose) -> None:
        """Stand it elsewhere, at rest. Its wheels keep their angles."""

    @abstractmethod
    def matrix(self, radius: float, separation: float) -> Floats:
        """Wheel velocities of a twist: (wheels, 3), for wheels that are as believed."""


def clipped(velocities: Sequence[float], names: Sequence[str], greatest: float) -> list[float]:
    """Wheel velocities within what the joints take; raises `SimError` for a wrong number of them, or none finite."""
    if len(velocities) != len(names):
        raise SimError(f"the base has {len(names)} wheels, not {len(velocities)}")
    if not all(math.isfinite(v) for v in velocities):
        raise SimError(f"wheel velocities {list(velocities)} are not finite")
    return [min(greatest, max(-greatest, float(v))) for v in velocities]


def power(joint: Any, axis: int) -> float:
    """What a servo puts out about an axis of its joint, watts; DART tells its force as the impulse of a step."""
    return abs(float(joint.getConstraintImpulse(axis) * joint.getVelocity(axis))) * 1e9 / STEP_NS


class Differential(Base):
    """Two driven wheels and casters, free in space: it rolls, slips, tips and is stopped by what it meets.

    A wheel touches the floor as a sphere: as a cylinder it would touch in two points and scrub (half a metre of error
    in a loop of 20 m, measured). Towards walls it is a tyre, which is part of the body. Motors are velocity servos with
    a greatest torque, so that a wall stalls them.
    """

    def __init__(self, robot: RobotDescription) -> None:
        super().__init__(robot)
        dynamics, wheels, body = dartpy().dynamics, robot.wheels, robot.body
        self.skeleton = dynamics.Skeleton(robot.name)
        self._root, self.body = self.skeleton.createFreeJointAndBodyNodePair()
        self.body.setInertia(_inertia(body.mass - 2 * wheels.mass, body.com, body.inertia))
        middle = (body.low + body.high) / 2 - wheels.radius
        hull = dynamics.CylinderShape(body.radius, body.high - body.low)
        attach(self.body, hull, isometry(0.0, 0.0, middle), body.friction)
        self._put_on(wheels.radius)
        for x, y in robot.casters.at:
            height = robot.casters.radius + robot.casters.gap - wheels.radius
            attach(self.body, dynamics.SphereShape(robot.casters.radius), isometry(x, y, height), 0.0)
        self._joints: list[Any] = []
        rolling = []
        for name, side in zip(wheels.names, (1, -1), strict=True):
            self._tyre(side)
            joint, wheel = self.skeleton.createRevoluteJointAndBodyNodePair(self.body)
            joint.setName(name)
            joint.setAxis([0.0, 1.0, 0.0])
            joint.setTransformFromParentBodyNode(isometry(0.0, side * wheels.separation / 2, 0.0))
            wheel.setInertia(_inertia(wheels.mass, (0.0, 0.0, 0.0), wheels.inertia))
            attach(wheel, dynamics.SphereShape(wheels.radius), isometry(0.0, 0.0, 0.0), wheels.friction)
            joint.setDampingCoefficient(0, wheels.damping)
            joint.setActuatorType(dynamics.ActuatorType.SERVO)
            joint.setForceUpperLimit(0, wheels.torque)
            joint.setForceLowerLimit(0, -wheels.torque)
            self._joints.append(joint)
            rolling.append(wheel)
        self.wheels = tuple(rolling)
        self.skeleton.setSelfCollisionCheck(False)
        self.place(BasePose(0.0, 0.0, 0.0))

    def _tyre(self, side: int) -> None:
        """What walls meet of a wheel: a box as high as it, a little above the floor, on the body."""
        wheels = self.robot.wheels
        low = 0.02
        tyre = dartpy().dynamics.BoxShape([1.4 * wheels.radius, wheels.width, 2 * (wheels.radius - low)])
        y = side * (wheels.separation / 2 - wheels.width / 2 + 0.003)
        attach(self.body, tyre, isometry(0.0, y, 0.0), self.robot.body.friction)

    def turn(self, velocities: Sequence[float]) -> None:
        """See `Base.turn`."""
        aims = clipped(velocities, self.names, self.robot.wheels.max_velocity)
        for joint, velocity in zip(self._joints, aims, strict=True):
            joint.setCommand(0, velocity)

    def joints(self) -> tuple[Floats, Floats]:
        """See `Base.joints`."""
        left, right = self._joints
        return (
            np.array([left.getPosition(0), right.getPosition(0)]),
            np.array([left.getVelocity(0), right.getVelocity(0)]),
        )

    def load(self) -> float:
        """See `Base.load`."""
        return sum(power(joint, 0) for joint in self._joints)

    def pose(self) -> BasePose:
        """See `Base.pose`."""
        at = self.body.getTransform()
        x, y, _ = at.translation()
        return BasePose(float(x), float(y), yaw_of(at.rotation()))

    def twist(self) -> Twist:
        """See `Base.twist`."""
        yaw = self.pose().yaw
        vx, vy, _ = self.body.getLinearVelocity()
        c, s = math.cos(yaw), math.sin(yaw)
        return Twist(float(c * vx + s * vy), float(c * vy - s * vx), float(self.body.getAngularVelocity()[2]))

    def place(self, pose: BasePose) -> None:
        """See `Base.place`."""
        positions = self.skeleton.getPositions()
        positions[:6] = 0.0, 0.0, pose.yaw, pose.x, pose.y, self.robot.wheels.radius
        self.skeleton.setPositions(positions)
        self.skeleton.setVelocities(np.zeros(len(positions)))

    def matrix(self, radius: float, separation: float) -> Floats:
        """See `Base.matrix`."""
        return np.array([[1.0, 0.0, -separation / 2], [1.0, 0.0, separation / 2]]) / radius


def _inertia(mass: float, com: tuple[float, float, float], moment: tuple[float, float, float]) -> Any:
    inertia = dartpy().dynamics.Inertia()
    inertia.setMass(mass)
    inertia.setLocalCOM(list(com))
    inertia.setMoment(np.diag(moment))
    return inertia


ANGLES = (150.0, 30.0, -90.0)
"""Where the wheels stand, degrees; baseControl's ikart_motors.cpp."""

_GRAVITY = 9.81


class Holonomic(Base):
    """Three omnidirectional wheels (ikart_V1): it moves in the plane, pushed by what its wheels can give.

    The wheels are no bodies of their own: the base follows the motion that they are turned for, with the force that
    their torque and their grip on the floor allow, and stalls at what it cannot push; the wheels then stand still with
    it. DART's Python package has no wheels that grip one way and roll the other.
    """

    def __init__(self, robot: RobotDescription) -> None:
        super().__init__(robot)
        dynamics, body, wheels = dartpy().dynamics, robot.body, robot.wheels
        self.skeleton = dynamics.Skeleton(robot.name)
        self._joint, self.body = self.skeleton.createPlanarJointAndBodyNodePair()
        self._joint.setXYPlane()
        inertia = dynamics.Inertia()
        inertia.setMass(body.mass)
        inertia.setMoment(np.diag(body.inertia))
        self.body.setInertia(inertia)
        hull = dynamics.CylinderShape(body.radius, body.high - body.low)
        attach(self.body, hull, isometry(0.0, 0.0, (body.low + body.high) / 2), body.friction)
        self._put_on(0.0)
        self._joint.setActuatorType(dynamics.ActuatorType.SERVO)
        # three wheels at 120 degrees push with 1.5 times what one of them gives, in any direction
        push = 1.5 * min(wheels.torque / wheels.radius, wheels.friction * body.mass * _GRAVITY / 3)
        for i, force in enumerate((push, push, 2.0 * push * wheels.separation)):
            self._joint.setForceUpperLimit(i, force)
            self._joint.setForceLowerLimit(i, -force)
        self._matrix = self.matrix(wheels.radius, wheels.separation)
        self._inverse = np.linalg.inv(self._matrix)
        self._turned = np.zeros(3)
        self._aim = np.zeros(3)
        self._last = BasePose(0.0, 0.0, 0.0)

    def turn(self, velocities: Sequence[float]) -> None:
        """See `Base.turn`."""
        self._aim = self._inverse @ clipped(velocities, self.names, self.robot.wheels.max_velocity)
        yaw = self._joint.getPosition(2)
        c, s = math.cos(yaw), math.sin(yaw)
        vx, vy, turning = self._aim
        for i, value in enumerate((c * vx - s * vy, s * vx + c * vy, turning)):
            self._joint.setCommand(i, float(value))

    def joints(self) -> tuple[Floats, Floats]:
        """See `Base.joints`. Calls are to be close together: the way between two of them counts as straight."""
        pose = self.pose()
        last, self._last = self._last, pose
        turned = math.remainder(pose.yaw - last.yaw, 2 * math.pi)
        c, s = math.cos(last.yaw + turned / 2), math.sin(last.yaw + turned / 2)
        dx, dy = pose.x - last.x, pose.y - last.y
        self._turned = self._turned + self._matrix @ (c * dx + s * dy, c * dy - s * dx, turned)
        return self._turned.copy(), self._matrix @ self.twist()

    def load(self) -> float:
        """See `Base.load`."""
        return sum(power(self._joint, i) for i in range(3))

    def pose(self) -> BasePose:
        """See `Base.pose`."""
        x, y, yaw = self._joint.getPositions()
        return BasePose(float(x), float(y), math.remainder(float(yaw), 2 * math.pi))

    def twist(self) -> Twist:
        """See `Base.twist`."""
        yaw = self._joint.getPosition(2)
        vx, vy, turning = self._joint.getVelocities()
        c, s = math.cos(yaw), math.sin(yaw)
        return Twist(float(c * vx + s * vy), float(c * vy - s * vx), float(turning))

    def place(self, pose: BasePose) -> None:
        """See `Base.place`."""
        self._joint.setPositions(list(pose))
        self._joint.setVelocities([0.0, 0.0, 0.0])
        self._last = self.pose()

    def matrix(self, radius: float, separation: float) -> Floats:
        """See `Base.matrix`."""
        rows = [(-math.cos(math.radians(a)), -math.sin(math.radians(a)), -separation) for a in ANGLES]
        return np.array(rows) / radius
