"""Depth images are converted to points, and images with inconsistent fields are rejected."""

from typing import Any

import numpy as np
import pytest

from bridge.messages.point_cloud import CloudError
from navigation.mapper3d.depth import Camera, Rays, read_camera, read_depth

CAMERA = Camera(4, 3, 2.0, 2.0, 1.5, 1.0)
DEPTH = np.array([[1.0, 2.0, 0.0, np.nan], [3.0, np.inf, 4.0, 5.0], [-1.0, 6.0, 7.0, 8.0]])


def image(depth=DEPTH, encoding="32FC1", kind="<f4", gap=0):
    """Return an image of depths in meters, with ``gap`` bytes of padding after each row."""
    values = np.nan_to_num(depth, nan=0, posinf=0, neginf=0) * 1000 if "16" in encoding else depth
    rows = np.maximum(values, 0).astype(kind) if "16" in encoding else values.astype(kind)
    data = b"".join(row.tobytes() + bytes(gap) for row in rows)
    step = rows.shape[1] * rows.dtype.itemsize + gap
    return {"width": depth.shape[1], "height": depth.shape[0], "step": step, "encoding": encoding,
            "is_bigendian": kind[0] == ">", "data": np.frombuffer(data, np.uint8)}  # fmt: skip


def info(**more: Any) -> dict[str, Any]:
    k = [2.0, 0.0, 1.5, 0.0, 2.0, 1.0, 0.0, 0.0, 1.0]
    return {"width": 4, "height": 3, "k": k, "p": [0.0] * 12, **more}


@pytest.mark.parametrize(
    ("encoding", "kind"), [("32FC1", "<f4"), ("32FC1", ">f4"), ("16UC1", "<u2"), ("16UC1", ">u2"), ("mono16", "<u2")]
)
@pytest.mark.parametrize("gap", [0, 3])
def test_all_encodings_give_the_same_points(encoding, kind, gap):
    points = Rays(1).points(read_depth(image(encoding=encoding, kind=kind, gap=gap)), CAMERA)
    z = np.array([1, 2, 3, 4, 5, 6, 7, 8.0])
    u, v = np.array([0, 1, 0, 2, 3, 1, 2, 3]), np.array([0, 0, 1, 1, 1, 2, 2, 2])
    np.testing.assert_allclose(points, np.stack(((u - 1.5) / 2 * z, (v - 1.0) / 2 * z, z), -1), rtol=1e-6)


def test_every_nth_pixel_is_used_and_a_changed_camera_applies():
    rays = Rays(2)
    assert rays.points(read_depth(image()), CAMERA)[:, 2].tolist() == [1.0, 7.0]
    wide = CAMERA._replace(cx=0.0)
    assert rays.points(read_depth(image()), wide)[:, 0].tolist() == [0.0, 7.0]
    assert not len(rays.points(np.full((3, 4), 3.4e38, np.float32), wide))


def test_a_camera_is_read_from_its_info():
    camera = read_camera(info())
    assert camera == CAMERA
    assert camera.view == (-1.0, 1.0, -0.75, 0.75)
    rectified = [4.0, 0.0, 1.0, 0.0, 0.0, 3.0, 0.5, 0.0, 0.0, 0.0, 1.0, 0.0]
    assert read_camera(info(p=rectified)) == Camera(4, 3, 4.0, 3.0, 1.0, 0.5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"encoding": "rgb8"}, "encoding: depth must be 32FC1 or 16UC1 or mono16, not 'rgb8'"),
        ({"width": 100_000, "height": 100_000}, "width, height: an image must have .* not 100000 x 100000"),
        ({"width": 0}, "width, height"),
        ({"step": 15}, "step: 15 bytes are too few for 4 pixels"),
        ({"height": 4}, "data: 48 bytes, but 4 rows of 16"),
        ({"data": b""}, "data: 0 bytes"),
    ],
)
def test_an_invalid_image_is_rejected_with_the_field_name(change, words):
    with pytest.raises(CloudError, match=words):
        read_depth({**image(), **change})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"k": [0.0] * 9}, "k: focal lengths must be above 0"),
        ({"k": [float("nan")] * 9}, "k: focal lengths"),
        ({"width": 0}, "width, height: a camera"),
        ({"width": 2**31, "height": 2**31}, "width, height: a camera"),
    ],
)
def test_an_invalid_camera_is_rejected(change, words):
    with pytest.raises(CloudError, match=words):
        read_camera(info(**change))


def test_an_image_of_another_size_is_rejected():
    with pytest.raises(CloudError, match="4 x 3 pixels, its camera 8 x 3"):
        Rays(1).points(read_depth(image()), CAMERA._replace(width=8))
