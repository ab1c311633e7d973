"""Calls between the edge and real Cyclone DDS programs are refused in both directions; topics cross."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from bridge.adapters.ros2.edge import Ros2Edge
from bridge.adapters.ros2.services import matching
from bridge.hub.endpoints.calls import CallError, UnsentCallError
from bridge.hub.wire.qos import Qos
from bridge.routing.edge import Kind
from tests.adapters.ros2.conftest import RunningEdge, string, text
from tests.peers.hub.calls import SET_BOOL, Asked, Ends, Service, answering
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
    """Wait for endpoints; those of the wheel have no node names."""
    until(lambda: len([e for e in edge.edge.endpoints() if (e.topic, e.kind) == (topic, kind)]) == count, topic)


def refused(edge: Ros2Edge, name: str, service: Service, request: bytes) -> str:
    """Return the reason of a call's immediate rejection."""
    ends, began = Ends(), time.monotonic()
    caller = edge.caller(name, service.type)
    caller.call(request, ends.done)
    (end,) = ends.wait()
    assert isinstance(end, UnsentCallError), end
    assert time.monotonic() - began < 1.0
    caller.close()
    return str(end)


def only_own(native: CyclonePeer, server: int, client: CyclonePeer, name: str, service: Service) -> bool:
    """Return whether a server receives a new request of its own client, and received none from Midspan."""
    call = client.call(name, TYPE, service.request(data=True))
    return service.answer(client.reply(call)) == YES and len(native.requests(server)) == 1


def test_cyclone_server_is_never_called(
    edge: RunningEdge, set_bool: Service, cyclone: Callable[[], CyclonePeer]
) -> None:
    native, client = cyclone(), cyclone()
    server = native.serve("/c/server", TYPE, set_bool.response(**YES))
    seen(edge, "/c/server", Kind.SERVER)
    reason = refused(edge.edge, "/c/server", set_bool, set_bool.request(data=True))
    assert "/c/server is served on Cyclone DDS" in reason
    assert "rmw_fastrtps_cpp" in reason
    assert only_own(native, server, client, "/c/server", set_bool)


@pytest.mark.parametrize("part", ["send_goal", "get_result", "cancel_goal"])
def test_no_part_of_a_cyclone_action_is_called(
    edge: RunningEdge, cyclone: Callable[[], CyclonePeer], part: str
) -> None:
    native = cyclone()
    servers = native.act("/c/go", ACTION)
    name = f"/c/go/_action/{part}"
    seen(edge, name, Kind.SERVER)
    types = {"send_goal": f"{ACTION}_SendGoal", "get_result": f"{ACTION}_GetResult"}
    service = Service(edge.registry, types.get(part, "action_msgs/srv/CancelGoal"))
    assert "Cyclone DDS" in refused(edge.edge, name, service, service.request())
    assert native.requests(servers) == []


def test_one_server_on_cyclone_dds_and_one_on_fast_dds(
    edge: RunningEdge, set_bool: Service, peer: Callable[..., Peer], cyclone: Callable[[], CyclonePeer]
) -> None:
    fast, native = peer("lamp"), cyclone()
    fast_server = int(fast.ask("serve", service="/c/both", type=TYPE, reply=YES)["id"])
    server = native.serve("/c/both", TYPE, set_bool.response(**YES))
    seen(edge, "/c/both", Kind.SERVER, 2)
    reason = refused(edge.edge, "/c/both", set_bool, set_bool.request(data=True))
    assert "delivers each request to all servers" in reason
    assert native.requests(server) == []
    native.stop()
    seen(edge, "/c/both", Kind.SERVER)
    ends = Ends()
    edge.edge.caller("/c/both", set_bool.type).call(set_bool.request(data=True), ends.done)
    assert set_bool.answer(ends.replies()[0]) == YES
    assert fast.ask("requests", id=fast_server)["requests"] == [{"data": True}]


