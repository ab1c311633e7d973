"""Real Cyclone DDS programs beside the real daemon: each caller of their services gets the reason at once."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

import pytest
import zenoh

from bridge.hub.endpoints.calls import CallError, CallRefusedError
from bridge.hub.wire.keys import topic_key
from bridge.messages.actions import GoalState
from bridge.messages.registry import Registry
from tests.adapters.ros2.calls import SET_BOOL, Ends, Service
from tests.adapters.ros2.conftest import string, text
from tests.interop.deployment import Deployment
from tests.interop.hub_actions import HubActions
from tests.support.cyclone import CyclonePeer
from tests.support.wait import until

TYPE = "std_srvs/SetBool"
ACTION = "nav2_msgs/action/NavigateToPose"
SEND_GOAL = f"{ACTION}_SendGoal"
GOAL = {"pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 5.0}}}}
AT_ONCE = 3.0


def cyclone(deployment: Deployment) -> CyclonePeer:
    return deployment.keep(CyclonePeer())


def until_refused(deployment: Deployment, name: str, direction: str = "in") -> dict[str, Any]:
    """The decision on a name that Cyclone DDS serves or calls."""

    def found() -> dict[str, Any] | None:
        lines = [line for line in deployment.explain(name) if (line["topic"], line["direction"]) == (name, direction)]
        return next((line for line in lines if line["decision"] == "refused"), None)

    deployment.status()
    return until(found, f"{name} is refused", 30, every=0.1)  # type: ignore[return-value]


def test_services_of_cyclone_dds(shared: Deployment) -> None:
    native, service = cyclone(shared), Service(Registry(), SET_BOOL)
    server = native.serve("/lamp", TYPE, service.response(success=True))
    decision = until_refused(shared, "/lamp")
    assert "/lamp is served on Cyclone DDS" in decision["reason"]
    assert "rmw_fastrtps_cpp" in decision["cure"]
    shared.until_route("ros1", "/lamp", "out", state="active")

    ros1, began = shared.ros1(), time.monotonic()
    ros1.ask("await_service", service="/lamp", seconds=20)
    call = ros1.ask("call", service="/lamp", type=TYPE, request={"data": True})["id"]
    answer = ros1.ask("result", id=call, seconds=20)
    assert answer["done"]
    assert "Cyclone DDS" in answer["error"]

    ends, hub = Ends(), shared.zenoh().hub
    client = hub.client("/lamp", SET_BOOL, service.type.type_id)
    until(lambda: client.ready, "the service is on the hub")
    began = time.monotonic()
    client.call(service.request(data=True), ends.done)
    assert isinstance(ends.wait()[0], CallRefusedError)
    assert time.monotonic() - began < AT_ONCE

    told = shared.command("service", "call", "/lamp", json.dumps({"data": True}))
    assert told.returncode == 1
    assert "Cyclone DDS" in told.stderr
    assert native.requests(server) == []


def test_actions_of_cyclone_dds(shared: Deployment) -> None:
    native = cyclone(shared)
    servers = native.act("/cyclone_go", ACTION)
    for part in ("send_goal", "get_result", "cancel_goal"):
        until_refused(shared, f"/cyclone_go/_action/{part}")
    ros1 = shared.ros1()
    shared.until_route("ros1", "/cyclone_go/_action/send_goal", "out", state="active")
    goal = ros1.ask("send_goal", action="/cyclone_go", type="nav2_msgs/NavigateToPose", goal=GOAL)["id"]
    state = ros1.ask("goal", id=goal, until={"status": 5}, seconds=20)
    assert "Cyclone DDS" in state.get("text", "Cyclone DDS")

    told = shared.command("goal", "send", "/cyclone_go", json.dumps(GOAL))
    assert told.returncode == 1
    assert "Cyclone DDS" in told.stderr
    assert native.requests(servers) == []


def test_halt_says_what_it_cannot_cancel(shared: Deployment) -> None:
    native = cyclone(shared)
    servers = native.act("/cyclone_stop", ACTION)
    until_refused(shared, "/cyclone_stop/_action/cancel_goal")
    told = shared.command("halt", "--json", "--seconds", "0.2")
    assert told.returncode == 1
    assert "Cyclone DDS" in json.loads(told.stdout)["errors"]["/cyclone_stop"]
    assert native.requests(servers) == []


def test_plain_zenoh_and_rmw_zenoh_get_error_and_refusal(shared: Deployment) -> None:
    """An rmw_zenoh client logs the error and waits for a reply, which is the refusal."""
    native = cyclone(shared)
    servers = native.act("/cyclone_zenoh", ACTION)
    until_refused(shared, "/cyclone_zenoh/_action/send_goal")
    service = Service(Registry(), SEND_GOAL)
    key = topic_key(0, "/cyclone_zenoh/_action/send_goal", SEND_GOAL, service.type.type_id)
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{shared.port}"]))
    with zenoh.open(config) as session:

        def asked() -> list[zenoh.Reply]:
            options = {"target": zenoh.QueryTarget.ALL_COMPLETE, "consolidation": zenoh.ConsolidationMode.NONE}
            return list(session.get(key, payload=service.request(), timeout=5.0, **options))

        error, reply = until(asked, "replies", 20)
    assert error.err is not None
    assert "Cyclone DDS" in error.err.payload.to_string()
    assert reply.ok is not None
    assert service.answer(reply.ok.payload.to_bytes())["accepted"] is False
    assert native.requests(servers) == []
