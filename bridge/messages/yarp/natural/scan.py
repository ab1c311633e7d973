"""Laser scans: `sensor_msgs/msg/LaserScan` and ``yarp::dev::LaserScan2D``.

``(angle_min angle_max range_min range_max (ranges) status)``, angles in degrees, no echo is infinity. The limits are
those of the other side; YARP does not send the angle between two rays, which its readers take to be the span divided
by the number of rays (``laserFromExternalPort.cpp``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bridge.messages.yarp.natural.kind import Kind, Message, Missing, header
from yarp_compat.dev.laserscan import LaserScan2D
from yarp_compat.sig.vector import Vector
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer

_IN_USE = 1
"""``IRangefinder2D::DEVICE_OK_IN_USE``."""


class _Scan:
    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        low, high = math.degrees(message["angle_min"]), math.degrees(message["angle_max"])
        ranges = Vector.of(message["ranges"])
        LaserScan2D(low, high, message["range_min"], message["range_max"], ranges, _IN_USE)._write(out)

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        scan = LaserScan2D()
        scan._read(source)
        low, high, ranges = math.radians(scan.angle_min), math.radians(scan.angle_max), scan.scans.numpy()
        return {
            "header": header(stamp_ns, missing.frame or "laser"),
            "angle_min": low,
            "angle_max": high,
            "angle_increment": (high - low) / len(ranges) if len(ranges) else 0.0,
            "range_min": scan.range_min,
            "range_max": scan.range_max,
            "ranges": ranges,
        }


KINDS: Mapping[str, Kind] = {"sensor_msgs/msg/LaserScan": _Scan()}