@pytest.mark.parametrize("known", [True, False], ids=["counting matches", "reading the graph"])
def test_cyclone_server_that_joins_later(
    edge: RunningEdge,
    set_bool: Service,
    peer: Callable[..., Peer],
    cyclone: Callable[[], CyclonePeer],
    monkeypatch: pytest.MonkeyPatch,
    known: bool,
) -> None:
    """Calls continue all the time, and the graph thread is late."""
    if not known:
        monkeypatch.setattr(matching, "_FUNCTIONS", None)
    fast, native = peer("lamp"), cyclone()
    fast.ask("serve", service="/c/joins", type=TYPE, reply=YES, depth=200)
    edge.until_seen("/c/joins", Kind.SERVER)
    caller, first = edge.edge.caller("/c/joins", set_bool.type), Ends()
    caller.call(set_bool.request(data=True), first.done)
    first.replies()
    graph = edge.edge._context.graph
    monkeypatch.setattr(graph, "_update", lambda: None)
    ends, stop = Ends(), threading.Event()

    def call() -> None:
        while not stop.wait(0.002):
            caller.call(set_bool.request(data=True), ends.done)

    calling = threading.Thread(target=call)
    calling.start()
    server = native.serve("/c/joins", TYPE, set_bool.response(**YES))
    until(lambda: any(isinstance(end, UnsentCallError) for end in ends.items), "calls are refused")
    stop.set()
    calling.join()
    assert only_own(native, server, cyclone(), "/c/joins", set_bool)
    replies = [set_bool.answer(end) for end in ends.items if not isinstance(end, CallError)]
    assert replies == [YES] * len(replies)


def test_killed_server_replaced_by_one_on_cyclone_dds(
    edge: RunningEdge, set_bool: Service, peer: Callable[..., Peer], cyclone: Callable[[], CyclonePeer]
) -> None:
    fast, native = peer("lamp"), cyclone()
    fast.ask("serve", service="/c/replaced", type=TYPE, reply=YES)
    edge.until_seen("/c/replaced", Kind.SERVER)
    caller, ends, stop = edge.edge.caller("/c/replaced", set_bool.type), Ends(), threading.Event()

    def call() -> None:
        while not stop.wait(0.002):
            caller.call(set_bool.request(data=True), ends.done)

    calling = threading.Thread(target=call)
    calling.start()
    fast.signal(signal.SIGKILL)
    server = native.serve("/c/replaced", TYPE, set_bool.response(**YES))
    until(lambda: any(isinstance(end, UnsentCallError) for end in ends.items), "calls are refused")
    stop.set()
    calling.join()
    assert only_own(native, server, cyclone(), "/c/replaced", set_bool)


def test_server_replaced_by_one_on_fast_dds(
    edge: RunningEdge, set_bool: Service, peer: Callable[..., Peer], cyclone: Callable[[], CyclonePeer]
) -> None:
    native = cyclone()
    native.serve("/c/cured", TYPE, set_bool.response())
    seen(edge, "/c/cured", Kind.SERVER)
    caller, ends, later = edge.edge.caller("/c/cured", set_bool.type), Ends(), Ends()
    caller.call(set_bool.request(data=True), ends.done)
    assert "Cyclone DDS" in ends.error()
    native.stop()
    edge.until_gone("/c/cured", Kind.SERVER)
    peer("lamp").ask("serve", service="/c/cured", type=TYPE, reply=YES)
    edge.until_seen("/c/cured", Kind.SERVER)
    caller.call(set_bool.request(data=True), later.done)
    assert set_bool.answer(later.replies()[0]) == YES


