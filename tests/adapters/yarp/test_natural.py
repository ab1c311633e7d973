"""Each natural type crosses from topic to port and back, in both profiles, with stamps, through a running adapter."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest

from bridge.adapters.yarp.topics import stamp
from tests.adapters.yarp.conftest import Place, YarpPort
from tests.support.wait import until
from yarp_compat.dev.basecontrol import OdometryData
from yarp_compat.dev.rangefinder import LaserScan2D
from yarp_compat.sig.image import ImageRgb
from yarp_compat.sig.pointcloud import PointCloudXYZ
from yarp_compat.sig.vector import Vector
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile

STAMP = {"sec": 1_700_000_000, "nanosec": 250_000_000}
STAMP_NS = 1_700_000_000_250_000_000
HEADER = {"stamp": STAMP, "frame_id": "map"}
QUARTER = {"x": 0.0, "y": 0.0, "z": math.sqrt(0.5), "w": math.sqrt(0.5)}
POSE = {"position": {"x": 1.0, "y": 2.0, "z": 0.0}, "orientation": QUARTER}

CASES: dict[str, tuple[dict[str, Any], Any]] = {
    "sensor_msgs/LaserScan": (
        {"header": HEADER, "angle_min": -math.pi, "angle_max": math.pi, "range_min": 0.5, "range_max": 8.0,
         "angle_increment": math.pi / 2, "ranges": [1.0, 2.0, 3.0, 4.0]},
        [-180.0, 180.0, 0.5, 8.0, [1.0, 2.0, 3.0, 4.0], 1],
    ),
    "nav_msgs/Odometry": (
        {"header": HEADER, "child_frame_id": "base", "pose": {"pose": POSE},
         "twist": {"twist": {"linear": {"x": 0.5, "y": 0.0}, "angular": {"z": math.pi}}}},
        [1.0, 2.0, 90.0, 0.5, 0.0, 180.0, 0.0, 0.5, 180.0],
    ),
    "sensor_msgs/JointState": ({"header": HEADER, "name": ["a", "b"], "position": [math.pi, 0.0]}, [180.0, 0.0]),
    "geometry_msgs/Twist": ({"linear": {"x": 0.5, "y": 0.25}, "angular": {"z": math.pi}}, [0.5, 0.25, 180.0]),
    "geometry_msgs/PoseStamped": ({"header": HEADER, "pose": POSE}, ["map", 1.0, 2.0, 90.0, ""]),
    "nav_msgs/Path": (
        {"header": HEADER, "poses": [{"header": HEADER, "pose": POSE}]}, [[["map", 1.0, 2.0, 90.0, ""]], ""]
    ),
    "nav_msgs/OccupancyGrid": (
        {"header": HEADER, "info": {"map_load_time": STAMP, "resolution": 0.5, "width": 2, "height": 1, "origin": POSE},
         "data": [100, -1]},
        # the same corner, as YARP describes a rotated map
        [2, 1, 2.0, -1.0, -90.0, 0.5, "map", 0, bytes([100, 255]), bytes([4, 5])],
    ),
    "std_msgs/String": ({"data": "two words"}, ["two words"]),
    "std_msgs/Int32": ({"data": -7}, [-7]),
    "std_msgs/Float64": ({"data": 0.25}, [0.25]),
    "std_msgs/Float64MultiArray": ({"layout": {"dim": [], "data_offset": 0}, "data": [0.5, 1.5]}, [0.5, 1.5]),
}  # fmt: skip


def near(value: Any, other: Any) -> bool:
    """Return whether two values are equal, apart from rounding."""
    if isinstance(value, dict):
        return value.keys() >= other.keys() and all(near(value[name], other[name]) for name in other)
    if isinstance(value, list):
        return len(value) == len(other) and all(map(near, value, other))
    return bool(value == (pytest.approx(other, rel=1e-6, abs=1e-6) if isinstance(other, float) else other))


def test_each_natural_type_is_bridged_in_both_directions(place: Place) -> None:
    rules = []
    for number, name in enumerate(CASES):
        type_ = name.replace("/", "/msg/")
        profile = "yarp4" if number % 2 else "yarp3"
        rule = {"type": type_, "as": "natural", "profile": profile, "frame": "map", "joints": ["a", "b"]}
        if name == "nav_msgs/Odometry":
            rule["child_frame"] = "base"
        if name != "sensor_msgs/JointState":
            del rule["joints"]
        rules += [{"topic": f"/in{number}", **rule}, {"topic": f"/out{number}", **rule, "direction": "out"}]
    place.bridge(*rules)
    for number, (name, (message, bottle)) in enumerate(CASES.items()):
        profile = Profile.YARP4 if number % 2 else Profile.YARP3
        reader, writer = place.port(f"/reader{number}", profile), place.port(f"/writer{number}", profile)
        out = place.far.advertise(f"/out{number}", name)
        reader.listen_to(f"/midspan/out{number}:o")
        place.far.hub_publish_until(out, message, lambda r=reader: r.messages(1, 0.2))
        assert near(reader.bottles()[0], bottle), name
        subscription = place.far.subscribe(f"/in{number}", name)
        writer.write_to(f"/midspan/in{number}:i")
        payload = bottle if isinstance(bottle[-1], bytes) else _payload(bottle, profile)

        def crossed(
            writer: YarpPort = writer, payload: Any = payload, number: int = number, subscription: int = subscription
        ) -> list[dict[str, Any]]:
            writer.write(payload, _envelope(number))
            return place.far.wait(subscription, 1, 0.2)

        received = until(crossed, f"{name} is bridged")
        assert near(received[0], message), name
        if "header" in message:
            assert received[0]["header"] == HEADER
            assert stamp(reader.messages()[0].envelope) == STAMP_NS


def _envelope(number: int) -> str:
    return f"{number} 1700000000.25"


def _payload(bottle: list[Any], profile: Profile) -> bytes:
    from yarp_compat.wire.binary import encode

    return encode(bottle, profile)


@pytest.mark.parametrize("profile", Profile)
def test_yarps_classes_read_and_write_natural_topics(place: Place, profile: Profile) -> None:
    """Scans, odometry, images, clouds and vectors cross to and from the classes of YARP programs.

    The configuration does not set the YARP release, because the programs' ports announce it.
    """
    types = {"scan": "sensor_msgs/LaserScan", "odom": "nav_msgs/Odometry", "picture": "sensor_msgs/Image",
             "cloud": "sensor_msgs/PointCloud2", "numbers": "std_msgs/Float64MultiArray"}  # fmt: skip
    rules = [{"topic": f"/{n}_in", "type": t.replace("/", "/msg/")} for n, t in types.items()]
    place.bridge(*rules, yarp={"as": "natural"})
    pixels = bytes(range(2 * 3 * 3))
    points = b"".join(struct.pack("<4f", n, n + 1, n + 2, 0.0) for n in range(3))
    fields = [{"name": a, "offset": 4 * i, "datatype": 7, "count": 1} for i, a in enumerate("xyz")]
    messages: dict[str, dict[str, Any]] = {
        "scan": {"header": HEADER, "angle_max": math.pi, "range_max": 8.0, "ranges": [1.0, "Infinity"]},
        "odom": {"header": HEADER, "pose": {"pose": POSE}},
        "picture": {"header": HEADER, "width": 3, "height": 2, "encoding": "rgb8", "step": 9, "data": list(pixels)},
        "cloud": {"header": HEADER, "width": 3, "height": 1, "point_step": 16, "row_step": 48, "fields": fields,
                  "is_dense": True, "data": list(points)},
        "numbers": {"data": [1.5, 2.5]},
    }  # fmt: skip
    classes: dict[str, type[Portable]] = {
        "scan": LaserScan2D,
        "odom": OdometryData,
        "picture": ImageRgb,
        "cloud": PointCloudXYZ,
        "numbers": Vector,
    }
    values: dict[str, Any] = {}
    for name, message in messages.items():
        reader, writer = place.port(f"/{name}/reader", profile), place.port(f"/{name}/writer", profile)
        out = place.far.advertise(f"/{name}_out", types[name])
        reader.listen_to(f"/midspan/{name}_out:o")
        place.far.hub_publish_until(out, message, lambda r=reader: r.messages(1, 0.2))
        value = values[name] = classes[name].from_bytes(bytes(reader.messages()[0].payload), profile)
        subscription = place.far.subscribe(f"/{name}_in", types[name])
        writer.write_to(f"/midspan/{name}_in:i")
        payload = value.to_bytes(profile)

        def crossed(
            writer: YarpPort = writer, payload: bytes = payload, subscription: int = subscription
        ) -> list[dict[str, Any]]:  # the bridge may not know the subscription yet
            writer.write(payload, _envelope(1))
            return place.far.wait(subscription, 1, 0.2)

        back = until(crossed, f"{name} is bridged")[0]
        known = {k: v for k, v in message.items() if k not in ("header", "angle_increment", "data")}
        assert near(back, known), name
        if name != "numbers":
            assert back["header"]["stamp"] == STAMP
            assert stamp(reader.messages()[0].envelope) == STAMP_NS
    assert list(values["scan"].scans) == [1.0, math.inf]
    assert (values["scan"].angle_max, values["odom"].odom_theta) == pytest.approx((180.0, 90.0), rel=1e-6)
    assert values["picture"].numpy().tobytes() == pixels
    assert [p.tolist()[:3] for p in values["cloud"].numpy()] == [(0.0, 1.0, 2.0), (1.0, 2.0, 3.0), (2.0, 3.0, 4.0)]
    assert list(values["numbers"]) == [1.5, 2.5]
