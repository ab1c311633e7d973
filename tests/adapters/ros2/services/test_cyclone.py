"""Calls and topics between the edge and real Cyclone DDS programs, in both directions."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator

import pytest

from bridge.adapters.ros2.edge import Ros2Edge
from bridge.adapters.ros2.services import matching
from bridge.adapters.ros2.services.cyclone import unwrap, wrap
from bridge.hub.endpoints.calls import CallError, UnsentCallError
from bridge.hub.wire.qos import Durability, Qos
from bridge.routing.edge import EdgeCaller, Kind
from tests.adapters.ros2.conftest import RunningEdge, string, text
from tests.peers.hub.calls import SET_BOOL, Asked, Ends, Service
from tests.peers.peer import Peer
from tests.peers.ros2.cyclone import CyclonePeer
from tests.support.wait import until

TYPE = "std_srvs/SetBool"
YES = {"success": True, "message": "done"}
ACTION = "nav2_msgs/action/NavigateToPose"


@pytest.fixture
def set_bool(edge: RunningEdge) -> Service:
    return Service(edge.registry, SET_BOOL)


@pytest.fixture
def cyclone() -> Iterator[Callable[[], CyclonePeer]]:
    """Return a function that starts programs on Cyclone DDS."""
    peers: list[CyclonePeer] = []

    def start() -> CyclonePeer:
        peers.append(CyclonePeer())
        return peers[-1]

    yield start
    for peer in peers:
        peer.stop()


def seen(edge: RunningEdge, topic: str, kind: Kind, count: int = 1) -> None:
    """Wait for endpoints by topic and kind: those of Cyclone DDS's Python package have no node names."""
    until(lambda: len([e for e in edge.edge.endpoints() if (e.topic, e.kind) == (topic, kind)]) == count, topic)


@contextlib.contextmanager
def calling(caller: EdgeCaller, request: bytes, ends: Ends) -> Iterator[None]:
    """Call a service continuously, on a thread."""
    stop = threading.Event()

    def call() -> None:
        while not stop.wait(0.002):
            caller.call(request, ends.done)

    thread = threading.Thread(target=call)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def refused(edge: Ros2Edge, name: str, service: Service, request: bytes) -> str:
    """Return the reason of a call's immediate rejection."""
    ends = Ends()
    caller = edge.caller(name, service.type)
    caller.call(request, ends.done)
    (end,) = ends.wait()
    assert isinstance(end, UnsentCallError), end
    caller.close()
    return str(end)


def executed(native: CyclonePeer, server: int) -> list[bytes]:
    """Return the requests that a server received, without header and trailing zeros (Fast DDS pads to 4 bytes)."""
    framed = [unwrap(request) for request in native.requests(server)]
    return [request.payload.rstrip(b"\0") for request in framed if request is not None]


def test_a_server_on_cyclone_dds_replies_to_each_call(
    edge: RunningEdge, set_bool: Service, cyclone: Callable[[], CyclonePeer]
) -> None:
    """Each call gets a reply, and the server receives the requests as they were sent."""
    native = cyclone()
    server = native.serve("/c/server", TYPE, set_bool.response(**YES))
    seen(edge, "/c/server", Kind.SERVER)
    caller, ends = edge.edge.caller("/c/server", set_bool.type), Ends()
    sent = [set_bool.request(data=number % 3 == 0) for number in range(50)]
    for request in sent:
        caller.call(request, ends.done)
    assert [set_bool.answer(reply) for reply in ends.replies(len(sent))] == [YES] * len(sent)
    assert executed(native, server) == [request.rstrip(b"\0") for request in sent]
    caller.close()


def test_the_first_call_at_once_gets_its_reply(
    edge: RunningEdge, set_bool: Service, cyclone: Callable[[], CyclonePeer]
) -> None:
    """The call waits until the new server has discovered the client; before that, request or reply would be lost."""
    for number in range(2):
        native = cyclone()
        name = f"/c/first{number}"
        native.serve(name, TYPE, set_bool.response(**YES))
        seen(edge, name, Kind.SERVER)
        caller, ends = edge.edge.caller(name, set_bool.type), Ends()
        caller.call(set_bool.request(data=True), ends.done)
        assert set_bool.answer(ends.replies()[0]) == YES
        native.stop()


