"""Messages that arrive before the engine knows their publishers: no message replaces a newer one, and none is lost."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.graph import HubEndpoint
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion
from bridge.routing import backlog, hub_to_side, side_to_hub
from bridge.routing.backlog import Backlog
from bridge.routing.decision import RouteKey
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.edge import Endpoint, Kind, MadeBy
from bridge.routing.hub_to_side import HubToSideRoute
from bridge.routing.peer_watch import Lease
from bridge.routing.route import EngineContext
from bridge.routing.rules import RoutePolicy
from bridge.routing.side_to_hub import SideToHubRoute
from bridge.routing.stall import StallDetector
from tests.peers.fake import FakeEdge, FakeNetwork
from tests.peers.hub.network import HubNetwork
from tests.peers.zenoh.releases import JAZZY, ReleaseNode, ReleasePublisher, Topic
from tests.routing.test_route import STRING, LatchedRoute, line
from tests.support.wait import until

TOPIC = "/state"
LATCHED = Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL, depth=1)


class HubRecord:
    """A route's end on the hub, which records what its publishers publish."""

    max_payload = 1000

    def __init__(self) -> None:
        self.published: list[bytes] = []

    def publisher(self, *_: object, **__: object) -> SimpleNamespace:
        return SimpleNamespace(put=lambda data, _time: self.published.append(data), close=lambda: None, by_lane=0)


class RouteToHub:
    """A route to the hub for latched publishers of the side."""

    def __init__(self) -> None:
        self.hub, self.lease, registry, self.wakes = HubRecord(), Lease(), Registry(), 0
        self.lease.extend(math.inf)
        self.during_conversion: Callable[[], object] = lambda: None
        idle, type_ = Dispatcher("idle"), registry.ros2(STRING)
        context = EngineContext(
            cast("Hub", self.hub), FakeEdge(FakeNetwork(), registry), StallDetector(), self.lease, cast("Any", None),
            idle, idle, self._wake,
        )  # fmt: skip
        self.route = SideToHubRoute(
            RouteKey(TOPIC, STRING, type_.type_id), TOPIC, Conversion(type_, type_, self.convert),
            RoutePolicy(allowed=True, why="", name=TOPIC), context,
        )  # fmt: skip

    def _wake(self) -> None:
        self.wakes += 1

    def convert(self, data: bytes) -> bytes:
        self.during_conversion()
        return data

    def deliver(self, text: str, source: str = "this") -> None:
        self.route.deliver(line(text), source, None)

    def update(self, *sources: str, qos: Qos = LATCHED) -> None:
        self.route.update([Endpoint(name, Kind.PUBLISHER, TOPIC, STRING, qos, MadeBy.NATIVE) for name in sources])


class Newer:
    """When first called, delivers a message on another thread, and gives that message time to overtake the caller's."""

    def __init__(self, deliver: Callable[[], None]) -> None:
        self._thread = threading.Thread(target=deliver)

    def __call__(self, *_: object, **__: object) -> None:
        if self._thread.ident is None:
            self._thread.start()
            self._thread.join(0.5)

    def join(self) -> None:
        self._thread.join(40)


@pytest.mark.parametrize("latched", [False, True])
def test_only_a_latched_message_of_an_unknown_publisher_outlasts_a_missing_lease(*, latched: bool) -> None:
    to_hub, qos = RouteToHub(), LATCHED if latched else Qos()
    to_hub.update("other", qos=qos)
    to_hub.lease.end()
    to_hub.deliver("old")
    to_hub.deliver("new")
    to_hub.update("other", "this", qos=qos)
    to_hub.lease.extend(math.inf)
    to_hub.update("other", "this", qos=qos)
    assert to_hub.hub.published == ([line("new")] if latched else [])
    assert to_hub.route.counters.drops["standby"] == (1 if latched else 2)
    to_hub.route.close()


def lease_returns_before(backlog: Backlog[Any], lease: Lease, check: Callable[[], None]) -> None:
    """Let the lease return, and the engine check the route, just before a message without a lease is stored."""
    keep = backlog.keep

    def late(*args: Any) -> int:
        lease.extend(math.inf)
        check()
        return keep(*args)

    backlog.keep = late  # type: ignore[method-assign]


def test_message_to_the_hub_that_is_stored_after_the_lease_has_returned_wakes_the_engine() -> None:
    to_hub = RouteToHub()
    to_hub.update("this")
    to_hub.lease.end()
    lease_returns_before(to_hub.route.pending, to_hub.lease, lambda: to_hub.update("this"))
    to_hub.deliver("state")
    assert to_hub.wakes == 1
    to_hub.update("this")
    assert to_hub.hub.published == [line("state")]
    to_hub.route.close()


