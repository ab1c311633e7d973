"""An octomap as it crosses ports and lies in files: OctoMap's own stream, and what it is of.

YARP has no such type. In words of `yarpidl_thrift` it is this, so that a C++ program can have it too::

    struct Octomap { 1: string id; 2: bool binary; 3: double resolution; 4: string frame; 5: binary data; }

A program reads it in three lines::

    octomap = port.read()                                  # of a yarp.BufferedPortOctomap
    centers, sizes, log_odds, occupied, _ = octomap.voxels()
    free = octomap.search(1.0, 2.0, 0.5) < 0               # NaN where nothing is known
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
_MOST_HEAD = 4096
MAX_FILE = 256 << 20
"""Bytes of a file that is read."""


@dataclass
class Octomap(Generated):
    """A tree in a frame: the fields are those of ROS's ``octomap_msgs/Octomap``, the data without a file's head."""

    TYPE: ClassVar[str] = "midspan/octomap"

    id: str = "OcTree"  #: OctoMap's class
    binary: bool = True  #: whether the stream is the one of ``.bt``, free or occupied alone, or of ``.ot``
    resolution: float = 0.1  #: edge of the finest cells, metres
    frame: str = ""
    data: bytes = b""

    def __post_init__(self) -> None:
        self._read_tree: tuple[Any, OcTree] | None = None

    @classmethod
    def of(cls, tree: OcTree, *, binary: bool = False, frame: str = "") -> Self:
        """A tree's octomap: in full, or as binary what is likelier."""
        return cls("OcTree", binary, tree.resolution, frame, tree.binary() if binary else tree.full())

    @classmethod
    def from_file(cls, data: bytes) -> Self:
        """The octomap of a ``.bt`` or ``.ot`` file's bytes; raises `OctreeError`, which names what is wrong in it."""
        first, binary = data[:_MOST_HEAD].partition(b"\n")[0].decode("latin-1"), True
        if first.startswith(_FULL):
            binary = False
        elif not first.startswith(_BINARY):
            raise OctreeError(f"it is no octomap: it begins with {first[:40]!r}, not {_BINARY!r} or {_FULL!r}")
        words, start = _head(data)
        try:
            size, resolution = int(words.get("size", "")), float(words.get("res", ""))
        except ValueError:
            raise OctreeError(f"size, res: {words.get('size')}, {words.get('res')} are no numbers") from None
        name = "OcTree" if words.get("id") == "1" else words.get("id", "")
        found = cls(name, binary, resolution, "", data[start:] if size else b"")
        check_resolution(resolution)
        if (nodes := count_nodes(found.data, name, binary=binary)) != size:
            raise OctreeError(f"size: the head says {size} nodes, and the tree has {nodes}")
        return found

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """The octomap of a file; raises `OctreeError` and `OSError`."""
        size = Path(path).stat().st_size
        if size > MAX_FILE:
            raise OctreeError(f"{path} has {size} bytes, and may have {MAX_FILE}")
        return cls.from_file(Path(path).read_bytes())

    def save(self, path: str | Path) -> None:
        """Write a file by its ending, ``.bt`` or ``.ot``; raises `OctreeError` and `OSError`."""
        make = {".bt": self.bt, ".ot": self.ot}.get(Path(path).suffix)
        if make is None:
            raise OctreeError(f"{path} is to end in .bt or .ot")
        Path(path).write_bytes(make())

    def tree(self) -> OcTree:
        """The leaves; raises `OctreeError`, which names the field that is wrong."""
        what = (self.id, self.binary, self.resolution, self.data)
        if self._read_tree is None or self._read_tree[0] != what:
            if self.binary:
                found = OcTree.from_binary(self.data, self.resolution)
            else:
                found = OcTree.from_full(self.data, self.resolution, self.id)
            self._read_tree = what, found
        return self._read_tree[1]

    def voxels(self) -> Voxels:
        """All leaves as arrays: centres and sizes in metres, log-odds, whether occupied; raises `OctreeError`."""
        return self.tree().voxels()

    def search(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Any:
        """Log-odds at a point or points (m) of its frame, NaN where nothing is known; raises `OctreeError`."""
        return self.tree().search(x, y, z)

    def bt(self) -> bytes:
        """A ``.bt`` file of what is likelier; raises `OctreeError`."""
        if self.binary:
            return _file(self.id, self.data, self.resolution, binary=True)
        return _file("OcTree", self.tree().binary(), self.resolution, binary=True)

    def ot(self) -> bytes:
        """A ``.ot`` file; raises `OctreeError`."""
        if not self.binary:
            return _file(self.id, self.data, self.resolution, binary=False)
        return _file("OcTree", self.tree().full(), self.resolution, binary=False)


def _head(data: bytes) -> tuple[dict[str, str], int]:
    """The words of a file's head, and where the stream begins (``AbstractOcTree::readHeader``)."""
    words: dict[str, str] = {}
    start = 0
    while (end := data.find(b"\n", start, _MOST_HEAD)) >= 0:
        line, start = data[start:end].decode("latin-1").split(), end + 1
        if line[:1] == ["data"]:
            return words, start
        if len(line) > 1 and not line[0].startswith("#"):
            words[line[0]] = line[1]
    raise OctreeError(f"data: the head of the file has no such line in {_MOST_HEAD} bytes")


def _file(name: str, data: bytes, resolution: float, *, binary: bool) -> bytes:
    size = count_nodes(data, name, binary=binary)
    first = _BINARY if binary else _FULL
    return f"{first}\n{_COMMENT}id {name}\nsize {size}\nres {resolution:g}\ndata\n".encode() + data
