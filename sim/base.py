"""The simulated bases: rigid bodies in DART, and the motors that drive their wheels."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from sim.bodies import attach, isometry, yaw_of
from sim.environment import SimError, dartpy
from sim.robot import RobotDescription

Floats = NDArray[np.float64]

STEP_NS = 1_000_000
"""Duration of one DART step."""

TICK_NS = 10_000_000
"""Duration of a tick, the step by which time advances; commands are constant during a tick."""


class BasePose(NamedTuple):
    """A planar pose, in meters and radians."""

    x: float
    y: float
    yaw: float


class Twist(NamedTuple):
    """A planar velocity in the base's own frame, in meters and radians per second."""

    x: float
    y: float
    yaw: float


@dataclass(frozen=True)
class Encoders:
    """A reading of the wheels' encoders."""

    time_ns: int  #: on the simulation's clock
    positions: Floats  #: radians
    velocities: Floats  #: radians per second


class Base(ABC):
    """A base with its wheels, as a DART skeleton."""

    skeleton: Any  #: the DART skeleton
    body: Any  #: the DART body that collides with walls
    wheels: tuple[Any, ...] = ()  #: the DART bodies that roll; they collide only with the floor

    def __init__(self, robot: RobotDescription) -> None:
        self.robot = robot
        self.names = robot.wheels.names  # the names of the wheels' joints

    def _put_on(self, middle: float) -> None:
        """Attach the upper parts to the body, whose origin is ``middle`` meters above the floor."""
        for part in self.robot.body.upper:
            shape = dartpy().dynamics.CylinderShape(part.radius, part.high - part.low)
            attach(self.body, shape, isometry(0.0, 0.0, (part.low + part.high) / 2 - middle), self.robot.body.friction)

    @abstractmethod
    def turn(self, velocities: Sequence[float]) -> None:
        """Set the motors' target velocities, in radians per second."""

    @abstractmethod
    def joints(self) -> tuple[Floats, Floats]:
        """Return the wheels' angles (radians) and velocities (radians per second)."""

    @abstractmethod
    def load(self) -> float:
        """Return the motors' mechanical power, in watts."""

    @abstractmethod
    def pose(self) -> BasePose:
        """Return the true pose, without the odometry's drift."""

    @abstractmethod
    def twist(self) -> Twist:
        """Return the true velocity, which may differ from the commanded velocity."""

    @abstractmethod
    def place(self, pose: BasePose) -> None:
        """Move the base to a pose, at rest; the wheels keep their angles."""

    @abstractmethod
    def matrix(self, radius: float, separation: float) -> Floats:
        """Return the matrix (wheels, 3) from a twist to wheel velocities, for the given wheel geometry."""


def clipped(velocities: Sequence[float], names: Sequence[str], greatest: float) -> list[float]:
    """Limit wheel velocities to ``greatest``; raises `SimError` unless each wheel has one finite velocity."""
    if len(velocities) != len(names):
        raise SimError(f"the base has {len(names)} wheels, not {len(velocities)}")
    if not all(math.isfinite(v) for v in velocities):
        raise SimError(f"wheel velocities {list(velocities)} are not finite")
    return [min(greatest, max(-greatest, float(v))) for v in velocities]


def power(joint: Any, axis: int) -> float:
    """Return a servo's power about an axis of its joint, in watts.

    DART reports the servo's force only as its impulse during one step.
    """
    return abs(float(joint.getConstraintImpulse(axis) * joint.getVelocity(axis))) * 1e9 / STEP_NS


