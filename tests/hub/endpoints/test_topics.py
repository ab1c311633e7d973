"""Publishers and subscriptions without retained messages."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import pytest
import zenoh

from bridge import resources
from bridge.hub.endpoints.sinks import LARGE, Matching
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.errors import HubClosedError, HubError, HubWireError
from bridge.hub.graph.tokens import BRIDGE_ENCLAVE, EndpointKind, EndpointToken, NodeToken, endpoint_key
from bridge.hub.node import Hub
from bridge.hub.wire.keys import pack_attachment, topic_key
from bridge.hub.wire.qos import History
from tests.peers.hub.endpoints import HASH, LATCHED, STREAM, TYPE, Subscriber, advertise, matched
from tests.peers.hub.network import HubNetwork
from tests.peers.zenoh.rmw import RmwSubscription
from tests.support.wait import until


def test_samples_arrive_in_order_with_their_metadata(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        subscriber = Subscriber(b, "/chatter")
        publisher = advertise(a, "/chatter")
        matched(publisher)
        for number in range(100):
            publisher.put(b"%d" % number, source_time_ns=1000 + number)
        until(lambda: len(subscriber.samples) == 100, "all messages arrive")
        assert subscriber.texts() == [str(n) for n in range(100)]
        assert [s.sequence for s in subscriber.samples] == list(range(1, 101))
        assert [s.source_time_ns for s in subscriber.samples] == list(range(1000, 1100))
        assert {s.gid for s in subscriber.samples} == {publisher.gid}
        assert {s.zid for s in subscriber.samples} == {a.zid}
        assert subscriber.subscription.lost == 0


def test_source_time_is_now_unless_given(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        subscriber = Subscriber(b, "/chatter")
        publisher = advertise(a, "/chatter")
        matched(publisher)
        before = time.time_ns()
        publisher.put(b"x")
        subscriber.expect("x")
        assert before <= subscriber.samples[0].source_time_ns <= time.time_ns()


def test_own_samples_are_not_received(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        own_subscriber, other = Subscriber(a, "/chatter"), Subscriber(b, "/chatter")
        publisher = advertise(a, "/chatter")
        matched(publisher)
        publisher.put(b"x")
        other.expect("x")
        assert own_subscriber.samples == []


def test_a_subscription_to_any_hash_receives_all_versions(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        every, same = Subscriber(b, "/chatter", type_hash="*"), Subscriber(b, "/chatter")
        until(lambda: len(a.graph.subscriptions("/chatter")) == 2, "both subscriptions are seen")
        other = a.publisher("/chatter", TYPE, "RIHS01_" + "00" * 32, STREAM)
        matched(other)
        other.put(b"other")
        advertise(a, "/chatter", STREAM, "same")
        every.expect("other", "same")
        same.expect("same")


def test_other_topics_types_and_domains_are_not_received(network: HubNetwork):
    with (
        Hub.open(network.settings("a")) as a,
        Hub.open(network.settings("b")) as b,
        Hub.open(network.settings("c", domain=0)) as c,
    ):
        subscribers = [Subscriber(b, "/one"), Subscriber(b, "/one/two"), Subscriber(c, "/one")]
        publisher = advertise(a, "/one")
        a.publisher("/one", "std_msgs/msg/Bool", HASH, STREAM).put(b"bool")
        matched(publisher)
        publisher.put(b"x")
        subscribers[0].expect("x")
        assert [h.texts() for h in subscribers] == [["x"], [], []]


def test_matched_reports_subscribers(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        publisher = advertise(a, "/chatter")
        assert not publisher.matched()
        subscriber = Subscriber(b, "/chatter")
        matched(publisher)
        subscriber.subscription.close()
        until(lambda: not publisher.matched(), "the publisher has no subscriber")
        again = Subscriber(b, "/chatter")
        until(lambda: not publisher.pass_over(), "the next subscriber is noticed")
        again.subscription.close()
        until(publisher.pass_over, "the subscriber has left")


@pytest.mark.parametrize("joins", [1, pytest.param(300, marks=pytest.mark.thorough)])
def test_a_listed_subscription_of_another_program_misses_nothing(
    network: HubNetwork, monkeypatch: pytest.MonkeyPatch, joins: int
) -> None:
    """The graph may list a subscription some time after zenoh can reach it, but before zenoh reports the match."""
    if joins == 1:
        monkeypatch.setattr(Matching, "_on_changed", lambda *_: None)  # as if zenoh reported the match very late
    with Hub.open(network.settings("a")) as a, network.rmw_session() as other:
        publisher, key = advertise(a, "/chatter"), topic_key(network.domain, "/chatter", TYPE, HASH)
        for number in range(joins):
            assert not publisher.matched()
            publisher.put(b"unheard")
            beside = RmwSubscription(other, key, STREAM)
            node = NodeToken(network.domain, str(other.zid()), "0", "/", "other", BRIDGE_ENCLAVE)
            entity = EndpointToken(node, str(number + 1), EndpointKind.SUBSCRIPTION, "/chatter", TYPE, HASH, STREAM)
            beside.announce(endpoint_key(entity))
            until(lambda: a.graph.subscriptions("/chatter"), "the subscription is listed")
            publisher.put(b"x")
            beside.expect("x")
            assert not publisher.pass_over()
            beside.close()
            until(lambda: not a.graph.subscriptions("/chatter") and publisher.pass_over(), "the subscription has left")


@pytest.mark.parametrize("late", [False, True])
def test_an_unlisted_subscriber_misses_nothing_after_the_match(
    network: HubNetwork, monkeypatch: pytest.MonkeyPatch, late: bool
) -> None:
    """A plain zenoh program announces no token. Its match is reported, or, if ``late``, found by a query."""
    if late:
        monkeypatch.setattr(Matching, "_on_changed", lambda *_: None)
    with Hub.open(network.settings("a")) as a, network.program() as other:
        publisher = advertise(a, "/chatter", STREAM, "unheard", "unheard")
        texts: list[str] = []
        key = topic_key(network.domain, "/chatter", TYPE, HASH)
        subscriber = other.declare_subscriber(key, lambda sample: texts.append(sample.payload.to_string()))
        (sink,) = publisher._sinks
        matching = sink._matching  # type: ignore[attr-defined]
        until(publisher.matched if late else lambda: matching._reported[""], "the match is known")
        for number in range(100):
            publisher.put(b"%d" % number)
        until(lambda: len(texts) >= 100, "all messages arrive")
        assert texts == [str(number) for number in range(100)]
        subscriber.undeclare()


def test_publisher_detects_earlier_subscriptions(network: HubNetwork):
    with Hub.open(network.settings("a")) as a:
        with Hub.open(network.settings("b")) as b:
            Subscriber(b, "/chatter")
            first = advertise(a, "/chatter")
            matched(first)
            second = advertise(a, "/chatter")
            assert second.matched()
            assert not second.pass_over()
        until(lambda: not second.matched(), "the session has left")
        assert second.pass_over()


def test_unreceived_messages_are_numbered_but_not_encoded(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        publisher, kept = advertise(a, "/chatter"), advertise(a, "/kept", LATCHED)
        assert [publisher.pass_over(), publisher.pass_over()] == [True, True]
        assert not kept.pass_over()
        subscriber = Subscriber(b, "/chatter")
        matched(publisher)
        assert not publisher.pass_over()
        publisher.put(b"x")
        subscriber.expect("x")
        assert [sample.sequence for sample in subscriber.samples] == [3]
        subscriber.subscription.close()
        until(lambda: not publisher.matched(), "the subscriber has left")
        assert publisher.pass_over()
        publisher.close()
        with pytest.raises(HubClosedError, match="/chatter is closed"):
            publisher.pass_over()


def test_a_large_message_arrives_complete(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        subscriber = Subscriber(b, "/image")
        publisher = advertise(a, "/image")
        matched(publisher)
        payload = bytes(range(256)) * 40_000
        # a busy machine may drop the message
        until(lambda: publisher.put(payload) or subscriber.samples, "a message arrives", every=0.2)
        assert subscriber.samples[0].data() == payload


def test_memory_of_a_large_message_is_released_at_both_ends(network: HubNetwork, monkeypatch: pytest.MonkeyPatch):
    """`LARGE_MESSAGES` gets the size of each message at both ends; tests/test_resources.py tests the release itself."""
    passed: list[int] = []
    monkeypatch.setattr(resources.LARGE_MESSAGES, "passed", passed.append)
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        subscriber = Subscriber(b, "/large")
        publisher = advertise(a, "/large", replace(STREAM, history=History.KEEP_ALL))  # which a busy link does not drop
        matched(publisher)
        publisher.put(b"small")
        publisher.put(bytes(resources.LARGE))
        until(lambda: len(subscriber.samples) == 2, "both messages arrive")
    assert sorted(passed) == [5, 5, resources.LARGE, resources.LARGE]


class Busy:
    """A program that reads nothing for a while, as on a machine that is busy otherwise."""

    def __init__(self, hub: Hub) -> None:
        self.begun, self.goes_on, self.received = threading.Event(), threading.Event(), list[int]()
        self.subscription = hub.subscription("/large", TYPE, HASH, STREAM, self._on_sample)

    def _on_sample(self, sample: HubSample) -> None:  # on zenoh's thread that reads the link
        self.received.append(len(sample.payload))
        self.begun.set()
        self.goes_on.wait(60)


def test_message_too_large_for_shared_memory_waits_for_a_busy_subscriber(network: HubNetwork):
    """Messages of 50 MB and more used to be lost: the link's queue had to accept each as a whole within 0.2 s."""
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        busy, other = Busy(b), Subscriber(b, "/small")
        publisher, small = advertise(a, "/large"), advertise(a, "/small")
        matched(publisher)
        matched(small)
        publisher.put(b"first")
        assert busy.begun.wait(20)
        sending = threading.Thread(target=publisher.put, args=[bytes(LARGE + 1)])
        sending.start()
        time.sleep(0.3)  # meanwhile the message fills the link, which cannot be observed
        small.put(b"meanwhile")
        assert sending.is_alive()  # and the small message did not wait for it
        busy.goes_on.set()
        sending.join()
        publisher.put(b"last")
        other.expect("meanwhile")
        until(lambda: len(busy.received) == 3, "all messages arrive")
        assert busy.received == [5, LARGE + 1, 4]
        assert busy.subscription.lost == 0


