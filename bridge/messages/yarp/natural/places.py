"""Places on a map: poses, paths and the map itself, as YARP's navigation has them (``yarp/dev/Map2DLocation.h`` ...).

The map's name is the frame. A location is ``map x y theta description``, theta in degrees.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bridge.messages.yarp.natural.grid import Grid
from bridge.messages.yarp.natural.kind import Kind, Message, Missing, header, heading, turned
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer


def write_location(out: Writer, frame: str, pose: Mapping[str, Any]) -> None:
    """``yarp::dev::Nav2D::Map2DLocation``."""
    out.begin(5)
    out.string(frame)
    out.float64(pose["position"]["x"])
    out.float64(pose["position"]["y"])
    out.float64(heading(pose["orientation"]))
    out.string("")


def read_location(source: Reader) -> tuple[str, Message]:
    """The map's name, and a pose on it."""
    source.begin()
    frame, x, y, theta = source.string(), source.float64(), source.float64(), source.float64()
    if source.left:  # YARP before 3.6 had no description
        source.string()
    source.end()
    return frame, {"position": {"x": x, "y": y}, "orientation": turned(theta)}


class _Pose:
    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        write_location(out, message["header"]["frame_id"], message["pose"])

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        frame, pose = read_location(source)
        return {"header": header(stamp_ns, missing.frame or frame), "pose": pose}


class _UncertainPose:
    """The covariance is not said."""

    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        write_location(out, message["header"]["frame_id"], message["pose"]["pose"])

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        frame, pose = read_location(source)
        return {"header": header(stamp_ns, missing.frame or frame), "pose": {"pose": pose}}


class _Path:
    """``Map2DPath``: a list of locations, and a description."""

    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        out.begin(2)
        out.begin(len(message["poses"]))
        for pose in message["poses"]:
            write_location(out, pose["header"]["frame_id"] or message["header"]["frame_id"], pose["pose"])
        out.string("")

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        source.begin()
        found = [read_location(source) for _ in range(source.begin())]
        source.end()
        if source.left:
            source.string()
        source.end()
        frame = missing.frame or (found[0][0] if found else "")
        poses = [{"header": header(stamp_ns, missing.frame or name), "pose": pose} for name, pose in found]
        return {"header": header(stamp_ns, frame), "poses": poses}


KINDS: Mapping[str, Kind] = {
    "geometry_msgs/msg/PoseStamped": _Pose(),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _UncertainPose(),
    "nav_msgs/msg/Path": _Path(),
    "nav_msgs/msg/OccupancyGrid": Grid(),
}
