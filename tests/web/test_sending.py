"""The console's forms: definitions, publishing one message, and calling one service."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from bridge.hub.wire.qos import Durability
from bridge.routing import limits
from bridge.web.verbs import sending
from tests.peers.browser.page import TestPage
from tests.support.wait import until
from tests.web.conftest import Desk


@pytest.fixture(autouse=True)
def settled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sending, "_SETTLE_SECONDS", 0.0)


def test_a_definition_includes_nested_types(desk: Desk) -> None:
    with TestPage(desk.port) as page:
        definition = page.call("definition", type="geometry_msgs/PoseStamped")["value"]
        assert definition["type"] == definition["root"] == "geometry_msgs/msg/PoseStamped"
        assert [field["name"] for field in definition["types"][definition["root"]]["fields"]] == ["header", "pose"]
        w = definition["types"]["geometry_msgs/msg/Quaternion"]["fields"][3]
        assert (w["name"], w["base"], w["shape"], w["default"]) == ("w", "float64", "single", 1)
        assert {"std_msgs/msg/Header", "builtin_interfaces/msg/Time", "geometry_msgs/msg/Point"} <= definition[
            "types"
        ].keys()


def test_a_definition_includes_constants(desk: Desk) -> None:
    with TestPage(desk.port) as page:
        definition = page.call("definition", type="sensor_msgs/msg/BatteryState")["value"]
        constants = {
            constant["name"]: constant["value"] for constant in definition["types"][definition["root"]]["constants"]
        }
        assert constants["POWER_SUPPLY_STATUS_CHARGING"] == 1


def test_a_services_definition_has_request_and_response(desk: Desk) -> None:
    with TestPage(desk.port) as page:
        definition = page.call("definition", type="std_srvs/SetBool", kind="service")["value"]
        request, response = definition["types"][definition["root"]], definition["types"][definition["response"]]
        assert [(field["name"], field["base"]) for field in request["fields"]] == [("data", "bool")]
        assert [field["name"] for field in response["fields"]] == ["success", "message"]


@pytest.mark.parametrize(
    ("verb", "args", "why"),
    [
        ("definition", {"type": "std_msgs/Strin"}, "no worker on the hub has its definition. Did you mean"),
        ("definition", {"type": "nonsense"}, "'nonsense' is not a type"),
        ("definition", {"type": "std_msgs/String", "kind": "action"}, "definition: kind must be one of topic, service"),
        ("publish", {"topic": "/x", "type": "std_msgs/String", "message": []}, "publish: message must be an object"),
        ("publish", {"topic": "x y", "type": "std_msgs/String", "message": {}}, "'x y' is not a topic name"),
        ("publish", {"topic": "/_midspan/x", "type": "std_msgs/String", "message": {}}, "is not a topic name"),
        (
            "publish", {"topic": "/x", "type": "std_msgs/String", "message": {"dat": "y"}},
            "std_msgs/msg/String: std_msgs/msg/String has no field 'dat'; did you mean 'data'?",
        ),
        (
            "publish", {"topic": "/x", "type": "std_msgs/Int8", "message": {"data": 300}},
            "std_msgs/msg/Int8: data must be int8, not 300",
        ),
        ("call_service", {"name": "/x/_action/send_goal", "type": "a/srv/B", "request": {}}, "is not a service name"),
    ],
)  # fmt: skip
def test_invalid_messages_and_calls_are_refused(desk: Desk, verb: str, args: dict[str, Any], why: str) -> None:
    with TestPage(desk.port) as page:
        assert why in page.call(verb, **args)["error"]


@pytest.mark.parametrize(
    ("topic", "type_name"),
    [
        ("/cmd_vel", "geometry_msgs/Twist"),
        ("/cmd_vel", "std_msgs/String"),
        ("/wheels", "std_msgs/msg/Float64"),
        ("/steering", "std_msgs/msg/Float64"),
        ("/anything", "geometry_msgs/msg/Twist"),
        ("/anything", "geometry_msgs/TwistStamped"),
        ("/tug/cmd", "std_msgs/String"),
    ],
)
def test_velocities_are_refused(desk: Desk, topic: str, type_name: str) -> None:
    desk.open_with(
        navigation={
            "planner": "tug",
            "planners": [{"name": "tug", "side": "ros1", "action": "/tug", "velocity": "/tug/cmd"}],
        },
        routing={
            "rules": [
                {"topic": "/wheels", "priority": "command"},
                {"topic": "/steering", "to": "ros1", "priority": "command"},
            ]
        },
    )
    with TestPage(desk.port) as page:
        error = page.call("publish", topic=topic, type=type_name, message={})["error"]
        assert "drive manually in the view Drive" in error
        assert not desk.far.hub.graph.publishers(topic)


def test_a_message_is_published_once_and_not_latched(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.client.publishing.MATCH_SECONDS", 20.0)
    subscription = desk.far.subscribe("/said", "std_msgs/String")
    with TestPage(desk.port) as page:
        page.until(lambda: desk.console.host.node.hub.graph.subscriptions("/said"), "the subscriber is discovered")
        reply = page.call("publish", topic="/said", type="std_msgs/String", message={"data": "hello"})
        assert reply["value"] == "published on /said"
        assert desk.far.wait(subscription, 1)[0] == {"data": "hello"}
        (end,) = until(lambda: desk.far.hub.graph.publishers("/said"), "the console's publisher is in the graph")
        assert end.qos.durability is Durability.VOLATILE
        second = page.call("publish", topic="/said", type="std_msgs/String", message={"data": "again"})
        while not second["ok"]:
            second = page.call("publish", topic="/said", type="std_msgs/String", message={"data": "again"})
        assert [message["data"] for message in desk.far.wait(subscription, 2)] == ["hello", "again"]
        assert len(desk.far.hub.graph.publishers("/said")) == 1, "the same publisher is reused"


def test_a_missing_subscriber_is_reported(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.client.publishing.MATCH_SECONDS", 0.2)
    with TestPage(desk.port) as page:
        reply = page.call("publish", topic="/void", type="std_msgs/Empty", message={})
        assert reply["value"] == "published on /void, but the hub has no subscriber"


def test_the_rate_of_messages_is_limited(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.client.publishing.MATCH_SECONDS", 0.0)
    monkeypatch.setattr(limits, "time", SimpleNamespace(monotonic=lambda: 1000.0))  # a busy console may be slow enough
    with TestPage(desk.port) as page:
        for number in range(1, 13):
            message = {"data": str(number)}
            page.send(
                op="call", id=1000 + number, verb="publish",
                args={"topic": "/often", "type": "std_msgs/String", "message": message},
            )  # fmt: skip
        page.until(lambda: sum(m.get("id", 0) > 1000 for m in page.others) == 12, "all calls get replies")
        errors = [m["error"] for m in page.others if m.get("id", 0) > 1000 and not m["ok"]]
        assert errors
        assert all("the limit is 5 messages per second" in error for error in errors)


def test_a_service_call_returns_its_reply(desk: Desk) -> None:
    served = desk.far.serve("/light", "std_srvs/SetBool", reply={"success": True, "message": "it is on"})
    assert served is not None
    with TestPage(desk.port) as page:
        page.watch("services")
        services = page.value("services", lambda value: any(service["service"] == "/light" for service in value or ()))
        assert next(service for service in services if service["service"] == "/light") == {
            "service": "/light", "type": "std_srvs/srv/SetBool", "servers": 1, "clients": 0,
        }  # fmt: skip
        reply = page.call("call_service", name="/light", type="std_srvs/SetBool", request={"data": True})
        assert reply["value"] == {"success": True, "message": "it is on"}
        invalid = page.call("call_service", name="/light", type="std_srvs/SetBool", request={"data": 3})
        assert invalid["error"] == "std_srvs/srv/SetBool: data must be bool, not 3"
        other = page.call("call_service", name="/light", type="std_srvs/Trigger", request={})
        assert "/light is std_srvs/srv/SetBool on the hub, not std_srvs/srv/Trigger" in other["error"]
        graph = desk.far.hub.graph
        until(lambda: not graph.clients("/light"), "the service's clients are closed")
