"""The natural YARP types: compared with bytes that YARP itself wrote and with expected values, and in round trips."""

from __future__ import annotations

import math
import re
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.messages.errors import ConversionError
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader
from bridge.messages.yarp.codec import Codec, Missing
from bridge.messages.yarp.contents import KINDS, Content
from tests.messages.samples import sample
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.octomap import Octomap
from yarp_compat.octree import OcTree
from yarp_compat.sig import image, pointcloud
from yarp_compat.wire import binary
from yarp_compat.wire.profile import Profile

REGISTRY = Registry()
CAPTURED = Path(__file__).parents[2] / "yarp_compat" / "data" / "portables.txt"
STAMP = 1_795_143_618_022_890_000
HEADER = {"stamp": {"sec": 1_795_143_618, "nanosec": 22_890_000}, "frame_id": "base"}


def captured(name: str) -> bytes:
    """Return the bytes that YARP 4.0 wrote for a value."""
    text = CAPTURED.read_text(encoding="utf-8").split(f"\n{name} (")[1].split("\n", 1)[1]
    lines = [line[9:57] for line in re.match(r"(?:   [0-9a-f]{4}  .*\n)+", text).group().splitlines()]
    return bytes.fromhex("".join(lines))


def codec(name: str, profile: Profile = Profile.YARP4, **missing: Any) -> Codec:
    return Content("natural", (), profile, Missing(**missing)).codec(REGISTRY, name)


def out(name: str, message: dict[str, Any], profile: Profile = Profile.YARP4) -> bytes:
    return b"".join(codec(name, profile).to_yarp(from_json(REGISTRY, name, message)).payload)


def back(name: str, payload: bytes, profile: Profile | None = Profile.YARP4, **missing: Any) -> dict[str, Any]:
    return to_json(REGISTRY, name, codec(name, **missing).to_hub(payload, profile, STAMP))


def values(payload: bytes, profile: Profile = Profile.YARP4) -> list[Any]:
    return binary.decode(payload, profile)


SCAN = "sensor_msgs/msg/LaserScan"


def test_a_laser_scan_of_a_real_yarp_is_read_and_written() -> None:
    payload = captured("LaserScan2D")
    scan = back(SCAN, payload, frame="lidar")
    assert scan["header"] == {**HEADER, "frame_id": "lidar"}
    assert (scan["angle_min"], scan["angle_max"]) == (0.0, pytest.approx(2 * math.pi))
    assert scan["angle_increment"] == pytest.approx(math.pi)
    assert (scan["range_min"], scan["range_max"], scan["ranges"]) == (pytest.approx(0.1), 8.0, [1.0, 1.0])
    again = out(SCAN, scan)
    assert len(again) == len(payload)
    assert _near(values(again), values(payload))


@pytest.mark.parametrize("profile", Profile)
def test_a_laser_scan_has_degrees_in_yarp(profile: Profile) -> None:
    scan = {"header": HEADER, "angle_min": -math.pi / 2, "angle_max": math.pi / 2, "angle_increment": math.pi / 4,
            "range_min": 0.25, "range_max": 8.0, "ranges": [1.0, "Infinity", 2.5, "NaN", 3.0]}  # fmt: skip
    sent = codec(SCAN, profile).to_yarp(from_json(REGISTRY, SCAN, scan))
    low, high, nearest, farthest, ranges, status = values(b"".join(sent.payload), profile)
    assert (low, high) == pytest.approx((-90.0, 90.0), rel=1e-6)
    assert (nearest, farthest, status) == (0.25, 8.0, 1)
    assert ranges[:3] == [1.0, math.inf, 2.5]
    assert math.isnan(ranges[3])
    assert sent.stamp_ns == STAMP


def test_an_image_of_a_real_yarp_is_written_byte_for_byte() -> None:
    for name, encoding in (("ImageOf<PixelMono> 3x2", "mono8"), ("ImageOf<PixelRgb> 2x1", "rgb8")):
        payload = captured(name)
        picture = back("sensor_msgs/msg/Image", payload)
        assert (picture["encoding"], picture["step"]) == (encoding, picture["width"] * (3 if encoding == "rgb8" else 1))
        assert out("sensor_msgs/msg/Image", picture) == payload


