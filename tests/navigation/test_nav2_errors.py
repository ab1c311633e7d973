"""Nav2's error codes have reasons: each code that nav2_msgs of Humble to Lyrical defines, and no other."""

from __future__ import annotations

import re

import pytest

from bridge.interfaces.folders import DEFINITIONS
from navigation.nav2_errors import reason
from navigation.status import Fault

# the constants of nav2_msgs/action/*.action, branches humble, jazzy, kilted and lyrical, without NONE=0
ACTIONS = {
    "any, in Lyrical": range(1, 3),
    "FollowPath": range(100, 109),
    "ComputePathToPose": range(200, 209),
    "ComputePathThroughPoses": range(300, 310),
    "ComputeRoute, ComputeAndTrackRoute": range(400, 408),
    "SmoothPath": range(500, 506),
    "FollowWaypoints, FollowGPSWaypoints": range(600, 604),
    "Spin": range(700, 704),
    "BackUp": range(710, 715),
    "DriveOnHeading": range(720, 725),
    "AssistedTeleop": range(730, 733),
    "Wait": range(740, 742),
    "DockRobot, UndockRobot, FollowObject": (*range(901, 908), 999),
    "NavigateToPose": range(9000, 9004),
    "NavigateThroughPoses": range(9100, 9104),
}


@pytest.mark.parametrize("action", ACTIONS)
def test_each_code_of_an_action_has_a_reason(action: str) -> None:
    texts = [reason(code) for code in ACTIONS[action]]
    assert all(texts)
    assert not [text for text in texts if re.search(r"\d|\.$|^[A-Z]", text)], (
        "each reason is a fragment of a sentence without the code"
    )


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (102, "a transform is missing or too old"),
        (105, "the robot makes no progress"),
        (204, "the goal is outside the map"),
        (208, "no path to the goal"),
        (304, "the goal is outside the map"),
        (703, "an obstacle blocks the spin"),
        (9001, "the behavior tree cannot be loaded"),
        (9102, "a transform is missing or too old"),
    ],
)
def test_each_error_code_of_nav2_has_a_reason(code: int, text: str) -> None:
    assert reason(code) == text


def test_no_other_code_has_a_reason() -> None:
    known = {code for codes in ACTIONS.values() for code in codes}
    assert [code for code in range(-1, 0x10000) if reason(code) and code not in known] == []


def test_midspan_codes_are_unknown_to_nav2() -> None:
    assert [fault for fault in Fault if reason(fault)] == []


def test_midspan_codes_have_their_names_in_midspan_msgs() -> None:
    text = (DEFINITIONS / "midspan_msgs/msg/NavigationFault.msg").read_text()
    constants = dict(re.findall(r"^uint16 ([A-Z_]+)=(\d+)$", text, re.MULTILINE))
    assert {name: int(code) for name, code in constants.items()} == {fault.name: fault for fault in Fault}
