"""Publishers and subscriptions that keep nothing."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import pytest
import zenoh

from bridge.hub import attachment
from bridge.hub.errors import HubClosedError, HubError, WireError
from bridge.hub.keyexpr import topic_key
from bridge.hub.qos import History
from bridge.hub.session import Hub
from tests.hub.parts import HASH, STREAM, TYPE, Heard, matched, talk
from tests.support.hub import HubNetwork
from tests.support.wait import until


def test_samples_arrive_in_order_with_what_they_carry(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        heard = Heard(b, "/chatter")
        publisher = talk(a, "/chatter")
        matched(publisher)
        for number in range(100):
            publisher.put(b"%d" % number, source_time_ns=1000 + number)
        until(lambda: len(heard.samples) == 100, "all heard")
        assert heard.texts() == [str(n) for n in range(100)]
        assert [s.sequence for s in heard.samples] == list(range(1, 101))
        assert [s.source_time_ns for s in heard.samples] == list(range(1000, 1100))
        assert {s.gid for s in heard.samples} == {publisher.gid}
        assert {s.zid for s in heard.samples} == {a.zid}
        assert heard.subscription.lost == 0


def test_source_time_is_now_unless_given(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        heard = Heard(b, "/chatter")
        publisher = talk(a, "/chatter")
        matched(publisher)
        before = time.time_ns()
        publisher.put(b"x")
        heard.wait("x")
        assert before <= heard.samples[0].source_time_ns <= time.time_ns()


def test_own_samples_are_not_heard(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        own, other = Heard(a, "/chatter"), Heard(b, "/chatter")
        publisher = talk(a, "/chatter")
        matched(publisher)
        publisher.put(b"x")
        other.wait("x")
        assert own.samples == []


def test_any_hash(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        every, same = Heard(b, "/chatter", type_hash="*"), Heard(b, "/chatter")
        other = a.publisher("/chatter", TYPE, "RIHS01_" + "00" * 32, STREAM)
        matched(other)
        other.put(b"other")
        talk(a, "/chatter", STREAM, "same")
        every.wait("other", "same")
        same.wait("same")


def test_topics_types_and_domains_are_apart(network: HubNetwork):
    with (
        Hub.open(network.settings("a")) as a,
        Hub.open(network.settings("b")) as b,
        Hub.open(network.settings("c", domain=0)) as c,
    ):
        heard = [Heard(b, "/one"), Heard(b, "/one/two"), Heard(c, "/one")]
        publisher = talk(a, "/one")
        a.publisher("/one", "std_msgs/msg/Bool", HASH, STREAM).put(b"bool")
        matched(publisher)
        publisher.put(b"x")
        heard[0].wait("x")
        assert [h.texts() for h in heard] == [["x"], [], []]


def test_matched_tells_whether_anybody_listens(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        publisher = talk(a, "/chatter")
        assert not publisher.matched()
        heard = Heard(b, "/chatter")
        matched(publisher)
        heard.subscription.close()
        until(lambda: not publisher.matched(), "nobody listens")


def test_a_big_message(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        heard = Heard(b, "/image")
        publisher = talk(a, "/image")
        matched(publisher)
        payload = bytes(range(256)) * 40_000
        # it may be dropped on a busy machine
        until(lambda: publisher.put(payload) or heard.samples, "heard", every=0.2)
        assert heard.samples[0].data() == payload


def test_messages_have_a_size_limit(network: HubNetwork):
    with Hub.open(network.settings("a", max_payload=1000)) as a, Hub.open(network.settings("b")) as b:
        to_a, to_b = Heard(a, "/to_a"), Heard(b, "/to_b")
        from_a, from_b = talk(a, "/to_b"), talk(b, "/to_a")
        matched(from_a)
        matched(from_b)
        with pytest.raises(HubError, match="1001 bytes on /to_b"):
            from_a.put(bytes(1001))
        from_a.put(b"fits")
        to_b.wait("fits")
        from_b.put(bytes(2000))
        from_b.put(b"fits")
        to_a.wait("fits")
        assert to_a.subscription.refused == 1


def test_samples_of_others_without_a_fitting_attachment_are_refused(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        heard = Heard(b, "/chatter")
        good = talk(a, "/chatter")
        matched(good)
        raw = a._session.declare_publisher(topic_key(a.domain, "/chatter", TYPE, HASH))
        for attached in (None, b"", b"short", bytes(33), bytes(200)):
            raw.put(b"bad", attachment=attached)
        raw.delete()
        raw.put(b"foreign", attachment=attachment.pack(0, 5, bytes(16)))
        good.put(b"good")
        heard.wait("foreign", "good")
        assert heard.subscription.refused == 5
        assert {sample.data(): sample.zid for sample in heard.samples} == {b"foreign": "", b"good": a.zid}


def test_lost_samples_are_seen_from_gaps(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        heard = Heard(b, "/chatter")
        raw = a._session.declare_publisher(topic_key(a.domain, "/chatter", TYPE, HASH))
        until(lambda: raw.matching_status.matching, "matched")
        one, two = b"1" * 16, b"2" * 16
        for gid, sequence in ((one, 1), (one, 2), (two, 7), (one, 5), (two, 8), (one, 6), (two, 10)):
            raw.put(b"x", attachment=attachment.pack(sequence, 1000 + sequence, gid))
        until(lambda: len(heard.samples) == 7, "all heard")
        assert heard.subscription.lost == 2 + 1


def test_a_sample_that_comes_twice_is_delivered_once(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        heard = Heard(b, "/chatter")
        raw = a._session.declare_publisher(topic_key(a.domain, "/chatter", TYPE, HASH))
        until(lambda: raw.matching_status.matching, "matched")
        for sequence in (1, 2, 2, 1, 3):
            raw.put(b"%d" % sequence, attachment=attachment.pack(sequence, 1000 + sequence, b"1" * 16))
        heard.wait("1", "2", "3")


def test_a_publisher_used_by_many_threads_numbers_without_gaps(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        heard = Heard(b, "/chatter")
        publisher = talk(a, "/chatter", replace(STREAM, history=History.KEEP_ALL))
        matched(publisher)
        threads = [threading.Thread(target=lambda: [publisher.put(b"x") for _ in range(200)]) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        until(lambda: len(heard.samples) == 800, "all heard")
        assert [s.sequence for s in heard.samples] == list(range(1, 801))


@pytest.mark.parametrize(
    ("priority", "expected"),
    [
        ("command", zenoh.Priority.INTERACTIVE_HIGH),
        ("state", zenoh.Priority.DATA_HIGH),
        ("stream", zenoh.Priority.DATA),
    ],
)
def test_priority_on_the_wire(network: HubNetwork, priority: str, expected: zenoh.Priority):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        heard: list[zenoh.Sample] = []
        key = topic_key(a.domain, "/chatter", TYPE, HASH)
        raw = b._session.declare_subscriber(key, heard.append)
        publisher = talk(a, "/chatter", priority=priority)
        matched(publisher)
        publisher.put(b"x")
        until(lambda: heard, "heard")
        raw.undeclare()
        assert (heard[0].priority, heard[0].express) == (expected, priority == "command")
        assert heard[0].congestion_control == zenoh.CongestionControl.DROP


def test_bad_names_are_refused(network: HubNetwork):
    with Hub.open(network.settings("a")) as a:
        with pytest.raises(WireError):
            a.publisher("/bad topic", TYPE, HASH, STREAM)
        with pytest.raises(WireError):
            a.publisher("/chatter", TYPE, "*", STREAM)
        with pytest.raises(WireError):
            a.subscription("/chatter", "String", HASH, STREAM, lambda _sample: None)
        assert a.graph.endpoints() == []


def test_nothing_is_left_after_close(network: HubNetwork):
    before = set(threading.enumerate())
    hub = Hub.open(network.settings("a"))
    publisher, heard = talk(hub, "/chatter"), Heard(hub, "/chatter")
    hub.serve("status", lambda _params: {})
    hub.close()
    hub.close()
    publisher.close()
    heard.subscription.close()
    until(lambda: set(threading.enumerate()) <= before, "its threads have ended")
    for use in (
        lambda: publisher.put(b"x"),
        lambda: hub.publisher("/x", TYPE, HASH, STREAM),
        lambda: hub.set_origin(None),
        lambda: hub.ask("status", {}),
        lambda: hub.serve("status", lambda _params: {}),
    ):
        with pytest.raises(HubClosedError):
            use()


def test_closed_endpoints_are_quiet(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        first, second = Heard(b, "/chatter"), Heard(b, "/chatter")
        publisher = talk(a, "/chatter")
        matched(publisher)
        first.subscription.close()
        first.subscription.close()
        publisher.put(b"x")
        second.wait("x")
        assert first.samples == []
        publisher.close()
        with pytest.raises(HubClosedError):
            publisher.put(b"y")
        until(lambda: not b.graph.publishers("/chatter"), "gone from the graph")