@pytest.mark.parametrize(
    ("encoding", "kind"),
    [("rgb8", image.ImageRgb), ("bgr8", image.ImageBgr), ("rgba8", image.ImageRgba), ("bgra8", image.ImageBgra),
     ("mono8", image.ImageMono), ("mono16", image.ImageMono16), ("32FC1", image.ImageFloat), ("bayer_grbg8", None),
     ("bayer_rggb16", None)],
)  # fmt: skip
@pytest.mark.parametrize("profile", Profile)
def test_images_of_each_encoding_survive_the_round_trip(
    encoding: str, kind: type[image.Image] | None, profile: Profile
) -> None:
    pixel = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1, "bayer_grbg8": 1, "32FC1": 4}.get(encoding, 2)
    width, height, step = 5, 3, 5 * pixel + 3  # rows with padding
    rows = np.arange(height * step, dtype=np.uint8).reshape(height, step)
    message = {"header": HEADER, "width": width, "height": height, "encoding": encoding, "step": step,
               "data": rows.tobytes()}  # fmt: skip
    payload = out("sensor_msgs/msg/Image", message, profile)
    picture = (kind or image.FlexImage).from_bytes(payload, profile)
    assert (picture.width(), picture.height(), picture.getQuantum()) == (width, height, 8)
    assert picture.numpy().tobytes() == rows[:, : width * pixel].tobytes()
    again = back("sensor_msgs/msg/Image", payload, None)
    assert (again["encoding"], again["step"]) == (encoding, width * pixel)
    name = "sensor_msgs/msg/Image"
    data = MessageReader(REGISTRY.schema(name), codec(name).to_hub(payload, profile, STAMP)).message()["data"]
    assert data.tobytes() == rows[:, : width * pixel].tobytes()


def test_big_endian_pixels_are_swapped() -> None:
    message = {"width": 2, "height": 1, "encoding": "mono16", "is_bigendian": 1, "step": 4, "data": b"\1\2\3\4"}
    assert image.ImageMono16.from_bytes(out("sensor_msgs/msg/Image", message)).numpy().tolist() == [[0x102, 0x304]]


@pytest.mark.parametrize(
    "message",
    [
        {"width": 2, "height": 2, "encoding": "mono8", "step": 2, "data": [1, 2, 3]},
        {"width": 2, "height": 2, "encoding": "mono8", "step": 1, "data": [1, 2, 3, 4]},
        {"width": 2, "height": 1, "encoding": "jpeg", "step": 2, "data": [1, 2]},
    ],
)
def test_invalid_images_are_rejected(message: dict[str, Any]) -> None:
    with pytest.raises(ConversionError):
        out("sensor_msgs/msg/Image", message)


CLOUD = "sensor_msgs/msg/PointCloud2"


def _field(name: str, offset: int, datatype: int = 7) -> dict[str, Any]:
    return {"name": name, "offset": offset, "datatype": datatype, "count": 1}


@pytest.mark.parametrize("profile", Profile)
def test_a_cloud_in_pcls_layout_is_passed_on_unchanged(profile: Profile) -> None:
    points = b"".join(struct.pack("<4f4B12x", n, n + 0.5, -n, 1.0, 10, 20, 30, 40) for n in range(4))
    message = {"header": HEADER, "height": 2, "width": 2, "point_step": 32, "row_step": 64, "is_dense": True,
               "fields": [_field("x", 0), _field("y", 4), _field("z", 8), _field("rgba", 16, 6)],
               "data": points}  # fmt: skip
    payload = out(CLOUD, message, profile)
    cloud = pointcloud.PointCloudXYZRGBA.from_bytes(payload, profile)
    assert (cloud.width(), cloud.height(), cloud.isDense()) == (2, 2, True)
    assert payload.endswith(points)
    assert cloud[3].tolist() == (3.0, 3.5, -3.0, 10, 20, 30, 40)
    again = back(CLOUD, payload, profile)
    assert again["fields"] == message["fields"]
    assert again == {**to_json(REGISTRY, CLOUD, from_json(REGISTRY, CLOUD, message)), "header": {**HEADER, "frame_id": "camera"}}  # fmt: skip # noqa: E501


