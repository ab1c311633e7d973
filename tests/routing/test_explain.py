"""The output of ``midspan explain``."""

from __future__ import annotations

import pytest

from bridge.hub.wire.qos import Qos
from bridge.routing.decision import RouteDecision
from bridge.routing.edge import Endpoint, Kind, MadeBy
from bridge.routing.explain import explain
from bridge.routing.rules import RoutePolicy

DECISIONS = [
    RouteDecision("in", "/scan", "/robot/scan", "sensor_msgs/LaserScan", RoutePolicy(allowed=True, why="", name="x")),
    RouteDecision.unrouted("out", "/go/_action/status", "action_msgs/msg/GoalStatusArray", "it comes from here"),
]


def endpoint(kind: Kind, topic: str, node: str) -> Endpoint:
    return Endpoint(f"{node}{topic}", kind, topic, "std_msgs/String", Qos(), MadeBy.NATIVE, node)


ENDPOINTS = [
    endpoint(Kind.SUBSCRIPTION, "/chatter", "/b"),
    endpoint(Kind.SUBSCRIPTION, "/chatter", "/a"),
    endpoint(Kind.CLIENT, "/reset", "/c"),
    endpoint(Kind.SUBSCRIPTION, "/scan", "/a"),
    endpoint(Kind.PUBLISHER, "/odom", "/p"),
]


@pytest.mark.parametrize(
    ("topic", "answers"),
    [
        ("/scan", ["/scan"]),
        ("robot/scan", ["/scan"]),
        ("/go", ["/go/_action/status"]),
        ("/chatter", ["/chatter"]),
        ("/reset", ["/reset"]),
        ("/odom", []),
        ("", ["/scan", "/go/_action/status", "/chatter", "/reset"]),
    ],
)
def test_names_match_on_both_networks_and_by_action(topic: str, answers: list[str]) -> None:
    assert [answer["topic"] for answer in explain(topic, DECISIONS, ENDPOINTS, {})] == answers


def test_names_with_one_kind_of_endpoint_list_its_nodes() -> None:
    (chatter,), (reset,) = explain("/chatter", [], ENDPOINTS, {}), explain("/reset", [], ENDPOINTS, {})
    assert (chatter["kind"], chatter["why"]) == ("topic", "it has no publisher; subscribed by /a, /b")
    assert (reset["kind"], reset["why"]) == ("service", "it has no server; clients: /c")


def test_the_nodes_of_the_side_are_listed_with_their_programs() -> None:
    fast, cyclone = "Fast DDS 3.2.2 (Kilted)", "Cyclone DDS 0.10.5 (Iron or later)"
    ends = [*ENDPOINTS, endpoint(Kind.PUBLISHER, "/scan", ""), endpoint(Kind.PUBLISHER, "/scan", "/d")]
    programs = {"/a/chatter": cyclone, "/b/chatter": fast, "/a/scan": fast, "/scan": cyclone, "/d/scan": cyclone}
    (chatter,), (scan,), (reset,) = (
        explain(name, DECISIONS, ends, programs) for name in ("/chatter", "/scan", "/reset")
    )
    assert chatter["users"] == [f"subscribed by /a on {cyclone}", f"subscribed by /b on {fast}"]
    assert scan["users"] == [f"published by /d, a node with an unknown name on {cyclone}"]
    assert reset["users"] == []
