"""Point clouds (`yarp/sig/PointCloud.h`): points in PCL's memory layout, one after another.

On the wire: width, height, the points' type (int32 each) and whether all are finite (1 byte), all without tags; then a
vector with the tag of doubles, whose elements are points. So a cloud is not a valid Bottle and has no text form.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from yarp_compat.overriding import override
from yarp_compat.wire.accessors import getter
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.tags import LIST

_HEADER = struct.Struct("<iiib")
_LIST = struct.Struct("<ii")


class PointType(IntEnum):
    """The point types that YARP sends, as sums of the flags in `yarp/sig/PointCloudTypes.h`."""

    XY = 1 << 0
    XYZ = 1 << 1
    XYZ_RGBA = 1 << 1 | 1 << 2 | 1 << 25
    XYZ_I = 1 << 1 | 1 << 3
    INTEREST_POINT_XYZ = 1 << 1 | 1 << 4
    NORMAL = 1 << 5 | 1 << 6 | 1 << 25
    XYZ_NORMAL = 1 << 1 | 1 << 5 | 1 << 6 | 1 << 25
    XYZ_NORMAL_RGBA = 1 << 1 | 1 << 2 | 1 << 5 | 1 << 6 | 1 << 24


def _layout(size: int, floats: Mapping[str, int], color: int | None = None) -> np.dtype[Any]:
    places = {name: ("<f4", place) for name, place in floats.items()}
    if color is not None:
        places.update({name: ("u1", color + place) for place, name in enumerate("bgra")})
    kinds, offsets = zip(*places.values(), strict=True)
    return np.dtype({"names": list(places), "formats": list(kinds), "offsets": list(offsets), "itemsize": size})


_XYZ = {"x": 0, "y": 4, "z": 8}
_NORMAL = {"normal_x": 16, "normal_y": 20, "normal_z": 24}
LAYOUTS: Mapping[int, np.dtype[Any]] = {
    PointType.XY: _layout(8, {"x": 0, "y": 4}),
    PointType.XYZ: _layout(16, _XYZ),
    PointType.XYZ_RGBA: _layout(32, _XYZ, color=16),
    PointType.XYZ_I: _layout(32, {**_XYZ, "intensity": 16}),
    PointType.INTEREST_POINT_XYZ: _layout(32, {**_XYZ, "strength": 16}),
    PointType.NORMAL: _layout(32, {"normal_x": 0, "normal_y": 4, "normal_z": 8, "curvature": 16}),
    PointType.XYZ_NORMAL: _layout(48, {**_XYZ, **_NORMAL, "curvature": 32}),
    PointType.XYZ_NORMAL_RGBA: _layout(48, {**_XYZ, **_NORMAL, "curvature": 36}, color=32),
}
"""The layout of each point type: the names, types and offsets of its fields, and its size in bytes."""


class PointCloud(Portable):
    """A cloud of any points (subclasses convert them to one type); an unorganized cloud has the ``height`` 1."""

    TYPE = "yarp/pointCloud"
    point: ClassVar[int] = PointType.XYZ  # the initial point type
    fixed: ClassVar[bool] = False  # whether the type is fixed

    def __init__(self, width: int = 0, height: int = 1) -> None:
        self._point = int(self.point)
        self._height = height if width else 0
        self._points: NDArray[Any] = np.zeros(width * height, LAYOUTS[self._point])
        self.dense = True

    @classmethod
    def of(cls, points: NDArray[Any], *, dense: bool = True) -> Self:
        """Return a cloud that shares an array of points (`LAYOUTS`), 1-D or (height, width); raises `ValueError`."""
        cloud = cls()
        kind = cloud._point if cls.fixed else next((kind for kind, form in LAYOUTS.items() if form == points.dtype), 0)
        if points.dtype != LAYOUTS.get(kind):
            raise ValueError(f"cannot make a {cls.__name__} from points of {points.dtype}")
        cloud._point, cloud._height = kind, points.shape[0] if points.ndim == 2 else 1
        cloud._points, cloud.dense = np.ascontiguousarray(points).reshape(-1), dense
        return cloud

    def numpy(self) -> NDArray[Any]:
        """Return the points, row by row, as a view of the cloud's memory."""
        return self._points

    def bytes_of_points(self) -> memoryview:
        """Return the points' bytes, without a copy."""
        return self._points.view(np.uint8).data if self._points.size else memoryview(b"")

    def width(self) -> int:
        """Return the number of points in a row."""
        return len(self._points) // self._height if self._height else 0

    height = getter("_height", int, "The number of rows.")

    def size(self) -> int:
        """Return the number of points."""
        return len(self._points)

    __len__ = size

    getPointType = getter("_point", int, "The point type.")

    def isOrganized(self) -> bool:
        """Return whether the points are in rows, as in an image."""
        return self._height > 1

    isDense = getter("dense", bool, "Whether all points are finite.")
    dataSizeBytes = getter("_points.nbytes", int, "The size of the points in bytes.")

    def wireSizeBytes(self) -> int:
        """Return the size of the points and the header in bytes."""
        return _HEADER.size + self._points.nbytes

    def resize(self, width: int, height: int = 1) -> None:
        """Change the size; points that fit are preserved, new ones are 0."""
        points = np.zeros(width * height, self._points.dtype)
        kept = min(len(points), len(self._points))
        points[:kept] = self._points[:kept]
        self._points, self._height = points, height

    def clear(self) -> None:
        self._points, self._height = self._points[:0], 0

    def push_back(self, point: Any) -> None:
        """Append a point, given as a record or a tuple of fields; the cloud becomes unorganized."""
        self.resize(len(self._points) + 1)
        self._points[-1] = point

    def toString(self) -> str:
        """Return the points as text, one per line."""
        return "\n".join(" ".join(map(str, point)) for point in self._points.tolist())

    toString_c = toString

    def __getitem__(self, index: int) -> Any:
        return self._points[index]

    @override
    def __eq__(self, other: object) -> bool:
        if not isinstance(other, PointCloud):
            return NotImplemented
        mine = (self._point, self._height, self.dense, self._points.tolist())
        return mine == (other._point, other._height, other.dense, other._points.tolist())

    @override
    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.width()} x {self._height} of type {self._point}>"

    @override
    def _write(self, out: ElementWriter) -> None:
        out.raw(_HEADER, self.width(), self._height, self._point, int(self.dense))
        out.begin(len(self._points), out.profile.float64_tag)
        out.block(self.bytes_of_points())

    @override
    def _read(self, source: ElementReader) -> None:
        width, height, kind, dense = source.raw(_HEADER)
        layout = LAYOUTS.get(kind)
        if layout is None:
            raise WireError(f"unknown point type {kind}")
        code, count = source.raw(_LIST)
        if code != LIST | source.profile.float64_tag:
            raise WireError(f"invalid cloud: expected the tag of a list of doubles, not {code}")
        if min(width, height) < 0 or width * height != count:
            raise WireError(f"invalid cloud: {count} points for {width} x {height}")
        points = np.frombuffer(source.block(count * layout.itemsize), layout, count)
        if self.fixed and kind != self._point:
            points, kind = _converted(points, LAYOUTS[self._point]), self._point
        self._point, self._height, self._points, self.dense = kind, height, points, bool(dense)