def test_the_fields_of_a_cloud_with_another_layout_are_copied() -> None:
    points = b"".join(struct.pack("<Hddd f", 7, n, 2 * n, 3 * n, 0.5) for n in range(3))
    message = {"height": 1, "width": 3, "point_step": 30, "row_step": 90, "data": points,
               "fields": [_field("ring", 0, 4), *(_field(a, 2 + 8 * i, 8) for i, a in enumerate("xyz")),
                          _field("intensity", 26)]}  # fmt: skip
    cloud = pointcloud.PointCloudXYZI.from_bytes(out(CLOUD, message))
    assert [p.tolist() for p in cloud.numpy()] == [(float(n), 2.0 * n, 3.0 * n, 0.5) for n in range(3)]


@pytest.mark.parametrize("change", [{"row_step": 10}, {"fields": [_field("x", 30)]}, {"fields": []}, {"width": 99}])
def test_invalid_clouds_are_rejected(change: dict[str, Any]) -> None:
    message = {"height": 1, "width": 1, "point_step": 16, "row_step": 16, "data": bytes(16),
               "fields": [_field("x", 0), _field("y", 4), _field("z", 8)]}  # fmt: skip
    assert out(CLOUD, message)
    with pytest.raises(ConversionError):
        out(CLOUD, {**message, **change})


@pytest.mark.parametrize("kind", pointcloud.PointType)
def test_points_of_each_type_come_back_as_they_were(kind: pointcloud.PointType) -> None:
    layout = pointcloud.LAYOUTS[kind]
    points = np.zeros(6, layout)
    for place, name in enumerate(layout.names or ()):
        points[name] = np.arange(6) + place
    sent = pointcloud.PointCloud.of(points.reshape(2, 3)).to_bytes(Profile.YARP4)
    message = codec(CLOUD).to_hub(sent, Profile.YARP4, STAMP)
    assert b"".join(codec(CLOUD).to_yarp(message).payload) == sent


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"width": 100_000_000}, "row_step: 16 bytes cannot hold 100000000 points"),
        ({"height": 100_000_000}, "data: 16 bytes, but 100000000 rows"),
        ({"point_step": 0}, "fields.x"),
        ({"fields": [_field("x", 4_294_967_295)]}, "fields.x.offset: byte 4294967295"),
        ({"fields": [_field("x", 0, 9)]}, "fields.x.datatype: 9"),
        ({"fields": [_field("ring", 0)]}, "for the fields ring"),
        ({"fields": [{**_field("x", 0), "count": 2}]}, "fields.x.count: a point has one x, not 2"),
        ({"width": 0, "row_step": 0, "fields": []}, "for the fields none"),
    ],
)
def test_a_bad_cloud_is_refused_by_the_name_of_its_field(change: dict[str, Any], words: str) -> None:
    message = {"height": 1, "width": 1, "point_step": 16, "row_step": 16, "data": bytes(16),
               "fields": [_field("x", 0), _field("y", 4), _field("z", 8)]}  # fmt: skip
    with pytest.raises(ConversionError, match=words):
        out(CLOUD, {**message, **change})


@pytest.mark.parametrize(
    "more",
    [
        [_field("rgb", 12), _field("rgba", 16, 6)],
        [_field("b", 16, 2), _field("rgb", 12)],
        [_field("rgb", 12), _field("rgb", 100)],
        [_field("rgb", 12), _field("x", 100)],
        [_field("rgb", 12), _field("kind", 16, 0), {**_field("signature", 16), "count": 33}],
    ],
)
def test_duplicate_and_unsupported_cloud_fields_are_skipped(more: list[dict[str, Any]]) -> None:
    data = struct.pack("<3f4B4B", 1.0, 2.0, 3.0, 10, 20, 30, 40, 9, 9, 9, 9)
    message = {"height": 1, "width": 1, "point_step": 20, "row_step": 20, "data": data,
               "fields": [_field("x", 0), _field("y", 4), _field("z", 8), *more]}  # fmt: skip
    (point,) = pointcloud.PointCloudXYZRGBA.from_bytes(out(CLOUD, message)).numpy().tolist()
    assert point == (1.0, 2.0, 3.0, 10, 20, 30, 40)


