"""A base with two driven wheels and casters, free in space: it rolls, slips, tips and is stopped by what it meets.

A wheel touches the floor as a sphere: as a cylinder it would touch in two points and scrub (half a metre of error in a
loop of 20 m, measured). Towards walls it is a tyre, which is part of the body. Motors are velocity servos with a
greatest torque, so that a wall stalls them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from sim.base import Base, Floats, Pose, Twist, clipped, power
from sim.bodies import attach, isometry, yaw_of
from sim.dart import dartpy
from sim.robot import Robot


class Differential(Base):
    """See the module."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        dynamics, wheels, body = dartpy().dynamics, robot.wheels, robot.body
        self.skeleton = dynamics.Skeleton(robot.name)
        self._root, self.body = self.skeleton.createFreeJointAndBodyNodePair()
        self.body.setInertia(_inertia(body.mass - 2 * wheels.mass, body.com, body.inertia))
        middle = (body.low + body.high) / 2 - wheels.radius
        hull = dynamics.CylinderShape(body.radius, body.high - body.low)
        attach(self.body, hull, isometry(0.0, 0.0, middle), body.friction)
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
        self.place(Pose(0.0, 0.0, 0.0))

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

    def pose(self) -> Pose:
        """See `Base.pose`."""
        at = self.body.getTransform()
        x, y, _ = at.translation()
        return Pose(float(x), float(y), yaw_of(at.rotation()))

    def twist(self) -> Twist:
        """See `Base.twist`."""
        yaw = self.pose().yaw
        vx, vy, _ = self.body.getLinearVelocity()
        c, s = math.cos(yaw), math.sin(yaw)
        return Twist(float(c * vx + s * vy), float(c * vy - s * vx), float(self.body.getAngularVelocity()[2]))

    def place(self, pose: Pose) -> None:
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
