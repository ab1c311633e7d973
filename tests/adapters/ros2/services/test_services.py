"""Services between the edge and real rclpy programs, as bytes."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.services import server as server_module
from bridge.hub.endpoints.calls import CallError
from bridge.kernels import CURE
from bridge.messages.definitions.hashes import rihs01
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.registry import Registry
from bridge.routing.edge import Kind, MadeBy
from tests.adapters.ros2.conftest import RunningEdge
from tests.adapters.ros2.graph.test_graph import marked_profile
from tests.peers.hub.calls import ECHO, SET_BOOL, Asked, Ends, Service, answering
from tests.peers.peer import Peer
from tests.support.wait import until

Peers = Callable[..., Peer]
MANY = 1000


@pytest.fixture(scope="module")
def set_bool(registry: Registry) -> Service:
    return Service(registry, SET_BOOL)


@pytest.fixture(scope="module")
def echo(registry: Registry) -> Service:
    return Service(registry, ECHO)


def serve(peer: Peer, service: str, type_: str = "std_srvs/SetBool", **more: object) -> int:
    return int(peer.ask("serve", service=service, type=type_, **more)["id"])


def call(peer: Peer, service: str, type_: str = "std_srvs/SetBool", **more: object) -> int:
    return int(peer.ask("call", service=service, type=type_, **more)["id"])


def test_servers_and_clients_are_listed(edge: RunningEdge, peer: Peers, registry: Registry, tmp_path: Path) -> None:
    native = peer("worker")
    server = serve(native, "/s/seen")
    (seen,) = edge.until_seen("/s/seen", Kind.SERVER)
    assert (seen.type, seen.node, seen.made_by) == (SET_BOOL, "/worker", MadeBy.NATIVE)
    assert seen.type_id == rihs01(registry.service_schemas(SET_BOOL)[0])
    assert edge.edge.service_to_hub(seen).hub == registry.service_ros2(SET_BOOL)
    call(native, "/s/seen")
    (client,) = edge.until_seen("/s/seen", Kind.CLIENT)
    assert (client.type, client.node, client.made_by) == (SET_BOOL, "/worker", MadeBy.NATIVE)
    native.drop(server)
    edge.until_gone("/s/seen", Kind.SERVER)
    profile, _ = marked_profile(tmp_path)
    serve(peer("midspan", FASTRTPS_DEFAULT_PROFILES_FILE=str(profile)), "/s/bridged")
    assert edge.until_seen("/s/bridged", Kind.SERVER)[0].made_by is MadeBy.MIDSPAN


def test_a_service_with_another_definition_is_refused(edge: RunningEdge, peer: Peers) -> None:
    serve(peer(), "/s/other")
    (seen,) = edge.until_seen("/s/other", Kind.SERVER)
    object.__setattr__(seen, "type_id", "RIHS01_" + "0" * 64)
    with pytest.raises(MessageTypeError, match="its server's requests have RIHS01_0000"):
        edge.edge.service_to_hub(seen)


def test_a_call_receives_its_reply(edge: RunningEdge, peer: Peers, set_bool: Service) -> None:
    native = peer()
    server = serve(native, "/s/call", reply={"success": True, "message": "done"})
    edge.until_seen("/s/call", Kind.SERVER)
    ends = Ends()
    edge.edge.caller("/s/call", set_bool.type).call(set_bool.request(data=True), ends.done)
    assert set_bool.answer(ends.replies()[0]) == {"success": True, "message": "done"}
    assert native.ask("requests", id=server)["requests"] == [{"data": True}]


def test_a_native_server_receives_a_thousand_concurrent_calls(edge: RunningEdge, peer: Peers, echo: Service) -> None:
    """By default, the server queues only 10 requests that it has not taken yet; see `pacing`."""
    serve(peer(), "/s/many", "diagnostic_msgs/AddDiagnostics", echo={"message": "load_namespace"})
    edge.until_seen("/s/many", Kind.SERVER)
    caller = edge.edge.caller("/s/many", echo.type)
    ends = [Ends() for _ in range(MANY)]
    for number, end in enumerate(ends):
        caller.call(echo.request(load_namespace=f"number {number}"), end.done)
    answers = [echo.answer(end.replies()[0])["message"] for end in ends]
    assert answers == [f"number {number}" for number in range(MANY)]


def test_a_slow_call_does_not_delay_others(edge: RunningEdge, peer: Peers, set_bool: Service) -> None:
    native = peer()
    held = serve(native, "/s/held", held=True, depth=100)  # the default depth of 10 might drop some of 30 replies
    serve(native, "/s/quick")
    edge.until_seen("/s/held", Kind.SERVER)
    edge.until_seen("/s/quick", Kind.SERVER)
    slow, quick = Ends(), Ends()
    slow_caller = edge.edge.caller("/s/held", set_bool.type)
    for _ in range(30):
        slow_caller.call(set_bool.request(), slow.done)
    edge.edge.caller("/s/quick", set_bool.type).call(set_bool.request(), quick.done)
    quick.replies()
    native.ask("requests", id=held, count=30, seconds=30)
    assert not slow.items
    native.ask("release", id=held)
    slow.replies(30)


def test_calls_end_when_their_server_leaves(edge: RunningEdge, peer: Peers, set_bool: Service) -> None:
    native = peer()
    held = serve(native, "/s/leaves", held=True)
    edge.until_seen("/s/leaves", Kind.SERVER)
    caller, ends, late = edge.edge.caller("/s/leaves", set_bool.type), Ends(), Ends()
    caller.call(set_bool.request(), ends.done)
    native.ask("requests", id=held)
    native.drop(held)
    assert "left before it answered" in ends.error()
    caller.call(set_bool.request(), late.done)
    assert "has no server" in late.error()


def test_calls_end_at_once_when_their_server_is_killed(edge: RunningEdge, peer: Peers, set_bool: Service) -> None:
    """DDS itself would notice after 20 s."""
    native = peer()
    held = serve(native, "/s/killed", held=True)
    edge.until_seen("/s/killed", Kind.SERVER)
    caller, ends, late = edge.edge.caller("/s/killed", set_bool.type), Ends(), Ends()
    caller.call(set_bool.request(), ends.done)
    native.ask("requests", id=held)
    native.signal(signal.SIGKILL)
    native.popen.wait()
    (end,) = ends.wait(seconds=18)
    assert isinstance(end, CallError)
    caller.call(set_bool.request(), late.done)
    assert "has no server" in late.error()


def test_a_returning_server_is_called_again(edge: RunningEdge, peer: Peers, set_bool: Service) -> None:
    native = peer()
    first = serve(native, "/s/back")
    edge.until_seen("/s/back", Kind.SERVER)
    caller, ends = edge.edge.caller("/s/back", set_bool.type), Ends()
    caller.call(set_bool.request(), ends.done)
    ends.replies()
    native.drop(first)
    edge.until_gone("/s/back", Kind.SERVER)
    serve(peer(), "/s/back", reply={"message": "again"})
    edge.until_seen("/s/back", Kind.SERVER)
    caller.call(set_bool.request(), ends.done)
    assert set_bool.answer(ends.replies(2)[1])["message"] == "again"


def test_an_abandoned_call_delivers_no_result(edge: RunningEdge, peer: Peers, set_bool: Service) -> None:
    native = peer()
    held = serve(native, "/s/abandoned", held=True)
    edge.until_seen("/s/abandoned", Kind.SERVER)
    caller, ends, other = edge.edge.caller("/s/abandoned", set_bool.type), Ends(), Ends()
    abandon = caller.call(set_bool.request(), ends.done)
    caller.call(set_bool.request(), other.done)
    native.ask("requests", id=held, count=2)
    abandon()
    abandon()
    native.ask("release", id=held)
    other.replies()
    assert not ends.items


def test_closing_a_caller_ends_its_calls(edge: RunningEdge, peer: Peers, set_bool: Service) -> None:
    serve(peer(), "/s/closed", held=True)
    edge.until_seen("/s/closed", Kind.SERVER)
    caller, ends = edge.edge.caller("/s/closed", set_bool.type), Ends()
    caller.call(set_bool.request(), ends.done)
    caller.close()
    caller.close()
    assert "no longer bridged" in ends.error()


def test_large_replies_and_large_requests_arrive(edge: RunningEdge, peer: Peers, registry: Registry) -> None:
    get_map, set_map = Service(registry, "nav_msgs/srv/GetMap"), Service(registry, "nav_msgs/srv/SetMap")
    grid = {"info": {"width": 1000, "height": 1000}, "data": [7] * 1_000_000}
    native = peer()
    serve(native, "/s/map", "nav_msgs/GetMap", reply={"map": grid})
    edge.until_seen("/s/map", Kind.SERVER)
    ends = Ends()
    edge.edge.caller("/s/map", get_map.type).call(get_map.request(), ends.done)
    result = get_map.answer(ends.replies()[0])["map"]
    assert result["info"]["width"] == 1000
    assert bytes(result["data"]) == b"\7" * 1_000_000
    requests = Asked()
    edge.edge.serve("/s/set_map", set_map.type, requests.call)
    called = call(native, "/s/set_map", "nav_msgs/SetMap", request={"map": grid})
    ((request, done),) = requests.wait()
    assert bytes(set_map.asked(request)["map"]["data"]) == b"\7" * 1_000_000
    done(set_map.response(success=True))
    assert native.ask("result", id=called)["reply"] == {"success": True}


def test_a_native_client_receives_replies(edge: RunningEdge, peer: Peers, set_bool: Service) -> None:
    native = peer()
    server = edge.edge.serve("/s/ours", set_bool.type, answering(set_bool.response(message="ours")))
    called = call(native, "/s/ours", request={"data": True})
    assert native.ask("result", id=called)["reply"] == {"success": False, "message": "ours"}
    server.close()
    server.close()


def test_the_last_replies_of_a_closing_server_reach_its_clients(
    edge: RunningEdge, peer: Peers, set_bool: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The event that ends the call (its server on the hub dies) also closes the server on DDS."""
    monkeypatch.setattr(server_module, "_LINGER", 20.0)  # the client may stall before it reads the reply
    native, last = peer(), set_bool.response(message="last reply")
    servers = []
    for number in range(20):
        name, request = f"/s/last{number}", Asked()
        server = edge.edge.serve(name, set_bool.type, request.call)
        servers.append((call(native, name), request, server))
    for _, request, server in servers:
        ((_, done),) = request.wait()
        done(last)
        server.close()
    for called, _, _ in servers:
        assert native.ask("result", id=called, seconds=40)["reply"] == {"success": False, "message": "last reply"}


