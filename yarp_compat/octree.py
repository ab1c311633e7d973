"""OctoMap's occupancy octrees: their leaves as arrays, and OctoMap's binary and full streams.

A tree divides the cube of 65,536 cells per side around the origin into eighths, 16 times. A leaf is identified by its
Morton code, three bits per level (x lowest, then y, then z), and its depth. Leaves are sorted by their codes, which is
the order of OctoMap's streams: depth first, from the root.

In a binary stream (``writeBinaryNode`` in `OccupancyOcTreeBase.hxx`), each inner node has 16 bits, two per child from
the lowest bits up: 0 unknown, 1 free leaf, 2 occupied leaf, 3 inner node. In a full stream (``writeNodesRecurs`` in
`OcTreeBaseImpl.hxx`), each node has its log-odds (float32), three bytes of color if the tree is a ``ColorOcTree``, and
a bit mask of its children.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yarp_compat.wire.errors import WireError

DEPTH = 16
"""Levels below the root."""
MIDDLE = 1 << (DEPTH - 1)
"""The key of the cell that begins at 0 m."""
FREE, OCCUPIED = (math.log(odds / (1 - odds)) for odds in (0.1192, 0.971))
"""The log-odds of leaves of a binary tree: OctoMap's clamping thresholds (`AbstractOccupancyOcTree.cpp`)."""
KINDS = {"OcTree": 5, "OcTreeStamped": 5, "ColorOcTree": 8}
"""OctoMap's classes whose full streams are supported, and their bytes per node (OctoMap writes no stamps)."""
MAX_NODES = 1 << 23
"""Larger trees are rejected before memory is allocated for their leaves: reading a tree of this size takes 450 MB,
writing it as a binary stream 650 MB. A map that fills Mapper3D's default memory (256 MB) has 3.5 to 5.5 million nodes:
61 to 97 per block of 8 x 8 x 8 cells."""

_CODES = np.uint64
_SPREAD = (
    (32, 0xFFFF00000000FFFF), (16, 0x00FF0000FF0000FF), (8, 0xF00F00F00F00F00F), (4, 0x30C30C30C30C30C3),
    (2, 0x9249249249249249),
)  # fmt: skip
_EIGHT = np.arange(8)
_AT_ONCE = 1 << 18  # nodes per step of the search for children


class OctreeError(WireError):
    """Raised for a stream, file or arrays that are not an octree; the text names the invalid part and its position."""


class Voxels(NamedTuple):
    """The leaves of a tree, sorted by their Morton codes."""

    centers: NDArray[np.float32]  #: (N, 3), meters
    sizes: NDArray[np.float32]  #: (N,) edges, meters
    log_odds: NDArray[np.float32]  #: (N,)
    occupied: NDArray[np.bool_]  #: (N,) whether the log-odds are above 0, OctoMap's default threshold
    colors: NDArray[np.uint8] | None  #: (N, 3) red, green and blue, of a full ``ColorOcTree``


