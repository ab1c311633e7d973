"""How a base moves and is told to (`yarp/dev/OdometryData.h`, `MobileBaseVelocity.h`)."""

from __future__ import annotations

from dataclasses import dataclass

from yarp_compat.dev.structure import Generated


@dataclass
class OdometryData(Generated):
    """Where a base has come to and how fast it is.

    Attributes:
        odom_x: where it is, metres.
        odom_y: where it is, metres.
        odom_theta: where it points, degrees.
        base_vel_x: its speed in its own frame, metres per second.
        base_vel_y: its speed in its own frame, metres per second.
        base_vel_theta: its turning, degrees per second.
        odom_vel_x: its speed in the odometry's frame, metres per second.
        odom_vel_y: its speed in the odometry's frame, metres per second.
        odom_vel_theta: its turning, degrees per second.
    """

    odom_x: float = 0.0
    odom_y: float = 0.0
    odom_theta: float = 0.0
    base_vel_x: float = 0.0
    base_vel_y: float = 0.0
    base_vel_theta: float = 0.0
    odom_vel_x: float = 0.0
    odom_vel_y: float = 0.0
    odom_vel_theta: float = 0.0


@dataclass
class MobileBaseVelocity(Generated):
    """A velocity to drive at.

    Attributes:
        vel_x: forward, metres per second.
        vel_y: to the left, metres per second.
        vel_theta: turning, degrees per second, counterclockwise.
    """

    vel_x: float = 0.0
    vel_y: float = 0.0
    vel_theta: float = 0.0
