"""Motion: odometry, velocities and joints. YARP's angles are in degrees."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bridge.messages.errors import ConversionError
from bridge.messages.yarp.natural.kind import Kind, Message, Missing, header, heading, turned
from bridge.messages.yarp.natural.numbers import read_numbers, write_numbers
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer


class _Odometry:
    """``yarp::dev::OdometryData``: pose, velocity in the robot's frame, velocity in the odometry's, each x y theta."""

    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        pose, twist = message["pose"]["pose"], message["twist"]["twist"]
        theta, turn = heading(pose["orientation"]), math.degrees(twist["angular"]["z"])
        ahead, left = twist["linear"]["x"], twist["linear"]["y"]
        cosine, sine = math.cos(math.radians(theta)), math.sin(math.radians(theta))
        out.begin(9)
        for number in (
            pose["position"]["x"], pose["position"]["y"], theta,
            ahead, left, turn,
            ahead * cosine - left * sine, ahead * sine + left * cosine, turn,
        ):  # fmt: skip
            out.float64(number)

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        source.begin()
        x, y, theta, ahead, left, turn, *_ = (source.float64() for _ in range(9))
        source.end()
        return {
            "header": header(stamp_ns, missing.frame or "odom"),
            "child_frame_id": missing.child_frame or "base_link",
            "pose": {"pose": {"position": {"x": x, "y": y}, "orientation": turned(theta)}},
            "twist": {"twist": _twist(ahead, left, turn)},
        }


class _Velocity:
    """``MobileBaseVelocity``: x and y in m/s, theta in degrees/s."""

    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        twist = message.get("twist", message)
        out.begin(3)
        out.float64(twist["linear"]["x"])
        out.float64(twist["linear"]["y"])
        out.float64(math.degrees(twist["angular"]["z"]))

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:  # noqa: ARG002
        source.begin()
        ahead, left, turn = (source.float64() for _ in range(3))
        source.end()
        return _twist(ahead, left, turn)


class _StampedVelocity(_Velocity):
    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        velocity = super().to_ros(source, stamp_ns, missing)
        return {"header": header(stamp_ns, missing.frame or "base_link"), "twist": velocity}


class _Joints:
    """A vector of the joints' positions in degrees, as a control board's ``state:o`` sends it; no names."""

    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            degrees = np.degrees(message["position"])
        write_numbers(out, degrees)

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        with np.errstate(invalid="ignore"):
            positions = np.radians(read_numbers(source))
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
