"""Static transforms of several publishers are merged into one message."""

from __future__ import annotations

from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from bridge.routing import rewrites
from bridge.routing.rewrites import TF_TYPE, StaticTransforms

STORE = get_typestore(Stores.ROS2_JAZZY)


def transforms(*children: str, x: float = 0.0) -> bytes:
    types = STORE.types
    time_ = types["builtin_interfaces/msg/Time"](1, 2)
    transform = types["geometry_msgs/msg/Transform"](
        types["geometry_msgs/msg/Vector3"](x, 0.0, 0.0), types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    )
    header = types["std_msgs/msg/Header"](time_, "base")
    stamped = [types["geometry_msgs/msg/TransformStamped"](header, child, transform) for child in children]
    return bytes(STORE.serialize_cdr(types[TF_TYPE](stamped), TF_TYPE))


def test_static_transforms_merge_by_child_frame() -> None:
    merged = StaticTransforms()
    merged.merge(transforms("a", "b"))
    whole: Any = STORE.deserialize_cdr(merged.merge(transforms("b", "c", x=5.0)), TF_TYPE)
    assert {t.child_frame_id: t.transform.translation.x for t in whole.transforms} == {"a": 0.0, "b": 5.0, "c": 5.0}


def test_static_transforms_of_another_byte_order_merge() -> None:
    message: Any = STORE.deserialize_cdr(transforms("a", "bc", x=2.5), TF_TYPE)
    swapped = bytes(STORE.serialize_cdr(message, TF_TYPE, little_endian=False))
    assert StaticTransforms().merge(swapped) == transforms("a", "bc", x=2.5)


def test_a_message_with_too_many_static_frames_does_not_affect_later_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rewrites, "MAX_FRAMES", 2)
    merged = StaticTransforms()
    merged.merge(transforms("a"))
    with pytest.raises(ValueError, match="more than 2 static frames"):
        merged.merge(transforms("b", "c"))
    assert merged.merge(transforms("b")) == transforms("a", "b")


@pytest.mark.parametrize(
    "junk",
    [
        b"",
        b"\x00\x01\x00\x00",
        b"\x07\x07" + transforms("a")[2:],
        transforms("a")[:-9],
        transforms("a") + bytes(8),
        transforms("a").replace(b"\x02\0\0\0a", b"\xff\xff\xff\xffa"),
        transforms("a").replace(b"base", b"\xffase"),
        transforms("a").replace(b"base\0", b"basee"),
    ],
)
def test_malformed_static_transforms_are_rejected(junk: bytes) -> None:
    with pytest.raises(ValueError, match="TFMessage"):
        StaticTransforms().merge(junk)
