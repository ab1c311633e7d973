"""Converts odometry, velocities, joints, poses, paths and maps to and from YARP's types. YARP's angles are in degrees.

A pose is ``map x y theta description`` (``yarp/dev/Map2DLocation.h``); the map's name is the frame in ROS. A map is a
``yarp::dev::Nav2D::MapGrid2D``. A ROS map gets the flags that YARP assigns to a map without flags: free below an
occupancy of 50, wall from 50 on, or unknown. YARP and ROS have different origins for a rotated map; see
`yarp_compat.dev.mapinfo`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from typing_extensions import override

from bridge.messages.errors import ConversionError
from bridge.messages.yarp.codec import Message, Missing, NaturalType, header, heading, yaw_quaternion
from yarp_compat.dev.basecontrol import MobileBaseVelocity, OdometryData
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapflag import flags_of
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.mapinfo import MapGrid2DOrigin
from yarp_compat.sig.vector import Vector
from yarp_compat.wire.elements import ElementReader, ElementWriter


class _Odometry:
    """``yarp::dev::OdometryData``: the pose, and the velocity in the robot's and the odometry frame, each x y theta."""

    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        pose, twist = message["pose"]["pose"], message["twist"]["twist"]
        theta, turn = heading(pose["orientation"]), math.degrees(twist["angular"]["z"])
        ahead, left = twist["linear"]["x"], twist["linear"]["y"]
        cosine, sine = math.cos(math.radians(theta)), math.sin(math.radians(theta))
        OdometryData(
            pose["position"]["x"], pose["position"]["y"], theta,
            ahead, left, turn,
            ahead * cosine - left * sine, ahead * sine + left * cosine, turn,
        )._write(out)  # fmt: skip

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:
        odometry = OdometryData()
        odometry._read(source)
        position = {"x": odometry.odom_x, "y": odometry.odom_y}
        return {
            "header": header(stamp_ns, missing.frame or "odom"),
            "child_frame_id": missing.child_frame or "base_link",
            "pose": {"pose": {"position": position, "orientation": yaw_quaternion(odometry.odom_theta)}},
            "twist": {"twist": _twist(odometry.base_vel_x, odometry.base_vel_y, odometry.base_vel_theta)},
        }


class _Velocity:
    """``MobileBaseVelocity``: x and y in m/s, theta in degrees/s."""

    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        twist = message.get("twist", message)
        turn = math.degrees(twist["angular"]["z"])
        MobileBaseVelocity(twist["linear"]["x"], twist["linear"]["y"], turn)._write(out)

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:  # noqa: ARG002
        velocity = MobileBaseVelocity()
        velocity._read(source)
        return _twist(velocity.vel_x, velocity.vel_y, velocity.vel_theta)


class _StampedVelocity(_Velocity):
    @override
    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:
        velocity = super().to_ros(source, stamp_ns, missing)
        return {"header": header(stamp_ns, missing.frame or "base_link"), "twist": velocity}


class _Joints:
    """A vector of the joints' positions in degrees, without names, as sent by a control board's ``state:o``."""

    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            degrees = np.degrees(message["position"])
        Vector.of(degrees)._write(out)

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:
        vector = Vector()
        vector._read(source)
        with np.errstate(invalid="ignore"):
            positions = np.radians(vector.numpy())
        names = missing.joints or tuple(f"joint_{number}" for number in range(len(positions)))
        if len(names) != len(positions):
            raise ConversionError(f"there are {len(positions)} joints, but the rule names {len(names)}")
        return {"header": header(stamp_ns, missing.frame), "name": list(names), "position": positions}


def _twist(ahead: float, left: float, turn: float) -> Message:
    return {"linear": {"x": ahead, "y": left}, "angular": {"z": math.radians(turn)}}


class Grid:
    """``yarp::dev::Nav2D::MapGrid2D``."""

    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        """Write the map uncompressed."""
        info = message["info"]
        width, height, position = info["width"], info["height"], info["origin"]["position"]
        if len(message["data"]) != width * height:
            raise ConversionError(f"a map of {width} x {height} cells needs as many values, not {len(message['data'])}")
        cells = np.ascontiguousarray(message["data"].reshape(height, width)[::-1]).view(np.uint8)  # -1 is 255
        yaw = math.radians(heading(info["origin"]["orientation"]))
        try:
            origin = MapGrid2DOrigin.from_ros(position["x"], position["y"], yaw)
            grid = MapGrid2D.of(
                flags_of(cells), cells,
                name=message["header"]["frame_id"], resolution=info["resolution"], origin=origin,
            )  # fmt: skip
        except ValueError as err:
            raise ConversionError(str(err)) from None
        grid.enable_map_compression_over_network(False)
        grid._write(out)

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:
        """Read the map without its flags."""
        grid = MapGrid2D()
        grid._read(source)
        cells = grid.occupancy.astype(np.int16)
        cells[cells > 100] = -1
        head = header(stamp_ns, missing.frame or grid.getMapName())
        x, y, yaw = grid.origin.to_ros()
        return {
            "header": head,
            "info": {
                "map_load_time": head["stamp"],
                "resolution": grid.getResolution(),
                "width": grid.width(),
                "height": grid.height(),
                "origin": {"position": {"x": x, "y": y}, "orientation": yaw_quaternion(math.degrees(yaw))},
            },
            "data": cells[::-1].astype(np.int8).reshape(-1),
        }


def _location(frame: str, pose: Mapping[str, Any]) -> Map2DLocation:
    return Map2DLocation(frame, pose["position"]["x"], pose["position"]["y"], heading(pose["orientation"]))


def _pose(location: Map2DLocation) -> Message:
    return {"position": {"x": location.x, "y": location.y}, "orientation": yaw_quaternion(location.theta)}


class _Pose:
    """``Map2DLocation``, which has no covariance."""

    def __init__(self, *, covariant: bool) -> None:
        self._covariant = covariant

    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        pose = message["pose"]["pose"] if self._covariant else message["pose"]
        _location(message["header"]["frame_id"], pose)._write(out)

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:
        location = Map2DLocation()
        location._read(source)
        pose = {"pose": _pose(location)} if self._covariant else _pose(location)
        return {"header": header(stamp_ns, missing.frame or location.map_id), "pose": pose}


class _Path:
    """``Map2DPath``: a list of locations, and a description."""

    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        frame = message["header"]["frame_id"]
        places = [_location(pose["header"]["frame_id"] or frame, pose["pose"]) for pose in message["poses"]]
        Map2DPath(places)._write(out)

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:
        path = Map2DPath()
        path._read(source)
        waypoints = path.waypoints
        frame = missing.frame or (waypoints[0].map_id if waypoints else "")
        poses = [
            {"header": header(stamp_ns, missing.frame or waypoint.map_id), "pose": _pose(waypoint)}
            for waypoint in waypoints
        ]
        return {"header": header(stamp_ns, frame), "poses": poses}


NAVIGATION: Mapping[str, NaturalType] = {
    "nav_msgs/msg/Odometry": _Odometry(),
    "geometry_msgs/msg/Twist": _Velocity(),
    "geometry_msgs/msg/TwistStamped": _StampedVelocity(),
    "sensor_msgs/msg/JointState": _Joints(),
    "geometry_msgs/msg/PoseStamped": _Pose(covariant=False),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _Pose(covariant=True),
    "nav_msgs/msg/Path": _Path(),
    "nav_msgs/msg/OccupancyGrid": Grid(),
}
