"""Cloud files: round trips, files of other programs, and invalid files."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from yarp_compat.sig.cloudfile import CloudFileError, load_cloud, read_cloud, write_pcd, write_ply
from yarp_compat.sig.pointcloud import LAYOUTS, PointCloud, PointType

IN_SPACE = [kind for kind in PointType if {"x", "y", "z"} <= set(LAYOUTS[kind].names or ())]


@pytest.mark.parametrize("write", [write_pcd, write_ply])
@pytest.mark.parametrize("kind", IN_SPACE)
def test_each_point_type_survives_a_file(tmp_path: Path, kind: PointType, write: Callable[[PointCloud], bytes]) -> None:
    points = np.zeros(6, LAYOUTS[kind])
    for place, name in enumerate(points.dtype.names or ()):
        points[name] = np.arange(6) + place
    (tmp_path / "cloud").write_bytes(write(PointCloud.of(points)))
    again = load_cloud(tmp_path / "cloud")
    assert again.getPointType() == kind
    np.testing.assert_array_equal(again.numpy(), points)


def test_pcd_keeps_rows() -> None:
    cloud = PointCloud.of(np.zeros((2, 3), LAYOUTS[PointType.XYZ]))
    again = read_cloud(write_pcd(cloud))
    assert (again.width(), again.height(), again == cloud) == (3, 2, True)


def test_pcls_text_file_with_colors_and_an_invalid_point_is_read() -> None:
    """The shortened example of the page about the format at pointclouds.org."""
    data = (
        b"# .PCD v.7 - Point Cloud Data file format\nVERSION .7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\n"
        b"COUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n"
        b"0.93773 0.33763 0 4.2108e+06\nnan 0.35641 0 4.2108e+06\n"
    )
    cloud = read_cloud(data)
    assert cloud.getPointType() == PointType.XYZ_RGBA
    assert cloud[0].tolist()[:3] == pytest.approx((0.93773, 0.33763, 0))
    assert bytes(cloud[0].tolist()[3:]) == struct.pack("<f", 4.2108e06)
    assert cloud.isDense() is False


def test_ply_of_other_programs_with_faces_is_read_in_text_and_big_endian() -> None:
    head = "ply\nformat {}\ncomment x\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\n"
    head += "property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\n"
    head += "property list uchar int vertex_index\nend_header\n"
    text = head.format("ascii 1.0").encode() + b"1 2 3 10 20 30\n4 5 6 40 50 60\n3 0 1 2\n"
    big = head.format("binary_big_endian 1.0").encode() + struct.pack(">dddBBBdddBBB", 1, 2, 3, 10, 20, 30, 4, 5, 6, 40, 50, 60)  # fmt: skip # noqa: E501
    for data in (text, big + b"\x03behind"):
        assert read_cloud(data).numpy()[["x", "z", "r", "b"]].tolist() == [(1, 3, 10, 30), (4, 6, 40, 60)]


PCD = write_pcd(PointCloud.of(np.zeros(2, LAYOUTS[PointType.XYZ])))
PLY = write_ply(PointCloud.of(np.zeros(2, LAYOUTS[PointType.XYZ])))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "DATA: line not found"),
        (b"\xff" * 9000, "DATA: line not found"),
        (PCD.replace(b"WIDTH 2", b"WIDTH 100000000"), "declares 100000000 points; the limit is"),
        (PCD.replace(b"WIDTH 2", b"WIDTH -2"), "WIDTH: '-2'"),
        (PCD.replace(b"WIDTH 2\n", b""), "WIDTH: ''"),
        (PCD.replace(b"SIZE 4 4", b"SIZE 4"), "FIELDS, SIZE, TYPE, COUNT"),
        (PCD.replace(b"SIZE 4", b"SIZE 3"), "TYPE, SIZE, COUNT of x: F3"),
        (PCD.replace(b"FIELDS x y z", b"FIELDS x y w"), "only the fields w, x, y; x, y and z are needed"),
        (PCD.replace(b"DATA binary", b"DATA binary_compressed"), "DATA: 'binary_compressed' is not binary or ascii"),
        (PCD[:-1], "the points have 23 bytes, not 24"),
        (PCD.replace(b"DATA binary", b"DATA ascii")[:-24] + b"1 2 3\n1 2\n", "invalid line of points"),
        (PCD.replace(b"DATA binary", b"DATA ascii")[:-24] + b"1 2 3\n", "the points are 1 x 3 numbers, not 2 x 3"),
        (PCD.replace(b"DATA binary", b"DATA ascii")[:-24] + b"1 2 3\n1 2 x\n", "invalid line of points"),
        (PLY.replace(b"vertex 2", b"vertex 100000000"), "declares 100000000 points"),
        (PLY.replace(b"element vertex", b"element edge"), "element: the first"),
        (PLY.replace(b"float z", b"list z"), "property: 'list z'"),
        (PLY.replace(b"little", b"middle"), "format: 'binary_middle_endian'"),
        (PLY[:-1], "the points have 23 bytes"),
    ],
)
def test_invalid_files_are_refused_with_the_name_of_the_line(data: bytes, message: str) -> None:
    with pytest.raises(CloudFileError, match=message):
        read_cloud(data)
