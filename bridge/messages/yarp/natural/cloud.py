"""Point clouds: `sensor_msgs/msg/PointCloud2` and ``yarp::sig::PointCloud``.

YARP has points of a few fixed kinds, laid out as PCL does. A cloud whose fields lie so is passed on as it is; of others
the numbers that the nearest kind has are copied.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bridge.messages.errors import ConversionError
from bridge.messages.yarp.natural.kind import Kind, Message, Missing, header
from yarp_compat.sig.pointcloud import LAYOUTS, PointCloud, PointType
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer

_DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_UINT32, _FLOAT32 = 6, 7
_COLOURS = ("rgba", "rgb")
_CHOICE = (
    (PointType.XYZ_NORMAL_RGBA, {"x", "y", "z", "normal_x", "color"}),
    (PointType.XYZ_NORMAL, {"x", "y", "z", "normal_x"}),
    (PointType.XYZ_RGBA, {"x", "y", "z", "color"}),
    (PointType.XYZ_I, {"x", "y", "z", "intensity"}),
    (PointType.INTEREST_POINT_XYZ, {"x", "y", "z", "strength"}),
    (PointType.XYZ, {"x", "y", "z"}),
    (PointType.NORMAL, {"normal_x"}),
    (PointType.XY, {"x", "y"}),
)
"""The first kind all of whose names a cloud has."""


class _Cloud:
    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        points = _points(message)
        names = set(points.dtype.names or ()) | ({"color"} if "b" in (points.dtype.names or ()) else set())
        kind = next((kind for kind, wanted in _CHOICE if wanted <= names), None)
        if kind is None:
            raise ConversionError(f"YARP has no points of the fields {', '.join(sorted(names)) or 'none'}")
        layout = LAYOUTS[kind]
        if points.dtype.itemsize == layout.itemsize and _same_places(points.dtype, layout):
            points = np.ascontiguousarray(points).view(layout)
        else:
            points = _copied(points, layout)
        cloud = PointCloud.of(points, dense=bool(message["is_dense"]))
        cloud.write(out)

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        cloud = PointCloud()
        cloud._read(source)
        layout = LAYOUTS[cloud.getPointType()]
        places: Mapping[str, Any] = layout.fields or {}
        fields = [
            {"name": "rgba" if name == "b" else name, "offset": places[name][1],
             "datatype": _UINT32 if name == "b" else _FLOAT32, "count": 1}
            for name in layout.names or () if name not in ("g", "r", "a")
        ]  # fmt: skip
        return {
            "header": header(stamp_ns, missing.frame or "camera"),
            "height": cloud.height(),
            "width": cloud.width(),
            "fields": fields,
            "point_step": layout.itemsize,
            "row_step": layout.itemsize * cloud.width(),
            "data": np.frombuffer(cloud.bytes_of_points(), np.uint8),
            "is_dense": cloud.isDense(),
        }


def _points(message: Mapping[str, Any]) -> np.ndarray:
    """The points as an array of records (height, width), or of one row; a colour's four bytes are ``b g r a``."""
    height, width, step, row = (message[name] for name in ("height", "width", "point_step", "row_step"))
    names: list[str] = []
    formats: list[str] = []
    offsets: list[int] = []
    order = ">" if message["is_bigendian"] else "<"
    for field in message["fields"]:
        letters = _DATATYPES.get(field["datatype"])
        if letters is None or field["offset"] + int(letters[1]) > step:
            raise ConversionError(f"field {field['name']} of the points lies outside of them or has no known type")
        if field["name"] in _COLOURS and letters[1] == "4":
            names += "bgra" if order == "<" else "argb"
            formats += ["u1"] * 4
            offsets += [field["offset"] + n for n in range(4)]
        elif field["name"] not in names:
            names.append(field["name"])
            formats.append(order + letters)
            offsets.append(field["offset"])
    data = message["data"]
    if not step or row < step * width or len(data) < row * height:
        raise ConversionError(f"{height} rows of {width} points of {step} bytes do not fit {len(data)} bytes")
    layout = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    rows = np.asarray(data[: row * height]).reshape(height, row)[:, : step * width]
    found = np.ascontiguousarray(rows).view(layout) if width else np.zeros((height, 0), layout)
    return found if height != 1 else found.reshape(-1)


def _same_places(found: np.dtype[Any], layout: np.dtype[Any]) -> bool:
    have: Mapping[str, Any] = found.fields or {}
    want: Mapping[str, Any] = layout.fields or {}
    return all(name in have and have[name][:2] == place[:2] for name, place in want.items())


def _copied(points: np.ndarray, layout: np.dtype[Any]) -> np.ndarray:
    made = np.zeros(points.shape, layout)
    for name in set(layout.names or ()) & set(points.dtype.names or ()):
        made[name] = points[name]
    return made


KINDS: Mapping[str, Kind] = {"sensor_msgs/msg/PointCloud2": _Cloud()}
