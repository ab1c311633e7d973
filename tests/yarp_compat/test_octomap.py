"""Octomaps in files, against OctoMap's own programs, and on YARP's wire."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.support.missing import OCTOMAP, needs
from tests.yarp_compat.test_octree import MIDDLE, a_tree
from yarp_compat.octomap import Octomap
from yarp_compat.octree import OcTree, OctreeError
from yarp_compat.os.data.bottle import Bottle
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile


def converted(source: Path, target: Path) -> bytes:
    """What OctoMap's own reader and writer make of a file."""
    ended = subprocess.run(["convert_octree", source, target], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0, ended.stderr
    assert "ERROR" not in ended.stderr
    return target.read_bytes()


@needs(OCTOMAP)
@pytest.mark.parametrize("seed", range(4))
def test_octomaps_own_programs_read_ours_and_we_theirs(tmp_path: Path, seed: int) -> None:
    ours = Octomap.of(a_tree(seed, count=50 * 8**seed).pruned())
    ours.save(tmp_path / "ours.ot")
    ours.save(tmp_path / "ours.bt")
    assert converted(tmp_path / "ours.ot", tmp_path / "theirs.bt") == ours.bt()
    theirs = Octomap.from_file(converted(tmp_path / "ours.bt", tmp_path / "theirs.ot"))
    assert (theirs.id, theirs.binary, theirs.resolution) == ("OcTree", False, 0.1)
    assert theirs.tree().full() == theirs.data  # inner nodes too
    assert theirs.bt() == ours.bt()
    assert Octomap.load(tmp_path / "theirs.bt").ot() == theirs.ot()


@pytest.mark.parametrize("profile", Profile)
@pytest.mark.parametrize("binary", [True, False])
def test_there_and_back_over_yarp(profile: Profile, binary: bool) -> None:
    octomap = Octomap.of(a_tree(1), binary=binary, frame="map")
    data = octomap.to_bytes(profile)
    again = Octomap.from_bytes(data)
    assert again == octomap
    x, y, z = octomap.voxels().centers[3]
    assert again.search(x, y, z) == octomap.voxels().log_odds[3]
    bottle = Bottle.from_bytes(data)  # a program without the class
    assert (bottle.get(0).asString(), bottle.get(2).asFloat64(), bottle.get(3).asString()) == ("OcTree", 0.1, "map")
    assert bottle.get(4).asBlob() == octomap.data


def test_a_tree_is_read_once_and_anew_after_a_change() -> None:
    octomap = Octomap.of(OcTree.of([[MIDDLE] * 3], 1.0, resolution=0.5))
    assert octomap.tree() is octomap.tree()
    octomap.resolution = 2.0
    assert octomap.search(1.5, 1.5, 1.5) == 1.0
    octomap.from_wire(Octomap().to_bytes())
    assert np.isnan(octomap.search(0, 0, 0))


FILE = Octomap.of(OcTree.of([[MIDDLE] * 3], 1.0, resolution=0.5)).ot()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b"# Octomap OcTree file", b"# Octomop", "it is no octomap: it begins with '# Octomop"),
        (b"size 17", b"size 18", "size: the head says 18 nodes, and the tree has 17"),
        (b"size 17", b"size much", "size, res: much, 0.5"),
        (b"res 0.5", b"res -1", "resolution is -1"),
        (b"res 0.5", b"res nan", "resolution is nan"),
        (b"\ndata\n", b"\n", "data: the head of the file"),
        (b"id OcTree", b"id Other", "id: full trees are"),
        (b"id OcTree\n", b"", "id: full trees are"),
        (FILE[-5:], b"", "data: cut off"),
    ],
)
def test_bad_files(tmp_path: Path, old: bytes, new: bytes, words: str) -> None:
    assert old in FILE
    (tmp_path / "bad.ot").write_bytes(FILE.replace(old, new))
    with pytest.raises(OctreeError, match=words):
        Octomap.load(tmp_path / "bad.ot")


def test_heads_as_octomap_takes_them() -> None:
    changed = FILE.replace(b"id OcTree\n", b"# by hand\nunknown word\nid 1\n")
    assert Octomap.from_file(changed).ot() == FILE
    assert Octomap.from_file(Octomap().bt()) == Octomap()


def test_a_file_of_another_ending_and_a_message_of_another_type(tmp_path: Path) -> None:
    with pytest.raises(OctreeError, match=r"is to end in \.bt or \.ot"):
        Octomap().save(tmp_path / "map.pcd")
    with pytest.raises(WireError, match="Octomap has 5 fields"):
        Octomap.from_bytes(Bottle("a b").to_bytes())