@pytest.mark.parametrize("part", ["send_goal", "get_result", "cancel_goal"])
def test_each_part_of_an_action_on_cyclone_dds_is_called(
    edge: RunningEdge, cyclone: Callable[[], CyclonePeer], part: str
) -> None:
    native = cyclone()
    servers = native.act("/c/go", ACTION)
    name = f"/c/go/_action/{part}"
    seen(edge, name, Kind.SERVER)
    types = {"send_goal": f"{ACTION}_SendGoal", "get_result": f"{ACTION}_GetResult"}
    service, ends = Service(edge.registry, types.get(part, "action_msgs/srv/CancelGoal")), Ends()
    request = service.request()
    edge.edge.caller(name, service.type).call(request, ends.done)
    assert len(ends.replies()) == 1
    assert executed(native, servers) == [request.rstrip(b"\0")]


def test_the_server_on_fast_dds_is_called_while_it_exists(
    edge: RunningEdge, set_bool: Service, peer: Callable[..., Peer], cyclone: Callable[[], CyclonePeer]
) -> None:
    """While the server on Fast DDS exists, only it is called; each server gets requests in its own DDS's form."""
    fast, native = peer("lamp"), cyclone()
    served = native.serve("/c/both", TYPE, set_bool.response(**YES))
    seen(edge, "/c/both", Kind.SERVER)
    caller, ends, request = edge.edge.caller("/c/both", set_bool.type), Ends(), set_bool.request(data=True)
    caller.call(request, ends.done)
    ends.replies(1)
    fast_server = int(fast.ask("serve", service="/c/both", type=TYPE, reply=YES)["id"])
    seen(edge, "/c/both", Kind.SERVER, 2)
    for _ in range(5):
        caller.call(request, ends.done)
    assert [set_bool.answer(reply) for reply in ends.replies(6)] == [YES] * 6
    assert fast.ask("requests", id=fast_server, count=5, seconds=20)["requests"] == [{"data": True}] * 5
    assert executed(native, served) == [request.rstrip(b"\0")]
    notes = ["calls go to /lamp, and not to a node with an unknown name on Cyclone DDS"]
    key = "service", "in", "/c/both"
    until(lambda: edge.edge.version_notes().get(key) == notes, "the node of the server on Fast DDS is known")
    assert edge.edge.details()["cyclone"]["both"] == ["/c/both"]
    (warning,) = edge.edge.warnings()
    assert "/c/both: served on Cyclone DDS and on another DDS, so the servers on Cyclone DDS are not called" in warning
    fast.drop(fast_server)
    seen(edge, "/c/both", Kind.SERVER)
    off = set_bool.request(data=False)
    caller.call(off, ends.done)
    assert set_bool.answer(ends.replies(7)[-1]) == YES
    assert executed(native, served) == [request.rstrip(b"\0"), off.rstrip(b"\0")]