def test_the_last_row_need_not_be_padded_and_large_numbers_become_infinite() -> None:
    rows = [struct.pack("<6d", *numbers) for numbers in ((1, 2, 3, 4, 5, 1e300), (7, 8, 9, 10, 11, 12))]
    message = {"height": 2, "width": 2, "point_step": 24, "row_step": 56, "data": rows[0] + bytes(8) + rows[1],
               "fields": [_field(axis, 8 * place, 8) for place, axis in enumerate("xyz")]}  # fmt: skip
    cloud = pointcloud.PointCloudXYZ.from_bytes(out(CLOUD, message))
    assert (cloud.width(), cloud.height()) == (2, 2)
    assert cloud.numpy().tolist() == [(1, 2, 3), (4, 5, float("inf")), (7, 8, 9), (10, 11, 12)]


@pytest.mark.parametrize("step", [16, 4_294_967_295])
def test_a_cloud_without_points_is_valid(step: int) -> None:
    fields = [_field("x", 0), _field("y", 4), _field("z", 8)]
    message = {"height": 1, "width": 0, "point_step": step, "row_step": 0, "data": b"", "fields": fields}
    assert pointcloud.PointCloudXYZ.from_bytes(out(CLOUD, message)).size() == 0


def test_depth_in_millimeters_becomes_floats_in_meters() -> None:
    data = struct.pack("<6H", 0, 1, 1000, 1500, 65535, 2)
    message = {"height": 2, "width": 3, "encoding": "16UC1", "step": 6, "data": data}
    depth = image.ImageFloat.from_bytes(out("sensor_msgs/msg/Image", message))
    assert depth.getPixelCode() == image.FlexImage.from_bytes(out("sensor_msgs/msg/Image", message)).getPixelCode()
    assert (depth.numpy() * 1000).round().astype(np.uint16).tobytes() == data
    assert depth.numpy()[0, 2] == 1.0
    again = back("sensor_msgs/msg/Image", out("sensor_msgs/msg/Image", message))
    assert (again["encoding"], again["width"], again["step"]) == ("32FC1", 3, 12)


OCTOMAP = "octomap_msgs/msg/Octomap"


@pytest.mark.parametrize("profile", Profile)
def test_an_octomap_survives_the_round_trip_and_yarp_compat_reads_it(profile: Profile) -> None:
    tree = OcTree.of([[32_768, 32_768, 32_768]], 1.5, resolution=0.5)
    for binary_ in (True, False):
        octomap = Octomap.of(tree, binary=binary_, frame="base")
        message = {"header": HEADER, "id": "OcTree", "binary": binary_, "resolution": 0.5, "data": list(np.frombuffer(octomap.data, "i1").tolist())}  # fmt: skip # noqa: E501
        payload = out(OCTOMAP, message, profile)
        restored = Octomap.from_bytes(payload)
        assert restored == octomap
        assert restored.search(0.25, 0.25, 0.25) > 0
        cdr = from_json(REGISTRY, OCTOMAP, message)
        assert back(OCTOMAP, payload, profile) == to_json(REGISTRY, OCTOMAP, cdr)


ODOMETRY = "nav_msgs/msg/Odometry"


