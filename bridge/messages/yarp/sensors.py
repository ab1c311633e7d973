"""Converts laser scans, point clouds, octomaps and images to and from YARP's own types.

A scan is a ``yarp::dev::LaserScan2D``: ``(angle_min angle_max range_min range_max (ranges) status)``, with angles in
degrees, and infinity for no echo. Apart from the unit of the angles, the limits are passed on unchanged. YARP does not
send the angle between two rays; its readers compute it as the span divided by the number of rays
(``laserFromExternalPort.cpp``).

``yarp::sig::PointCloud`` has points of a few fixed kinds with PCL's layout. A cloud with the layout of such a kind is
passed on unchanged; from other clouds the fields of the best kind are copied. The rows of ``yarp::sig::Image`` are
padded to a multiple of 8 bytes. Depth is sent as floats in meters: millimeters (``16UC1``, REP 118) are converted,
``mono16`` is not.

An octomap has the same form in YARP and in ROS; see `yarp_compat.octomap`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bridge.messages.errors import ConversionError
from bridge.messages.point_cloud import FORMATS, number_format, records
from bridge.messages.yarp.codec import Message, Missing, NaturalType, header
from yarp_compat.dev.rangefinder import LaserScan2D
from yarp_compat.octomap import Octomap
from yarp_compat.sig.image import QUANTUM, FlexImage
from yarp_compat.sig.pixels import PixelCode, format_of
from yarp_compat.sig.pointcloud import LAYOUTS, PointCloud, PointType
from yarp_compat.sig.vector import Vector
from yarp_compat.wire.elements import ElementReader, ElementWriter

_IN_USE = 1  # ``IRangefinder2D::DEVICE_OK_IN_USE``


class _Scan:
    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        low, high = math.degrees(message["angle_min"]), math.degrees(message["angle_max"])
        ranges = Vector.of(message["ranges"])
        LaserScan2D(low, high, message["range_min"], message["range_max"], ranges, _IN_USE)._write(out)

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:
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


_UINT32, _FLOAT32 = 6, 7
_COLORS = ("rgba", "rgb")
_NUMBERS = {name for layout in LAYOUTS.values() for name in layout.names or ()}
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
"""The kinds of points, in order of preference: a cloud is sent as the first kind whose fields it has."""


class _Cloud:
    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        points = _points(message)
        names = set(points.dtype.names or ()) | ({"color"} if "b" in (points.dtype.names or ()) else set())
        kind = next((kind for kind, wanted in _CHOICE if wanted <= names), None)
        if kind is None:
            have = sorted({field["name"] for field in message["fields"]})
            raise ConversionError(f"YARP has no kind of points for the fields {', '.join(have) or 'none'}")
        layout = LAYOUTS[kind]
        if points.dtype.itemsize == layout.itemsize and _has_fields_of(points.dtype, layout):
            points = np.ascontiguousarray(points).view(layout)
        else:
            points = _copy_fields(points, layout)
        cloud = PointCloud.of(points, dense=bool(message["is_dense"]))
        cloud.write(out)

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:
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
    """Return the points as an array of records, (height, width) or (width,); a color is four bytes ``b g r a``.

    Of several fields with the same name, the first is used. A color in four bytes is preferred to separate fields.
    """
    names: list[str] = []
    formats: list[str] = []
    offsets: list[int] = []
    for field in sorted(message["fields"], key=lambda field: field["name"] not in _COLORS):
        name, offset = field["name"], field["offset"]
        color = name in _COLORS and FORMATS.get(field["datatype"]) in ("u4", "i4", "f4")
        if name in names or (color and "b" in names) or not (color or name in _NUMBERS):
            continue
        letters = number_format(message, field)
        if not color:
            names.append(name)
            formats.append(letters)
            offsets.append(offset)
        else:
            names += "argb" if message["is_bigendian"] else "bgra"
            formats += ["u1"] * 4
            offsets += [offset + n for n in range(4)]
    points = records(message, names, formats, offsets)
    return points if len(points) > 1 else points.reshape(-1)


def _has_fields_of(record: np.dtype[Any], layout: np.dtype[Any]) -> bool:
    """Return whether a record has all fields of a layout, with the same types at the same offsets."""
    have: Mapping[str, Any] = record.fields or {}
    want: Mapping[str, Any] = layout.fields or {}
    return all(name in have and have[name][:2] == field[:2] for name, field in want.items())


def _copy_fields(points: np.ndarray, layout: np.dtype[Any]) -> np.ndarray:
    copy = np.zeros(points.shape, layout)
    with np.errstate(over="ignore", invalid="ignore"):  # values beyond float32 become infinite
        for name in set(layout.names or ()) & set(points.dtype.names or ()):
            copy[name] = points[name]
    return copy


_DEPTH = "16UC1"
_CODES = {
    "mono8": PixelCode.MONO,
    "8UC1": PixelCode.MONO,
    "mono16": PixelCode.MONO16,
    _DEPTH: PixelCode.MONO16,
    "rgb8": PixelCode.RGB,
    "bgr8": PixelCode.BGR,
    "8UC3": PixelCode.BGR,
    "rgba8": PixelCode.RGBA,
    "bgra8": PixelCode.BGRA,
    "8UC4": PixelCode.BGRA,
    "8SC1": PixelCode.MONO_SIGNED,
    "8SC3": PixelCode.RGB_SIGNED,
    "32SC1": PixelCode.INT,
    "32SC3": PixelCode.RGB_INT,
    "32FC1": PixelCode.MONO_FLOAT,
    "32FC3": PixelCode.RGB_FLOAT,
    **{
        f"bayer_{code.name.rpartition('_')[2].rstrip('0123456789').lower()}{code.name[-2:].lstrip('BGR')}": code
        for code in PixelCode
        if "BAYER" in code.name
    },
}
"""ROS's encodings (``sensor_msgs/image_encodings.hpp``) and YARP's equivalent pixel codes."""

_ENCODINGS = {code: name for name, code in reversed(_CODES.items())}  # the first encoding of each code


class _Picture:
    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        code = _CODES.get(message["encoding"])
        if code is None:
            raise ConversionError(f"YARP has no pixel code for the encoding {message['encoding']!r}")
        rows = _rows(message, format_of(code).size)
        if message["is_bigendian"] and format_of(code).dtype.itemsize > 1:
            rows = rows.view(format_of(code).dtype.newbyteorder(">")).astype(format_of(code).dtype).view(np.uint8)
        if message["encoding"] == _DEPTH:
            code, rows = PixelCode.MONO_FLOAT, (rows.view("<u2") / np.float32(1000)).astype("<f4").view(np.uint8)
        padding = -rows.shape[1] % QUANTUM
        if padding:
            rows = np.pad(rows, ((0, 0), (0, padding)))
        picture = FlexImage()
        picture.setPixelCode(code)
        picture.setQuantum(QUANTUM)
        picture.setExternal(np.ascontiguousarray(rows), message["width"], message["height"])
        picture.write(out)

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:
        picture = FlexImage()
        picture._read(source)
        name = _ENCODINGS.get(PixelCode(picture.getPixelCode())) if picture.getPixelCode() > 0 else None
        if name is None:
            raise ConversionError(f"ROS has no encoding for pixels of code {picture.getPixelCode()}")
        row = picture.width() * picture.getPixelSize()
        rows = np.frombuffer(picture.getRawImage(), np.uint8).reshape(picture.height(), picture.getRowSize())
        return {
            "header": header(stamp_ns, missing.frame or "camera"),
            "height": picture.height(),
            "width": picture.width(),
            "encoding": name,
            "is_bigendian": 0,
            "step": row,
            "data": rows[:, :row].reshape(-1),
        }


def _rows(message: Mapping[str, Any], pixel: int) -> np.ndarray:
    """Return the image's rows without padding; raises `ConversionError` if the sizes do not fit the data."""
    width, height, step, data = (message[name] for name in ("width", "height", "step", "data"))
    if step < width * pixel or len(data) < step * height:
        raise ConversionError(
            f"{height} rows of {step} bytes for {width} pixels of {message['encoding']} do not fit {len(data)} bytes"
        )
    return np.asarray(data[: step * height]).reshape(height, step)[:, : width * pixel]


class _Octomap:
    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        frame = message["header"]["frame_id"]
        data = bytes(message["data"].view(np.uint8).data)
        Octomap(message["id"], bool(message["binary"]), message["resolution"], frame, data)._write(out)

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:
        octomap = Octomap()
        octomap._read(source)
        return {
            "header": header(stamp_ns, octomap.frame or missing.frame or "map"),
            "binary": octomap.binary,
            "id": octomap.id,
            "resolution": octomap.resolution,
            "data": np.frombuffer(octomap.data, np.int8),
        }


SENSORS: Mapping[str, NaturalType] = {
    "sensor_msgs/msg/LaserScan": _Scan(),
    "sensor_msgs/msg/PointCloud2": _Cloud(),
    "sensor_msgs/msg/Image": _Picture(),
    "octomap_msgs/msg/Octomap": _Octomap(),
}