def _converted(points: NDArray[Any], layout: np.dtype[Any]) -> NDArray[Any]:
    """Convert points to another layout; missing fields become 0."""
    converted = np.zeros(len(points), layout)
    for name in set(layout.names or ()) & set(points.dtype.names or ()):
        converted[name] = points[name]
    return converted


def _class(name: str, point: PointType, doc: str) -> type[PointCloud]:
    return type(name, (PointCloud,), {"fixed": True, "point": point, "__doc__": doc, "__module__": __name__})


PointCloudXY = _class("PointCloudXY", PointType.XY, "A cloud of points in a plane.")
PointCloudXYZ = _class("PointCloudXYZ", PointType.XYZ, "A cloud of points in space.")
PointCloudXYZRGBA = _class("PointCloudXYZRGBA", PointType.XYZ_RGBA, "A cloud of points with a color.")
PointCloudXYZI = _class("PointCloudXYZI", PointType.XYZ_I, "A cloud of points with an intensity.")
PointCloudInterestPointXYZ = _class(
    "PointCloudInterestPointXYZ", PointType.INTEREST_POINT_XYZ, "A cloud of points with a strength."
)
PointCloudNormal = _class("PointCloudNormal", PointType.NORMAL, "A cloud of normals with a curvature.")
PointCloudXYZNormal = _class("PointCloudXYZNormal", PointType.XYZ_NORMAL, "A cloud of points with normals.")
PointCloudXYZNormalRGBA = _class(
    "PointCloudXYZNormalRGBA", PointType.XYZ_NORMAL_RGBA, "A cloud of points with normals and a color."
)
