"""Large messages cross two workers in a block of the lane: the routes convert into it, and from it."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.lane.blocks import Blocks
from bridge.hub.node import Hub
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages import copies
from bridge.messages.registry import Registry
from bridge.messages.transcode import direct
from bridge.messages.transcode.conversion import Conversion, SideType
from bridge.routing.decision import RouteKey
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.edge import Endpoint, Kind, MadeBy
from bridge.routing.hub_to_side import HubToSideRoute
from bridge.routing.limits import BULK
from bridge.routing.peer_watch import Lease
from bridge.routing.route import EngineContext
from bridge.routing.rules import RoutePolicy
from bridge.routing.side_to_hub import SideToHubRoute
from bridge.routing.stall import StallDetector
from tests.peers.fake import FakeEdge, FakeNetwork
from tests.peers.hub.endpoints import STREAM, Subscriber, matched
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

STRING, TOPIC = "std_msgs/msg/String", "/large"
POLICY = RoutePolicy(allowed=True, why="", name=TOPIC)


def line(text: str) -> bytes:
    return b"\0\1\0\0" + (len(text) + 1).to_bytes(4, "little") + text.encode() + b"\0"


class Side(FakeEdge):
    """An edge whose publishers record what they send."""

    def __init__(self, registry: Registry, *, own_threads: bool = False, sends_views: bool = True) -> None:
        super().__init__(FakeNetwork(), registry)
        self.own_threads = own_threads  # type: ignore[misc]  # otherwise a constant of the class
        self.sends_views = sends_views  # type: ignore[misc]
        self.sent: list[bytes] = []
        self.kinds: set[type] = set()
        self.sending: Callable[[], None] = lambda: None

    def advertise(self, *_: object) -> Any:
        return SimpleNamespace(send=self.send, dropped=0, has_subscribers=True, native=None, close=lambda: None)

    def send(self, payload: bytes | memoryview, _source: str) -> None:
        self.sending()
        if len(payload) > BULK:
            self.kinds.add(type(payload))
        self.sent.append(bytes(payload))


class Crossing:
    """A route to the hub in one worker, and a route from the hub in another one."""

    def __init__(self, writer: Hub, reader: Hub, *, own_threads: bool, sends_views: bool, qos: Qos) -> None:
        registry, lease = Registry(), Lease()
        lease.extend(math.inf)
        self.type: SideType = registry.ros2(STRING)
        conversion = Conversion(self.type, self.type, registry.hub_check(STRING))
        key = RouteKey(TOPIC, STRING, self.type.type_id)
        self.here, self.there = Side(registry, own_threads=own_threads), Side(registry, sends_views=sends_views)
        self.dispatchers = Dispatcher("small"), Dispatcher("bulk")
        for dispatcher in self.dispatchers:
            dispatcher.start()

        def context(hub: Hub, edge: Side) -> EngineContext:
            return EngineContext(hub, edge, StallDetector(), lease, cast("Any", None), *self.dispatchers, lambda: None)

        self.to_hub = SideToHubRoute(key, TOPIC, conversion, POLICY, context(writer, self.here))
        self.to_hub.update([Endpoint("a", Kind.PUBLISHER, TOPIC, STRING, qos, MadeBy.NATIVE)])
        self.publisher: HubPublisher = self.to_hub._sources["a"].hub_publisher
        publishers = until(lambda: reader.graph.publishers(TOPIC), "the reader's worker knows the publisher")
        self.to_side = HubToSideRoute(key, TOPIC, None, conversion, POLICY, context(reader, self.there))
        self.to_side.update(publishers, [])
        matched(self.publisher)
        self.crossed = 0

    def on_lane(self) -> Blocks:
        """Wait until all subscriptions are on lanes; return the writer's blocks."""

        def blocks() -> Blocks | None:
            self.cross("to notice that zenoh has no subscriber")
            return self.publisher.blocks()

        return until(blocks, "all messages use the lane")

    def deliver(self, *texts: str) -> None:
        self.crossed += len(texts)
        for text in texts:
            self.to_hub.deliver(line(text), "a", None)

    def cross(self, *texts: str) -> None:
        """Send messages, and wait until they have arrived in order."""
        self.deliver(*texts)
        until(lambda: len(self.there.sent) >= self.crossed, "all messages arrive")
        assert self.there.sent[-len(texts) :] == [line(text) for text in texts]

    def close(self) -> None:
        self.to_hub.close()
        self.to_side.close()
        for dispatcher in self.dispatchers:
            dispatcher.stop()


Make = Callable[..., Crossing]


@pytest.fixture
def network() -> Iterator[HubNetwork]:
    with HubNetwork() as network:
        yield network


@pytest.fixture
def writer(network: HubNetwork, tmp_path: Path) -> Iterator[Hub]:
    with Hub.open(network.settings("writer", lane=str(tmp_path))) as hub:
        yield hub


@pytest.fixture
def crossing(network: HubNetwork, writer: Hub, tmp_path: Path) -> Iterator[Make]:
    made: list[Crossing] = []
    with Hub.open(network.settings("reader", lane=str(tmp_path))) as reader:

        def make(*, own_threads: bool = False, sends_views: bool = True, qos: Qos = STREAM) -> Crossing:
            made.append(Crossing(writer, reader, own_threads=own_threads, sends_views=sends_views, qos=qos))
            return made[-1]

        yield make
        for each in made:
            each.close()