def test_lost_messages_are_reported_with_their_source(network: HubNetwork):
    """The receiver is busy for longer than a large message may wait."""
    drop = {"congestion_control": {"drop": {"max_wait_before_drop_fragments": 1000}}}
    hurried = {"transport": {"link": {"tx": {"queue": drop}}}}
    with Hub.open(replace(network.settings("a"), zenoh=hurried)) as a, Hub.open(network.settings("b")) as b:
        busy = Busy(b)
        publisher = advertise(a, "/large")
        matched(publisher)
        publisher.put(b"first")
        assert busy.begun.wait(20)
        publisher.put(bytes(LARGE + 1))
        busy.goes_on.set()

        def seen() -> bool:  # a later message reveals the loss
            publisher.put(b"next")
            return busy.subscription.lost > 0 and len(busy.received) > 1  # the loss is counted before the delivery

        until(seen, "the loss is detected")
        assert busy.received[1] == 4
        assert "busy for too long" in (losses := busy.subscription.losses())
        assert " from a;" in losses
        assert "max_wait_before_drop_fragments" in losses


def test_messages_have_a_size_limit(network: HubNetwork):
    with Hub.open(network.settings("a", max_payload=1000)) as a, Hub.open(network.settings("b")) as b:
        to_a, to_b = Subscriber(a, "/to_a"), Subscriber(b, "/to_b")
        from_a, from_b = advertise(a, "/to_b"), advertise(b, "/to_a")
        matched(from_a)
        matched(from_b)
        with pytest.raises(HubError, match="1001 bytes on /to_b"):
            from_a.put(bytes(1001))
        from_a.put(b"fits")
        to_b.expect("fits")
        from_b.put(bytes(2000))
        from_b.put(b"fits")
        to_a.expect("fits")
        assert to_a.subscription.refused == 1


