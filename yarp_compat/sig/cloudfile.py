"""Point cloud files: PCL's ``.pcd`` and Stanford's ``.ply``, text or binary.

Sources: pointclouds.org, "The PCD (Point Cloud Data) file format" (0.7); Greg Turk's "The PLY Polygon File Format".
Reading keeps the fields of the best matching YARP point type (`yarp_compat.sig.pointcloud`); writing keeps all fields,
in binary little endian.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yarp_compat.sig.pointcloud import LAYOUTS, PointCloud, PointType
from yarp_compat.wire.errors import WireError

MAX_POINTS = 8_000_000  # a file with more points is rejected
MAX_FILE = 512 << 20
"""Size in bytes of the largest file that is read."""

_MOST_HEAD = 8192
_MOST_FIELDS = 64
_KINDS = (
    (PointType.XYZ_NORMAL_RGBA, {"x", "y", "z", "normal_x", "b"}),
    (PointType.XYZ_NORMAL, {"x", "y", "z", "normal_x"}),
    (PointType.XYZ_RGBA, {"x", "y", "z", "b"}),
    (PointType.XYZ_I, {"x", "y", "z", "intensity"}),
    (PointType.INTEREST_POINT_XYZ, {"x", "y", "z", "strength"}),
    (PointType.XYZ, {"x", "y", "z"}),
)
"""Point types with their required fields; a file gets the first type that fits."""
_PLY_NAMES = {"nx": "normal_x", "ny": "normal_y", "nz": "normal_z", "red": "r", "green": "g", "blue": "b", "alpha": "a"}
_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


class CloudFileError(WireError):
    """Raised if a file is not a point cloud; the message names the invalid header line, or gives another reason."""


def load_cloud(path: str | Path) -> PointCloud:
    """Read a ``.pcd`` or ``.ply`` file; raises `CloudFileError` and `OSError`."""
    size = Path(path).stat().st_size
    if size > MAX_FILE:
        raise CloudFileError(f"{path} has {size} bytes; the limit is {MAX_FILE}")
    return read_cloud(Path(path).read_bytes())


def read_cloud(data: bytes) -> PointCloud:
    """Parse the bytes of a ``.pcd`` or ``.ply`` file; raises `CloudFileError`."""
    return _read_ply(data) if data[:3] == b"ply" else _read_pcd(data)


def write_pcd(cloud: PointCloud) -> bytes:
    """Return the cloud as a binary ``.pcd`` file."""
    points, names = _packed(cloud, color="rgba")
    letters = ["U" if points.dtype[name].kind == "u" else "F" for name in names]
    lines = (
        "# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", f"FIELDS {' '.join(names)}",
        f"SIZE {' '.join('4' * len(names))}", f"TYPE {' '.join(letters)}", f"COUNT {' '.join('1' * len(names))}",
        f"WIDTH {cloud.width()}", f"HEIGHT {cloud.height()}", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {cloud.size()}",
        "DATA binary\n",
    )  # fmt: skip
    return "\n".join(lines).encode() + points.tobytes()


def write_ply(cloud: PointCloud) -> bytes:
    """Return the cloud as a binary ``.ply`` file."""
    points, names = _packed(cloud, color="")
    ply_names = {ours: theirs for theirs, ours in _PLY_NAMES.items()}
    kinds = ["uchar" if points.dtype[name].itemsize == 1 else "float" for name in names]
    properties = [f"property {kind} {ply_names.get(name, name)}" for kind, name in zip(kinds, names, strict=True)]
    head = ("ply", "format binary_little_endian 1.0", f"element vertex {cloud.size()}", *properties, "end_header\n")
    return "\n".join(head).encode() + points.tobytes()


def _packed(cloud: PointCloud, color: str) -> tuple[NDArray[Any], list[str]]:
    """Return the points without padding, and their fields; a ``color`` packs the color channels into one field."""
    points = cloud.numpy()
    names = list(points.dtype.names or ())
    merged = color and "b" in names
    fields = [name for name in names if not (merged and name in "gra")]
    kinds = [("rgba" if merged and n == "b" else n, "<u4" if merged and n == "b" else points.dtype[n]) for n in fields]
    packed = np.zeros(len(points), kinds)
    for name in fields:
        if merged and name == "b":
            packed["rgba"] = sum(points[channel].astype("<u4") << (8 * index) for index, channel in enumerate("bgra"))
        else:
            packed[name] = points[name]
    return packed, list(packed.dtype.names or ())


def _lines(data: bytes, end: str) -> tuple[list[list[str]], int]:
    """Return the words of the header's lines, up to the one that begins with ``end``, and the offset of the points."""
    lines: list[list[str]] = []
    start = 0
    while (stop := data.find(b"\n", start, _MOST_HEAD)) >= 0:
        line, start = data[start:stop].decode("latin-1").split(), stop + 1
        if line and not line[0].startswith("#"):
            lines.append(line)
            if line[0] == end:
                return lines, start
    raise CloudFileError(f"{end}: line not found in the first {_MOST_HEAD} bytes; it is not a .pcd or .ply file")


def _int_of(words: list[str], name: str) -> int:
    if len(words) != 1 or not words[0].isdecimal() or len(words[0]) > 10:
        raise CloudFileError(f"{name}: {' '.join(words)[:40]!r} is not a number")
    return int(words[0])


