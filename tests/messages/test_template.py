"""Messages that are encoded once and then filled in have the bytes of a full encoding; invalid values are refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from bridge.messages.errors import ConversionError
from bridge.messages.registry import Registry
from bridge.messages.template import MessageTemplate
from bridge.messages.values import MessageWriter


@pytest.fixture(scope="module")
def registry() -> Registry:
    return Registry()


def _stamped(sec: int, nanosec: int, frame: str) -> dict[str, Any]:
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}


def _odometry(sec: int, nanosec: int, *values: float) -> dict[str, Any]:
    x, y, z, a, b, c, d, u, v, w, p, q, r = values
    return {
        "header": _stamped(sec, nanosec, "odom"),
        "child_frame_id": "base",
        "pose": {
            "pose": {"position": {"x": x, "y": y, "z": z}, "orientation": {"x": a, "y": b, "z": c, "w": d}},
            "covariance": np.arange(36.0),
        },
        "twist": {"twist": {"linear": {"x": u, "y": v, "z": w}, "angular": {"x": p, "y": q, "z": r}}},
    }


def test_filled_template_equals_the_serialized_message(registry: Registry) -> None:
    schema = registry.schema("nav_msgs/msg/Odometry")
    template = MessageTemplate(schema, _odometry(0, 0, *[0.0] * 13), "header.stamp", "pose.pose", "twist.twist")
    for shift in (0.0, 0.25, -1e300, math.inf):
        numbers = 17, 999_999_999, *(shift + number for number in range(13))
        assert template.fill(*numbers) == MessageWriter(schema).message(_odometry(*numbers))


def test_missing_numbers_change_although_their_bytes_are_kept(registry: Registry) -> None:
    schema = registry.schema("nav_msgs/msg/Odometry")
    MessageWriter(schema).message({"header": {}, "pose": {}, "twist": {}})
    template = MessageTemplate(schema, {}, "header.stamp", "pose.pose", "twist.twist")
    numbers = 17, 4, *(float(number) for number in range(13))
    whole = _odometry(*numbers)
    del whole["pose"]["covariance"]
    whole["header"]["frame_id"] = whole["child_frame_id"] = ""
    assert template.fill(*numbers) == MessageWriter(schema).message(whole)


def test_arrays_change_and_texts_stay(registry: Registry) -> None:
    schema = registry.schema("sensor_msgs/msg/JointState")
    names = ["left", "right wheel"]
    message = {"header": _stamped(1, 2, "b"), "name": names, "position": np.zeros(2), "velocity": [5.0, 6.0]}
    template = MessageTemplate(schema, message, "position", "header.stamp.nanosec")
    assert template.fill(7, 0.5, -0.5) == MessageWriter(schema).message(
        {"header": _stamped(1, 7, "b"), "name": names, "position": [0.5, -0.5], "velocity": [5.0, 6.0]}
    )


def test_a_template_fills_one_element_of_a_list_of_messages(registry: Registry) -> None:
    schema = registry.schema("tf2_msgs/msg/TFMessage")

    def message(height: float) -> dict[str, Any]:
        other = {"child_frame_id": "a", "header": _stamped(3, 4, "p")}
        return {"transforms": [other, {**other, "transform": {"translation": {"z": height}}}]}

    template = MessageTemplate(schema, message(0.0), "transforms[1].transform.translation.z")
    assert template.fill(2.5) == MessageWriter(schema).message(message(2.5))


def test_a_fill_leaves_no_trace_in_the_next(registry: Registry) -> None:
    template = MessageTemplate(registry.schema("geometry_msgs/msg/Vector3"), {}, "x")
    first = template.fill(1.0)
    template.fill(2.0)
    assert template.fill(1.0) == first


@pytest.mark.parametrize(
    ("path", "why"), [("z.x", "no number at 'z.x'"), ("header.frame_id", "no number"), ("posit", "no number")]
)
def test_a_path_without_a_number_is_refused(registry: Registry, path: str, why: str) -> None:
    message = {"name": ["one"], "position": [1.0]}
    with pytest.raises(ConversionError, match=why):
        MessageTemplate(registry.schema("sensor_msgs/msg/JointState"), message, path)


def test_numbers_that_do_not_fit_are_refused(registry: Registry) -> None:
    template = MessageTemplate(registry.schema("builtin_interfaces/msg/Time"), {}, "sec", "nanosec")
    for numbers, problem in (
        ((1,), "1 numbers are given for 2 changing"),
        ((1, -1), "does not fit"),
        ((1, 0.5), "does not fit"),
    ):
        with pytest.raises(ConversionError, match=problem):
            template.fill(*numbers)