class OcTree:
    """A tree as its leaves: ``codes`` (ascending), ``depths`` (1 to 16; 0 is the whole cube) and ``log_odds``."""

    __slots__ = ("codes", "colors", "depths", "log_odds", "resolution")

    def __init__(
        self,
        resolution: float,
        codes: NDArray[Any],
        depths: NDArray[Any],
        log_odds: NDArray[Any],
        colors: NDArray[np.uint8] | None = None,
    ) -> None:
        check_resolution(resolution)
        self.resolution = resolution
        self.codes = np.asarray(codes, _CODES)  #: of each leaf's lowest cell, three bits per level, 48 in total
        self.depths = np.asarray(depths, np.uint8)
        self.log_odds = np.asarray(log_odds, np.float32)
        self.colors = colors

    @classmethod
    def of(cls, keys: ArrayLike, log_odds: ArrayLike, depths: ArrayLike = DEPTH, *, resolution: float) -> Self:
        """Make a tree of leaves in any order; ``keys`` (N, 3) has OctoMap's key of any cell of each leaf.

        Keys are 0 to 65,535; the cell with the key 32,768 begins at 0 m. Raises `OctreeError` if leaves overlap, or
        numbers are invalid.
        """
        cells, values = np.asarray(keys), np.asarray(log_odds, np.float32)
        if cells.ndim != 2 or cells.shape[1] != 3 or (cells.size and not 0 <= cells.min() <= cells.max() < 2 * MIDDLE):
            raise OctreeError(f"keys must be (N, 3) integers from 0 to {2 * MIDDLE - 1}, not {cells.shape}")
        levels = np.broadcast_to(np.asarray(depths, np.int64), len(cells))
        values = np.broadcast_to(values, len(cells))
        if len(cells) and not 0 <= levels.min() <= levels.max() <= DEPTH:
            raise OctreeError(f"depths must be 0 to {DEPTH}, not {levels.min()} to {levels.max()}")
        if not np.isfinite(values).all():
            raise OctreeError("log_odds contains numbers that are not finite")
        shift = _shifts(levels)
        codes = codes_of(cells) >> shift << shift
        order = np.argsort(codes, kind="stable")
        codes, levels, values = codes[order], levels[order], values[order]
        ends = codes + (_CODES(1) << shift[order])
        if (ends[:-1] > codes[1:]).any():
            raise OctreeError("keys contains overlapping leaves")
        return cls(resolution, codes, levels, values)

    @classmethod
    def from_binary(cls, data: bytes | NDArray[Any], resolution: float) -> Self:
        """Decode a binary stream; raises `OctreeError`. Bytes after the tree are ignored."""
        check_resolution(resolution)
        pairs = _binary_children(data)
        codes, depths = _locate(pairs == 3, DEPTH - 1)  # of inner nodes; leaves are one level below them
        rows, children = np.nonzero((pairs == 1) | (pairs == 2))
        levels = depths[rows] + 1
        leaves = codes[rows] + (children.astype(_CODES) << _shifts(levels))
        order = np.argsort(leaves, kind="stable")
        values = np.where(pairs[rows, children] == 2, np.float32(OCCUPIED), np.float32(FREE))
        return cls(resolution, leaves[order], levels[order], values[order])

    @classmethod
    def from_full(cls, data: bytes | NDArray[Any], resolution: float, kind: str = "OcTree") -> Self:
        """Decode a full stream of one of ``KINDS``; raises `OctreeError`. Values of inner nodes are dropped."""
        check_resolution(resolution)
        nodes, masks = _full_nodes(data, kind)
        codes, depths = _locate(np.unpackbits(masks[:, None], axis=1, bitorder="little").view(bool), DEPTH)
        leaves = masks == 0
        rows = nodes[leaves]
        values = rows[:, :4].copy().view("<f4").reshape(-1)
        if not np.isfinite(values).all():
            raise OctreeError(f"data: the log-odds of leaf {np.flatnonzero(~np.isfinite(values))[0]} are not finite")
        return cls(resolution, codes[leaves], depths[leaves], values, rows[:, 4:7].copy() if kind[0] == "C" else None)

    def __len__(self) -> int:
        return len(self.codes)

    def voxels(self) -> Voxels:
        """Return the leaves in meters."""
        edges = self.edges()
        centers = (self.keys() - float(MIDDLE) + edges[:, None] / 2) * self.resolution
        sizes = (edges * self.resolution).astype(np.float32)
        return Voxels(centers.astype(np.float32), sizes, self.log_odds, self.log_odds > 0, self.colors)

    def edges(self) -> NDArray[np.int64]:
        """Return each leaf's edge in cells of the finest level."""
        return np.left_shift(1, DEPTH - self.depths.astype(np.int64))

    def keys(self) -> NDArray[np.uint16]:
        """Return OctoMap's keys (N, 3) of each leaf's lowest cell."""
        return keys_of(self.codes)

    def search(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Any:
        """Return the log-odds at points (m), NaN where unknown: a float for numbers, an array for arrays."""
        points = np.stack(np.broadcast_arrays(*(np.asarray(axis, np.float64) for axis in (x, y, z))), axis=-1)
        shape = points.shape[:-1]
        with np.errstate(invalid="ignore"):
            cells = np.floor(points.reshape(-1, 3) / self.resolution) + MIDDLE
            inside = ((cells >= 0) & (cells < 2 * MIDDLE)).all(axis=1)
        result = np.full(len(cells), np.nan, np.float32)
        if len(self):
            wanted = codes_of(cells[inside].astype(np.int64))
            leaf = np.searchsorted(self.codes, wanted, side="right") - 1
            hit = (leaf >= 0) & (wanted - self.codes[leaf] < _CODES(1) << _shifts(self.depths[leaf]))
            result[inside] = np.where(hit, self.log_odds[leaf], np.float32(np.nan))
        return result.reshape(shape) if shape else float(result[0])

    def pruned(self) -> Self:
        """Return a tree, without colors, in which eight leaves that have equal values and fill a node are merged."""
        codes, depths, values = self.codes, self.depths, self.log_odds
        for level in range(DEPTH, 0, -1):
            leaves = np.flatnonzero(depths == level)
            parents = codes[leaves] >> _shift(level - 1)
            starts = _starts(parents)
            full = np.diff(starts, append=len(leaves)) == 8
            if not full.any():
                continue
            level_values = values[leaves]
            full &= np.maximum.reduceat(level_values, starts) == np.minimum.reduceat(level_values, starts)
            merged = leaves[(starts[full][:, None] + _EIGHT[1:]).reshape(-1)]
            depths = depths.copy()
            depths[leaves[starts[full]]] -= 1
            keep = np.ones(len(codes), bool)
            keep[merged] = False
            codes, depths, values = codes[keep], depths[keep], values[keep]
        return type(self)(self.resolution, codes, depths, values)

    def binary(self) -> bytes:
        """Encode leaves as free or occupied in a pruned stream, like OctoMap's ``writeBinary``; empty if none."""
        likely = np.where(self.log_odds > 0, np.float32(OCCUPIED), np.float32(FREE))
        tree = type(self)(self.resolution, self.codes, self.depths, likely).pruned()
        if len(tree) == 1 and tree.depths[0] == 0:  # the stream begins below the root
            value = tree.log_odds[0]
            tree = type(self)(self.resolution, _EIGHT.astype(_CODES) << _shift(1), np.ones(8), np.full(8, value))
        nodes = _Nodes.from_tree(tree)
        pairs = np.where(nodes.masks != 0, 3, np.where(nodes.values > 0, 2, 1)).astype(np.uint16)
        return nodes.binary(pairs)

    def full(self) -> bytes:
        """Encode the full stream of an ``OcTree``; inner nodes have their children's maximum. Empty without leaves."""
        return _Nodes.from_tree(self).full()


class _Nodes(NamedTuple):
    """All nodes of a tree, parents before children."""

    codes: NDArray[np.uint64]
    depths: NDArray[np.uint8]
    values: NDArray[np.float32]
    masks: NDArray[np.uint8]  # bit masks of the children

    @classmethod
    def from_tree(cls, tree: OcTree) -> _Nodes:
        """Return the leaves and their ancestors, computed level by level from the finest up."""
        levels = []
        codes, values, masks = _none()
        for level in range(DEPTH, -1, -1):
            at = tree.depths == level
            codes = np.concatenate([codes, tree.codes[at]])
            order = np.argsort(codes, kind="stable")
            codes = codes[order]
            values = np.concatenate([values, tree.log_odds[at]])[order]
            masks = np.concatenate([masks, np.zeros(len(codes) - len(masks), np.uint8)])[order]
            levels.append(cls(codes, np.full(len(codes), level, np.uint8), values, masks))
            if not level or not len(codes):
                codes, values, masks = _none()
                continue
            parents = codes >> _shift(level - 1)
            starts = _starts(parents)
            child = np.uint8(1) << (codes >> _shift(level) & _CODES(7)).astype(np.uint8)
            codes, values = parents[starts] << _shift(level - 1), np.maximum.reduceat(values, starts)
            masks = np.bitwise_or.reduceat(child, starts)
        parts: list[Any] = [np.concatenate(part) for part in zip(*levels, strict=True)]
        order = np.argsort(_preorder(parts[0], parts[1]), kind="stable")
        return cls(*(part[order] for part in parts))

    def full(self) -> bytes:
        """Encode the full stream."""
        rows = np.empty((len(self.codes), 5), np.uint8)
        rows[:, :4] = self.values.astype("<f4")[:, None].view(np.uint8)
        rows[:, 4] = self.masks
        return rows.tobytes()

    def binary(self, pairs: NDArray[np.uint16]) -> bytes:
        """Encode the binary stream; ``pairs`` has the two bits that represent each node in its parent."""
        below = np.flatnonzero(self.depths > 0)
        levels = self.depths[below].astype(np.int64)
        places = (self.codes[below] >> _shifts(levels) & _CODES(7)).astype(np.uint16)
        shift = _shifts(levels - 1)
        inner = np.flatnonzero(self.masks != 0)
        order = _preorder(self.codes[inner], self.depths[inner])
        parents = np.searchsorted(order, _preorder(self.codes[below] >> shift << shift, levels - 1))
        masks = np.zeros(len(inner), "<u2")
        np.bitwise_or.at(masks, parents, pairs[below] << (places * np.uint16(2)))
        return masks.tobytes()


def check_resolution(resolution: float) -> None:
    """Raise `OctreeError` if the edge of a cell is invalid."""
    if not (math.isfinite(resolution) and resolution > 0):
        raise OctreeError(f"the resolution must be above 0 m, not {resolution}")


def count_nodes(data: bytes | NDArray[Any], kind: str, *, binary: bool) -> int:
    """Return the number of nodes in a stream, for the header of an OctoMap file; raises `OctreeError`."""
    if not len(data):
        return 0
    return int(np.count_nonzero(_binary_children(data))) + 1 if binary else len(_full_nodes(data, kind)[1])


def codes_of(keys: NDArray[Any]) -> NDArray[np.uint64]:
    """Return the Morton codes of OctoMap keys (N, 3)."""
    bits = keys.astype(_CODES)
    for shift, mask in _SPREAD:
        bits = (bits | bits << _CODES(shift)) & _CODES(mask)
    return np.asarray(bits[:, 0] | bits[:, 1] << _CODES(1) | bits[:, 2] << _CODES(2))


def keys_of(codes: NDArray[np.uint64]) -> NDArray[np.uint16]:
    """Return OctoMap's keys (N, 3) of Morton codes."""
    bits = (codes[:, None] >> np.arange(3, dtype=_CODES)) & _CODES(_SPREAD[-1][1])
    for (shift, _), (_, mask) in zip(_SPREAD[:0:-1], _SPREAD[-2::-1], strict=True):
        bits = (bits | bits >> _CODES(shift)) & _CODES(mask)
    return ((bits | bits >> _CODES(32)) & _CODES(0xFFFF)).astype(np.uint16)


def _shift(level: int) -> np.uint64:
    """Return the number of bits of a code below a level."""
    return _CODES(3 * (DEPTH - level))


def _shifts(levels: NDArray[Any]) -> NDArray[np.uint64]:
    return (3 * (DEPTH - levels.astype(np.int64))).astype(_CODES)


def _starts(groups: NDArray[Any]) -> NDArray[np.int64]:
    """Return the index at which each run of equal numbers starts."""
    return np.flatnonzero(np.concatenate([np.ones(min(1, len(groups)), bool), groups[1:] != groups[:-1]]))


def _none() -> tuple[NDArray[np.uint64], NDArray[np.float32], NDArray[np.uint8]]:
    return np.zeros(0, _CODES), np.zeros(0, np.float32), np.zeros(0, np.uint8)


def _preorder(codes: NDArray[np.uint64], depths: NDArray[Any]) -> NDArray[np.uint64]:
    """Return sort keys for the order of nodes in a stream: parents precede their first child."""
    return codes << _CODES(5) | depths.astype(_CODES)


def _array(data: bytes | NDArray[Any]) -> NDArray[np.uint8]:
    return data.view(np.uint8) if isinstance(data, np.ndarray) else np.frombuffer(data, np.uint8)


def _binary_children(data: bytes | NDArray[Any]) -> NDArray[np.uint8]:
    """Return the two bits of each child (N, 8) of each inner node of a binary stream."""
    array = _array(data)
    rows = array[: len(array) // 2 * 2].reshape(-1, 2)
    inner = np.array([sum(byte >> place & 3 == 3 for place in range(0, 8, 2)) for byte in range(256)], np.int8)
    count = _tree_size(inner[rows[:, 0]] + inner[rows[:, 1]], len(array))
    pairs = (rows[:count, :, None] >> np.arange(0, 8, 2, dtype=np.uint8) & np.uint8(3)).reshape(count, 8)
    bad = np.flatnonzero(~pairs.any(axis=1))
    if len(bad) and count > 1:
        raise OctreeError(f"data: inner node {bad[0]} of {count} has no children")
    if np.count_nonzero(pairs) > MAX_NODES:
        raise OctreeError(f"data: more than {MAX_NODES} nodes")
    return pairs


def _full_nodes(data: bytes | NDArray[Any], kind: str) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return the nodes of a full stream as rows of bytes, and the bit masks of their children."""
    size = KINDS.get(kind)
    if size is None:
        raise OctreeError(f"id: full trees must be {', '.join(KINDS)}, not {kind!r:.40}")
    array = _array(data)
    rows = array[: len(array) // size * size].reshape(-1, size)
    masks = rows[:, -1]
    count = _tree_size(np.array([byte.bit_count() for byte in range(256)], np.int8)[masks], len(array))
    return rows[:count], masks[:count].copy()


def _tree_size(children: NDArray[np.int8], size: int) -> int:
    """Return the number of nodes that form one tree; raises `OctreeError` if it is incomplete or too large."""
    if not size:
        return 0
    open_nodes = np.cumsum(children[:MAX_NODES] - np.int8(1), dtype=np.int32)
    end = int(np.argmax(open_nodes == -1)) if len(open_nodes) else 0
    if not len(open_nodes) or open_nodes[end] != -1:
        if len(children) > MAX_NODES:
            raise OctreeError(f"data: more than {MAX_NODES} nodes")
        more = int(open_nodes[-1]) + 1 if len(children) else 1
        raise OctreeError(f"data: incomplete after {size} bytes: {more} more nodes are announced")
    return end + 1


def _locate(inner: NDArray[np.bool_], deepest: int) -> tuple[NDArray[np.uint64], NDArray[np.uint8]]:
    """Return the code and depth of each node of a stream, from the children (N, 8) of each node in the stream.

    Let S of a node be the number of nodes after it that the nodes before it have announced. A child after m siblings is
    the first node after its parent p with S = S(p) + children(p) - 1 - m, so one search finds all children of a level.
    """
    many = inner.sum(axis=1, dtype=np.uint8)
    size = len(inner)
    sums = np.cumsum(many, dtype=np.int32)
    sums -= np.arange(1, size + 1, dtype=np.int32)
    if size and sums.max() > 7 * DEPTH:
        raise OctreeError(f"data: the tree is deeper than {DEPTH} levels")
    sums = np.concatenate([np.zeros(min(1, size), np.uint8), sums[:-1].astype(np.uint8)])
    order = np.argsort(sums, kind="stable")
    wanted = sums[order] * np.int64(size)
    wanted += order
    codes, depths = np.zeros(size, _CODES), np.zeros(size, np.uint8)
    level = np.zeros(min(1, size), np.int64)
    for depth in range(1, deepest + 1):
        children_of_level = [np.zeros(0, np.int64)]
        for begin in range(0, len(level), _AT_ONCE):
            above = level[begin : begin + _AT_ONCE]
            rows, children = np.nonzero(inner[above])
            parents = above[rows]
            before = np.arange(len(rows)) - np.searchsorted(rows, rows)
            target = sums[parents].astype(np.int64) + many[parents] - 1 - before
            below = order[np.searchsorted(wanted, target * size + parents + 1)]
            codes[below] = codes[parents] + (children.astype(_CODES) << _shift(depth))
            depths[below] = depth
            children_of_level.append(below)
        level = np.concatenate(children_of_level)
        level.sort()
    if inner[level].any():
        raise OctreeError(f"data: the tree is deeper than {DEPTH} levels")
    return codes, depths
