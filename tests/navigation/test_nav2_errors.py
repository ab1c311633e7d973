"""Nav2's error codes have reasons: each code that nav2_msgs (Jazzy) defines, and no other."""

from __future__ import annotations

import re

import pytest

from navigation.nav2_errors import reason
from navigation.status import Fault

# the constants of nav2_msgs/action/*.action, branch jazzy, without NONE=0
JAZZY = {
    "FollowPath": range(100, 108),
    "ComputePathToPose": range(200, 209),
    "ComputePathThroughPoses": range(300, 310),
    "ComputeRoute, ComputeAndTrackRoute": range(400, 408),
    "SmoothPath": range(500, 506),
    "FollowWaypoints, FollowGPSWaypoints": range(600, 602),
    "Spin": range(700, 704),
    "BackUp": range(710, 715),
    "DriveOnHeading": range(720, 725),
    "AssistedTeleop": range(730, 733),
    "DockRobot, UndockRobot, FollowObject": (*range(901, 907), 999),
}


@pytest.mark.parametrize("action", JAZZY)
def test_each_code_of_an_action_has_a_reason(action: str) -> None:
    texts = [reason(code) for code in JAZZY[action]]
    assert all(texts)
    assert not [text for text in texts if re.search(r"\d|\.$|^[A-Z]", text)], "a fragment of a sentence, without code"


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (102, "a transform is missing or too old"),
        (105, "the robot makes no progress"),
        (204, "the goal is outside the map"),
        (208, "no path to the goal"),
        (304, "the goal is outside the map"),
        (703, "an obstacle blocks the spin"),
    ],
)
def test_reason_of_a_code(code: int, text: str) -> None:
    assert reason(code) == text


def test_no_other_code_has_a_reason() -> None:
    known = {code for codes in JAZZY.values() for code in codes}
    assert [code for code in range(-1, 0x10000) if reason(code) and code not in known] == []


def test_midspan_codes_are_unknown_to_nav2() -> None:
    assert [fault for fault in Fault if reason(fault)] == []