@pytest.mark.parametrize("profile", Profile)
def test_odometry_survives_the_round_trip(profile: Profile) -> None:
    half = math.radians(90) / 2
    message = {
        "header": {**HEADER, "frame_id": "odom"},
        "child_frame_id": "base_link",
        "pose": {"pose": {"position": {"x": 1.0, "y": 2.0}, "orientation": {"z": math.sin(half), "w": math.cos(half)}}},
        "twist": {"twist": {"linear": {"x": 0.5, "y": 0.25}, "angular": {"z": math.pi}}},
    }
    payload = out(ODOMETRY, message, profile)
    assert len(payload) == len(captured("OdometryData"))
    assert values(payload, profile) == pytest.approx([1, 2, 90, 0.5, 0.25, 180, -0.25, 0.5, 180])
    got = back(ODOMETRY, payload, profile)
    assert got["header"] == message["header"]
    assert got["child_frame_id"] == "base_link"
    pose, twist = got["pose"]["pose"], got["twist"]["twist"]
    assert (pose["position"]["x"], pose["position"]["y"]) == (1.0, 2.0)
    assert (pose["orientation"]["z"], pose["orientation"]["w"]) == pytest.approx((math.sin(half), math.cos(half)))
    assert (twist["linear"]["x"], twist["linear"]["y"]) == (0.5, 0.25)
    assert twist["angular"]["z"] == pytest.approx(math.pi)


def test_a_velocity_of_a_real_yarp_is_written_byte_for_byte() -> None:
    payload = captured("MobileBaseVelocity")
    twist = back("geometry_msgs/msg/Twist", payload)
    assert (twist["linear"]["x"], twist["linear"]["y"]) == (0.1, 0.2)
    assert twist["angular"]["z"] == pytest.approx(math.radians(3))
    assert out("geometry_msgs/msg/Twist", twist)[:-8] == payload[:-8]
    assert values(out("geometry_msgs/msg/Twist", twist)) == pytest.approx(values(payload))
    stamped = back("geometry_msgs/msg/TwistStamped", payload)
    assert stamped["header"] == {**HEADER, "frame_id": "base_link"}
    assert out("geometry_msgs/msg/TwistStamped", stamped)[:-8] == payload[:-8]


def test_joints_are_a_vector_in_degrees() -> None:
    name = "sensor_msgs/msg/JointState"
    payload = out(name, {"name": ["a", "b"], "position": [math.pi, -math.pi / 2]})
    assert values(payload) == pytest.approx([180.0, -90.0])
    got = back(name, payload, joints=("a", "b"))
    assert got["name"] == ["a", "b"]
    assert got["position"] == pytest.approx([math.pi, -math.pi / 2])
    assert back(name, payload)["name"] == ["joint_0", "joint_1"]
    with pytest.raises(ConversionError, match="there are 2 joints, but the rule names 1"):
        back(name, payload, joints=("a",))


def test_places_of_a_real_yarp_are_read_and_written() -> None:
    pose = back("geometry_msgs/msg/PoseStamped", captured("Map2DLocation"))
    assert pose["header"] == {**HEADER, "frame_id": "map1"}
    assert pose["pose"]["position"] == {"x": 1.0, "y": 2.0, "z": 0.0}
    assert pose["pose"]["orientation"]["z"] == pytest.approx(math.sqrt(0.5))
    assert values(out("geometry_msgs/msg/PoseStamped", pose)) == ["map1", 1.0, 2.0, pytest.approx(90.0), ""]
    name = "geometry_msgs/msg/PoseWithCovarianceStamped"
    assert back(name, out("geometry_msgs/msg/PoseStamped", pose))["pose"]["pose"] == pose["pose"]
    assert values(out(name, {"pose": {"pose": pose["pose"]}}))[1:3] == [1.0, 2.0]
    path = back("nav_msgs/msg/Path", captured("Map2DPath"))
    assert [p["pose"]["position"]["x"] for p in path["poses"]] == [1.0, 3.0]
    assert path["header"]["frame_id"] == "map1"
    assert values(out("nav_msgs/msg/Path", path))[0][1] == ["map1", 3.0, 4.0, 0.0, ""]


GRID = "nav_msgs/msg/OccupancyGrid"