def test_samples_with_an_invalid_attachment_are_rejected(network: HubNetwork):
    with (
        Hub.open(network.settings("a")) as a,
        Hub.open(network.settings("b")) as b,
        network.program() as program,
    ):
        subscriber = Subscriber(b, "/chatter")
        good = advertise(a, "/chatter")
        matched(good)
        raw = program.declare_publisher(topic_key(a.domain, "/chatter", TYPE, HASH))
        until(lambda: raw.matching_status.matching, "the publisher is matched")  # type: ignore[attr-defined]
        for attachment in (None, b"", b"short", bytes(33), bytes(200)):
            raw.put(b"bad", attachment=attachment)
        raw.delete()
        raw.put(b"foreign", attachment=pack_attachment(0, 5, bytes(16)))
        good.put(b"good")
        subscriber.expect("foreign", "good")
        assert subscriber.subscription.refused == 5
        assert {sample.data(): sample.zid for sample in subscriber.samples} == {b"foreign": "", b"good": a.zid}


def test_sequence_gaps_count_as_lost_samples(network: HubNetwork):
    with network.program() as program, Hub.open(network.settings("b")) as b:
        subscriber = Subscriber(b, "/chatter")
        raw = program.declare_publisher(topic_key(b.domain, "/chatter", TYPE, HASH))
        until(lambda: raw.matching_status.matching, "the publisher is matched")  # type: ignore[attr-defined]
        first, second = b"1" * 16, b"2" * 16
        for gid, sequence in ((first, 1), (first, 2), (second, 7), (first, 5), (second, 8), (first, 6), (second, 10)):
            raw.put(b"x", attachment=pack_attachment(sequence, 1000 + sequence, gid))
        until(lambda: len(subscriber.samples) == 7, "all messages arrive")
        assert subscriber.subscription.lost == 2 + 1
        assert "3 from an unknown node" in subscriber.subscription.losses()


