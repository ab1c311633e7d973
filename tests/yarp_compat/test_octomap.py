"""Octomaps in files, compared with OctoMap's own programs, and octomaps at YARP ports."""

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
    """Convert a file with OctoMap's own reader and writer."""
    ended = subprocess.run(["convert_octree", source, target], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0, ended.stderr
    assert "ERROR" not in ended.stderr
    return target.read_bytes()


@needs(OCTOMAP)
@pytest.mark.parametrize("seed", range(4))
def test_files_are_compatible_with_the_programs_of_octomap(tmp_path: Path, seed: int) -> None:
    ours = Octomap.of(a_tree(seed, count=50 * 8**seed).pruned())
    ours.save(tmp_path / "ours.ot")
    ours.save(tmp_path / "ours.bt")
    assert converted(tmp_path / "ours.ot", tmp_path / "theirs.bt") == ours.bt()
    theirs = Octomap.from_file(converted(tmp_path / "ours.bt", tmp_path / "theirs.ot"))
    assert (theirs.id, theirs.binary, theirs.resolution) == ("OcTree", False, 0.1)
    assert theirs.tree().full() == theirs.data  # inner nodes are equal too
    assert theirs.bt() == ours.bt()
    assert Octomap.load(tmp_path / "theirs.bt").ot() == theirs.ot()


@pytest.mark.parametrize("profile", Profile)
@pytest.mark.parametrize("binary", [True, False])
def test_an_octomap_survives_a_yarp_port(profile: Profile, binary: bool) -> None:
    octomap = Octomap.of(a_tree(1), binary=binary, frame="map")
    data = octomap.to_bytes(profile)
    decoded = Octomap.from_bytes(data)
    assert decoded == octomap
    x, y, z = octomap.voxels().centers[3]
    assert decoded.search(x, y, z) == octomap.voxels().log_odds[3]
    bottle = Bottle.from_bytes(data)  # as read by a program without the class
    assert (bottle.get(0).asString(), bottle.get(2).asFloat64(), bottle.get(3).asString()) == ("OcTree", 0.1, "map")
    assert bottle.get(4).asBlob() == octomap.data


def test_a_tree_is_cached_until_a_field_changes() -> None:
    octomap = Octomap.of(OcTree.of([[MIDDLE] * 3], 1.0, resolution=0.5))
    assert octomap.tree() is octomap.tree()
    octomap.resolution = 2.0
    assert octomap.search(1.5, 1.5, 1.5) == 1.0
    octomap.from_wire(Octomap().to_bytes())
    assert np.isnan(octomap.search(0, 0, 0))


FILE = Octomap.of(OcTree.of([[MIDDLE] * 3], 1.0, resolution=0.5)).ot()


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        (b"# Octomap OcTree file", b"# Octomop", "not an octomap: it begins with '# Octomop"),
        (b"size 17", b"size 18", "size: 18 nodes in the header, but 17 in the tree"),
        (b"size 17", b"size much", "size, res: much, 0.5"),
        (b"res 0.5", b"res -1", "resolution must be above 0 m, not -1"),
        (b"res 0.5", b"res nan", "resolution must be above 0 m, not nan"),
        (b"\ndata\n", b"\n", "data: no such line"),
        (b"id OcTree", b"id Other", "id: full trees must be"),
        (b"id OcTree\n", b"", "id: full trees must be"),
        (FILE[-5:], b"", "data: incomplete"),
    ],
)
def test_invalid_files_are_rejected(tmp_path: Path, old: bytes, new: bytes, error: str) -> None:
    assert old in FILE
    (tmp_path / "bad.ot").write_bytes(FILE.replace(old, new))
    with pytest.raises(OctreeError, match=error):
        Octomap.load(tmp_path / "bad.ot")


def test_headers_are_accepted_as_by_octomap() -> None:
    changed = FILE.replace(b"id OcTree\n", b"# by hand\nunknown word\nid 1\n")
    assert Octomap.from_file(changed).ot() == FILE
    assert Octomap.from_file(Octomap().bt()) == Octomap()


def test_another_suffix_and_another_type_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(OctreeError, match=r"must be \.bt or \.ot"):
        Octomap().save(tmp_path / "map.pcd")
    with pytest.raises(WireError, match="Octomap has 5 fields"):
        Octomap.from_bytes(Bottle("a b").to_bytes())