@pytest.mark.parametrize("successor", ["own", "native"])
def test_a_closed_server_rejects_requests_unless_it_has_a_successor(
    edge: RunningEdge, peer: Peers, registry: Registry, monkeypatch: pytest.MonkeyPatch, successor: str
) -> None:
    """A client that has not noticed the closing gets a refusal, unless another server of the same name is open."""
    monkeypatch.setattr(server_module, "_LINGER", 60.0)
    native, cancel, name = peer(), Service(registry, "action_msgs/srv/CancelGoal"), f"/s/closed_{successor}"

    def code(seconds: float) -> int | None:
        reply = native.ask("result", id=call(native, name, "action_msgs/CancelGoal"), seconds=seconds)["reply"]
        return reply and int(reply["return_code"])

    server = edge.edge.serve(name, cancel.type, answering(cancel.response(return_code=2)))
    assert code(20.0) == 2
    server.close()
    assert code(20.0) == 1
    if successor == "own":
        edge.edge.serve(name, cancel.type, answering(cancel.response(return_code=3)))
    else:
        peer().ask("serve", service=name, type="action_msgs/CancelGoal", reply={"return_code": 3})
        edge.until_seen(name, Kind.SERVER)
    codes: list[int | None] = []
    until(lambda: codes.append(code(0.5)) or codes[-1] == 3, "the new server replies")
    assert 1 not in codes


