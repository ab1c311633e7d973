"""An initial pose without a covariance gets that of RViz; all other messages stay unchanged."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion, SideType
from bridge.routing.decision import RouteKey
from bridge.routing.hub_to_side import HubToSideRoute
from bridge.routing.peer_watch import Lease
from bridge.routing.rewrites import POSE_TYPE, filled_in, with_spread
from bridge.routing.rules import RoutePolicy
from bridge.routing.side_to_hub import SideToHubRoute

REGISTRY = Registry()
HUB = SideType(POSE_TYPE, "0", "")
SIDE = SideType("geometry_msgs/PoseWithCovarianceStamped", "0", "")
PLAIN = Conversion(HUB, SIDE, None)
MARKED = Conversion(HUB, SIDE, lambda payload: payload + b"!")
INWARDS = Conversion(SIDE, HUB, None)
KEY = RouteKey("/initialpose", POSE_TYPE, "0")
DECISION = RoutePolicy(allowed=True, why="", name="/initialpose")
JOINT = cast(
    "Any",
    SimpleNamespace(
        small=None,
        bulk=None,
        hold=None,
        lease=Lease(),
        stall_detector=None,
        hub=SimpleNamespace(max_payload=1000),
        edge=SimpleNamespace(clock=SimpleNamespace(simulated=False), own_threads=False),
    ),
)


def message(covariance: list[float], frame: str = "map") -> bytes:
    pose = {"position": {"x": 1.0, "y": 2.0}, "orientation": {"w": 1.0}}
    return from_json(
        REGISTRY, POSE_TYPE, {"header": {"frame_id": frame}, "pose": {"pose": pose, "covariance": covariance}}
    )


@pytest.mark.parametrize("frame", ["", "map", "a_map", "robot1/map"])
def test_a_covariance_of_zeros_is_replaced_by_that_of_rviz(frame: str) -> None:
    before, after = (
        to_json(REGISTRY, POSE_TYPE, cdr) for cdr in (message([0.0] * 36, frame), filled_in(message([0.0] * 36, frame)))
    )
    expected = [0.0] * 36
    expected[0] = expected[7] = 0.25
    expected[35] = math.radians(15.0) ** 2
    assert after["pose"]["covariance"] == expected
    assert {**after, "pose": after["pose"]["pose"]} == {**before, "pose": before["pose"]["pose"]}


@pytest.mark.parametrize("place", [0, 7, 35, 1])
def test_given_covariance_is_kept(place: int) -> None:
    covariance = [0.0] * 36
    covariance[place] = 1e-12
    assert filled_in(message(covariance)) == message(covariance)


@pytest.mark.parametrize("length", [0, 4, 15, 16, 60, 100, 300])
def test_a_truncated_message_stays_unchanged(length: int) -> None:
    cut = message([0.0] * 36)[:length]
    assert filled_in(cut) == cut


def test_a_message_with_an_invalid_frame_length_stays_unchanged() -> None:
    bad = bytearray(message([0.0] * 36))
    bad[12:16] = b"\xff\xff\xff\x7f"
    assert filled_in(bytes(bad)) == bytes(bad)


def test_only_initial_poses_are_changed() -> None:
    string = SideType("std_msgs/msg/String", "0", "")
    assert with_spread(PLAIN, "/amcl_pose") is PLAIN
    other = Conversion(string, SIDE, None)
    assert with_spread(other, "/initialpose") is other
    assert with_spread(PLAIN, "/robot1/initialpose").convert is filled_in


def test_covariance_is_filled_in_before_conversion_to_a_side() -> None:
    out = HubToSideRoute(KEY, "/initialpose", None, MARKED, DECISION, JOINT).conversion.convert
    assert out is not None
    zeros = message([0.0] * 36)
    assert out(zeros) == filled_in(zeros) + b"!"


def test_zero_covariance_to_the_hub_is_kept_for_our_localizer() -> None:
    assert SideToHubRoute(KEY, "/initialpose", INWARDS, DECISION, JOINT).conversion is INWARDS