def test_maps_of_a_real_yarp_are_read_and_written() -> None:
    plain, zipped = (back(GRID, captured(f"MapGrid2D 5x2 {how}")) for how in ("uncompressed", "compressed"))
    assert plain == zipped
    assert (plain["info"]["width"], plain["info"]["height"], plain["info"]["resolution"]) == (5, 2, pytest.approx(0.05))
    assert plain["data"] == [0, 0, 0, 0, -1, 100, 0, 0, 0, 0]
    assert plain["header"]["frame_id"] == "m1"
    again = values(out(GRID, plain))
    assert again[-2:] == [bytes([100, 0, 0, 0, 0, 0, 0, 0, 0, 255]), bytes([4, 0, 0, 0, 0, 0, 0, 0, 0, 5])]
    assert out(GRID, back(GRID, out(GRID, plain))) == out(GRID, plain)


def test_the_cells_of_a_rotated_map_keep_their_positions() -> None:
    grid = MapGrid2D.of(np.zeros((4, 6), np.uint8), name="m", resolution=0.5, origin=(-1.0, 2.0, 30.0))
    info = back(GRID, grid.to_bytes(Profile.YARP4))["info"]
    turn, place = info["origin"]["orientation"], info["origin"]["position"]
    yaw = 2 * math.atan2(turn["z"], turn["w"])
    # in ROS, this is the center of the third cell in the second row from the bottom
    x, y = 2.5 * 0.5, 1.5 * 0.5
    ros = place["x"] + x * math.cos(yaw) - y * math.sin(yaw), place["y"] + x * math.sin(yaw) + y * math.cos(yaw)
    assert ros == pytest.approx(tuple(grid.centers_of((2, 2))))
    again = MapGrid2D.from_bytes(out(GRID, back(GRID, grid.to_bytes(Profile.YARP4))), Profile.YARP4)
    assert again.getOrigin() == pytest.approx(grid.getOrigin())


def test_a_map_that_unzips_without_end_is_refused() -> None:
    bomb = zlib.compress(bytes(10_000_000))
    payload = binary.encode([5, 2, 0.0, 0.0, 0.0, 0.05, "m", 1, bomb, bomb], Profile.YARP4)
    with pytest.raises(ConversionError, match="its data has 11"):
        back(GRID, payload)


def test_texts_and_numbers_become_single_values() -> None:
    assert values(out("std_msgs/msg/String", {"data": "two words"})) == ["two words"]
    assert back("std_msgs/msg/String", binary.encode(["two words"], Profile.YARP4)) == {"data": "two words"}
    assert back("std_msgs/msg/String", binary.encode(["two", "words", 3], Profile.YARP4)) == {"data": "two words 3"}
    assert values(out("std_msgs/msg/Int32", {"data": -5})) == [-5]
    assert out("std_msgs/msg/Int64", {"data": 5}) == bytes.fromhex("110100000100000005") + bytes(7)
    assert back("std_msgs/msg/UInt16", out("std_msgs/msg/UInt16", {"data": 65535})) == {"data": 65535}
    assert back("std_msgs/msg/Float64", binary.encode([2], Profile.YARP3), None) == {"data": 2.0}
    assert back("std_msgs/msg/Bool", binary.encode([1], Profile.YARP3), None) == {"data": True}
    assert values(out("std_msgs/msg/Bool", {"data": True})) == [True]
    with pytest.raises(ConversionError, match="must be one number"):
        back("std_msgs/msg/Int32", binary.encode(["five"], Profile.YARP4))
    with pytest.raises(ConversionError):
        back("std_msgs/msg/Int8", binary.encode([300], Profile.YARP4))


def test_a_vector_of_a_real_yarp_is_written_byte_for_byte() -> None:
    assert out("geometry_msgs/msg/Quaternion", {"w": 1.0}) == captured("Quaternion x0y0z0w1")
    array = {"data": [1.0, 2.5]}
    assert out("std_msgs/msg/Float64MultiArray", array) == struct.pack("<ii2d", 256 | 20, 2, 1.0, 2.5)
    assert back("std_msgs/msg/Float64MultiArray", binary.encode([1, 2.5], Profile.YARP3), None)["data"] == [1.0, 2.5]
    assert back("std_msgs/msg/Float64MultiArray", binary.encode([], Profile.YARP3), None)["data"] == []
    assert (
        back("std_msgs/msg/UInt8MultiArray", out("std_msgs/msg/UInt8MultiArray", {"data": [1, 255]}))["data"] == "Af8="
    )