SIZES = [(10, BULK + 1, 20), (3 * BULK, 1 << 20, 5, 1 << 20), (2 * BULK,)]
"""Sizes of messages that are sent together, fewer large ones than may be lent at a time."""


@pytest.mark.parametrize("own_threads", [True, False])
@pytest.mark.parametrize("sends_views", [True, False])
@pytest.mark.parametrize("compiled", [True, False])
def test_messages_of_all_sizes_cross_in_order(
    crossing: Make, monkeypatch: pytest.MonkeyPatch, *, own_threads: bool, sends_views: bool, compiled: bool
) -> None:
    if not compiled:
        for module in (copies, direct):
            monkeypatch.setattr(module, "buffers", None)
    routes = crossing(own_threads=own_threads, sends_views=sends_views)
    routes.on_lane()
    for sizes in 3 * SIZES:
        routes.cross(*(chr(ord("a") + number) * size for number, size in enumerate(sizes)))
    assert (memoryview in routes.there.kinds) == (sends_views and compiled), "messages that wait are copied"


def test_a_block_is_given_back_when_its_message_was_sent(crossing: Make) -> None:
    routes = crossing()
    blocks = routes.on_lane()
    for number in range(20):
        routes.cross(chr(ord("a") + number) * BULK)
        until(lambda: len(blocks._free) == 1, "the block is not in use")
    assert blocks.size == len(line("a" * BULK))


@pytest.mark.parametrize("fault", ["bad", "large"])
def test_a_refused_message_uses_no_block(crossing: Make, monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    routes = crossing(own_threads=True)
    blocks = routes.on_lane()
    payload = line("x" * (2 * BULK))
    if fault == "bad":
        payload = payload[:-1] + b"x"  # the closing NUL
    else:
        monkeypatch.setattr(routes.to_hub, "_max_payload", len(payload) - 5)
        payload += bytes(3)  # slack
    routes.to_hub.deliver(payload, "a", None)
    assert routes.to_hub.counters.drops[fault] == 1
    assert len(blocks._free) == (blocks.size > 0), "every block is free"
    monkeypatch.undo()
    routes.cross("y" * BULK)


def test_a_message_that_cannot_be_written_uses_no_block(crossing: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    routes = crossing(own_threads=True)
    blocks = routes.on_lane()

    def refuse(*_: object) -> None:
        msg = "the message changed while it was converted"
        raise ValueError(msg)

    with monkeypatch.context() as patch:
        patch.setattr(direct, "buffers", SimpleNamespace(measured=copies.buffers.measured, write_to=refuse))
        routes.to_hub.deliver(line("x" * (2 * BULK)), "a", None)
    assert routes.to_hub.counters.drops["bad"] == 1
    assert len(blocks._free) == 1, "the block is free"
    routes.cross("y" * BULK)


def test_a_message_that_cannot_be_queued_uses_no_block(crossing: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    routes = crossing()
    blocks = routes.on_lane()

    def refuse(*_: object) -> None:
        raise MemoryError

    (outlet,) = routes.publisher._outlets
    monkeypatch.setattr(outlet, "lend", refuse)
    with pytest.raises(MemoryError):
        routes.publisher.put(line("x" * BULK))
    assert len(blocks._free) == 1


def test_the_thread_of_a_connection_publishes_large_messages_unless_it_could_block(
    network: HubNetwork, crossing: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    routes = crossing(own_threads=True)
    routes.on_lane()
    threads: set[threading.Thread] = set()
    put = routes.publisher.put

    def spy(*message: Any) -> None:
        threads.add(threading.current_thread())
        put(*message)

    for publisher in (routes.publisher, routes.to_hub._sources["a"]):
        monkeypatch.setattr(publisher, "put", spy)
    routes.cross("a" * BULK, "small", "b" * BULK)
    assert threads == {threading.current_thread()}
    threads.clear()
    with Hub.open(network.settings("foreign")) as foreign:  # it has no lane
        subscriber = Subscriber(foreign, TOPIC, type_hash=routes.type.type_id)
        until(lambda: routes.publisher.way()[0] == "both", "zenoh has a subscriber")
        routes.cross("c" * BULK, "last")
        until(lambda: len(subscriber.samples) == 2, "the other program receives them")
    assert threading.current_thread() not in threads


def test_a_zenoh_subscription_that_has_just_appeared_receives_a_message_in_a_block(
    network: HubNetwork, crossing: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    routes = crossing(own_threads=True)
    blocks = routes.on_lane()
    with Hub.open(network.settings("foreign")) as foreign:
        subscriber = Subscriber(foreign, TOPIC, type_hash=routes.type.type_id)
        until(lambda: routes.publisher.way()[0] == "both", "zenoh has a subscriber")
        monkeypatch.setattr(routes.publisher, "blocks", lambda: blocks)  # as if the route had asked just before
        routes.cross("c" * BULK)
        until(lambda: subscriber.samples, "the other program receives it")
        assert subscriber.samples[0].data() == line("c" * BULK)


def test_latched_messages_are_stored_and_use_no_block(crossing: Make) -> None:
    routes = crossing(own_threads=True, qos=LATCHED)
    routes.cross("a" * BULK)
    assert routes.publisher.blocks() is None
    assert routes.there.kinds == {bytes}
