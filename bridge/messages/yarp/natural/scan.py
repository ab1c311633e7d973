"""Laser scans: `sensor_msgs/msg/LaserScan` and ``yarp::dev::LaserScan2D``.

``(angle_min angle_max range_min range_max (ranges) status)``, angles in degrees, no echo is infinity. The limits are
those of the other side; YARP does not send the angle between two rays, which its readers take to be the span divided
by the number of rays (``laserFromExternalPort.cpp``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bridge.messages.yarp.natural.kind import Kind, Message, Missing, header
from bridge.messages.yarp.natural.numbers import read_numbers, write_numbers
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer

_IN_USE = 1
"""``IRangefinder2D::DEVICE_OK_IN_USE``."""


class _Scan:
    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        out.begin(6)
        out.float64(math.degrees(message["angle_min"]))
        out.float64(math.degrees(message["angle_max"]))
        out.float64(message["range_min"])
        out.float64(message["range_max"])
        write_numbers(out, message["ranges"].astype(np.float64))
        out.integer(_IN_USE)

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        source.begin()
        low, high = math.radians(source.float64()), math.radians(source.float64())
        nearest, farthest = source.float64(), source.float64()
        ranges = read_numbers(source)
        source.integer()
        source.end()
        return {
            "header": header(stamp_ns, missing.frame or "laser"),
            "angle_min": low,
            "angle_max": high,
            "angle_increment": (high - low) / len(ranges) if len(ranges) else 0.0,
            "range_min": nearest,
            "range_max": farthest,
            "ranges": ranges,
        }


KINDS: Mapping[str, Kind] = {"sensor_msgs/msg/LaserScan": _Scan()}
