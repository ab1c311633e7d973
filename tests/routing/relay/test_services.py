"""Services and actions between nodes of several ROS 2 releases on one hub, which Midspan relays."""

from __future__ import annotations

from threading import Event
from typing import Any

import pytest
import zenoh

from bridge.hub.endpoints.calls import Done, nothing
from tests.peers.zenoh.release_actions import (
    SUCCEEDED,
    ReleaseActionClient,
    ReleaseActionServer,
    ReleaseTypes,
    hash_in,
)
from tests.peers.zenoh.releases import (
    HUMBLE,
    JAZZY,
    KILTED,
    LYRICAL,
    Nodes,
    Release,
    ReleaseClient,
    ReleaseNode,
    ReleaseServer,
    ReleaseSubscription,
)
from tests.routing.relay.conftest import Relay, Relays
from tests.support.wait import until

SET_BOOL, CLEAR = "std_srvs/srv/SetBool", "nav2_msgs/srv/ClearEntireCostmap"
TO_POSE = "nav2_msgs/action/NavigateToPose"
ID = bytes(range(16))


def server(node: ReleaseNode, type_name: str, answer: dict[str, Any]) -> ReleaseServer:
    types = ReleaseTypes(node)
    reply = types.encode(type_name, answer, "Response")
    return ReleaseServer(node, types.topic("/do", type_name), lambda _request: reply)


def client(node: ReleaseNode, type_name: str) -> ReleaseClient:
    return ReleaseClient(node, ReleaseTypes(node).topic("/do", type_name))


def until_answered(node: ReleaseNode, type_name: str, name: str = "/do") -> None:
    """Wait until calls from a node have a server, even a hidden one."""
    key = node.key(ReleaseTypes(node).topic(name, type_name))
    with node.session.declare_querier(key, target=zenoh.QueryTarget.ALL_COMPLETE) as querier:
        until(lambda: getattr(querier.matching_status, "matching", False), "a server can be called")


def until_services(relay: Relay, count: int) -> None:
    until(lambda: len(relay.relay.services()) == count, f"{count} services are relayed")


@pytest.mark.parametrize(("caller", "callee"), [(HUMBLE, JAZZY), (JAZZY, HUMBLE)])
def test_a_server_of_another_release_gets_each_call_once(
    relay: Relays, node: Nodes, caller: Release, callee: Release
) -> None:
    relay()
    nodes = node(caller), node(callee)
    end = server(nodes[1], SET_BOOL, {"success": True, "message": "yes"})
    ReleaseSubscription(nodes[0], ReleaseTypes(nodes[0]).topic("/other", "std_msgs/msg/String"))
    until_answered(nodes[0], SET_BOOL)
    calls = client(nodes[0], SET_BOOL)  # calls at once
    for _ in range(3):
        (reply,) = calls.call(ReleaseTypes(nodes[0]).encode(SET_BOOL, {"data": True}, "Request"))
        assert ReleaseTypes(nodes[0]).decode(SET_BOOL, reply, "Response") == {"success": True, "message": "yes"}
    assert len(end.requests) == 3


def both_releases(node: Nodes) -> tuple[ReleaseNode, ReleaseNode]:
    """Return nodes of Humble and Jazzy, each with an endpoint."""
    nodes = node(HUMBLE), node(JAZZY)
    for each in nodes:
        ReleaseSubscription(each, ReleaseTypes(each).topic(f"/of_{each.release.name}", "std_msgs/msg/String"))
    return nodes


def until_waiting(relay: Relay, node: ReleaseNode) -> None:
    """Wait until the relay waits for a server for a node's client."""
    until(lambda: any(not waiting.pair.servers for waiting in tuple(relay.relay._services.values())), "it waits")
    until_answered(node, SET_BOOL)


def test_a_call_that_follows_the_token_of_a_server_at_once_is_answered(relay: Relays, node: Nodes) -> None:
    worker, (humble, jazzy) = relay(), both_releases(node)
    calls, seen = client(humble, SET_BOOL), Event()
    until_waiting(worker, humble)

    def on_token(sample: zenoh.Sample) -> None:
        if "/SS/" in str(sample.key_expr):
            seen.set()

    handler = zenoh.handlers.Callback(on_token, indirect=False)
    humble.session.liveliness().declare_subscriber("@ros2_lv/**", handler)
    end = server(jazzy, SET_BOOL, {"success": True})
    assert seen.wait(40)
    assert len(calls.call(ReleaseTypes(humble).encode(SET_BOOL, {"data": True}, "Request"))) == 1
    assert len(end.requests) == 1


def test_a_call_without_a_server_ends_and_is_not_made_later(relay: Relays, node: Nodes) -> None:
    worker, (humble, jazzy) = relay(), both_releases(node)
    calls = client(humble, SET_BOOL)
    until_waiting(worker, humble)
    request = ReleaseTypes(humble).encode(SET_BOOL, {"data": True}, "Request")
    assert calls.call(request) == []
    end = server(jazzy, SET_BOOL, {"success": True})
    until_services(worker, 1)
    until(lambda: len(calls.call(request)) == 1, "the server answers")
    assert len(end.requests) == 1


def test_a_waiting_client_is_answered_once_by_a_server_of_its_own_release(relay: Relays, node: Nodes) -> None:
    worker, (humble, _) = relay(), both_releases(node)
    calls = client(humble, SET_BOOL)
    until_waiting(worker, humble)
    end = server(humble, SET_BOOL, {"success": True})
    request = ReleaseTypes(humble).encode(SET_BOOL, {"data": True}, "Request")
    assert len(calls.call(request)) == 1
    until(lambda: all(key.type_hash for key in tuple(worker.relay._services)), "Humble's calls are no longer relayed")
    assert len(calls.call(request)) == 1
    assert len(end.requests) == 2


