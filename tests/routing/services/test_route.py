"""Service routes: their counters, and calls that end exactly once despite all disturbances."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from base64 import b64decode
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import MagicMock

import pytest
import zenoh

from bridge.config.sections.routing import RoutingSection
from bridge.hub.endpoints.calls import Abandon, CallError, ClosedCallError, Done
from bridge.hub.endpoints.services import HubClient
from bridge.hub.node import Hub
from bridge.messages.actions import (
    CANCEL,
    CANCEL_GOAL,
    ENDINGS,
    GET_RESULT,
    SEND_GOAL,
    CancelCode,
    GoalState,
    part_name,
)
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from bridge.routing import counters
from bridge.routing.edge import MadeBy
from bridge.routing.engine import Engine
from bridge.routing.peer_watch import Lease
from bridge.routing.services import held, orphans
from bridge.routing.services import route as service_route
from bridge.routing.services.held import HeldCalls
from bridge.routing.services.orphans import OrphanCancels
from tests.peers.fake import FakeEdge, FakeNetwork
from tests.peers.hub.calls import Calling, Serving
from tests.peers.hub.quick import QuickHub
from tests.support.wait import until

SET, GO = "std_srvs/srv/SetBool", "nav2_msgs/action/NavigateToPose"
REGISTRY = Registry()


class Rig:
    """A fake network, an engine, and a native participant of the hub."""

    def __init__(self, hubs: QuickHub) -> None:
        self.hubs = hubs
        self.network, self.far = FakeNetwork(), Hub.open(hubs.settings("far"))
        self._open: list[tuple[Engine, Hub]] = []
        self._held = list[HeldCalls]()
        self.engine = self.another("test")

    def another(self, daemon: str) -> Engine:
        """Start another engine on the network."""
        hub = Hub.open(self.hubs.settings("midspan_fake"))
        engine = Engine(FakeEdge(self.network, REGISTRY), hub, RoutingSection(), daemon, self._failed, REGISTRY)
        engine.start()
        self._open.append((engine, hub))
        return engine

    def _failed(self, reason: str) -> None:
        raise AssertionError(reason)

    def serve(self, name: str = "/do", type_name: str = SET, **params: Any) -> Serving:
        """Start a native server on the side."""
        serving = Serving(REGISTRY, type_name, params)
        self.network.serve(name, type_name, MadeBy.NATIVE, "/native", serving.call)
        return serving

    def client(self, name: str = "/do", type_name: str = SET) -> HubClient:
        client = self.far.client(name, type_name, REGISTRY.service_ros2(type_name).type_id)
        until(lambda: client.ready, "the service is on the hub")
        return client

    def row(self, name: str = "/do") -> dict[str, Any]:
        return next(row for row in self.engine.status().document()["routes"] if row["topic"] == name)

    def counts(self, name: str = "/do") -> tuple[int, ...]:
        row = self.row(name)
        return tuple(row[key] for key in ("calls", "replies", "errors", "abandoned", "pending"))

    def without_lease(self) -> Lease:
        """Give the only route another lease, which has just expired."""
        (route,) = self.engine.routes()
        lease = Lease()
        lease.until = time.monotonic()
        route._context = replace(route._context, lease=lease)
        self._held.append(route._context.held_calls)
        return lease

    def close(self) -> None:
        for engine, hub in self._open:
            engine.stop()
            hub.close()
        for calls in self._held:
            calls.close()
        self.far.close()


@pytest.fixture
def rig() -> Iterator[Rig]:
    with QuickHub() as hubs, contextlib.closing(Rig(hubs)) as rig:
        yield rig


def ask(client: HubClient, **request: Any) -> Calling:
    return Calling(REGISTRY, SET, request, client.call)


def test_too_many_calls_get_an_error_at_once(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service_route, "MAX_CALLS", 3)
    serving = rig.serve(held=True, reply={"message": "late"})
    client = rig.client()
    waiting = [ask(client) for _ in range(3)]
    serving.requests(3)
    assert ask(client).result()["error"] == "3 calls of /do are already pending; call again later"
    assert rig.counts() == (4, 0, 1, 0, 3)
    assert rig.row()["drops"]["queue"] == 1
    serving.release()
    assert [call.result()["reply"]["message"] for call in waiting] == ["late"] * 3
    assert ask(client).result()["reply"]
    assert rig.counts() == (5, 4, 1, 0, 0)


def test_the_same_error_of_repeated_calls_is_logged_once(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A cancel request, for example, is repeated until the server responds."""
    caplog.set_level(logging.INFO, "bridge.routing.services.route")
    answer: list[bytes | CallError] = [CallError("no server of /do is on ROS 2")]
    works = from_json(REGISTRY, f"{SET}_Response", {})

    def call(_request: bytes, done: Done) -> Abandon:
        done(answer[0])
        return lambda: None

    rig.network.serve("/do", SET, MadeBy.NATIVE, "/native", call)
    client = rig.client()
    clock = time.monotonic()
    monkeypatch.setattr(counters, "time", SimpleNamespace(monotonic=lambda: clock))

    def logged(calls: int) -> int:
        nonlocal clock
        caplog.clear()
        for _ in range(calls):
            clock += 1.5
            ask(client).result()
        return sum("/do" in record.getMessage() for record in caplog.records)

    assert [logged(10), logged(10)] == [1, 0]
    answer[0] = CallError("the server of /do left before it answered")
    assert logged(5) == 1
    answer[0] = works
    assert logged(2) == 0
    answer[0] = CallError("the server of /do left before it answered")
    assert logged(5) == 1, "logged again, because a call succeeded in between"
    clock += 100.0
    assert logged(5) == 1, "logged again after a pause"


