"""A topic switches between lane and zenoh while it is published: all messages arrive once and in order."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.hub.endpoints import lane_subscription
from bridge.hub.endpoints.lane_subscription import LaneSubscription
from bridge.hub.endpoints.sinks import Matching
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.lane.blocks import Blocks
from bridge.hub.lane.inlet import Inlet, LaneReader
from bridge.hub.lane.joining import Joining
from bridge.hub.lane.lent import LentPayload
from bridge.hub.lane.wire import BOUND
from bridge.hub.node import Hub
from bridge.hub.session import HubSession
from bridge.hub.wire.keys import topic_key
from bridge.hub.wire.qos import History, Qos
from tests.peers.hub.endpoints import HASH, LATCHED, TYPE, Subscriber, advertise, matched
from tests.peers.hub.lane import goes_by, subscription, whole
from tests.peers.hub.network import HubNetwork
from tests.peers.peer import Peer
from tests.peers.zenoh.rmw import RmwSubscription
from tests.support.wait import until


@pytest.fixture
def lane(tmp_path: Path) -> str:
    return str(tmp_path / "a folder whose path is longer than a socket's can be, as the address has 108 bytes" / "lane")


@pytest.fixture
def reader(network: HubNetwork, lane: str) -> Iterator[Hub]:
    with Hub.open(network.settings("reader", lane=lane)) as hub:
        yield hub


@pytest.fixture
def writer(network: HubNetwork, lane: str) -> Iterator[Hub]:
    with Hub.open(network.settings("writer", lane=lane)) as hub:
        yield hub


@pytest.fixture
def drummer(network: HubNetwork, lane: str) -> Iterator[Peer]:
    with network.hub_peer("drummer", lane=lane) as peer:
        yield peer


@pytest.mark.parametrize("switches", [10, pytest.param(200, marks=pytest.mark.thorough)])
def test_switches_lose_nothing(
    network: HubNetwork, reader: Hub, drummer: Peer, switches: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The test waits for all messages before each switch, because a link that is congested for seconds drops some."""
    monkeypatch.setattr(lane_subscription, "EARLY_SECONDS", 40.0)  # on a busy machine, one transport may be late
    subscriber = Subscriber(reader, "/t")
    number, put = drummer.ask("publisher", topic="/t")["id"], 0
    with network.hub_peer("foreign") as foreign, network.rmw_session() as rmw:
        beside = RmwSubscription(rmw, topic_key(network.domain, "/t", TYPE, HASH), Qos(depth=10))
        goes_by(subscriber, "lane")
        for _ in range(switches // 2):
            drummer.ask("drum", id=number, rate=1000.0, size=100, first=put + 1)
            strange = foreign.ask("publisher", topic="/t")["id"]
            goes_by(subscriber, "zenoh", "foreign: it has no lane here")
            foreign.ask("drop", id=strange)
            goes_by(subscriber, "lane")
            put += drummer.ask("counted", id=number, now=True)["sent"]
            last = [str(put).ljust(100)]
            for received in (subscriber, beside):
                until(lambda received=received, last=last: received.texts()[-1:] == last, f"{put} arrives")
        beside.close()
    whole(subscriber.texts())
    whole(beside.texts())
    assert subscription(subscriber).by_lane
    assert not subscription(subscriber).lost


def test_foreign_publishers_are_received_again(network: HubNetwork, reader: Hub, writer: Hub) -> None:
    subscriber = Subscriber(reader, "/t")
    ours = advertise(writer, "/t")
    goes_by(subscriber, "lane")
    until(lambda: ours.way() == ("lane", ""), "the publisher uses the lane")
    with Hub.open(network.settings("foreign")) as far:
        strange = advertise(far, "/t")
        goes_by(subscriber, "zenoh", "foreign")
        matched(strange)
        strange.put(b"from afar")
        ours.put(b"from here")
        subscriber.expect("from afar", "from here")
        until(lambda: ours.way() == ("zenoh", "a subscription is not on the lane"), "the publisher uses zenoh")


def test_other_subscribers_receive_lane_messages(network: HubNetwork, reader: Hub, writer: Hub) -> None:
    ours = advertise(writer, "/t")
    subscriber, every = Subscriber(reader, "/t"), Subscriber(reader, "/t", type_hash="*")
    goes_by(subscriber, "lane")
    goes_by(every, "lane")
    until(lambda: ours.way() == ("lane", ""), "the publisher has matched both subscriptions")
    with Hub.open(network.settings("foreign")) as far:
        strange = Subscriber(far, "/t")
        until(lambda: ours.way()[0] == "both", "the publisher uses both transports")
        ours.put(b"x")
        for receiver in (subscriber, every, strange):
            receiver.expect("x")


def test_joined_messages_do_not_wait_for_a_publisher_that_blocks(reader: Hub, writer: Hub) -> None:
    subscriber, ours = Subscriber(reader, "/t"), advertise(writer, "/t")
    blocks = advertise(writer, "/blocks", Qos(history=History.KEEP_ALL))
    until(lambda: ours.way() == ("lane", ""), "the publisher uses the lane")
    joining = Joining()
    try:
        ours.put(b"joined")
        blocks.put(b"x")
        subscriber.expect("joined")
    finally:
        joining.end()


@pytest.mark.parametrize("blocks", [True, False], ids=["blocks", "parts"])
def test_large_messages_use_the_lane(
    reader: Hub, writer: Hub, monkeypatch: pytest.MonkeyPatch, *, blocks: bool
) -> None:
    if not blocks:
        monkeypatch.setattr(Blocks, "store", lambda *_: None)
    subscriber, every = Subscriber(reader, "/t"), Subscriber(reader, "/t", type_hash="*")
    ours = advertise(writer, "/t")
    for receiver in (subscriber, every):
        goes_by(receiver, "lane")
    until(lambda: ours.way() == ("lane", ""), "the publisher uses the lane")
    texts = ["small", "a" * (3 * BOUND), "b" * (40 * BOUND), "c" * (BOUND + 1), "d" * (100 * BOUND), "last"]
    for text in texts:
        ours.put(text.encode())
    for receiver in (subscriber, every):
        until(lambda receiver=receiver: len(receiver.samples) == len(texts), "all messages arrive")
        assert receiver.texts() == texts
        goes_by(receiver, "lane")
    assert subscription(subscriber).by_lane == len(texts)


def test_topic_returns_to_zenoh_before_the_match_is_reported(
    network: HubNetwork, reader: Hub, writer: Hub, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The writer's session may see the declaration on zenoh before."""
    monkeypatch.setattr(Matching, "_on_changed", lambda *_: None)  # as if zenoh reported the match very late
    subscriber = Subscriber(reader, "/t")
    ours = advertise(writer, "/t")
    goes_by(subscriber, "lane")
    ours.put(b"by lane")
    subscriber.expect("by lane")
    with Hub.open(network.settings("foreign")) as far:
        advertise(far, "/t")
        goes_by(subscriber, "zenoh", "foreign: it has no lane here")
        until(lambda: ours.way()[0] == "zenoh", "the lane has been left")
        ours.put(b"by zenoh")
        subscriber.expect("by lane", "by zenoh")


def test_messages_still_on_the_way_over_zenoh_are_received_after_the_switch_to_the_lane(
    network: HubNetwork, reader: Hub, writer: Hub, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy machine, a callback may take longer than everything else."""
    subscriber, ours, gate = Subscriber(reader, "/t"), advertise(writer, "/t"), threading.Event()
    chosen, asked = subscription(subscriber), threading.Event()
    receive, passed = chosen._callback, chosen._lane.barriers.has_passed
    texts = [str(number) for number in range(50)]

    def slow(message: HubSample) -> None:
        assert gate.wait(60)
        receive(message)

    def ask(zid: str, since: float) -> bool:
        asked.set()
        return passed(zid, since)

    with Hub.open(network.settings("foreign")) as far:
        advertise(far, "/t")
        goes_by(subscriber, "zenoh", "foreign: it has no lane here")
        until(lambda: ours.way()[0] == "zenoh", "the publisher uses zenoh")
        monkeypatch.setattr(chosen, "_callback", slow)
        for text in texts:
            ours.put(text.encode())
        monkeypatch.setattr(chosen._lane.barriers, "has_passed", ask)
    try:
        until(asked.is_set, "the lane is joined")
        until(lambda: chosen.why == "switching to the lane", "the switch is reported, which may be after the query")
        assert chosen.way == "zenoh"
    finally:
        gate.set()
    goes_by(subscriber, "lane")
    subscriber.expect(*texts)
    assert subscriber.texts() == texts


@pytest.mark.parametrize("depth", [10, 1])
def test_message_that_is_still_on_a_closing_lane_is_received_before_later_ones(
    network: HubNetwork, reader: Hub, writer: Hub, monkeypatch: pytest.MonkeyPatch, depth: int
) -> None:
    """With a depth of 1, as for velocity commands, the newest message does not wait."""
    monkeypatch.setattr(lane_subscription, "LEAVING_SECONDS", 1000.0)  # no matter how slow the machine is
    subscriber, ours, gate = Subscriber(reader, "/t", Qos(depth=depth)), advertise(writer, "/t"), threading.Event()
    chosen = subscription(subscriber)
    goes_by(subscriber, "lane")
    receive = chosen.on_message

    def slow(inlet: Inlet, attachment: tuple[int, int, bytes], payload: bytes) -> None:
        assert payload != b"late" or gate.wait(60)
        receive(inlet, attachment, payload)

    monkeypatch.setattr(chosen, "on_message", slow)
    for text in ("first", "late"):
        ours.put(text.encode())
    with Hub.open(network.settings("foreign")) as far:
        try:
            advertise(far, "/t")
            until(lambda: ours.way()[0] == "both", "the publisher uses both transports")
            ours.put(b"last")
            until(lambda: chosen._sequencer.early or len(subscriber.samples) > 1, "the last message arrives over zenoh")
            held = time.monotonic()
            if depth == 1:
                subscriber.expect("first", "last")
                return
            until(lambda: time.monotonic() > held + 0.5, "the last message is held longer than other early messages")
        finally:
            gate.set()
        subscriber.expect("first", "late", "last")
        assert subscriber.texts() == ["first", "late", "last"]
        goes_by(subscriber, "zenoh", "foreign: it has no lane here")


Waiting = tuple[Subscriber, LaneSubscription, Callable[[LentPayload], None]]


@pytest.fixture
def waiting(reader: Hub, writer: Hub, monkeypatch: pytest.MonkeyPatch) -> Waiting:
    """A subscriber that has "first", and a function that delivers a message after the next one, which is missing."""
    subscriber, ours = Subscriber(reader, "/t"), advertise(writer, "/t")
    chosen = subscription(subscriber)
    goes_by(subscriber, "lane")
    ours.put(b"first")
    subscriber.expect("first")
    monkeypatch.setattr(chosen._sequencer, "_both", lambda _gid: True)
    (inlet,) = chosen._lanes.inlets
    stamp = (ours.sender.sequence + 2, time.time_ns(), ours.gid)
    return subscriber, chosen, lambda lent: chosen.on_message(inlet, stamp, lent)


def test_a_large_message_that_waits_for_an_earlier_one_is_copied(
    waiting: Waiting, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A subscription that is closed meanwhile may remain until Python's next collection."""
    subscriber, chosen, deliver = waiting
    given_back: list[bool] = []
    schedule = chosen._schedule
    monkeypatch.setattr(chosen, "_schedule", lambda: None)  # the message waits until the test has looked
    deliver(LentPayload(memoryview(b"last"), lambda: given_back.append(True)))
    assert (given_back, subscriber.texts()) == ([True], ["first"])
    schedule()
    subscriber.expect("first", "last")


def test_an_early_message_does_not_wait_for_that_of_a_publisher_whose_lane_is_left(
    waiting: Waiting,
) -> None:
    subscriber, chosen, deliver = waiting
    chosen._lane.calls.within(1000.0, chosen._release_due)  # as for a message that waits for a lane that is left
    deliver(LentPayload(memoryview(b"last"), lambda: None))
    subscriber.expect("first", "last")


def test_subscription_that_is_closed_while_it_joins_a_lane_leaves_it(
    reader: Hub, writer: Hub, monkeypatch: pytest.MonkeyPatch
) -> None:
    publisher, join = advertise(writer, "/t"), Inlet.join

    def close_then_join(inlet: Inlet, joining: LaneReader) -> None:
        assert isinstance(joining, LaneSubscription)
        joining.close()
        join(inlet, joining)
        joined.set()

    joined = threading.Event()
    monkeypatch.setattr(Inlet, "join", close_then_join)
    Subscriber(reader, "/t")
    assert joined.wait(20.0)
    until(lambda: not publisher.matched(), "the publisher is no longer matched")


class EndingInlet:
    """A connection whose end another thread handles while this thread checks it."""

    def __init__(self, lanes: Any) -> None:
        self._lanes = lanes

    @property
    def alive(self) -> bool:
        self._lanes.inlets.pop(self, None)
        return False


def test_lanes_may_end_during_the_choice(reader: Hub) -> None:
    subscriber = Subscriber(reader, "/t")
    chosen = subscription(subscriber)
    goes_by(subscriber, "zenoh", "no other worker publishes it")
    chosen._lane.remove(chosen)
    ending: Any = [EndingInlet(chosen._lanes), EndingInlet(chosen._lanes)]
    chosen._lanes.inlets = dict.fromkeys(ending, 0.0)
    chosen.settle()
    assert not chosen._lanes.inlets


@pytest.mark.parametrize(
    ("qos", "why"),
    [
        (LATCHED, "writer stores messages for late joiners"),
        (Qos(history=History.KEEP_ALL), "writer has the history keep_all"),
    ],
)
def test_latched_and_keep_all_topics_stay_on_zenoh(reader: Hub, writer: Hub, qos: Qos, why: str) -> None:
    subscriber = Subscriber(reader, "/t")
    ours = advertise(writer, "/t", qos)
    goes_by(subscriber, "zenoh", why)
    matched(ours)
    ours.put(b"x")
    subscriber.expect("x")


def test_each_message_is_received_once_from_any_session(network: HubNetwork, writer: Hub, lane: str) -> None:
    session = HubSession.open(network.settings("unused", lane=lane), shared=True)
    try:
        first_node, second_node = Hub.on(session, "one", "one"), Hub.on(session, "two", "two")
        subscribers = [Subscriber(hub, "/t") for hub in (first_node, second_node)]
        says = {hub: hub.publisher("/t", TYPE, HASH, Qos(depth=10)) for hub in (first_node, second_node, writer)}
        for subscriber in subscribers:
            goes_by(subscriber, "lane")
        for number in range(100):
            for name, publisher in zip(("one", "two", "far"), says.values(), strict=True):
                publisher.put(f"{name} {number}".encode())
        for subscriber, others in zip(subscribers, (("two", "far"), ("one", "far")), strict=True):
            subscriber.expect(*(f"{name} {number}" for name in others for number in range(100)))
    finally:
        session.close()


def test_late_publishers_and_subscribers_use_the_lane(reader: Hub, writer: Hub) -> None:
    subscriber = Subscriber(reader, "/t")
    first = advertise(writer, "/t")
    goes_by(subscriber, "lane")
    second = advertise(writer, "/t", Qos(depth=10), "at once")  # the first message uses the lane, too
    subscriber.expect("at once")
    later = Subscriber(reader, "/t")
    goes_by(later, "lane")
    first.put(b"one")
    second.put(b"two")
    subscriber.expect("at once", "one", "two")
    # the first publisher's message used the lane; "at once" over zenoh may still be under way
    until(lambda: {"one", "two"} <= set(later.texts()), "the later subscription receives both messages")
    assert sorted(later.texts()) in (["one", "two"], ["at once", "one", "two"])
    later.subscription.close()
    subscriber.subscription.close()
    until(lambda: not first.matched(), "the publisher has no subscriber")
    assert first.pass_over()


def test_a_session_with_zenoh_access_control_has_no_lane(network: HubNetwork, lane: str) -> None:
    empty: dict[str, Any] = {key: [] for key in ("rules", "policies", "subjects")}
    rules = {"access_control": {"enabled": True, "default_permission": "allow", **empty}}
    with Hub.open(network.settings("ruled", lane=lane, zenoh=rules)) as hub:
        assert hub.lane().document() == {}
    with Hub.open(network.settings("free", lane=lane)) as hub:
        assert hub.lane().document() == {"why": "", "writers": 0, "readers": 0, "dropped": 0}