def test_replies_out_of_order_reach_their_requests(edge: RunningEdge, peer: Peers, echo: Service) -> None:
    native, pending = peer(), Asked()
    edge.edge.serve("/s/order", echo.type, pending.call)
    requests = [{"load_namespace": str(n)} for n in range(10)]
    called = call(native, "/s/order", "diagnostic_msgs/AddDiagnostics", requests=requests)
    for request, done in reversed(pending.wait(10)):
        done(echo.response(message=echo.asked(request)["load_namespace"]))
    replies = native.ask("result", id=called)["replies"]
    assert [reply["message"] for reply in replies] == [str(n) for n in range(10)]


def test_a_native_client_makes_a_thousand_concurrent_calls(edge: RunningEdge, peer: Peers, echo: Service) -> None:
    native, pending = peer(), Asked()
    edge.edge.serve("/s/crowd", echo.type, pending.call)
    requests = [{"load_namespace": str(n)} for n in range(MANY)]
    called = call(native, "/s/crowd", "diagnostic_msgs/AddDiagnostics", requests=requests, depth=MANY)
    for request, done in pending.wait(MANY):
        done(echo.response(message=echo.asked(request)["load_namespace"]))
    replies = native.ask("result", id=called, seconds=30)["replies"]
    assert [reply and reply["message"] for reply in replies] == [str(n) for n in range(MANY)]


