"""Octomaps at ports and in files: OctoMap's stream with its metadata.

YARP lacks this type. C++ programs can define it for `yarpidl_thrift`::

    struct Octomap { 1: string id; 2: bool binary; 3: double resolution; 4: string frame; 5: binary data; }

A program reads it in three lines::

    octomap = port.read()                                  # of a yarp.BufferedPortOctomap
    centers, sizes, log_odds, occupied, _ = octomap.voxels()
    free = octomap.search(1.0, 2.0, 0.5) < 0               # NaN where unknown
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

from numpy.typing import ArrayLike

from yarp_compat.dev.fields import Generated
from yarp_compat.octree import OcTree, OctreeError, Voxels, check_resolution, count_nodes

_FULL, _BINARY = "# Octomap OcTree file", "# Octomap OcTree binary file"
_COMMENT = "# (feel free to add / change comments, but leave the first line as it is!)\n#\n"
_MAX_HEADER = 4096
MAX_FILE = 256 << 20
"""Bytes of the largest accepted file."""


@dataclass
class Octomap(Generated):
    """A tree in a frame, with the fields of ROS's ``octomap_msgs/Octomap``; the data has no file header."""

    TYPE: ClassVar[str] = "midspan/octomap"

    id: str = "OcTree"  #: the class of OctoMap
    binary: bool = True  #: whether the stream has the format of ``.bt`` (only free or occupied) instead of ``.ot``
    resolution: float = 0.1  #: edge of the finest cells, meters
    frame: str = ""
    data: bytes = b""

    def __post_init__(self) -> None:
        self._read_tree: tuple[Any, OcTree] | None = None

    @classmethod
    def of(cls, tree: OcTree, *, binary: bool = False, frame: str = "") -> Self:
        """Make an octomap from a tree, with log-odds, or if ``binary`` only with each leaf's likelier state."""
        return cls("OcTree", binary, tree.resolution, frame, tree.binary() if binary else tree.full())

    @classmethod
    def from_file(cls, data: bytes) -> Self:
        """Parse the bytes of a ``.bt`` or ``.ot`` file; raises `OctreeError`, which names the invalid part."""
        first, binary = data[:_MAX_HEADER].partition(b"\n")[0].decode("latin-1"), True
        if first.startswith(_FULL):
            binary = False
        elif not first.startswith(_BINARY):
            raise OctreeError(f"not an octomap: it begins with {first[:40]!r}, not {_BINARY!r} or {_FULL!r}")
        header, start = _header(data)
        try:
            size, resolution = int(header.get("size", "")), float(header.get("res", ""))
        except ValueError:
            raise OctreeError(f"size, res: {header.get('size')}, {header.get('res')} are not numbers") from None
        name = "OcTree" if header.get("id") == "1" else header.get("id", "")
        octomap = cls(name, binary, resolution, "", data[start:] if size else b"")
        check_resolution(resolution)
        if (nodes := count_nodes(octomap.data, name, binary=binary)) != size:
            raise OctreeError(f"size: {size} nodes in the header, but {nodes} in the tree")
        return octomap

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a file; raises `OctreeError` and `OSError`."""
        size = Path(path).stat().st_size
        if size > MAX_FILE:
            raise OctreeError(f"{path} has {size} bytes, more than {MAX_FILE}")
        return cls.from_file(Path(path).read_bytes())

    def save(self, path: str | Path) -> None:
        """Write a file in the format of its suffix, ``.bt`` or ``.ot``; raises `OctreeError` and `OSError`."""
        make = {".bt": self.bt, ".ot": self.ot}.get(Path(path).suffix)
        if make is None:
            raise OctreeError(f"the suffix of {path} must be .bt or .ot")
        Path(path).write_bytes(make())

    def tree(self) -> OcTree:
        """Return the decoded tree, which is cached; raises `OctreeError`, which names the invalid field."""
        key = (self.id, self.binary, self.resolution, self.data)
        if self._read_tree is None or self._read_tree[0] != key:
            if self.binary:
                tree = OcTree.from_binary(self.data, self.resolution)
            else:
                tree = OcTree.from_full(self.data, self.resolution, self.id)
            self._read_tree = key, tree
        return self._read_tree[1]

    def voxels(self) -> Voxels:
        """Return all leaves as arrays: centers and sizes in meters, log-odds, occupied; raises `OctreeError`."""
        return self.tree().voxels()

    def search(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Any:
        """Return the log-odds at a point or points (m) in the frame, NaN where unknown; raises `OctreeError`."""
        return self.tree().search(x, y, z)

    def bt(self) -> bytes:
        """Return a ``.bt`` file with the likelier state of each leaf; raises `OctreeError`."""
        if self.binary:
            return _file(self.id, self.data, self.resolution, binary=True)
        return _file("OcTree", self.tree().binary(), self.resolution, binary=True)

    def ot(self) -> bytes:
        """Return a ``.ot`` file; raises `OctreeError`."""
        if not self.binary:
            return _file(self.id, self.data, self.resolution, binary=False)
        return _file("OcTree", self.tree().full(), self.resolution, binary=False)


def _header(data: bytes) -> tuple[dict[str, str], int]:
    """Return the values of a file's header, and the start of the stream (``AbstractOcTree::readHeader``)."""
    values: dict[str, str] = {}
    start = 0
    while (end := data.find(b"\n", start, _MAX_HEADER)) >= 0:
        line, start = data[start:end].decode("latin-1").split(), end + 1
        if line[:1] == ["data"]:
            return values, start
        if len(line) > 1 and not line[0].startswith("#"):
            values[line[0]] = line[1]
    raise OctreeError(f"data: no such line in the first {_MAX_HEADER} bytes of the file")


def _file(name: str, data: bytes, resolution: float, *, binary: bool) -> bytes:
    size = count_nodes(data, name, binary=binary)
    first = _BINARY if binary else _FULL
    return f"{first}\n{_COMMENT}id {name}\nsize {size}\nres {resolution:g}\ndata\n".encode() + data