def test_a_canceled_call_is_canceled_on_the_side(rig: Rig) -> None:
    serving = rig.serve(held=True)
    call = ask(rig.client())
    serving.requests(1)
    call.abandon()
    until(lambda: serving.abandoned == 1, "the side's server is notified")
    serving.release()
    assert rig.counts() == (1, 0, 0, 1, 0)
    assert not call.result(0)["done"]


def test_malformed_requests_and_replies_are_refused(rig: Rig) -> None:
    rig.serve()

    def nonsense(_request: bytes, done: Done) -> Abandon:
        done(b"\0\1\0\0nonsense")
        return lambda: None

    rig.network.serve("/odd", SET, MadeBy.NATIVE, "/odd", nonsense)
    ends: list[bytes | CallError] = []
    ended = threading.Event()
    rig.client().call(b"\0\1\0\0", lambda end: (ends.append(end), ended.set()))
    assert ended.wait(20)
    assert str(ends[0]).startswith("the request does not match its type")
    assert ask(rig.client("/odd")).result()["error"].startswith("the reply does not match its type")
    assert [rig.row(name)["drops"]["bad"] for name in ("/do", "/odd")] == [1, 1]
    assert rig.counts("/odd") == (1, 0, 1, 0, 0)


def test_a_large_reply_arrives_complete_and_delays_no_small_one(rig: Rig) -> None:
    rig.serve("/large", reply={"message": "x" * 1_000_000})
    rig.serve(reply={"message": "small"})
    large, small = rig.client("/large"), rig.client()
    calls = [ask(large) for _ in range(5)]
    assert ask(small).result()["reply"]["message"] == "small"
    assert [len(call.result()["reply"]["message"]) for call in calls] == [1_000_000] * 5