def test_duplicate_sample_is_delivered_once(network: HubNetwork):
    with network.program() as program, Hub.open(network.settings("b")) as b:
        subscriber = Subscriber(b, "/chatter")
        raw = program.declare_publisher(topic_key(b.domain, "/chatter", TYPE, HASH))
        until(lambda: raw.matching_status.matching, "the publisher is matched")  # type: ignore[attr-defined]
        for sequence in (1, 2, 2, 1, 3):
            raw.put(b"%d" % sequence, attachment=pack_attachment(sequence, 1000 + sequence, b"1" * 16))
        subscriber.expect("1", "2", "3")


def test_publisher_used_by_many_threads_numbers_without_gaps(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        subscriber = Subscriber(b, "/chatter")
        publisher = advertise(a, "/chatter", replace(STREAM, history=History.KEEP_ALL))
        matched(publisher)
        threads = [threading.Thread(target=lambda: [publisher.put(b"x") for _ in range(200)]) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        until(lambda: len(subscriber.samples) == 800, "all messages arrive")
        assert [s.sequence for s in subscriber.samples] == list(range(1, 801))


@pytest.mark.parametrize(
    ("priority", "expected"),
    [
        ("command", zenoh.Priority.INTERACTIVE_HIGH),
        ("state", zenoh.Priority.DATA_HIGH),
        ("stream", zenoh.Priority.DATA),
    ],
)
def test_each_class_of_topics_has_its_zenoh_priority(network: HubNetwork, priority: str, expected: zenoh.Priority):
    with (
        Hub.open(network.settings("a")) as a,
        network.program() as program,
    ):
        samples: list[zenoh.Sample] = []
        key = topic_key(a.domain, "/chatter", TYPE, HASH)
        raw = program.declare_subscriber(key, samples.append)
        publisher = advertise(a, "/chatter", priority=priority)
        matched(publisher)
        publisher.put(b"x")
        until(lambda: samples, "a message arrives")
        raw.undeclare()
        assert (samples[0].priority, samples[0].express) == (expected, priority == "command")
        assert samples[0].congestion_control == zenoh.CongestionControl.DROP


def test_bad_names_are_refused(network: HubNetwork):
    with Hub.open(network.settings("a")) as a:
        with pytest.raises(HubWireError):
            a.publisher("/bad topic", TYPE, HASH, STREAM)
        with pytest.raises(HubWireError):
            a.publisher("/chatter", TYPE, "*", STREAM)
        with pytest.raises(HubWireError):
            a.subscription("/chatter", "String", HASH, STREAM, lambda _sample: None)
        assert a.graph.endpoints() == []


def test_close_leaves_no_endpoints(network: HubNetwork):
    before = set(threading.enumerate())
    hub = Hub.open(network.settings("a"))
    publisher, subscriber = advertise(hub, "/chatter"), Subscriber(hub, "/chatter")
    hub.serve("status", lambda _params: {})
    hub.close()
    hub.close()
    publisher.close()
    subscriber.subscription.close()
    until(lambda: set(threading.enumerate()) <= before, "the session's threads have ended")
    for use in (
        lambda: publisher.put(b"x"),
        lambda: hub.publisher("/x", TYPE, HASH, STREAM),
        lambda: hub.set_origin(None),
        lambda: hub.ask("status", {}),
        lambda: hub.serve("status", lambda _params: {}),
    ):
        with pytest.raises(HubClosedError):
            use()


def test_closed_endpoints_send_and_receive_nothing(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        first, second = Subscriber(b, "/chatter"), Subscriber(b, "/chatter")
        publisher = advertise(a, "/chatter")
        matched(publisher)
        first.subscription.close()
        first.subscription.close()
        publisher.put(b"x")
        second.expect("x")
        assert first.samples == []
        publisher.close()
        with pytest.raises(HubClosedError):
            publisher.put(b"y")
        until(lambda: not b.graph.publishers("/chatter"), "the publisher is gone from the graph")
