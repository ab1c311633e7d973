"""The answer of ``midspan explain``."""

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
    assert [answer["topic"] for answer in explain(topic, DECISIONS, ENDPOINTS)] == answers


def test_names_with_one_kind_of_endpoint_list_its_nodes() -> None:
    (chatter,), (reset,) = explain("/chatter", [], ENDPOINTS), explain("/reset", [], ENDPOINTS)
    assert (chatter["kind"], chatter["why"]) == ("topic", "it has no publisher; subscribed by /a, /b")
    assert (reset["kind"], reset["why"]) == ("service", "it has no server; clients: /c")
