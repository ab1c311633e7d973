"""Octrees: leaves as arrays, OctoMap's streams, and invalid input."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from yarp_compat import octree
from yarp_compat.octree import FREE, OCCUPIED, OcTree, OctreeError, codes_of, count_nodes, keys_of

MIDDLE = 32_768


def a_tree(seed: int, count: int = 400, spread: int = 12) -> OcTree:
    """Return a tree of leaves at the finest level around the origin."""
    random = np.random.default_rng(seed)
    keys = np.unique(random.integers(MIDDLE - spread, MIDDLE + spread, (count, 3)), axis=0)
    return OcTree.of(keys, random.choice([-2.0, 0.4, 3.5], len(keys)), resolution=0.1)


def same(first: OcTree, second: OcTree) -> bool:
    """Whether two trees have the same leaves."""
    parts = ("codes", "depths", "log_odds")
    return all(np.array_equal(getattr(first, part), getattr(second, part)) for part in parts)


def test_codes_have_three_bits_per_level_with_x_lowest() -> None:
    keys = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 0, 0], [65535, 65535, 65535]])
    assert codes_of(keys).tolist() == [1, 2, 4, 8, (1 << 48) - 1]
    many = np.random.default_rng(0).integers(0, 65536, (500, 3))
    np.testing.assert_array_equal(keys_of(codes_of(many)), many)


def test_a_small_tree_has_the_expected_bytes() -> None:
    """The cube of positive coordinates is one occupied leaf, and its neighbor along -x is free."""
    tree = OcTree.of([[MIDDLE, MIDDLE, MIDDLE], [0, MIDDLE, MIDDLE]], [3.5, -2.0], depths=1, resolution=0.5)
    # numbers of children are sums of x 1, y 2 and z 4
    assert tree.binary() == struct.pack("<H", 2 << 14 | 1 << 12)
    assert tree.full() == struct.pack("<fBfBfB", 3.5, 0b1100_0000, -2.0, 0, 3.5, 0)
    centers, sizes, log_odds, occupied, colors = tree.voxels()
    assert centers.tolist() == [[-8192.0, 8192.0, 8192.0], [8192.0, 8192.0, 8192.0]]
    assert (sizes.tolist(), log_odds.tolist(), occupied.tolist(), colors) == ([16384.0] * 2, [-2, 3.5], [0, 1], None)


@pytest.mark.parametrize("seed", range(5))
def test_streams_survive_a_round_trip(seed: int) -> None:
    tree = a_tree(seed, count=20 * 4**seed)
    assert same(OcTree.from_full(tree.full(), 0.1), tree)
    pruned = tree.pruned()
    assert same(OcTree.from_full(pruned.full(), 0.1), pruned)
    decoded = OcTree.from_binary(tree.binary(), 0.1)
    assert decoded.binary() == tree.binary()
    points = tree.voxels().centers.T
    np.testing.assert_array_equal(pruned.search(*points), tree.log_odds)
    np.testing.assert_array_equal(decoded.search(*points), np.where(tree.log_odds > 0, OCCUPIED, FREE).astype("f4"))
    for binary, data in ((False, tree.full()), (True, tree.binary())):
        assert count_nodes(data + b"surplus", "OcTree", binary=binary) >= len(decoded)


def test_eight_leaves_of_equal_value_are_merged() -> None:
    keys = MIDDLE + np.stack(np.meshgrid(*[range(4)] * 3), axis=-1).reshape(-1, 3)
    tree = OcTree.of(keys, 1.5, resolution=0.1).pruned()
    assert (len(tree), tree.depths.tolist(), tree.keys().tolist()) == (1, [14], [[MIDDLE] * 3])
    keys[0] = 0  # one of eight siblings moves far away, so the other seven are not merged
    assert sorted(OcTree.of(keys, 1.5, resolution=0.1).pruned().depths.tolist()) == [*[15] * 7, *[16] * 8]


def test_the_whole_cube_and_an_empty_tree_are_encoded() -> None:
    whole = OcTree.of([[5, 5, 5]], [2.0], depths=0, resolution=1.0)
    assert OcTree.from_full(whole.full(), 1.0).depths.tolist() == [0]
    assert len(OcTree.from_binary(whole.binary(), 1.0)) == 8
    nothing = OcTree.of(np.zeros((0, 3), int), [], resolution=1.0)
    assert (nothing.full(), nothing.binary(), len(OcTree.from_full(b"", 1.0)), len(OcTree.from_binary(b"", 1))) == (
        b"", b"", 0, 0,
    )  # fmt: skip
    assert np.isnan(nothing.search(0, 0, 0))
    assert nothing.voxels().centers.shape == (0, 3)


def test_search_accepts_numbers_and_arrays() -> None:
    tree = OcTree.of([[MIDDLE, MIDDLE, MIDDLE - 2]], [1.5], depths=15, resolution=0.5)
    assert tree.search(0.99, 0.0, -1.0) == 1.5
    assert np.isnan([tree.search(1.0, 0, -1), tree.search(np.nan, 0, 0), tree.search(1e30, 0, 0)]).all()
    values = tree.search(np.array([[0.1, 2.0]]), 0.2, [[-0.1], [-0.9]])
    assert values.shape == (2, 2)
    assert values[:, 0].tolist() == [1.5, 1.5]
    assert np.isnan(values[:, 1]).all()


def test_colors_of_a_color_tree_are_read() -> None:
    data = struct.pack("<f3BB", 1.0, 0, 0, 0, 0b11) + struct.pack("<f3BBf3BB", 1.0, 10, 20, 30, 0, -1.0, 1, 2, 3, 0)
    voxels = OcTree.from_full(data, 0.1, "ColorOcTree").voxels()
    assert voxels.colors is not None
    assert voxels.colors.tolist() == [[10, 20, 30], [1, 2, 3]]


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (b"\x03", "incomplete after 1 bytes: 1 more nodes"),
        (b"\x03\x00", "incomplete after 2 bytes: 1 more nodes"),
        (b"\xff\xff" + b"\x01\x00" * 7, "1 more nodes"),
        (b"\x03\x00\x00\x00", "inner node 1 of 2 has no children"),
        (b"\x03\x00" * 16 + b"\x01\x00", "deeper than 16"),
        (b"\xff\xff" * 40 + b"\x01\x00" * 281, "deeper than 16"),
    ],
)
def test_invalid_binary_streams_are_rejected(data: bytes, error: str) -> None:
    with pytest.raises(OctreeError, match=f"data: .*{error}"):
        OcTree.from_binary(data, 0.1)


@pytest.mark.parametrize(
    ("data", "kind", "error"),
    [
        (b"\0\0\0\0", "OcTree", "data: incomplete"),
        (b"\0\0\0\0\1", "OcTree", "data: incomplete"),
        (b"\0\0\0\0\1" * 17 + bytes(5), "OcTree", "data: .* deeper than 16"),
        (b"\0\0\xc0\x7f\0", "OcTree", "data: the log-odds of leaf 0 are not finite"),
        (b"", "CountingOcTree", "id: full trees must be OcTree, .* not 'CountingOcTree'"),
    ],
)
def test_invalid_full_streams_are_rejected(data: bytes, kind: str, error: str) -> None:
    with pytest.raises(OctreeError, match=error):
        OcTree.from_full(data, 0.1, kind)


def test_a_tree_with_too_many_nodes_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = [[32768, 32768, 32768 + step] for step in range(3)]
    tree = OcTree.of(keys, [1.0, -1.0, 1.0], resolution=0.1)
    nodes = len(tree.full()) // 5
    monkeypatch.setattr(octree, "MAX_NODES", nodes)
    monkeypatch.setattr(octree, "_AT_ONCE", 2)
    assert OcTree.from_full(tree.full(), 0.1).codes.tolist() == tree.codes.tolist()
    assert OcTree.from_binary(tree.binary(), 0.1).codes.tolist() == tree.codes.tolist()
    monkeypatch.setattr(octree, "MAX_NODES", nodes - 2)
    for read, data in ((OcTree.from_full, tree.full()), (OcTree.from_binary, tree.binary())):
        with pytest.raises(OctreeError, match=f"data: more than {nodes - 2} nodes"):
            read(data, 0.1)


def test_a_tree_may_have_sixteen_levels() -> None:
    assert OcTree.from_full(b"\0\0\0\0\1" * 16 + bytes(5), 0.1).depths.tolist() == [16]
    assert OcTree.from_binary(b"\x03\x00" * 15 + b"\x01\x00", 0.1).depths.tolist() == [16]


@pytest.mark.parametrize(
    ("keys", "log_odds", "depths", "resolution", "error"),
    [
        ([[0, 0, 0], [1, 1, 1]], 1, [16, 15], 0.1, "keys contains overlapping leaves"),
        ([[0, 0, 70000]], 1, 16, 0.1, "keys must be"),
        ([0, 0, 0], 1, 16, 0.1, "keys must be"),
        ([[0, 0, 0]], 1, 17, 0.1, "depths must be"),
        ([[0, 0, 0]], np.nan, 16, 0.1, "log_odds"),
        ([[0, 0, 0]], 1, 16, 0.0, "resolution must be above 0 m, not 0.0"),
        ([[0, 0, 0]], 1, 16, np.inf, "resolution must be above 0 m, not inf"),
    ],
)
def test_invalid_leaves_are_rejected(
    keys: object, log_odds: object, depths: object, resolution: float, error: str
) -> None:
    with pytest.raises(OctreeError, match=error):
        OcTree.of(keys, log_odds, depths, resolution=resolution)  # type: ignore[arg-type]
