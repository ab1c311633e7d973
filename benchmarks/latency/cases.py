"""The messages of the benchmark in both wire formats; serialized by rosbags, not by Midspan."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from benchmarks.latency.stamps import DIGITS

_STORE = get_typestore(Stores.ROS2_JAZZY)
_T: dict[str, Any] = dict(_STORE.types)
_TEXT_MARK = "#" * DIGITS
_NUMBER_MARK = 123456789.015625
"""Placeholders of the stamp: a text and a float64. Each message contains exactly one of them, once."""


@dataclass(frozen=True, slots=True)
class Case:
    """One kind of message.

    Attributes:
        name: name for display.
        key: part of topic names.
        type: ROS 2's name of the type.
        make: builds the message with the placeholder of the stamp.
        kind: ``small``, ``tf`` or ``large``, which select the limit; or ``numbered``.
        count: messages per measurement.
        rate: messages per second.
    """

    name: str
    key: str
    type: str
    make: Callable[[], Any]
    kind: str
    count: int
    rate: float


@dataclass(frozen=True, slots=True)
class Prepared:
    """A case's message in files, with the offset of the stamp."""

    case: Case
    form: str
    ros1: Path
    ros1_offset: int
    cdr: Path
    cdr_offset: int

    def topic(self, name: str, *, ros1: bool) -> dict[str, Any]:
        """Return a topic in the format of the ends' commands."""
        file, offset = (self.ros1, self.ros1_offset) if ros1 else (self.cdr, self.cdr_offset)
        return {"topic": name, "type": self.case.type, "file": str(file), "offset": offset, "form": self.form}


def prepare(case: Case, folder: Path) -> Prepared:
    """Serialize a case's message for both wires into files."""
    cdr = bytes(_STORE.serialize_cdr(case.make(), case.type))
    ros1 = bytes(_STORE.cdr_to_ros1(cdr, case.type))
    text = _TEXT_MARK.encode()
    mark = text if text in cdr else struct.pack("<d", _NUMBER_MARK)
    files = (folder / f"{case.key}.ros1", folder / f"{case.key}.cdr")
    for file, content in zip(files, (ros1, cdr), strict=True):
        if content.count(mark) != 1:
            msg = f"{case.name}: the mark occurs {content.count(mark)} times"
            raise ValueError(msg)
        file.write_bytes(content)
    form = case.kind if case.kind == "numbered" else "text" if mark == text else "float64"
    return Prepared(case, form, files[0], ros1.index(mark), files[1], cdr.index(mark))


def _header(frame: str = _TEXT_MARK) -> Any:
    return _T["std_msgs/msg/Header"](stamp=_time(), frame_id=frame)


def _time() -> Any:
    return _T["builtin_interfaces/msg/Time"](sec=1700000000, nanosec=123456789)


def _vector(x: float, y: float, z: float) -> Any:
    return _T["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)


def _quaternion() -> Any:
    return _T["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)


def _string() -> Any:
    return _T["std_msgs/msg/String"](data=_TEXT_MARK + "x" * (100 - DIGITS))


def _twist() -> Any:
    return _T["geometry_msgs/msg/Twist"](linear=_vector(_NUMBER_MARK, 0.0, 0.0), angular=_vector(0.0, 0.0, 0.5))


def _transforms(frame: str = _TEXT_MARK) -> Any:
    transform = _T["geometry_msgs/msg/Transform"]
    headers = [_header(frame)] + [_header(f"link_{i}") for i in range(1, 20)]
    stamped = [
        _T["geometry_msgs/msg/TransformStamped"](
            header=header,
            child_frame_id=f"arm_link_{i}",
            transform=transform(translation=_vector(0.1 * i, 0.2, 0.3), rotation=_quaternion()),
        )
        for i, header in enumerate(headers)
    ]
    return _T["tf2_msgs/msg/TFMessage"](transforms=stamped)


def _scan() -> Any:
    return _T["sensor_msgs/msg/LaserScan"](
        header=_header(), angle_min=-3.14, angle_max=3.14, angle_increment=0.0087, time_increment=0.0, scan_time=0.1,
        range_min=0.05, range_max=30.0, ranges=np.linspace(0.5, 9.0, 720, dtype=np.float32),
        intensities=np.zeros(0, np.float32),
    )  # fmt: skip


def _grid() -> Any:
    pose = _T["geometry_msgs/msg/Pose"](
        position=_T["geometry_msgs/msg/Point"](x=0.0, y=0.0, z=0.0), orientation=_quaternion()
    )
    info = _T["nav_msgs/msg/MapMetaData"](map_load_time=_time(), resolution=0.05, width=1000, height=1000, origin=pose)
    cells = np.random.default_rng(1).integers(0, 2, 1_000_000).astype(np.int8) * 100
    return _T["nav_msgs/msg/OccupancyGrid"](header=_header(), info=info, data=cells)


def _image(width: int, height: int) -> Any:
    pixels = np.random.default_rng(2).integers(0, 256, width * height, dtype=np.uint8)
    return _T["sensor_msgs/msg/Image"](
        header=_header(), height=height, width=width, encoding="mono8", is_bigendian=0, step=width, data=pixels
    )


CASES = (
    Case("String 100 B", "string", "std_msgs/msg/String", _string, "small", 300, 150.0),
    Case("Twist", "twist", "geometry_msgs/msg/Twist", _twist, "small", 300, 150.0),
    Case("TFMessage of 20", "tf", "tf2_msgs/msg/TFMessage", _transforms, "tf", 300, 150.0),
    Case("LaserScan 720", "scan", "sensor_msgs/msg/LaserScan", _scan, "small", 300, 150.0),
    Case("OccupancyGrid 1000x1000", "grid", "nav_msgs/msg/OccupancyGrid", _grid, "large", 60, 30.0),
    Case("Image 1 MB", "image1", "sensor_msgs/msg/Image", lambda: _image(1000, 1000), "large", 60, 30.0),
    Case("Image 6 MB", "image6", "sensor_msgs/msg/Image", lambda: _image(3000, 2000), "large", 30, 10.0),
)

BACKGROUND = CASES[0]
"""The message of the idle and the busy background topics."""

NUMBERED = Case("String 100 B", "numbered", "std_msgs/msg/String", _string, "numbered", 0, 10.0)
"""A message with space for a number after its stamp."""

NUMBERED_TF = Case(
    "TFMessage of 20", "numbered_tf", "tf2_msgs/msg/TFMessage", lambda: _transforms(_TEXT_MARK + "x" * DIGITS),
    "numbered", 0, 2000.0,
)  # fmt: skip
"""A transform message with space for a number after its stamp."""
