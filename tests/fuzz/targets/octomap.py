"""Octomaps as streams and files, and point clouds in files, from messages, stores and folders."""

from __future__ import annotations

from tests.fuzz.target import Subject, Target

_KINDS = ("OcTree", "ColorOcTree", "OcTreeStamped", "Other")


def _octomap() -> Subject:
    """A file or a stream; accepted ones have ordered leaves, and are written as an equivalent map."""
    import numpy as np

    from yarp_compat.octomap import Octomap
    from yarp_compat.octree import OcTree, OctreeError

    def parse(data: bytes) -> None:
        choice, data = data[0] if data else 0, data[1:]
        if choice % 4 == 0:
            octomap = Octomap.from_file(data)
        else:
            octomap = Octomap(_KINDS[choice // 4 % 4], choice % 4 == 1, 0.1, "map", data)
        tree = octomap.tree()
        ends = tree.codes + (np.uint64(1) << (3 * (16 - tree.depths.astype(np.int64))).astype(np.uint64))
        assert (ends[:-1] <= tree.codes[1:]).all()
        assert not len(tree) or int(ends[-1]) <= 1 << 48
        again = OcTree.from_full(tree.full(), tree.resolution)
        assert np.array_equal(again.codes, tree.codes)
        assert np.array_equal(again.log_odds, tree.log_odds)
        assert Octomap.from_file(octomap.bt()).bt() == octomap.bt()
        levels = tree.search(*octomap.voxels().centers.T)
        assert levels.shape == (len(tree),)

    random = np.random.default_rng(1)
    keys = np.unique(random.integers(32_768 - 6, 32_768 + 6, (300, 3)), axis=0)
    tree = OcTree.of(keys, random.choice([-2.0, 3.5], len(keys)), resolution=0.05)
    small = OcTree.of([[0, 0, 0], [40_000, 1, 2]], [1.0, -1.0], [16, 3], resolution=1.0)
    chain = b"\0\0\0\0\1" * 16 + bytes(5)
    seeds = [b"\x01" + b"\x03\x00" * 15 + b"\x01\x00", b"\x02" + chain, b"\x06" + bytes(7) + b"\1" + bytes(8)]
    for variant in (tree, tree.pruned(), small):
        octomap = Octomap.of(variant)
        seeds += [b"\0" + octomap.bt(), b"\0" + octomap.ot(), b"\x01" + variant.binary(), b"\x02" + variant.full()]
    tokens = [b"\ndata\n", b"size ", b"res ", b"id ", b"\xff\xff", b"\x03\x00", b"\0\0\xc0\x7f", b"1e999", b"nan"]
    return Subject(parse, seeds, (OctreeError,), tokens)


def _cloud() -> Subject:
    """A point cloud file; a written cloud has the same size and type when read, and is written to equal bytes again."""
    import numpy as np

    from yarp_compat.sig.cloudfile import CloudFileError, read_cloud, write_pcd, write_ply
    from yarp_compat.sig.pointcloud import LAYOUTS, PointCloud

    def parse(data: bytes) -> None:
        cloud = read_cloud(data)
        written = write_pcd(cloud)
        again = read_cloud(written)
        assert write_pcd(again) == written
        assert (again.size(), again.getPointType()) == (cloud.size(), cloud.getPointType())

    spatial = [
        PointCloud.of(np.zeros(3, form)) for form in LAYOUTS.values() if {"x", "y", "z"} <= set(form.names or ())
    ]
    seeds = [write(cloud) for cloud in spatial for write in (write_pcd, write_ply)]
    seeds.append(write_pcd(spatial[0]).partition(b"DATA")[0] + b"DATA ascii\n1 2 3\nnan 0 1e9\n4 5 6\n")
    tokens = [
        b"FIELDS x y z _", b"SIZE 4 4 4 1", b"TYPE F F F U", b"COUNT 1 1 1 16", b"WIDTH 4294967295", b"HEIGHT 0",
        b"property list uchar int v", b"format binary_big_endian 1.0", b"format ascii 1.0", b"element vertex 9999999",
        b"\n", b"1e999", b"nan",
    ]  # fmt: skip
    return Subject(parse, seeds, (CloudFileError,), tokens)


TARGETS = (Target("octomap", 10_000, _octomap), Target("cloud_file", 10_000, _cloud))
