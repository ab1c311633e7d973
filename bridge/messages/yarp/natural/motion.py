"""Motion: odometry, velocities and joints. YARP's angles are in degrees."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bridge.messages.errors import ConversionError
from bridge.messages.yarp.natural.kind import Kind, Message, Missing, header, heading, turned
from yarp_compat.dev.odometry import MobileBaseVelocity, OdometryData
from yarp_compat.sig.vector import Vector
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer


class _Odometry:
    """``yarp::dev::OdometryData``: pose, velocity in the robot's frame, velocity in the odometry's, each x y theta."""

    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        pose, twist = message["pose"]["pose"], message["twist"]["twist"]
        theta, turn = heading(pose["orientation"]), math.degrees(twist["angular"]["z"])
        ahead, left = twist["linear"]["x"], twist["linear"]["y"]
        cosine, sine = math.cos(math.radians(theta)), math.sin(math.radians(theta))
        OdometryData(
            pose["position"]["x"], pose["position"]["y"], theta,
            ahead, left, turn,
            ahead * cosine - left * sine, ahead * sine + left * cosine, turn,
        )._write(out)  # fmt: skip

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        found = OdometryData()
        found._read(source)
        position = {"x": found.odom_x, "y": found.odom_y}
        return {
            "header": header(stamp_ns, missing.frame or "odom"),
            "child_frame_id": missing.child_frame or "base_link",
            "pose": {"pose": {"position": position, "orientation": turned(found.odom_theta)}},
            "twist": {"twist": _twist(found.base_vel_x, found.base_vel_y, found.base_vel_theta)},
        }


class _Velocity:
    """``MobileBaseVelocity``: x and y in m/s, theta in degrees/s."""

    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        twist = message.get("twist", message)
        turn = math.degrees(twist["angular"]["z"])
        MobileBaseVelocity(twist["linear"]["x"], twist["linear"]["y"], turn)._write(out)

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:  # noqa: ARG002
        found = MobileBaseVelocity()
        found._read(source)
        return _twist(found.vel_x, found.vel_y, found.vel_theta)


class _StampedVelocity(_Velocity):
    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        velocity = super().to_ros(source, stamp_ns, missing)
        return {"header": header(stamp_ns, missing.frame or "base_link"), "twist": velocity}


class _Joints:
    """A vector of the joints' positions in degrees, as a control board's ``state:o`` sends it; no names."""

    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            degrees = np.degrees(message["position"])
        Vector.of(degrees)._write(out)

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        found = Vector()
        found._read(source)
        with np.errstate(invalid="ignore"):
            positions = np.radians(found.numpy())
        names = missing.joints or tuple(f"joint_{number}" for number in range(len(positions)))
        if len(names) != len(positions):
            raise ConversionError(f"there are {len(positions)} joints, and the rule names {len(names)}")
        return {"header": header(stamp_ns, missing.frame), "name": list(names), "position": positions}


def _twist(ahead: float, left: float, turn: float) -> Message:
    return {"linear": {"x": ahead, "y": left}, "angular": {"z": math.radians(turn)}}


KINDS: Mapping[str, Kind] = {
    "nav_msgs/msg/Odometry": _Odometry(),
    "geometry_msgs/msg/Twist": _Velocity(),
    "geometry_msgs/msg/TwistStamped": _StampedVelocity(),
    "sensor_msgs/msg/JointState": _Joints(),
}