ANY = [name for name in KINDS if name not in ("sensor_msgs/msg/Image", CLOUD, GRID)]


@pytest.mark.parametrize("name", ANY)
@pytest.mark.parametrize("profile", Profile)
def test_round_trip_keeps_every_value(name: str, profile: Profile) -> None:
    """Values that YARP's type lacks are lost in the first round trip; the second one loses nothing more."""
    first = out(name, _small(sample(REGISTRY.schema(name))), profile)
    again = out(name, back(name, first, profile), profile)
    assert _near(values(again, profile), values(first, profile))


def _small(message: Any) -> Any:
    """Divide all floats by 1000, because large angles are wrapped and small ones are kept."""
    if isinstance(message, dict):
        return {key: _small(value) for key, value in message.items()}
    return message / 1000 if isinstance(message, float) else message


def _near(one: Any, other: Any) -> bool:
    if isinstance(one, list):
        return len(one) == len(other) and all(map(_near, one, other))
    return one == (pytest.approx(other, rel=1e-6, abs=1e-6) if isinstance(other, float) else other)


@settings(max_examples=300)
@given(st.sampled_from(list(KINDS)), st.binary(max_size=120), st.sampled_from([None, *Profile]))
def test_any_bytes_are_refused_or_are_a_message(name: str, junk: bytes, profile: Profile | None) -> None:
    try:
        cdr = codec(name).to_hub(junk, profile, None)
    except ConversionError:
        return
    assert REGISTRY.hub_check(name)(cdr) == cdr


@settings(max_examples=200)
@given(st.data())
def test_a_message_with_changed_bytes_is_refused_or_converts(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(ANY))
    whole = bytearray(out(name, sample(REGISTRY.schema(name))))
    whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    try:
        cdr = codec(name).to_hub(bytes(whole), None, None)
    except ConversionError:
        return
    assert REGISTRY.hub_check(name)(cdr) == cdr


@settings(max_examples=100)
@given(
    st.sampled_from(list(Profile)),
    st.lists(st.floats(0, 30, width=32) | st.just(math.inf), max_size=50),
    st.floats(-3, 3, width=32),
    st.integers(0, 2**31 - 1),
    st.integers(0, 999_999_999),
)
def test_any_scan_survives_the_round_trip(
    profile: Profile, ranges: list[float], low: float, sec: int, nanosec: int
) -> None:
    stamp = {"sec": sec, "nanosec": nanosec}
    message = {"header": {"stamp": stamp}, "angle_min": low, "angle_max": low + 0.1, "ranges": list(map(_json, ranges))}
    sent = codec(SCAN, profile).to_yarp(from_json(REGISTRY, SCAN, message))
    got = to_json(REGISTRY, SCAN, codec(SCAN).to_hub(b"".join(sent.payload), profile, sent.stamp_ns))
    assert [np.float32(r) for r in got["ranges"]] == ranges
    assert got["angle_min"] == pytest.approx(low, abs=1e-6)
    if sent.stamp_ns:
        assert got["header"]["stamp"] == stamp


def _json(number: float) -> Any:
    return "Infinity" if math.isinf(number) else number


def test_a_clock_is_yarps_network_clock_whatever_the_rule_says() -> None:
    time = {"clock": {"sec": 12, "nanosec": 500_000_000}}
    kind = "rosgraph_msgs/msg/Clock"
    for form in ("bottle", "natural"):
        chosen = Content(form).codec(REGISTRY, kind)
        payload = b"".join(map(bytes, chosen.to_yarp(from_json(REGISTRY, kind, time)).payload))
        assert binary.decode(payload, Profile.YARP3) == [12, 500_000_000]
        for values in ([12, 500_000_000], [[12, 500_000_000]]):
            cdr = chosen.to_hub(binary.encode(values, Profile.YARP3), None, None)
            assert to_json(REGISTRY, kind, cdr) == time
        with pytest.raises(ConversionError, match="seconds and nanoseconds"):
            chosen.to_hub(binary.encode(["noon"], Profile.YARP3), None, None)