class Differential(Base):
    """A base with two driven wheels and casters, free in space: it can roll, slip and tip, and obstacles stop it.

    For contacts with the floor a wheel is a sphere, because a cylinder would touch the floor at two points and scrub (a
    loop of 20 m then had an error of half a meter). For contacts with walls it is a box on the body. The motors are
    velocity servos with limited torque, so that a wall stalls them.
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
            self._tire(side)
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

    def _tire(self, side: int) -> None:
        """Attach the box that collides with walls in place of a wheel, slightly above the floor."""
        wheels = self.robot.wheels
        low = 0.02
        tire = dartpy().dynamics.BoxShape([1.4 * wheels.radius, wheels.width, 2 * (wheels.radius - low)])
        y = side * (wheels.separation / 2 - wheels.width / 2 + 0.003)
        attach(self.body, tire, isometry(0.0, y, 0.0), self.robot.body.friction)

    @override
    def turn(self, velocities: Sequence[float]) -> None:
        aims = clipped(velocities, self.names, self.robot.wheels.max_velocity)
        for joint, velocity in zip(self._joints, aims, strict=True):
            joint.setCommand(0, velocity)

    @override
    def joints(self) -> tuple[Floats, Floats]:
        left, right = self._joints
        return (
            np.array([left.getPosition(0), right.getPosition(0)]),
            np.array([left.getVelocity(0), right.getVelocity(0)]),
        )

    @override
    def load(self) -> float:
        return sum(power(joint, 0) for joint in self._joints)

    @override
    def pose(self) -> BasePose:
        at = self.body.getTransform()
        x, y, _ = at.translation()
        return BasePose(float(x), float(y), yaw_of(at.rotation()))

    @override
    def twist(self) -> Twist:
        yaw = self.pose().yaw
        vx, vy, _ = self.body.getLinearVelocity()
        c, s = math.cos(yaw), math.sin(yaw)
        return Twist(float(c * vx + s * vy), float(c * vy - s * vx), float(self.body.getAngularVelocity()[2]))

    @override
    def place(self, pose: BasePose) -> None:
        positions = self.skeleton.getPositions()
        positions[:6] = 0.0, 0.0, pose.yaw, pose.x, pose.y, self.robot.wheels.radius
        self.skeleton.setPositions(positions)
        self.skeleton.setVelocities(np.zeros(len(positions)))

    @override
    def matrix(self, radius: float, separation: float) -> Floats:
        return np.array([[1.0, 0.0, -separation / 2], [1.0, 0.0, separation / 2]]) / radius


def _inertia(mass: float, com: tuple[float, float, float], moment: tuple[float, float, float]) -> Any:
    inertia = dartpy().dynamics.Inertia()
    inertia.setMass(mass)
    inertia.setLocalCOM(list(com))
    inertia.setMoment(np.diag(moment))
    return inertia


ANGLES = (150.0, 30.0, -90.0)
"""Directions of the wheels, degrees; from baseControl's ikart_motors.cpp."""

_GRAVITY = 9.81


class Holonomic(Base):
    """Three omnidirectional wheels (ikart_V1); the base moves in the plane.

    The wheels are not separate bodies, because DART's Python package has no wheels that grip in one direction and roll
    in the other. Instead, the base follows the commanded motion with the force that the wheels' torque and grip allow.
    It stalls at obstacles that it cannot push, and the wheels then stop too.
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
        # three wheels at 120 degrees push with 1.5 times the force of one wheel, in any direction
        push = 1.5 * min(wheels.torque / wheels.radius, wheels.friction * body.mass * _GRAVITY / 3)
        for i, force in enumerate((push, push, 2.0 * push * wheels.separation)):
            self._joint.setForceUpperLimit(i, force)
            self._joint.setForceLowerLimit(i, -force)
        self._matrix = self.matrix(wheels.radius, wheels.separation)
        self._inverse = np.linalg.inv(self._matrix)
        self._turned = np.zeros(3)
        self._aim = np.zeros(3)
        self._last = BasePose(0.0, 0.0, 0.0)

    @override
    def turn(self, velocities: Sequence[float]) -> None:
        self._aim = self._inverse @ clipped(velocities, self.names, self.robot.wheels.max_velocity)
        yaw = self._joint.getPosition(2)
        c, s = math.cos(yaw), math.sin(yaw)
        vx, vy, angular = self._aim
        for i, value in enumerate((c * vx - s * vy, s * vx + c * vy, angular)):
            self._joint.setCommand(i, float(value))

    @override
    def joints(self) -> tuple[Floats, Floats]:
        # the motion between two calls is integrated as a straight line, so calls must be frequent
        pose = self.pose()
        last, self._last = self._last, pose
        turned = math.remainder(pose.yaw - last.yaw, 2 * math.pi)
        c, s = math.cos(last.yaw + turned / 2), math.sin(last.yaw + turned / 2)
        dx, dy = pose.x - last.x, pose.y - last.y
        self._turned = self._turned + self._matrix @ (c * dx + s * dy, c * dy - s * dx, turned)
        return self._turned.copy(), self._matrix @ self.twist()

    @override
    def load(self) -> float:
        return sum(power(self._joint, i) for i in range(3))

    @override
    def pose(self) -> BasePose:
        x, y, yaw = self._joint.getPositions()
        return BasePose(float(x), float(y), math.remainder(float(yaw), 2 * math.pi))

    @override
    def twist(self) -> Twist:
        yaw = self._joint.getPosition(2)
        vx, vy, turning = self._joint.getVelocities()
        c, s = math.cos(yaw), math.sin(yaw)
        return Twist(float(c * vx + s * vy), float(c * vy - s * vx), float(turning))

    @override
    def place(self, pose: BasePose) -> None:
        self._joint.setPositions(list(pose))
        self._joint.setVelocities([0.0, 0.0, 0.0])
        self._last = self.pose()

    @override
    def matrix(self, radius: float, separation: float) -> Floats:
        rows = [(-math.cos(math.radians(a)), -math.sin(math.radians(a)), -separation) for a in ANGLES]
        return np.array(rows) / radius
