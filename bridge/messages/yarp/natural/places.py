"""Places on a map: poses, paths and the map itself, as YARP's navigation has them (``yarp/dev/Map2DLocation.h`` ...).

The map's name is the frame. A location is ``map x y theta description``, theta in degrees.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bridge.messages.yarp.natural.grid import Grid
from bridge.messages.yarp.natural.kind import Kind, Message, Missing, header, heading, turned
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer


def _location(frame: str, pose: Mapping[str, Any]) -> Map2DLocation:
    return Map2DLocation(frame, pose["position"]["x"], pose["position"]["y"], heading(pose["orientation"]))


def _pose(location: Map2DLocation) -> Message:
    return {"position": {"x": location.x, "y": location.y}, "orientation": turned(location.theta)}


def _read_location(source: Reader) -> Map2DLocation:
    found = Map2DLocation()
    found._read(source)
    return found


class _Pose:
    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        _location(message["header"]["frame_id"], message["pose"])._write(out)

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        found = _read_location(source)
        return {"header": header(stamp_ns, missing.frame or found.map_id), "pose": _pose(found)}


class _UncertainPose:
    """The covariance is not said."""

    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        _location(message["header"]["frame_id"], message["pose"]["pose"])._write(out)

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        found = _read_location(source)
        return {"header": header(stamp_ns, missing.frame or found.map_id), "pose": {"pose": _pose(found)}}


class _Path:
    """``Map2DPath``: a list of locations, and a description."""

    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        frame = message["header"]["frame_id"]
        Map2DPath([_location(pose["header"]["frame_id"] or frame, pose["pose"]) for pose in message["poses"]])._write(
            out
        )

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        path = Map2DPath()
        path._read(source)
        found = path.waypoints
        frame = missing.frame or (found[0].map_id if found else "")
        poses = [{"header": header(stamp_ns, missing.frame or one.map_id), "pose": _pose(one)} for one in found]
        return {"header": header(stamp_ns, frame), "poses": poses}


KINDS: Mapping[str, Kind] = {
    "geometry_msgs/msg/PoseStamped": _Pose(),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _UncertainPose(),
    "nav_msgs/msg/Path": _Path(),
    "nav_msgs/msg/OccupancyGrid": Grid(),
}
