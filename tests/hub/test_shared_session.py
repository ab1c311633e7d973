"""Several nodes share a session: each has its name and endpoints, receives each message once, and closes separately."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace

import pytest

from bridge.hub.endpoints.keyspace import KeyItem
from bridge.hub.errors import HubClosedError
from bridge.hub.node import Hub
from bridge.hub.session import HubSession
from bridge.hub.wire.qos import Qos
from tests.hub.endpoints.test_sdk import STRING, STRING_HASH
from tests.hub.endpoints.test_services import HASH as SERVICE_HASH
from tests.hub.endpoints.test_services import SERVICE, Serving, call, client
from tests.peers.hub.endpoints import (
    BEST_EFFORT_LATCHED,
    HASH,
    LATCHED,
    STREAM,
    TYPE,
    Subscriber,
    advertise,
    matched,
    see_each_other,
)
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

EACH_QOS = pytest.mark.parametrize(
    "qos",
    [STREAM, LATCHED, BEST_EFFORT_LATCHED, replace(LATCHED, depth=50)],
    ids=["volatile", "latched", "best effort latched", "deep"],
)


@pytest.fixture(params=["peer", "client"])
def session(network: HubNetwork, request: pytest.FixtureRequest) -> Iterator[HubSession]:
    settings = network.settings("unused", zenoh={"mode": request.param})
    opened = HubSession.open(settings, shared=True)
    yield opened
    opened.close()


@pytest.fixture
def one(session: HubSession) -> Hub:
    return Hub.on(session, "one", "one")


@pytest.fixture
def two(session: HubSession) -> Hub:
    return Hub.on(session, "two", "two")


@pytest.fixture
def far(network: HubNetwork) -> Iterator[Hub]:
    with Hub.open(network.settings("far")) as hub:
        yield hub


@EACH_QOS
def test_each_node_receives_the_others_once_and_not_itself(qos: Qos, one: Hub, two: Hub, far: Hub) -> None:
    hubs = {"one": one, "two": two, "far": far}
    subscribers = [
        (name, Subscriber(hub, "/t", qos, **how)) for name, hub in hubs.items() for how in ({}, {"type_hash": "*"})
    ]
    says = {name: advertise(hub, "/t", qos) for name, hub in hubs.items()}
    until(lambda: all(len(hub.graph.subscriptions("/t")) == 6 for hub in hubs.values()), "all subscriptions are seen")
    for publisher in says.values():
        matched(publisher)
    count = 20
    for number in range(count):
        for name, publisher in says.items():
            publisher.put(f"{name} {number}".encode())
        until(
            lambda number=number: all(len(subscriber.samples) > 2 * number + 1 for _, subscriber in subscribers),
            f"message {number} arrives",
        )
    for name, subscriber in subscribers:
        subscriber.expect(*(f"{other} {number}" for other in hubs if other != name for number in range(count)))
        assert subscriber.subscription.lost == 0


@pytest.mark.parametrize("qos", [LATCHED, BEST_EFFORT_LATCHED], ids=["reliable", "best effort"])
def test_late_joiners_receive_latched_messages_of_the_others(qos: Qos, session: HubSession, far: Hub) -> None:
    first_node, second_node = (Hub.on(session, name, name) for name in ("one", "two"))
    says = [
        advertise(hub, "/map", qos, "old", text) for hub, text in ((first_node, "1"), (second_node, "2"), (far, "far"))
    ]
    until(
        lambda: len(first_node.graph.publishers("/map")) == len(far.graph.publishers("/map")) == 3,
        "all publishers are seen",
    )
    subscribers = [
        Subscriber(first_node, "/map", qos),
        Subscriber(second_node, "/map", qos),
        Subscriber(far, "/map", qos),
    ]
    third_node = Hub.on(session, "three", "three")
    subscribers.append(Subscriber(third_node, "/map", qos))
    for subscriber, texts in zip(subscribers, (("2", "far"), ("1", "far"), ("1", "2"), ("1", "2", "far")), strict=True):
        subscriber.expect(*texts)
    for publisher in says:
        publisher.put(b"new")
    for subscriber, count in zip(subscribers, (2, 2, 2, 3), strict=True):
        until(
            lambda subscriber=subscriber, count=count: subscriber.texts().count("new") == count,
            "the next message arrives",
        )


def test_history_and_live_messages_arrive_without_gaps_or_duplicates(one: Hub, two: Hub) -> None:
    """A node joins while its neighbor continues to publish on another thread."""
    deep = replace(LATCHED, depth=200)
    publisher = advertise(one, "/map", deep, *(str(n) for n in range(100)))
    joiners = []

    def say_on() -> None:
        for number in range(100, 200):
            publisher.put(str(number).encode())

    saying = threading.Thread(target=say_on)
    saying.start()
    joiners += [Subscriber(two, "/map", deep) for _ in range(5)]
    saying.join()
    for joiner in joiners:
        until(lambda joiner=joiner: joiner.samples and joiner.texts()[-1] == "199", "the last message arrives")
        assert joiner.texts() == [str(n) for n in range(200)]
        assert joiner.subscription.lost == 0


def test_all_have_their_names_and_numbers(one: Hub, two: Hub, far: Hub) -> None:
    advertise(one, "/t")
    Subscriber(two, "/t")
    Serving(two)
    one.client("/do", SERVICE, SERVICE_HASH)
    graph = far.graph
    until(lambda: len(graph.endpoints()) == 4 and len(graph.nodes()) == 3, "all nodes and endpoints are seen")
    assert {(node.node, node.zid) for node in graph.nodes()} == {("one", one.zid), ("two", one.zid), ("far", far.zid)}
    assert {(e.kind.value, e.node, e.zid) for e in graph.endpoints()} == {
        ("publisher", "one", one.zid),
        ("subscription", "two", one.zid),
        ("server", "two", one.zid),
        ("client", "one", one.zid),
    }
    assert {e.gid for e in graph.endpoints()} == {e.gid for e in two.graph.endpoints()}


def test_ros_2_sees_each_node_by_its_name(network: HubNetwork, one: Hub, two: Hub) -> None:
    one.publisher("/chatter", STRING, STRING_HASH, STREAM)
    two.subscription("/chatter", STRING, STRING_HASH, STREAM, lambda _sample: None)
    two.publisher("/chatter", STRING, STRING_HASH, STREAM)
    with network.sdk_peer() as sdk:

        def seen() -> set[tuple[str, str]]:
            info = sdk.ask("topic_info", topic="/chatter")["info"] or {"publishers": [], "subscribers": []}
            return {(kind, end["node_name"].strip("/")) for kind in ("publishers", "subscribers") for end in info[kind]}

        until(
            lambda: seen() == {("publishers", "one"), ("publishers", "two"), ("subscribers", "two")},
            "all endpoints are seen",
        )


def test_local_and_remote_calls_are_answered_once(one: Hub, two: Hub, far: Hub) -> None:
    requests: list[bytes] = []
    Serving(one, answer=lambda request: (requests.append(request), b"re " + request)[1])
    for hub in (two, far):
        caller = client(hub)
        name = hub.graph.clients("/do")[0].node.encode()
        assert [call(caller, name + b"%d" % n)[0].wait() for n in range(20)] == [
            b"re " + name + b"%d" % n for n in range(20)
        ]
    assert len(requests) == 40


def test_a_node_does_not_call_itself(one: Hub, two: Hub) -> None:
    mine = Serving(one, answer=lambda _: b"mine")
    caller = one.client("/do", SERVICE, SERVICE_HASH)
    assert not caller.ready
    assert call(caller)[0].wait(0) == "no server of /do is on the hub"
    Serving(two, answer=lambda _: b"the neighbor's")
    until(lambda: caller.ready, "the neighbor's server is seen")
    assert call(caller)[0].wait() == b"the neighbor's"
    assert mine.held == []


def test_closed_clients_and_servers_are_detected(session: HubSession) -> None:
    server, first_caller, second_caller = (Hub.on(session, name, name) for name in ("server", "one", "two"))
    serving = Serving(server)
    first, abandon = call(client(first_caller), b"one")
    call(client(second_caller), b"two")
    until(lambda: len(serving.held) == 2, "both requests have arrived")
    second_caller.close()
    until(lambda: serving.abandoned == [b"two"], "the call of the closed node is abandoned")
    abandon()
    until(lambda: serving.abandoned == [b"two", b"one"], "the abandoned call is reported")
    assert first.ends == []
    last, _ = call(client(first_caller), b"last")
    server.close()
    assert "left before it answered" in str(last.wait())


def test_closed_node_removes_only_its_own_endpoints(session: HubSession, far: Hub) -> None:
    stays, goes = Hub.on(session, "stays", "stays"), Hub.on(session, "goes", "goes")
    says, subscriber = advertise(stays, "/t", LATCHED, "kept"), Subscriber(stays, "/u")
    advertise(goes, "/t", LATCHED, "lost")
    Subscriber(goes, "/u")
    Serving(goes)
    stays.serve("verb", lambda _: "stays")
    goes.serve("verb", lambda _: "goes")
    see_each_other(stays, far)
    until(lambda: len(far.graph.endpoints()) == 5, "all endpoints are seen")
    gaps: list[set[str]] = []

    def check() -> None:
        topics = {end.topic for end in far.graph.endpoints() if end.node == "stays"}
        if topics != {"/t", "/u"}:
            gaps.append(topics)

    unwatch = far.graph.watch(check)
    goes.close()
    goes.close()
    until(lambda: {node.node for node in far.graph.nodes()} == {"stays", "far"}, "the closed node is gone")
    until(lambda: {end.node for end in far.graph.endpoints()} == {"stays"}, "the closed node's endpoints are gone")
    assert [answer.value for answer in far.ask("verb", {}, timeout=40.0)] == ["stays"]
    Subscriber(far, "/t", LATCHED).expect("kept")
    speaker = advertise(far, "/u")
    matched(speaker)
    speaker.put(b"on")
    subscriber.expect("on")
    unwatch()
    assert gaps == [], "the other node's endpoints stayed on the graph"
    assert says.matched()
    with pytest.raises(HubClosedError):
        goes.publisher("/t", STRING, STRING_HASH, STREAM)
    again = Hub.on(session, "goes", "goes")
    Subscriber(again, "/t", LATCHED).expect("kept")
    session.close()
    with pytest.raises(HubClosedError):
        Hub.on(session, "late", "late")
    until(lambda: {n.node for n in far.graph.nodes()} == {"far"}, "all nodes of the session have left")


def test_message_published_in_a_callback_is_received(one: Hub, two: Hub) -> None:
    """A brake does so. Its callback runs on the publishing thread, which must hold no lock that the callback needs."""
    answers = advertise(two, "/answer")
    subscriber = Subscriber(one, "/answer")
    two.subscription("/ask", STRING, STRING_HASH, STREAM, lambda sample: answers.put(b"re " + sample.data()))
    one.publisher("/ask", STRING, STRING_HASH, STREAM).put(b"you")
    assert subscriber.texts() == ["re you"], "the answer arrives before put returns"


PATIENT = {
    "transport": {"link": {"tx": {"queue": {"congestion_control": {"block": {"wait_before_close": 30_000_000}}}}}}
}
"""By default, zenoh closes a link that does not accept a reliable message within 5 s."""


def test_stalled_reader_does_not_block_other_nodes(network: HubNetwork) -> None:
    """Meanwhile, the other readers receive messages from another node, which the stalled reader must receive, too."""
    settings, read, ended = replace(network.settings("x"), shared_memory=False), threading.Event(), threading.Event()
    with (
        Hub.open(replace(settings, node="stands")) as stands,
        Hub.open(replace(settings, node="far")) as far,
        closing(HubSession.open(replace(settings, zenoh=PATIENT), shared=True)) as session,
    ):
        first_node, second_node = Hub.on(session, "one", "one"), Hub.on(session, "two", "two")
        see_each_other(first_node, stands, far)
        subscriber, _ = Subscriber(far, "/odom"), Subscriber(stands, "/odom")
        values, stop = first_node.keyspace("values"), advertise(first_node, "/stop")
        stands.keyspace("values").subscribe("**", lambda _: None)
        stands.subscription("/stop", TYPE, HASH, STREAM, lambda _: read.wait(60.0) and None)
        odometry = advertise(second_node, "/odom")
        until(lambda: len(second_node.graph.subscriptions("/odom")) == 2, "both subscriptions are seen")
        matched(stop)

        def send() -> None:
            values.send(KeyItem("large", bytes(30 << 20)))
            ended.set()

        sending = threading.Thread(target=send)
        try:
            stop.put(b"x")
            sending.start()
            for number in range(100):
                odometry.put(b"%d" % number)
                until(lambda number=number: len(subscriber.samples) > number, f"message {number} arrives", 9.0)
            assert not ended.is_set(), "the link was not congested, so the test shows nothing"
        finally:
            read.set()
            sending.join(30.0)