def test_a_waiting_client_does_not_look_like_a_server(relay: Relays, node: Nodes) -> None:
    worker, other, (_, jazzy) = relay(), relay(), both_releases(node)
    client(jazzy, SET_BOOL)
    until_waiting(worker, jazzy)
    own = other.hub.client("/do", SET_BOOL, hash_in("jazzy", SET_BOOL))
    until(lambda: not worker.relay._services and not own.ready, "no server is ready")
    own.close()
    until_waiting(worker, jazzy)


def test_requests_and_replies_are_converted(relay: Relays, node: Nodes) -> None:
    relay()
    jazzy, lyrical = node(JAZZY), node(LYRICAL)
    server(lyrical, CLEAR, {"success": True})
    calls = client(jazzy, CLEAR)
    until_answered(jazzy, CLEAR)
    (reply,) = calls.call(ReleaseTypes(jazzy).encode(CLEAR, {}, "Request"))
    assert ReleaseTypes(jazzy).decode(CLEAR, reply, "Response") == {"response": {}}


def test_calls_are_not_relayed_if_a_server_has_the_version_of_the_client(relay: Relays, node: Nodes) -> None:
    worker, humble, jazzy = relay(), node(HUMBLE), node(JAZZY)
    first, second = server(humble, SET_BOOL, {"success": True}), server(jazzy, SET_BOOL, {"success": True})
    calls = client(jazzy, SET_BOOL)
    request = ReleaseTypes(jazzy).encode(SET_BOOL, {"data": True}, "Request")
    until(lambda: len(calls.call(request)) == 1, "the server of the same release answers")
    assert (first.requests, worker.relay.services()) == ([], {})
    second.close()
    until_services(worker, 1)
    until(lambda: len(calls.call(request)) == 1, "the other server answers")
    assert len(first.requests) == 1


def test_a_server_of_midspan_is_called_directly_and_once(relay: Relays, node: Nodes) -> None:
    worker, other, humble, jazzy = relay(), relay(), node(HUMBLE), node(JAZZY)
    native, calls = server(humble, SET_BOOL, {"success": True}), client(jazzy, SET_BOOL)
    until_services(worker, 1)
    requests: list[bytes] = []

    def answer(request: bytes, done: Done) -> Any:
        requests.append(request)
        done(ReleaseTypes(jazzy).encode(SET_BOOL, {"success": True, "message": "Midspan"}, "Response"))
        return nothing

    other.hub.server("/do", SET_BOOL, hash_in("jazzy", SET_BOOL), answer)
    until_services(worker, 0)
    request = ReleaseTypes(jazzy).encode(SET_BOOL, {"data": True}, "Request")
    # the worker and the client's node see the server independently of each other
    (reply,) = until(lambda: calls.call(request), "the client's node sees the server")
    assert ReleaseTypes(jazzy).decode(SET_BOOL, reply, "Response")["message"] == "Midspan"
    assert (len(requests), native.requests) == (1, [])


def test_a_client_of_midspan_calls_a_server_directly(relay: Relays, node: Nodes) -> None:
    worker, other, humble, jazzy = relay(), relay(), node(HUMBLE), node(JAZZY)
    native = server(humble, SET_BOOL, {"success": True})
    client(jazzy, SET_BOOL)
    until_services(worker, 1)
    own = other.hub.client("/do", SET_BOOL, hash_in("jazzy", SET_BOOL))
    until(lambda: own.ready, "the server is ready")
    replies: list[object] = []
    own.call(ReleaseTypes(jazzy).encode(SET_BOOL, {"data": True}, "Request"), replies.append)
    until(lambda: replies, "the call ends")
    assert isinstance(replies[0], bytes)
    (relayed,) = worker.relay.services().values()
    assert (len(native.requests), relayed.counters.messages) == (1, 0)


@pytest.mark.parametrize(
    ("caller", "callee"), [(JAZZY, LYRICAL), (LYRICAL, JAZZY), (HUMBLE, JAZZY), (JAZZY, HUMBLE), (KILTED, HUMBLE)]
)
def test_an_action_of_another_release_is_carried_out(
    relay: Relays, node: Nodes, caller: Release, callee: Release
) -> None:
    worker = relay()
    result = {} if callee is HUMBLE else {"error_code": 7}
    end = ReleaseActionServer(node(callee), "/navigate", TO_POSE, {"distance_remaining": 2.5}, result)
    goals = ReleaseActionClient(node(caller), "/navigate", TO_POSE)
    for part in ("SendGoal", "GetResult"):
        name = {"SendGoal": "send_goal", "GetResult": "get_result"}[part]
        until_answered(goals.types.node, f"{TO_POSE}_{part}", f"/navigate/_action/{name}")
    until(worker.relay.topics, "the feedback is relayed")
    goal = {"pose": {"pose": {"position": {"x": 1.0}}}}
    assert goals.send(ID, goal)["accepted"]
    until(lambda: goals.feedback(), "feedback arrives")
    assert goals.feedback()[-1]["distance_remaining"] == 2.5
    reply = goals.result(ID)
    assert reply["status"] == SUCCEEDED
    assert reply["result"].get("error_code", 0) == (7 if result and caller is not HUMBLE else 0)
    assert [sent["goal"]["pose"]["pose"]["position"]["x"] for sent in end.goals] == [1.0]
    end.close()