def test_call_without_the_lease_is_served_when_the_lease_is_back(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(held, "HOLD_SECONDS", 60.0)  # no matter how slow the machine is
    serving = rig.serve(reply={"message": "done"})
    client = rig.client()
    lease = rig.without_lease()
    left, call = ask(client), ask(client)
    until(lambda: rig.row()["pending"] == 2, "both calls are held")
    left.abandon()
    until(lambda: rig.row()["abandoned"] == 1, "the first client has left")
    assert serving.requests(1, 0) == []
    lease.extend(time.monotonic() + 60.0)
    assert call.result()["reply"]["message"] == "done"
    assert len(serving.requests(1, 0)) == 1
    assert rig.counts() == (2, 1, 0, 1, 0)


def test_call_is_refused_if_the_lease_does_not_return(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(held, "HOLD_SECONDS", 0.2)
    serving = rig.serve()
    client = rig.client()
    rig.without_lease()
    assert ask(client).result()["error"] == "the bridge to fake was suspended or is on standby; call again later"
    assert serving.requests(1, 0) == []
    assert rig.row()["drops"]["standby"] == 1


def test_a_call_of_an_action_that_the_bridge_refuses_is_reported_as_unsent(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Clients repeat such a request to cancel; the reply *rejected* could be the server's own."""
    monkeypatch.setattr(held, "HOLD_SECONDS", 0.2)
    name, kind = "/go/_action/send_goal", f"{GO}_SendGoal"
    rig.serve(name, kind)
    client = rig.client(name, kind)
    rig.without_lease()
    error = Calling(REGISTRY, kind, {}, client.call).result()["error"]
    assert error == "the bridge to fake was suspended or is on standby; call again later"


def test_call_that_may_have_waited_while_the_machine_slept_is_refused_unless_it_cancels(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lease does not expire meanwhile, because the monotonic clock stands."""
    cancel, sent = "/go/_action/cancel_goal", rig.serve()
    rig.serve("/go/_action/send_goal", f"{GO}_SendGoal")
    canceled = rig.serve(cancel, CANCEL)
    client, canceling = rig.client(), rig.client(cancel, CANCEL)
    monkeypatch.setattr(rig.engine.stall_detector, "hung", lambda seconds: seconds < 60.0)
    assert ask(client).result()["error"] == "the bridge to fake was suspended or is on standby; call again later"
    assert rig.row()["drops"]["standby"] == 1
    assert Calling(REGISTRY, CANCEL, {}, canceling.call).result()["done"]
    assert (len(sent.requests(1, 0)), len(canceled.requests(1, 0))) == (0, 1)


def test_call_survives_a_watch_that_does_not_run(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """One thread of a starved worker stands still until its lease expires, while its other threads receive calls."""
    monkeypatch.setattr(held, "HOLD_SECONDS", 60.0)
    rig.serve(reply={"message": "done"})
    client = rig.client()
    runs, lease = threading.Event(), rig.engine._context.lease
    sightings = rig.engine.edge.sightings
    monkeypatch.setattr(rig.engine.edge, "sightings", lambda: (runs.wait(20), sightings())[1])
    until(lambda: lease.over, "the lease has expired")
    call = ask(client)
    until(lambda: rig.row()["pending"] == 1, "the call is held")
    runs.set()
    assert call.result()["reply"]["message"] == "done"


def test_held_call_ends_when_its_route_closes(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(held, "HOLD_SECONDS", 60.0)
    rig.serve()
    client = rig.client()
    rig.without_lease()
    call = ask(client)
    until(lambda: rig.row()["pending"] == 1, "the call is held")
    rig.network.restart(None)
    assert call.result()["error"]


def test_calls_of_a_closing_route_end_with_the_reason_why_it_closes(rig: Rig) -> None:
    """An edge's client that is closed ends its calls itself, but only the route knows why it is closed."""
    serving = rig.serve(held=True)
    call = ask(rig.client())
    serving.requests(1)
    (route,) = rig.engine.routes()
    assert isinstance(route, service_route.ServiceRoute)
    far, calls = route._far, tuple(route._calls)

    def close() -> None:
        for pending in calls:
            pending._on_result(ClosedCallError("its client was closed"))

    route._far = cast("Any", SimpleNamespace(close=close))
    route.close()
    assert call.result()["error"] == "the server of /do left before it answered"
    assert far is not None
    far.close()
    serving.release()


def test_the_end_of_the_network_ends_its_calls(rig: Rig) -> None:
    serving = rig.serve(held=True)
    call = ask(rig.client())
    serving.requests(1)
    rig.network.restart(None)
    assert call.result()["error"] in (
        "the fake network of the server is unavailable",
        "the server of /do left before it answered",
    )
    serving.release()
    until(lambda: not rig.far.graph.servers("/do"), "the service is gone from the hub")


@pytest.mark.parametrize(
    ("part", "type_name", "refusal"),
    [
        ("send_goal", f"{GO}_SendGoal", {"accepted": False}),
        ("cancel_goal", "action_msgs/srv/CancelGoal", {"return_code": 1}),
    ],
)
def test_an_error_of_an_actions_service_becomes_a_refusing_reply(
    rig: Rig, part: str, type_name: str, refusal: dict[str, int]
) -> None:
    """A client of rmw_zenoh receives no errors."""
    rig.serve(f"/go/_action/{part}", type_name, error="the planner fell over")
    if part == "cancel_goal":
        rig.serve("/go/_action/send_goal", f"{GO}_SendGoal")
    client = rig.client(f"/go/_action/{part}", type_name)
    ended = Calling(REGISTRY, type_name, {}, client.call).result()
    assert ended["reply"], ended
    reply = ended["reply"]
    assert {name: reply[name] for name in refusal} == refusal
    row = rig.row(f"/go/_action/{part}")
    assert (row["action"], row["errors"], row["error"]) == ("/go", 1, "the planner fell over")


@pytest.mark.parametrize("action", [GO, "tf2_msgs/action/LookupTransform"])
def test_an_error_of_a_result_request_precedes_its_reply(rig: Rig, action: str) -> None:
    """Midspan's clients use the error, as if the hub had reported it; clients of rmw_zenoh receive only the reply."""
    name, type_name = "/go/_action/get_result", f"{action}_GetResult"
    rig.serve(name, type_name, error="the planner fell over")
    client = rig.client(name, type_name)
    assert Calling(REGISTRY, type_name, {}, client.call).result()["error"] == "the planner fell over"
    request = from_json(REGISTRY, f"{type_name}_Request", {})
    everything = zenoh.ConsolidationMode.NONE
    received = list(
        rig.far._session.get(client._key, payload=request, attachment=client._attached(2), consolidation=everything)
    )
    assert [reply.err.payload.to_string() for reply in received[:1]] == ["the planner fell over"]
    replies = [to_json(REGISTRY, f"{type_name}_Response", reply.ok.payload.to_bytes()) for reply in received[1:]]
    assert [reply["status"] for reply in replies] == [GoalState.UNKNOWN]
    assert replies[0]["result"].get("error_msg", "the planner fell over") == "the planner fell over"


def test_explain_lists_the_parts_of_an_action(rig: Rig) -> None:
    rig.serve("/go/_action/send_goal", f"{GO}_SendGoal")
    rig.serve("/go/_action/cancel_goal", "action_msgs/srv/CancelGoal")
    rig.client("/go/_action/send_goal", f"{GO}_SendGoal")
    expected = {
        ("/go/_action/send_goal", "/go", "bridged"),
        ("/go/_action/cancel_goal", "/go", "bridged"),
    }

    def explained() -> set[tuple[str, str, str]]:
        return {(line["topic"], line["action"], line["decision"]) for line in rig.engine.explain("/go")}

    until(lambda: explained() == expected, "both services are explained")


def test_a_server_of_the_hub_is_called_from_the_side(rig: Rig) -> None:
    def serve(request: bytes, done: Done) -> Abandon:
        on = to_json(REGISTRY, f"{SET}_Request", request)["data"]
        done(from_json(REGISTRY, f"{SET}_Response", {"success": on}))
        return lambda: None

    server = rig.far.server("/do", SET, REGISTRY.service_ros2(SET).type_id, serve)
    served: Callable[[], bool] = lambda: any(e.topic == "/do" for e in rig.network.endpoints())  # noqa: E731
    until(served, "the service is offered on the side")

    def ask_side(request: bytes, done: Done) -> Abandon:
        return rig.network.call("/do", request, done)

    assert Calling(REGISTRY, SET, {"data": True}, ask_side).result()["reply"]["success"] is True
    server.close()
    until(lambda: not served(), "the service is withdrawn")
    assert Calling(REGISTRY, SET, {}, ask_side).result()["error"] == "/do has no server"


def test_one_worker_of_a_network_offers_a_service_and_another_takes_over(rig: Rig) -> None:
    """The pending call ends with an error; the next one is served through the other worker."""
    serving = rig.serve(held=True, reply={"success": True})
    client = rig.client()
    call = ask(client)
    serving.requests(1)
    second = rig.another("second")
    until(lambda: second.summary().standing_by, "the second worker is on standby")
    until(lambda: [line["decision"] for line in second.explain("/do")] == ["standby"], "it is explained")
    assert len(rig.far.graph.servers("/do")) == 1
    rig.engine.stop()
    assert call.result()["error"]
    serving.release()
    until(lambda: second.summary().state == "running", "the second worker is active")
    again = rig.client()
    until(lambda: (ask(again).result()["reply"] or {}).get("success"), "the next call is served")
    until(lambda: len(rig.far.graph.servers("/do")) == 1, "exactly one worker serves the service")


@pytest.mark.parametrize("part", [SEND_GOAL, GET_RESULT])
def test_only_planner_goals_are_canceled_when_their_client_dies(rig: Rig, part: str) -> None:
    """The gateway's session ends: no other program knows its goal, so no other program could stop the robot."""
    hub = Hub.open(rig.hubs.settings("gateway"))
    cancels = {action: _goal(rig, hub, action, part) for action in ("/planner/nav2/navigate_to_pose", "/arm/move")}
    hub.close()
    (request,) = cancels["/planner/nav2/navigate_to_pose"].requests(1)
    assert b64decode(request["goal_info"]["goal_id"]["uuid"]) == bytes(range(16))
    assert request["goal_info"]["stamp"] == {"sec": 0, "nanosec": 0}
    until(
        lambda: rig.row(part_name("/arm/move", part))["abandoned"] == 1,
        "the other request is canceled",
    )
    assert cancels["/arm/move"].requests(1, 0) == []


def test_canceling_a_planners_goal_is_repeated_until_its_server_knows_the_goal(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On DDS, the cancel request may overtake the goal, whose server would then accept it."""
    monkeypatch.setattr(orphans, "PAUSE_SECONDS", 0.1)
    action, asked = "/planner/nav2/navigate_to_pose", list[bytes]()
    codes = [CancelCode.UNKNOWN_GOAL_ID, None, CancelCode.REJECTED, CancelCode.NONE]

    def cancel(request: bytes, done: Done) -> Abandon:
        code = codes[min(len(asked), len(codes) - 1)]
        asked.append(request)
        reply = {"return_code": code}
        done(CallError("lost") if code is None else from_json(REGISTRY, f"{CANCEL}_Response", reply))
        return lambda: None

    hub = Hub.open(rig.hubs.settings("gateway"))
    rig.network.serve(part_name(action, CANCEL_GOAL), CANCEL, MadeBy.NATIVE, "/native", cancel)
    _begin_goal(rig, hub, action, SEND_GOAL)
    hub.close()
    until(lambda: len(asked) == len(codes), "the request is repeated until it has an effect")
    assert len(set(asked)) == 1
    time.sleep(0.5)
    assert len(asked) == len(codes), "a canceled goal is not canceled again"


def test_a_cancel_request_without_a_reply_is_repeated_and_abandoned(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(orphans, "PAUSE_SECONDS", 0.1)
    monkeypatch.setattr(orphans, "_REPEATS", 3)
    action, asked, abandoned = "/planner/nav2/navigate_to_pose", list[Done](), list[int]()

    def cancel(_request: bytes, done: Done) -> Abandon:
        number = len(asked)
        asked.append(done)
        return lambda: abandoned.append(number)

    hub = Hub.open(rig.hubs.settings("gateway"))
    rig.network.serve(part_name(action, CANCEL_GOAL), CANCEL, MadeBy.NATIVE, "/native", cancel)
    _begin_goal(rig, hub, action, SEND_GOAL)
    hub.close()
    until(lambda: abandoned == [0, 1, 2, 3], "a request without a reply is repeated three times, and then abandoned")
    time.sleep(0.5)
    assert len(asked) == 4


def test_a_late_reply_to_an_abandoned_cancel_request_has_no_effect() -> None:
    later, asked, abandoned = MagicMock(), list[Done](), list[int]()

    def call(_request: bytes, done: Done) -> Abandon:
        number = len(asked)
        asked.append(done)
        return lambda: abandoned.append(number)

    OrphanCancels(later, lambda _name: call).cancel("/navigate_to_pose", bytes(20))
    later.after.call_args.args[1]()
    assert (len(asked), abandoned) == (2, []), "the side may still send the first request"
    asked[1](from_json(REGISTRY, f"{CANCEL}_Response", {"return_code": CancelCode.NONE}))
    later.after.call_args.args[1]()
    assert abandoned == [0, 1]
    asked[0](CallError("late"))
    assert (len(asked), later.after.call_count) == (2, 2), "the request is not repeated"


def _goal(rig: Rig, hub: Hub, action: str, part: str) -> Serving:
    """Send a goal, or request its result, on the hub; return the side's cancel server."""
    cancels = rig.serve(part_name(action, CANCEL_GOAL), CANCEL)
    _begin_goal(rig, hub, action, part)
    return cancels


def _begin_goal(rig: Rig, hub: Hub, action: str, part: str) -> None:
    """Send a goal, or request its result, on the hub; the side's server does not reply."""
    name, kind = part_name(action, part), f"{GO}{ENDINGS[part]}"
    rig.serve(name, kind, held=True)
    client = hub.client(name, kind, REGISTRY.service_ros2(kind).type_id)
    until(lambda: client.ready, "the service is on the hub")
    rig.client(part_name(action, CANCEL_GOAL), CANCEL)
    Calling(REGISTRY, kind, {"goal_id": {"uuid": list(range(16))}}, client.call)
    until(lambda: rig.row(name)["pending"] == 1, "the request is pending")