def _read_pcd(data: bytes) -> PointCloud:
    lines, start = _lines(data, "DATA")
    head = {line[0]: line[1:] for line in lines}
    names, sizes, types = (head.get(key, []) for key in ("FIELDS", "SIZE", "TYPE"))
    counts = head.get("COUNT", ["1"] * len(names))
    width, height = (_int_of(head.get(key, []), key) for key in ("WIDTH", "HEIGHT"))
    if not 0 < len(names) == len(sizes) == len(types) == len(counts) <= _MOST_FIELDS:
        raise CloudFileError(f"FIELDS, SIZE, TYPE, COUNT: their lengths differ, or exceed {_MOST_FIELDS} fields")
    columns: list[Any] = []
    for index, (name, size, letter, count) in enumerate(zip(names, sizes, types, counts, strict=True)):
        length = _int_of([count], f"COUNT of {name}")
        if f"{letter}{size}" not in ("I1", "I2", "I4", "I8", "U1", "U2", "U4", "U8", "F4", "F8") or length > 4096:
            raise CloudFileError(f"TYPE, SIZE, COUNT of {name[:40]}: {letter[:8]}{size[:8]}, {count} are not supported")
        field = name if length == 1 and name not in [column[0] for column in columns] else f"{index}_"
        columns.append((field, f"<{letter.lower()}{size}", *([] if length == 1 else [(length,)])))
    form = (head["DATA"] or [""])[0]
    if form not in ("binary", "ascii"):
        raise CloudFileError(
            f"DATA: {form[:40]!r} is not binary or ascii; convert it with pcl_convert_pcd_ascii_binary"
        )
    points = _rows(data, start, np.dtype(columns), width * height, text=form == "ascii")
    return _cloud(points, max(height, 1))


def _read_ply(data: bytes) -> PointCloud:
    lines, start = _lines(data, "end_header")
    form = next((line[1] for line in lines if line[0] == "format" and len(line) > 1), "")
    order = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}.get(form)
    if order is None:
        raise CloudFileError(f"format: {form[:40]!r} is not ascii, binary_little_endian or binary_big_endian")
    elements = [index for index, line in enumerate(lines) if line[0] == "element"]
    if not elements or lines[elements[0]][1:2] != ["vertex"]:
        raise CloudFileError("element: the first must be vertex")
    count = _int_of(lines[elements[0]][2:], "element vertex")
    columns: list[tuple[str, str]] = []
    for line in lines[elements[0] + 1 : (elements[1:] or [len(lines)])[0]]:
        if line[0] != "property":
            continue
        letters = _PLY_TYPES.get(line[1] if len(line) == 3 else "")
        if letters is None or len(columns) >= _MOST_FIELDS:
            raise CloudFileError(f"property: {' '.join(line[1:])[:40]!r} is not a scalar, or one too many")
        name = _PLY_NAMES.get(line[2], line[2])
        columns.append((name if name not in [known for known, _ in columns] else f"{len(columns)}_", order + letters))
    return _cloud(_rows(data, start, np.dtype(columns), count, text=form == "ascii"), 1)


def _rows(data: bytes, start: int, layout: np.dtype[Any], count: int, *, text: bool) -> NDArray[Any]:
    """Return ``count`` points; raises `CloudFileError` if there are fewer, or more than the limit."""
    if count > MAX_POINTS:
        raise CloudFileError(f"the header declares {count} points; the limit is {MAX_POINTS}")
    if not text:
        if len(data) - start < count * layout.itemsize:
            raise CloudFileError(f"the points have {len(data) - start} bytes, not {count * layout.itemsize}")
        return np.frombuffer(data, layout, count, start)
    lines = data[start:].split(b"\n", count)[:count]
    width = sum(int(np.prod(layout[name].shape)) for name in layout.names or ())
    try:
        numbers = np.array([line.split() for line in lines if line.strip()], "S32").astype(np.float64)
    except ValueError as err:
        raise CloudFileError(f"invalid line of points: {str(err)[:80]}") from None
    if numbers.shape != (count, width) and count:
        raise CloudFileError(f"the points are {' x '.join(map(str, numbers.shape))} numbers, not {count} x {width}")
    points, column = np.zeros(count, layout), 0
    with np.errstate(invalid="ignore", over="ignore"):
        for name in layout.names or () if count else ():
            length = int(np.prod(layout[name].shape))
            points[name] = numbers[:, column : column + length].reshape(count, *layout[name].shape)
            column += length
    return points


def _cloud(points: NDArray[Any], height: int) -> PointCloud:
    """Return a cloud of the first type in `_KINDS` whose fields the points have; raises `CloudFileError` if none."""
    names = set(points.dtype.names or ())
    packed = next((name for name in ("rgba", "rgb") if name in names and points.dtype[name].itemsize == 4), "")
    fields = names | ({"b", "g", "r", "a"} if packed else set())
    kind = next((kind for kind, wanted in _KINDS if wanted <= fields), None)
    if kind is None:
        raise CloudFileError(f"the points have only the fields {', '.join(sorted(names))[:80]}; x, y and z are needed")
    converted = np.zeros(len(points), LAYOUTS[kind])
    with np.errstate(invalid="ignore", over="ignore"):
        for name in set(converted.dtype.names or ()) & names:
            converted[name] = points[name]
    if packed and "b" in (converted.dtype.names or ()):
        color = np.ascontiguousarray(points[packed]).view(np.uint8).reshape(-1, 4)
        for channel, name in enumerate("bgra"):
            converted[name] = color[:, channel]
    dense = all(np.isfinite(converted[name]).all() for name in "xyz")
    return PointCloud.of(converted.reshape(height, -1) if height > 1 else converted, dense=dense)