def test_message_to_the_side_that_is_stored_after_the_lease_has_returned_wakes_the_engine(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    latched = LatchedRoute(monkeypatch)
    update = partial(latched.route.update, [latched.publisher], [])
    update()
    latched.lease.end()
    lease_returns_before(latched.route.held.latched, latched.lease, update)
    latched.receive("state")
    assert latched.wakes == 1
    update()
    assert latched.network.retained() == [line("state")]


@pytest.mark.parametrize(("standby", "qos"), [(False, LATCHED), (True, LATCHED), (False, Qos())])
def test_message_held_by_a_route_to_the_hub_is_published_before_newer_ones(*, standby: bool, qos: Qos) -> None:
    to_hub = RouteToHub()
    to_hub.update("this" if standby else "other", qos=qos)
    if standby:
        to_hub.lease.end()
    to_hub.deliver("old")
    to_hub.lease.extend(math.inf)
    to_hub.during_conversion = newer = Newer(lambda: to_hub.deliver("new"))
    to_hub.update("this", qos=qos)
    newer.join()
    assert to_hub.hub.published == [line("old"), line("new")]
    to_hub.route.close()


@pytest.mark.parametrize("qos", [replace(LATCHED, depth=3), Qos()])
def test_all_messages_of_a_publisher_that_is_not_known_yet_reach_the_hub(qos: Qos) -> None:
    """A latched publisher's history arrives at once, and only once."""
    to_hub = RouteToHub()
    to_hub.update("other", qos=qos)
    for text in ("first", "second", "third"):
        to_hub.deliver(text)
    to_hub.update("other", "this", qos=qos)
    assert to_hub.hub.published == [line("first"), line("second"), line("third")]
    assert not to_hub.route.counters.drops["unknown"]
    to_hub.route.close()


def test_message_that_arrives_before_the_release_of_an_older_one_is_published_after_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    to_hub = RouteToHub()
    to_hub.update("other", qos=Qos())
    to_hub.deliver("old")
    monkeypatch.setattr(to_hub.route, "_subscribe", lambda: to_hub.deliver("new"))
    to_hub.update("this", qos=Qos())
    assert to_hub.hub.published == [line("old"), line("new")]
    to_hub.route.close()


def test_newer_message_of_another_thread_waits_for_held_ones_that_a_third_publishes() -> None:
    to_hub = RouteToHub()
    to_hub.update("this", "other")
    to_hub.lease.end()
    to_hub.deliver("old")
    to_hub.lease.extend(math.inf)
    to_hub.during_conversion = newer = Newer(lambda: to_hub.deliver("new"))
    to_hub.deliver("different", "other")
    newer.join()
    assert to_hub.hub.published == [line("old"), line("different"), line("new")]
    to_hub.route.close()


def test_pending_message_does_not_replace_one_that_arrives_after_its_removal(monkeypatch: pytest.MonkeyPatch) -> None:
    latched = LatchedRoute(monkeypatch)
    latched.route.update([latched.other], [])
    latched.receive("old")
    newer = Newer(lambda: latched.receive("new"))
    monkeypatch.setattr(latched.route, "over_rate", newer)
    latched.route.update([latched.other, latched.publisher], [])
    newer.join()
    latched.route.queue._next()
    assert latched.network.retained() == [line("new")]


@pytest.mark.parametrize("waits", [False, True], ids=["allowed", "waiting"])
def test_pending_message_does_not_replace_one_that_arrives_once_its_publisher_is_known(
    monkeypatch: pytest.MonkeyPatch, *, waits: bool
) -> None:
    """The check loop learns of the publisher, then a newer message arrives, then the loop handles the pending one."""
    latched = LatchedRoute(monkeypatch)
    latched.route.update([latched.other], [])
    latched.receive("old")
    with monkeypatch.context() as patch:
        patch.setattr(latched.route, "_follow_demand", lambda _: latched.receive("new"))
        latched.route.update(
            *(([latched.other], [], [latched.publisher]) if waits else ([latched.other, latched.publisher], []))
        )
    assert latched.wakes == 2, "a check is due"
    latched.route.update([latched.other, latched.publisher], [])
    assert latched.network.retained() == [line("new")]


def test_messages_of_a_new_volatile_publisher_reach_the_side_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """One arrives before its publisher is known, one while the side's publisher opens, and one before the release."""
    latched, received = LatchedRoute(monkeypatch), list[bytes]()
    latched.network.read_from(TOPIC, STRING, Qos(), MadeBy.NATIVE, "/listener", lambda data, *_: received.append(data))
    volatile = replace(latched.publisher, qos=Qos())
    latched.route.update([latched.other], [])
    latched.receive("first")
    publishers = latched.route._publishers
    advertise = publishers._advertise
    monkeypatch.setattr(publishers, "_advertise", lambda qos: (latched.receive("second"), advertise(qos))[1])
    monkeypatch.setattr(latched.route, "_follow_demand", lambda _: latched.receive("third"))
    latched.route.update([latched.other, volatile], [])
    assert received == [line("first"), line("second"), line("third")]


def suspend(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Return a function that advances the clock of the routes by seconds."""
    now = [100.0]
    monkeypatch.setattr(backlog, "time", SimpleNamespace(monotonic=lambda: now[0]))

    def advance(seconds: float) -> None:
        now[0] += seconds

    return advance


def test_a_resumed_process_checks_the_lease_before_it_drops_a_message_to_the_hub(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    advance, to_hub = suspend(monkeypatch), RouteToHub()
    to_hub.update("other")
    to_hub.deliver("only")
    advance(2 * side_to_hub.PENDING_SECONDS)
    to_hub.deliver("different", "other")
    to_hub.update("other")  # this list was made before the suspension
    to_hub.update("other", "this")
    assert to_hub.hub.published == [line("different"), line("only")]
    to_hub.deliver("unknown", "nobody")
    for _ in range(2):
        advance(2 * side_to_hub.PENDING_SECONDS)
        to_hub.update("other", "this")
    assert not to_hub.route.pending
    assert to_hub.route.counters.drops["unknown"] == 1
    to_hub.route.close()


def test_a_resumed_process_checks_the_lease_before_it_drops_a_message_to_the_side(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    advance, latched = suspend(monkeypatch), LatchedRoute(monkeypatch)
    latched.route.update([latched.other], [])
    latched.receive("only")
    advance(2 * hub_to_side.PENDING_SECONDS)
    latched.route.update([latched.other], [])
    latched.route.update([latched.other, latched.publisher], [])
    assert latched.network.retained() == [line("only")]


class HubRoute:
    """A route to the side with a subscription on the hub, and another hub session with publishers."""

    def __init__(self, hub: Hub, there: Hub) -> None:
        registry, self.network = Registry(), FakeNetwork()
        type_, lease = registry.ros2(STRING), Lease()
        lease.extend(math.inf)
        self.dispatcher = Dispatcher("test-messages")  # queued messages wait until a test starts it
        policy = RoutePolicy(allowed=True, why="", name=TOPIC)
        self.hub, self._there, self._type_id = hub, there, type_.type_id
        self.route = HubToSideRoute(
            RouteKey(TOPIC, STRING, type_.type_id), TOPIC, None, Conversion(type_, type_, None), policy,
            EngineContext(
                hub, FakeEdge(self.network, registry), StallDetector(), lease, cast("Any", None),
                self.dispatcher, self.dispatcher, lambda: None,
            ),
        )  # fmt: skip
        self.received: list[str] = []
        self.network.read_from(TOPIC, STRING, Qos(), MadeBy.NATIVE, "reader", self._receive)

    def _receive(self, data: bytes, *_: object) -> None:
        self.received.append(next(text for text in "123456789" if line(text) == data))

    def publisher(self, qos: Qos, *texts: str) -> tuple[HubPublisher, HubEndpoint]:
        publisher = self._there.publisher(TOPIC, STRING, self._type_id, qos)
        for text in texts:
            publisher.put(line(text))
        seen = until(
            lambda: [e for e in self.hub.graph.publishers(TOPIC) if e.gid == publisher.gid],
            "the publisher is discovered",
        )
        return publisher, seen[0]

    def expect(self, *texts: str) -> None:
        until(lambda: len(self.received) >= len(texts), f"{texts} arrive")
        assert self.received == [*texts]


@pytest.fixture
def hub_route() -> Iterator[HubRoute]:
    with HubNetwork() as hubs, Hub.open(hubs.settings("here")) as hub, Hub.open(hubs.settings("there")) as there:
        route = HubRoute(hub, there)
        yield route
        route.route.close()
        route.dispatcher.stop()


def test_messages_of_a_hub_publisher_that_returns_are_retained_again(hub_route: HubRoute) -> None:
    """As after a lost link, or while another daemon carried the topic: the route has received the message before."""
    route, network = hub_route.route, hub_route.network
    hub_route.dispatcher.start()  # for a message that arrives while this thread publishes
    endpoints = [hub_route.publisher(LATCHED, text)[1] for text in ("1", "2")]
    route.update(endpoints, [])
    until(lambda: sorted(network.retained()) == [line("1"), line("2")], "both messages are retained")
    route.update(endpoints[:1], [])
    assert len(network.retained()) == 1
    route.update(endpoints, [])
    until(lambda: sorted(network.retained()) == [line("1"), line("2")], "both messages are retained again")
    until(lambda: route.counters.messages >= 3, "the message is counted")  # after it is retained
    assert route.counters.messages == 3, "the other publisher's message is not repeated"


def test_message_with_an_invented_gid_is_retained_again_when_its_publisher_returns() -> None:
    with HubNetwork() as hubs, Hub.open(hubs.settings("here")) as hub:
        hub_route = HubRoute(hub, hub)
        hub_route.dispatcher.start()  # for a message that arrives while this thread publishes
        route, network = hub_route.route, hub_route.network
        node = ReleaseNode(hubs.endpoint, hubs.domain, "sdk", JAZZY)
        publisher = ReleasePublisher(node, Topic(TOPIC, STRING, route.key.type_id, LATCHED))
        publisher.gid = b"i" * 16
        publisher.put(line("1"))
        endpoints = until(lambda: hub.graph.publishers(TOPIC), "the publisher is discovered")
        route.update(endpoints, [])
        until(lambda: network.retained() == [line("1")], "the message is retained")
        route.update([], endpoints)
        assert network.retained() == []
        route.update(endpoints, [])
        until(lambda: network.retained() == [line("1")], "the message is retained again")
        route.close()
        hub_route.dispatcher.stop()
        node.close()


def test_messages_published_during_an_absence_cross_once_and_in_order(hub_route: HubRoute) -> None:
    """Messages are held while their publisher waits or is not on the graph, and are also in the publisher's cache."""
    route = hub_route.route
    hub_route.dispatcher.start()  # for a message that arrives while this thread publishes
    publisher, endpoint = hub_route.publisher(replace(LATCHED, depth=2), "1", "2")
    route.update([endpoint], [])
    hub_route.expect("1", "2")
    for text, waiting in (("3", [endpoint]), ("4", [])):
        route.update([], [], waiting)
        publisher.put(line(text))
        until(lambda: len(route.held.unknown) + len(route.held.latched) == 1, "the message is held")
        hub_route.received.clear()
        route.update([endpoint], [])
        hub_route.expect(str(int(text) - 1), text)
    publisher.put(line("5"))
    hub_route.expect("3", "4", "5")


def test_queued_message_of_a_publisher_that_returns_crosses_once(hub_route: HubRoute) -> None:
    route = hub_route.route
    publisher, endpoint = hub_route.publisher(replace(LATCHED, depth=2), "1")
    route.update([endpoint], [])
    hub_route.expect("1")
    route.update([], [endpoint])
    with route.queue.publishing:
        publisher.put(line("2"))
        until(lambda: len(route.queue.line) == 1, "the message is queued")
    hub_route.received.clear()
    route.update([endpoint], [])
    until(lambda: route.queue._next() or len(hub_route.received) >= 2, "the messages are bridged")
    hub_route.expect("1", "2")


def test_held_message_crosses_once_though_a_new_subscription_receives_it_again(hub_route: HubRoute) -> None:
    """The route's first subscription is volatile, like its first publisher; the next one also gets the cache."""
    route = hub_route.route
    hub_route.dispatcher.start()  # for a message that arrives while this thread publishes
    _, volatile = hub_route.publisher(Qos())
    latched, endpoint = hub_route.publisher(replace(LATCHED, depth=2))
    route.update([volatile], [], [endpoint])

    def held() -> bool:
        latched.put(line("1"))
        return bool(route.held.latched)

    until(held, "the message is held")
    latched.put(line("2"))

    def held_texts() -> list[bytes]:
        return [waiting.message.data() for waiting in tuple(route.held.latched.line)]

    # the first text may have been sent, and be held, twice
    until(lambda: held_texts() == [line("1"), line("2")], "both messages are held")
    route.update([volatile, endpoint], [])
    # wait, because the next message replaces the first one in the publisher's cache
    until(lambda: len(hub_route.received) >= 2, "the held messages are bridged")
    latched.put(line("3"))
    hub_route.expect("1", "2", "3")
