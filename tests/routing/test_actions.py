"""Rules decide on an action as a whole, which includes its five parts."""

from __future__ import annotations

import pytest

from bridge.config.sections.routing import RoutingSection
from bridge.hub.wire.qos import Qos
from bridge.messages.actions import split
from bridge.routing.edge import Endpoint, Kind, MadeBy
from bridge.routing.gates import EntryGate, GraphActions, Subject
from bridge.routing.rules import RuleSet

GO = "nav2_msgs/action/NavigateToPose"
PARTS = {
    "send_goal": (Kind.SERVER, f"{GO}_SendGoal"),
    "cancel_goal": (Kind.SERVER, "action_msgs/srv/CancelGoal"),
    "get_result": (Kind.SERVER, f"{GO}_GetResult"),
    "feedback": (Kind.PUBLISHER, f"{GO}_FeedbackMessage"),
    "status": (Kind.PUBLISHER, "action_msgs/msg/GoalStatusArray"),
}


def gate(*rules: dict, parts: tuple[str, ...] = tuple(PARTS), **section: object) -> EntryGate:
    endpoints = [
        Endpoint(part, PARTS[part][0], f"/robot/go/_action/{part}", PARTS[part][1], Qos(), MadeBy.NATIVE)
        for part in parts
    ]
    return EntryGate(RuleSet(RoutingSection.model_validate({"rules": list(rules), **section})), "ros2", endpoints)


def decided(gate: EntryGate) -> dict[str, str | None]:
    """Return each part's name on the other side of the gate, or None if the part is not bridged."""
    result: dict[str, str | None] = {}
    for part, (kind, type_name) in PARTS.items():
        of = "service" if kind is Kind.SERVER else "topic"
        policy = gate.decide(of, f"/robot/go/_action/{part}", type_name)
        result[part] = policy.name if policy.allowed else None
    return result


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("/go/_action/send_goal", ("/go", "send_goal")),
        ("/a/b/_action/status", ("/a/b", "status")),
        ("/go/_action/other", ("", "")),
        ("/_action/status", ("", "")),
        ("/go/send_goal", ("", "")),
    ],
)
def test_names_of_parts_are_split_into_action_and_part(name: str, parts: tuple[str, str]) -> None:
    assert split(name) == parts


def test_the_type_of_an_action_is_known_from_its_other_parts() -> None:
    known = GraphActions([("/go/_action/feedback", f"{GO}_FeedbackMessage")])
    assert known.subject("topic", "/go/_action/status", PARTS["status"][1]) == Subject("action", "/go", GO, "status")
    other = known.subject("topic", "/other/_action/status", PARTS["status"][1])
    assert other.unknown
    assert not known.subject("topic", "/other/_action/status", "std_msgs/msg/String").unknown
    assert known.subject("service", "/do", "std_srvs/srv/SetBool").kind == "service"


@pytest.mark.parametrize(
    ("rule", "name"),
    [
        ({"kind": "action", "topic": "/robot/*", "rename": "/r1/*"}, "/r1/go"),
        ({"topic": "/robot/**", "rename": "/r1/**"}, "/r1/go"),
        ({"kind": "action", "type": "nav2_msgs/action/*", "deny": True}, None),
        ({"kind": "action", "topic": "/robot/go", "deny": True}, None),
        ({"topic": "/robot/go", "deny": True}, None),
        ({"kind": "service", "topic": "/robot/**", "deny": True}, "/robot/go"),
        ({"kind": "topic", "topic": "/robot/**", "deny": True}, "/robot/go"),
        ({"topic": "/robot/go/_action/*", "deny": True}, "/robot/go"),
    ],
)
def test_a_rule_moves_or_denies_the_whole_action(rule: dict, name: str | None) -> None:
    assert decided(gate(rule)) == {part: name and f"{name}/_action/{part}" for part in PARTS}


def test_default_deny_covers_actions() -> None:
    assert set(decided(gate(default="deny")).values()) == {None}
    assert None not in decided(gate({"kind": "action"}, default="deny")).values()


def test_a_part_without_its_siblings_waits_for_them() -> None:
    lone = gate(parts=("status", "cancel_goal"))
    policy = lone.decide("topic", "/robot/go/_action/status", PARTS["status"][1])
    assert (policy.allowed, policy.settled) == (False, True)
    assert "its type is unknown" in policy.why


def test_only_the_name_of_a_rule_applies_to_parts_of_an_action() -> None:
    rule = {"topic": "/robot/**", "rate": 1, "priority": "command", "depth": 1}
    policy = gate(rule).decide("topic", "/robot/go/_action/feedback", PARTS["feedback"][1])
    assert (policy.allowed, policy.rate, policy.priority, policy.depth) == (True, None, "", None)


@pytest.mark.parametrize(
    ("side", "name", "type_name", "allowed"),
    [
        ("ros1", "/talker/get_loggers", "roscpp/srv/GetLoggers", False),
        ("ros1", "/get_loggers", "my_msgs/srv/GetLoggers", True),
        ("ros1", "/amcl/set_parameters", "dynamic_reconfigure/srv/Reconfigure", False),
        ("ros2", "/talker/get_parameters", "rcl_interfaces/srv/GetParameters", False),
        ("ros2", "/talker/get_type_description", "type_description_interfaces/srv/GetTypeDescription", False),
        ("ros2", "/amcl/change_state", "lifecycle_msgs/srv/ChangeState", False),
        ("zenoh", "/talker/get_parameters", "rcl_interfaces/srv/GetParameters", False),
        ("ros2", "/map_server/load_map", "nav2_msgs/srv/LoadMap", True),
    ],
)
def test_services_that_each_node_has_for_itself_are_private(
    side: str, name: str, type_name: str, *, allowed: bool
) -> None:
    rules = RuleSet(RoutingSection())
    policy = rules.enter(side, name, type_name, "service")
    assert (policy.allowed, policy.private) == (allowed, not allowed)
    named = RuleSet(RoutingSection.model_validate({"rules": [{"kind": "service", "topic": name}]}))
    assert named.enter(side, name, type_name, "service").allowed


def test_a_rule_of_services_has_no_rate() -> None:
    with pytest.raises(ValueError, match="rate, priority, depth, timeout and qos are for topics"):
        RoutingSection.model_validate({"rules": [{"kind": "service", "topic": "/do", "rate": 5}]})
