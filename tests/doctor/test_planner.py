"""The doctor's reasons for an unavailable planner."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.config.sections.navigation import NavigationSection
from bridge.doctor.check import Result
from bridge.doctor.checks import daemon as daemon_checks
from bridge.doctor.hub_problems import absence
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import EndpointKind
from bridge.hub.wire.qos import Qos
from tests.doctor.parts import around, document, hub, only

MOVE_BASE = "/planner/move_base/navigate_to_pose"
ROS1 = {"worker": "ros1", "side": "ros1", "state": "running", "refused": []}
GATEWAY = {"worker": "gateway", "module": True, "state": "waiting", "text": "the planner p is not available"}


def server(action: str) -> HubEndpoint:
    """Return a server of one part of an action on the hub."""
    return HubEndpoint(
        "ab", "n", "/", EndpointKind.SERVER, f"{action}/_action/send_goal", "a/action/A_SendGoal", "h", Qos(),
        bytes(16), origin=None, pending=False, own=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("planner", "documents", "why", "cure"),
    [
        ("move_base", [ROS1], "no node serves its action /move_base on ROS 1", "start move_base there"),
        ("move_base", [], "no worker of the ROS 1 side answers", "ros1-master"),
        ("move_base", [{**ROS1, "state": "waiting"}], "its side, ROS 1, is unavailable", "ros1-master"),
        ("nav2", [ROS1, {"side": "ros2", "state": "running"}], "/navigate_to_pose on ROS 2", "start nav2 there"),
        ("robot_goto", [ROS1], "its module does not run", "modules.robot_goto.enabled: true"),
    ],
)
def test_each_reason_has_its_cure(planner: str, documents: list[dict[str, Any]], why: str, cure: str) -> None:
    finding = absence(NavigationSection(planner=planner), planner, [], list(map(document, documents)))
    assert finding is not None
    assert finding.text.startswith(f"the planner {planner} is not available: ")
    assert why in finding.text
    assert cure in finding.cure


def test_a_planner_whose_class_cannot_be_imported_is_reported() -> None:
    finding = absence(NavigationSection.model_validate({"planner": "hall:Hall"}), "hall", [], [])
    assert finding is not None
    assert finding.text == "the planner hall is not available: its module does not run"
    assert finding.cure.startswith("put the folder of hall on PYTHONPATH")


def test_a_planner_whose_action_cannot_be_bridged_is_reported() -> None:
    entry = {"direction": "in", "topic": "/move_base/goal", "reason": "no definition", "cure": "install it"}
    finding = absence(NavigationSection(planner="move_base"), "move_base", [], [document({**ROS1, "refused": [entry]})])
    assert finding is not None
    assert ("cannot be bridged: no definition" in finding.text, finding.cure) == (True, "install it")


def test_a_running_or_unknown_planner_is_not_reported_as_absent() -> None:
    section = NavigationSection(planner="move_base")
    assert absence(section, "move_base", [server(MOVE_BASE)], [document(ROS1)]) is None
    assert absence(section, "another", [], [document(ROS1)]) is None


def test_doctor_reports_the_state_of_its_own_gateway() -> None:
    config = {"navigation": {"planner": "move_base"}}
    view = hub({**GATEWAY, "planner": "move_base"})
    mine = only(daemon_checks.check_workers(around(config, hub=view)))
    assert (mine.result, "start" in mine.cure or "ros1-master" in mine.cure) == (Result.WARN, True)
    assert "robot1/gateway waits: the planner move_base is not available: no worker of the ROS 1 side" in mine.seen
    with_gateway = hub({**GATEWAY, "planner": "move_base"}, endpoints=[server(MOVE_BASE)])
    for other in (hub({**GATEWAY, "daemon": "robot2", "planner": "move_base"}), with_gateway):
        finding = only(daemon_checks.check_workers(around(config, hub=other)))
        assert (finding.seen.partition(" ")[2], finding.cure) == ("waits: the planner p is not available", "")


def test_module_reports_what_it_waits_for() -> None:
    view = hub({"worker": "robot_goto", "module": True, "state": "waiting", "text": "no scan comes"})
    finding = only(daemon_checks.check_workers(around(hub=view)))
    assert (finding.result, finding.seen) == (Result.WARN, "robot1/robot_goto waits: no scan comes")
