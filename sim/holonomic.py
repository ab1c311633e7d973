"""A base with three omnidirectional wheels (ikart_V1). It moves in the plane, pushed by what its wheels can give.

The wheels are no bodies of their own: the base follows the motion that they are turned for, with the force that their
torque and their grip on the floor allow, and stalls at what it cannot push; the wheels then stand still with it. DART's
Python package has no wheels that grip one way and roll the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sim.base import Base, Floats, Pose, Twist, clipped, power
from sim.bodies import attach, isometry
from sim.dart import dartpy
from sim.robot import Robot

ANGLES = (150.0, 30.0, -90.0)
"""Where the wheels stand, degrees; baseControl's ikart_motors.cpp."""

_GRAVITY = 9.81


class Holonomic(Base):
    """See the module."""

    def __init__(self, robot: Robot) -> None:
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
        self._last = Pose(0.0, 0.0, 0.0)

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

    def pose(self) -> Pose:
        """See `Base.pose`."""
        x, y, yaw = self._joint.getPositions()
        return Pose(float(x), float(y), math.remainder(float(yaw), 2 * math.pi))

    def twist(self) -> Twist:
        """See `Base.twist`."""
        yaw = self._joint.getPosition(2)
        vx, vy, turning = self._joint.getVelocities()
        c, s = math.cos(yaw), math.sin(yaw)
        return Twist(float(c * vx + s * vy), float(c * vy - s * vx), float(turning))

    def place(self, pose: Pose) -> None:
        """See `Base.place`."""
        self._joint.setPositions(list(pose))
        self._joint.setVelocities([0.0, 0.0, 0.0])
        self._last = self.pose()

    def matrix(self, radius: float, separation: float) -> Floats:
        """See `Base.matrix`."""
        rows = [(-math.cos(math.radians(a)), -math.sin(math.radians(a)), -separation) for a in ANGLES]
        return np.array(rows) / radius