def test_without_the_filter_no_server_of_two_kinds_of_dds_is_called(
    set_bool: Service, edge: RunningEdge, peer: Callable[..., Peer], cyclone: Callable[[], CyclonePeer],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr("bridge.adapters.ros2.filters.is_available", lambda: False)
    monkeypatch.setattr("bridge.adapters.ros2.services.sender.is_available", lambda: False)
    monkeypatch.setattr("bridge.adapters.ros2.services.caller._MATCH_SECONDS", 100.0)  # longer than `Ends.wait`
    peer("lamp").ask("serve", service="/c/both", type=TYPE, reply=YES)
    cyclone().serve("/c/both", TYPE, set_bool.response(**YES))
    seen(edge, "/c/both", Kind.SERVER, 2)
    reason = refused(edge.edge, "/c/both", set_bool, set_bool.request(data=True))
    assert "delivers each request to all servers" in reason


@pytest.mark.parametrize("known", [True, False], ids=["counting matches", "reading the graph"])
def test_a_server_on_cyclone_dds_that_joins_later_is_not_called(
    edge: RunningEdge,
    set_bool: Service,
    peer: Callable[..., Peer],
    cyclone: Callable[[], CyclonePeer],
    monkeypatch: pytest.MonkeyPatch,
    known: bool,
) -> None:
    """Even while the graph is out of date, only the server on Fast DDS is called, and each call gets its reply."""
    if not known:
        monkeypatch.setattr(matching, "_functions", lambda: None)
    fast, native = peer("lamp"), cyclone()
    fast.ask("serve", service="/c/joins", type=TYPE, reply=YES, depth=200)
    edge.until_seen("/c/joins", Kind.SERVER)
    caller, first = edge.edge.caller("/c/joins", set_bool.type), Ends()
    caller.call(set_bool.request(data=True), first.done)
    first.replies()
    graph = edge.edge._context.graph
    monkeypatch.setattr(graph, "_update", lambda: None)
    ends = Ends()
    with calling(caller, set_bool.request(data=True), ends):
        server = native.serve("/c/joins", TYPE, set_bool.response(**YES))
        until(lambda: len(graph.servers("/c/joins")) == 2, "both are discovered")
        count = len(ends.items)
        until(lambda: len(ends.items) > count + 100, "a hundred more calls have ended")
    assert native.requests(server) == []
    ended = list(ends.items)  # further calls may end meanwhile
    replies = [set_bool.answer(end) for end in ended if not isinstance(end, CallError)]
    assert replies == [YES] * len(ended)


def test_calls_reach_the_server_on_cyclone_dds_that_replaced_a_killed_one(
    edge: RunningEdge, set_bool: Service, peer: Callable[..., Peer], cyclone: Callable[[], CyclonePeer]
) -> None:
    """Calls are refused until Fast DDS has removed the dead server from the graph, then they reach the new one."""
    fast, native = peer("lamp"), cyclone()
    fast.ask("serve", service="/c/replaced", type=TYPE, reply=YES)
    edge.until_seen("/c/replaced", Kind.SERVER)
    caller, ends = edge.edge.caller("/c/replaced", set_bool.type), Ends()
    request = set_bool.request(data=True)
    with calling(caller, request, ends):
        fast.signal(signal.SIGKILL)
        server = native.serve("/c/replaced", TYPE, set_bool.response(**YES))
        until(lambda: native.requests(server), "the new server is called", 40)
        count = len(ends.items)
        until(lambda: YES in [set_bool.answer(end) for end in ends.items[count:] if isinstance(end, bytes)], "a reply")
    assert set(executed(native, server)) == {request.rstrip(b"\0")}


def test_calls_reach_the_server_on_fast_dds_that_replaced_one_on_cyclone_dds(
    edge: RunningEdge, set_bool: Service, peer: Callable[..., Peer], cyclone: Callable[[], CyclonePeer]
) -> None:
    native = cyclone()
    native.serve("/c/moved", TYPE, set_bool.response(**YES))
    seen(edge, "/c/moved", Kind.SERVER)
    caller, ends, later = edge.edge.caller("/c/moved", set_bool.type), Ends(), Ends()
    caller.call(set_bool.request(data=True), ends.done)
    assert set_bool.answer(ends.replies()[0]) == YES
    native.stop()
    edge.until_gone("/c/moved", Kind.SERVER)
    fast = peer("lamp")
    server = fast.ask("serve", service="/c/moved", type=TYPE, reply=YES)["id"]
    edge.until_seen("/c/moved", Kind.SERVER)
    caller.call(set_bool.request(data=True), later.done)
    assert set_bool.answer(later.replies()[0]) == YES
    assert fast.ask("requests", id=server)["requests"] == [{"data": True}]


def test_calls_fail_when_their_server_on_cyclone_dds_leaves(
    edge: RunningEdge, set_bool: Service, cyclone: Callable[[], CyclonePeer]
) -> None:
    native = cyclone()
    server = native.serve("/c/silent", TYPE, b"")
    seen(edge, "/c/silent", Kind.SERVER)
    caller, ends = edge.edge.caller("/c/silent", set_bool.type), Ends()
    caller.call(set_bool.request(data=True), ends.done)
    until(lambda: native.requests(server), "the server has the request")
    native.stop()
    assert "left before it answered" in ends.error()


def test_a_call_does_not_read_the_graph(
    edge: RunningEdge, set_bool: Service, peer: Callable[..., Peer], monkeypatch: pytest.MonkeyPatch
) -> None:
    peer("lamp").ask("serve", service="/c/quick", type=TYPE, reply=YES, depth=200)
    edge.until_seen("/c/quick", Kind.SERVER)
    caller, ends, reads = edge.edge.caller("/c/quick", set_bool.type), Ends(), []
    caller.call(set_bool.request(), ends.done)
    ends.replies()
    graph = edge.edge._context.graph
    monkeypatch.setattr(graph, "servers", lambda service: reads.append(service))
    for count in range(2, 102):
        caller.call(set_bool.request(), ends.done)
        ends.replies(count)
    assert reads == []


def test_clients_on_both_dds_implementations_get_their_own_replies(
    edge: RunningEdge, set_bool: Service, peer: Callable[..., Peer], cyclone: Callable[[], CyclonePeer]
) -> None:
    """Clients on both DDS implementations call one service of Midspan; each call gets its own reply."""
    requests = Asked()
    edge.edge.serve("/c/ours", set_bool.type, requests.call)
    client, native = cyclone(), peer("asker")
    calls = [client.call("/c/ours", TYPE, set_bool.request(data=number == 1)) for number in range(3)]
    call = native.ask("call", service="/c/ours", type=TYPE, request={"data": True})["id"]
    values = []
    for request, done in requests.wait(4):
        values.append(set_bool.asked(request)["data"])
        done(set_bool.response(success=values[-1], message=str(len(values))))
    assert sorted(values) == [False, False, True, True]
    replies = [set_bool.answer(client.reply(number)) for number in calls]
    assert [reply["success"] for reply in replies] == [False, True, False]
    replies.append(native.ask("result", id=call)["reply"])
    assert {reply["message"] for reply in replies} == {"1", "2", "3", "4"}


def test_requests_without_a_header_are_refused(
    edge: RunningEdge, set_bool: Service, cyclone: Callable[[], CyclonePeer], caplog: pytest.LogCaptureFixture
) -> None:
    requests = Asked()
    edge.edge.serve("/c/short", set_bool.type, requests.call)
    native = cyclone()
    out = native.advertise_raw("rq/c/shortRequest", "std_srvs::srv::dds_::SetBool_Request_")
    seen(edge, "/c/short", Kind.CLIENT)

    def warned() -> bool:
        native.put(out, set_bool.request(data=True))
        return "not little-endian CDR with Cyclone DDS's header" in caplog.text

    until(warned, "the warning is logged")
    client = cyclone()
    call = client.call("/c/short", TYPE, set_bool.request(data=True))
    ((request, done),) = requests.wait()
    assert set_bool.asked(request) == {"data": True}
    done(set_bool.response(**YES))
    assert set_bool.answer(client.reply(call)) == YES


def test_header_is_separated_from_the_payload() -> None:
    request = bytes.fromhex("00010000 0102030405060708 0100000000000000 aabbcc")
    assert unwrap(request) == (request[4:20], bytes.fromhex("00010000 aabbcc"))
    assert wrap(request[4:20], bytes.fromhex("00010000 aabbcc")) == request
    padded = bytes.fromhex("00010001 0102030405060708 0100000000000000 aabbcc00")
    assert unwrap(padded) == (request[4:20], bytes.fromhex("00010000 aabbcc"))
    for malformed in (b"", request[:19], b"\0\0" + request[2:], b"\0\7" + request[2:]):
        assert unwrap(malformed) is None
    assert unwrap(bytes.fromhex("00010003") + bytes(16)) == (bytes(16), b"\0\1\0\0")


def test_topics_cross_both_ways(edge: RunningEdge, cyclone: Callable[[], CyclonePeer]) -> None:
    native = cyclone()
    inbox, out = edge.subscribe("/c/in", "std_msgs/msg/String"), native.advertise("/c/in", "std_msgs/String")

    def received() -> bool:
        native.put(out, string("from Cyclone"))
        return bool(inbox.messages)

    until(received, "a message of Cyclone DDS arrives")
    assert set(inbox.texts()) == {"from Cyclone"}
    subscription = native.subscribe("/c/out", "std_msgs/String")
    publisher = edge.edge.advertise("/c/out", edge.type("std_msgs/msg/String"), Qos())

    def delivered() -> list[bytes]:
        publisher.send(string("from Midspan"), "hub")
        return native.received(subscription, 1, 0.1)

    assert text(until(delivered, "a message of Midspan arrives")[0]) == "from Midspan"


@pytest.mark.parametrize("latched", [False, True], ids=["volatile", "latched"])
def test_the_first_large_message_arrives_on_cyclone_dds(
    edge: RunningEdge, cyclone: Callable[[], CyclonePeer], latched: bool
) -> None:
    """A message of 1 MB is sent in fragments; a latched one is sent by a new writer, not matched yet."""
    native, topic, large = cyclone(), f"/c/large{int(latched)}", "x" * 1_000_000
    subscription = native.subscribe(topic, "std_msgs/String")
    seen(edge, topic, Kind.SUBSCRIPTION)
    heartbeats = edge.edge._context.heartbeats
    until(lambda: heartbeats.readers(topic), "the edge handles the change, after it lists the subscription")
    qos = Qos(durability=Durability.TRANSIENT_LOCAL) if latched else Qos()
    publisher = edge.edge.advertise(topic, edge.type("std_msgs/msg/String"), qos)
    until(lambda: edge.edge.has_subscribers(topic), "the subscription is known")
    if not latched:
        until(lambda: not heartbeats._pending, "the subscription is prepared")
    publisher.send(string(large), "first")
    (received,) = native.received(subscription, 1)
    assert text(received) == large
    if latched:
        publisher.send(string(large), "second")  # another source has another writer
        assert len(native.received(subscription, 2)) == 2


def test_status_names_the_nodes(
    edge: RunningEdge, set_bool: Service, cyclone: Callable[[], CyclonePeer], peer: Callable[..., Peer]
) -> None:
    peer("lamp").ask("serve", service="/c/fine", type=TYPE)
    edge.until_seen("/c/fine", Kind.SERVER)
    assert "cyclone" not in edge.edge.details()
    cyclone().serve("/c/named", TYPE, set_bool.response())
    seen(edge, "/c/named", Kind.SERVER)
    assert edge.edge.details()["cyclone"] == {"nodes": ["a node with an unknown name"], "both": [], "mixed": []}
    assert edge.edge.warnings() == []


@pytest.mark.parametrize("on_cyclone", ["server", "client"])
def test_native_clients_and_servers_of_two_kinds_are_reported(
    edge: RunningEdge, set_bool: Service, cyclone: Callable[[], CyclonePeer], peer: Callable[..., Peer], on_cyclone: str
) -> None:
    """ROS 2 delivers such a request itself, in the wrong form, and the client gets no reply."""
    fast, native, name, unnamed = peer("fast"), cyclone(), f"/c/{on_cyclone}_mixed", "a node with an unknown name"
    if on_cyclone == "server":
        native.serve(name, TYPE, set_bool.response(**YES))
        fast.ask("call", service=name, type=TYPE, request={"data": True})
        pair = f"client /fast, server {unnamed} on Cyclone DDS"
    else:
        fast.ask("serve", service=name, type=TYPE, reply=YES)
        call = native.call(name, TYPE, set_bool.request(data=True))
        pair = f"client {unnamed} on Cyclone DDS, server /fast"
        assert native.reply(call, 0.5) == b""
    until(lambda: edge.edge.details().get("cyclone", {}).get("mixed") == [f"{name} ({pair})"], "the pair is reported")
    (warning,) = edge.edge.warnings()
    assert warning.startswith(f"{name} ({pair}): between two kinds of DDS, ROS 2 executes requests with wrong values")
    (note,) = edge.edge.version_notes()["service", "in", name]
    assert note.startswith(f"{pair}: ")
    assert "in two domains" in note