def test_a_call_does_not_read_the_graph(
    edge: RunningEdge, set_bool: Service, peer: Callable[..., Peer], monkeypatch: pytest.MonkeyPatch
) -> None:
    peer("lamp").ask("serve", service="/c/quick", type=TYPE, reply=YES, depth=200)
    edge.until_seen("/c/quick", Kind.SERVER)
    caller, ends, reads = edge.edge.caller("/c/quick", set_bool.type), Ends(), []
    caller.call(set_bool.request(), ends.done)
    ends.replies()
    graph = edge.edge._context.graph
    monkeypatch.setattr(graph, "obstacle", lambda service: reads.append(service))
    for count in range(2, 102):
        caller.call(set_bool.request(), ends.done)
        ends.replies(count)
    assert reads == []


def test_requests_of_cyclone_clients_are_refused(
    edge: RunningEdge,
    set_bool: Service,
    peer: Callable[..., Peer],
    cyclone: Callable[[], CyclonePeer],
    caplog: pytest.LogCaptureFixture,
) -> None:
    requests = Asked()
    edge.edge.serve("/c/ours", set_bool.type, requests.call)
    client = cyclone()
    calls = [client.call("/c/ours", TYPE, set_bool.request(data=True)) for _ in range(3)]
    until(lambda: "Cyclone DDS" in caplog.text, "the warning")
    seen(edge, "/c/ours", Kind.CLIENT, 3)
    (obstacle,) = {e.obstacle for e in edge.edge.endpoints() if e.topic == "/c/ours"}
    assert "requests for /c/ours from Cyclone DDS" in obstacle.reason
    native = peer("asker")
    call = native.ask("call", service="/c/ours", type=TYPE, request={"data": True})["id"]
    ((request, done),) = requests.wait()
    assert set_bool.asked(request) == {"data": True}
    done(set_bool.response(**YES))
    assert native.ask("result", id=call)["reply"] == YES
    assert client.reply(calls[0], 0.0) == b""
    warnings = [record.getMessage() for record in caplog.records if "Cyclone DDS" in record.getMessage()]
    assert len(warnings) == 1
    assert "requests for /c/ours" in warnings[0]


def test_topics_cross_both_ways(edge: RunningEdge, cyclone: Callable[[], CyclonePeer]) -> None:
    native = cyclone()
    inbox, out = edge.subscribe("/c/in", "std_msgs/msg/String"), native.advertise("/c/in", "std_msgs/String")

    def received() -> bool:
        native.put(out, string("from Cyclone"))
        return bool(inbox.messages)

    until(received, "a message of Cyclone DDS")
    assert set(inbox.texts()) == {"from Cyclone"}
    subscription = native.subscribe("/c/out", "std_msgs/String")
    publisher = edge.edge.advertise("/c/out", edge.type("std_msgs/msg/String"), Qos())

    def delivered() -> list[bytes]:
        publisher.send(string("from Midspan"), "hub")
        return native.received(subscription, 1, 0.1)

    assert text(until(delivered, "a message of Midspan")[0]) == "from Midspan"


def test_status_names_the_nodes(
    edge: RunningEdge, set_bool: Service, cyclone: Callable[[], CyclonePeer], peer: Callable[..., Peer]
) -> None:
    peer("lamp").ask("serve", service="/c/fine", type=TYPE)
    edge.until_seen("/c/fine", Kind.SERVER)
    assert edge.edge.details() == {}
    assert edge.edge.warnings() == []
    native = cyclone()
    native.serve("/c/named", TYPE, set_bool.response())
    native.act("/c/go", ACTION)
    edge.edge.serve("/c/called", set_bool.type, answering(set_bool.response()))
    native.call("/c/called", TYPE, set_bool.request())
    seen(edge, "/c/called", Kind.CLIENT)
    seen(edge, "/c/go/_action/cancel_goal", Kind.SERVER)
    result = edge.edge.details()["cyclone"]
    assert result["nodes"] == ["a node with an unknown name"]
    assert (result["served"], result["called"]) == (["/c/go", "/c/named"], ["/c/called"])
    (warning,) = edge.edge.warnings()
    assert "topics cross" in warning
    assert "/c/named" in warning