def test_calls_are_abandoned_when_their_client_leaves(edge: RunningEdge, peer: Peers, set_bool: Service) -> None:
    requests = Asked()
    edge.edge.serve("/s/left", set_bool.type, requests.call)
    leaving, killed = peer(), peer()
    call(leaving, "/s/left")
    requests.wait(1)
    call(killed, "/s/left")
    requests.wait(2)
    edge.until_seen("/s/left", Kind.CLIENT, 2)
    leaving.stop()
    until(lambda: requests.abandoned == 1, "the call of the client that left is abandoned")
    killed.signal(signal.SIGKILL)
    killed.popen.wait()
    until(lambda: requests.abandoned == 2, "the call of the killed client is abandoned", 18)
    for _, done in requests.items:
        done(set_bool.response())


def test_an_error_leaves_a_client_without_reply(
    edge: RunningEdge, peer: Peers, set_bool: Service, caplog: pytest.LogCaptureFixture
) -> None:
    native, request = peer(), Asked()
    edge.edge.serve("/s/fails", set_bool.type, request.call)
    first = call(native, "/s/fails")
    ((_, done),) = request.wait()
    done(CallError("the robot is asleep"))
    assert "/s/fails failed: the robot is asleep; ROS 2 has no error replies, so" in caplog.text
    second = call(native, "/s/fails")
    request.wait(2)[1][1](set_bool.response(success=True))
    assert native.ask("result", id=second)["reply"]["success"]
    assert not native.ask("result", id=first, seconds=0)["done"]


def test_requests_of_midspan_are_ignored(edge: RunningEdge, peer: Peers, set_bool: Service, tmp_path: Path) -> None:
    native, pending = peer(), Asked()
    edge.edge.serve("/s/transit", set_bool.type, pending.call)
    profile, _ = marked_profile(tmp_path)
    call(peer("midspan", FASTRTPS_DEFAULT_PROFILES_FILE=str(profile)), "/s/transit", request={"data": True})
    call(native, "/s/transit")
    ((request, _),) = pending.wait()
    assert set_bool.asked(request) == {"data": False}


def test_malformed_bytes_are_refused(edge: RunningEdge, peer: Peers, set_bool: Service) -> None:
    native = peer()
    server = serve(native, "/s/bad")
    edge.until_seen("/s/bad", Kind.SERVER)
    convert = edge.edge.service_from_hub(SET_BOOL, set_bool.type.type_id)
    for check, whole in (
        (convert.request_to_side, set_bool.request()),
        (convert.response_to_hub, set_bool.response(message="x")),
    ):
        assert check is not None
        assert check(whole) == whole
        for bad in (
            b"",
            whole[:4],
            whole[:-1] if len(whole) > 8 else whole[:4],
            b"\0\0" + whole[2:],
            whole + bytes(99),
        ):
            with pytest.raises(ConversionError):
                check(bad)
    caller = edge.edge.caller("/s/bad", set_bool.type)
    for bad in (b"", b"\0\0\0\0\0"):
        ends = Ends()
        caller.call(bad, ends.done)
        assert "not little-endian CDR" in ends.error()
    ends = Ends()
    caller.call(set_bool.request(data=True), ends.done)
    ends.replies()
    assert native.ask("requests", id=server)["requests"] == [{"data": True}]


def test_descriptors_are_released(edge: RunningEdge, set_bool: Service) -> None:
    def churn(count: int) -> int:
        for _ in range(count):
            edge.edge.caller("/s/churn", set_bool.type).close()
            edge.edge.serve("/s/churn", set_bool.type, answering(b"")).close()
        return len(list(Path("/proc/self/fd").iterdir()))

    before = churn(3)
    until(lambda: churn(10) <= before, "no more descriptors than before are open")


def test_without_the_compiled_extension_services_are_refused_and_topics_cross(
    registry: Registry,
    tmp_path: Path,
    peer: Peers,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(rcl, "service_callbacks", None)
    running = RunningEdge(registry, tmp_path)
    try:
        native = peer()
        serve(native, "/s/bare")
        (seen,) = running.until_seen("/s/bare", Kind.SERVER)
        for make in (
            lambda: running.edge.service_to_hub(seen),
            lambda: running.edge.service_from_hub(SET_BOOL, ""),
        ):
            with pytest.raises(MessageTypeError, match="services and actions are not bridged") as caught:
                make()
            assert caught.value.cure == CURE
        inbox = running.subscribe("/s/topic", "std_msgs/msg/String")
        publisher = native.advertise("/s/topic", "std_msgs/String")

        def crossed() -> bool:
            native.publish(publisher, {"data": "hello"})
            return bool(inbox.texts())

        until(crossed, "a message crosses")
    finally:
        running.edge.stop()
    reported = [record.getMessage() for record in caplog.records if CURE in record.getMessage()]
    assert reported == [f"{rcl.NOT_COMPILED}; {CURE}"]
