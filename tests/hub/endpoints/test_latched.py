"""Late subscribers receive the last messages of each latched publisher."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest
import zenoh

from bridge.concurrency import DelayedCalls, SerialExecutor
from bridge.hub.endpoints import latched
from bridge.hub.endpoints.latched import HEARTBEAT
from bridge.hub.endpoints.latched_subscription import LatchedHubSubscription
from bridge.hub.node import Hub
from bridge.hub.wire.keys import pack_attachment, topic_key
from bridge.hub.wire.qos import History, Qos
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

EACH_LATCHED = pytest.mark.parametrize("qos", [LATCHED, BEST_EFFORT_LATCHED], ids=["reliable", "best effort"])


@EACH_LATCHED
def test_late_joiners_receive_from_all_publishers_of_one_session(network: HubNetwork, qos: Qos):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        see_each_other(a, b)
        publishers = [advertise(a, "/map", qos, "old", name) for name in ("one", "two", "three")]
        for joiner in (Subscriber(b, "/map", qos), Subscriber(b, "/map", qos, type_hash="*")):
            joiner.expect("one", "two", "three")
            assert {s.gid for s in joiner.samples} == {p.gid for p in publishers}
            assert {s.zid for s in joiner.samples} == {a.zid}
            assert joiner.subscription.lost == 0
        with Hub.open(network.settings("c")) as c:
            Subscriber(c, "/map", qos).expect("one", "two", "three")


@EACH_LATCHED
def test_late_joiners_receive_from_all_publishers_of_several_sessions(network: HubNetwork, qos: Qos):
    with (
        Hub.open(network.settings("a")) as a,
        Hub.open(network.settings("b")) as b,
        Hub.open(network.settings("c")) as c,
    ):
        see_each_other(a, b, c)
        first = Subscriber(c, "/map", qos)
        talks = [advertise(a, "/map", qos, "one"), advertise(a, "/map", qos, "two"), advertise(b, "/map", qos, "three")]
        first.expect("one", "two", "three")
        Subscriber(c, "/map", qos).expect("one", "two", "three")
        assert len({p.gid for p in talks}) == 3


@EACH_LATCHED
def test_latched_message_disappears_with_its_publisher(network: HubNetwork, qos: Qos):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        see_each_other(a, b)
        publishers = [advertise(a, "/map", qos, name) for name in ("one", "two", "three")]
        Subscriber(b, "/map", qos).expect("one", "two", "three")
        publishers[1].close()
        until(lambda: len(b.graph.publishers("/map")) == 2, "the publisher has left")
        Subscriber(b, "/map", qos).expect("one", "three")


def test_latched_messages_disappear_with_their_session(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        advertise(a, "/map", LATCHED, "stays")
        with Hub.open(network.settings("c")) as c:
            publisher = advertise(c, "/map", LATCHED, "goes")
            Subscriber(b, "/map", LATCHED).expect("stays", "goes")
            assert publisher.gid != bytes(16)
        until(lambda: len(b.graph.publishers("/map")) == 1, "the session has left")
        Subscriber(b, "/map", LATCHED).expect("stays")


def test_a_subscription_receives_from_publishers_that_start_later(network: HubNetwork):
    with Hub.open(network.settings("b")) as b:
        early = Subscriber(b, "/map", LATCHED)
        with Hub.open(network.settings("a")) as a:
            kept = [advertise(a, "/map", LATCHED, name) for name in ("one", "two")]
            early.expect("one", "two")
            kept[0].put(b"three")
            early.expect("one", "two", "three")
            Subscriber(b, "/map", LATCHED).expect("two", "three")


def test_history_and_live_messages_join_without_gaps_or_duplicates(network: HubNetwork):
    """A subscription that joins while a publisher publishes receives all cached and all later messages, in order."""
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        see_each_other(a, b)
        deep = replace(LATCHED, depth=200)
        publisher = advertise(a, "/map", deep, *(str(n) for n in range(100)))
        joiners = []
        for number in range(100, 200):
            publisher.put(str(number).encode())
            if number % 20 == 0:
                joiners.append(Subscriber(b, "/map", deep))
        for joiner in joiners:
            until(lambda joiner=joiner: joiner.samples and joiner.texts()[-1] == "199", "the last message arrives")
            assert joiner.texts() == [str(n) for n in range(200)]
            assert joiner.subscription.lost == 0


@pytest.mark.parametrize(("published", "asked", "expected"), [(3, 10, 3), (10, 2, 2), (10, 10, 5)])
def test_a_late_subscriber_receives_the_smaller_depth(network: HubNetwork, published: int, asked: int, expected: int):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        see_each_other(a, b)
        texts = [str(n) for n in range(5)]
        kept = advertise(a, "/map", replace(LATCHED, depth=published), *texts)
        subscriber = Subscriber(b, "/map", replace(LATCHED, depth=asked))
        subscriber.expect(*texts[-expected:])
        assert subscriber.texts() == texts[-expected:]
        assert kept.matched()


def test_keep_all_caches_many_messages(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        see_each_other(a, b)
        every = Qos(LATCHED.reliability, LATCHED.durability, History.KEEP_ALL, depth=1)
        texts = [str(n) for n in range(300)]
        publisher = advertise(a, "/map", every, *texts)
        subscriber = Subscriber(b, "/map", every)
        subscriber.expect(*texts)
        assert subscriber.texts() == texts
        assert publisher.matched()


def test_own_latched_messages_are_not_received(network: HubNetwork):
    """Zenoh's locality setting does not apply to caches, so the hub itself drops the session's own messages."""
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        see_each_other(a, b)
        own_publisher = advertise(a, "/map", LATCHED, "own")
        advertise(b, "/map", LATCHED, "other")
        subscriber = Subscriber(a, "/map", LATCHED)
        subscriber.expect("other")
        own_publisher.put(b"more")
        Subscriber(b, "/map", LATCHED).expect("more")
        advertise(b, "/map", LATCHED, "last")
        subscriber.expect("other", "last")


def test_volatile_subscription_receives_only_new_latched_messages(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        see_each_other(a, b)
        publisher = advertise(a, "/map", LATCHED, "past")
        subscriber = Subscriber(b, "/map", STREAM)
        matched(publisher)
        publisher.put(b"now")
        subscriber.expect("now")
        assert subscriber.samples[0].zid == a.zid


def test_latched_subscription_receives_from_volatile_publishers(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        see_each_other(a, b)
        publisher = advertise(a, "/map", STREAM, "past")
        subscriber = Subscriber(b, "/map", LATCHED)
        matched(publisher)
        publisher.put(b"one")
        publisher.put(b"two")
        subscriber.expect("one", "two")


def test_late_joiners_receive_a_large_latched_message(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        see_each_other(a, b)
        payload = "x" * 5_000_000
        publisher = advertise(a, "/map", LATCHED, payload)
        for _ in range(3):
            Subscriber(b, "/map", LATCHED).expect(payload)
        assert publisher.matched()


def test_messages_dropped_by_a_link_are_recovered():
    """The router blocks live samples of /map, so only replies to queries arrive."""
    deny = {"id": "deny", "permission": "deny", "messages": ["put"], "flows": ["egress"], "key_exprs": ["*/map/**"]}
    access = {
        "enabled": True,
        "default_permission": "allow",
        "rules": [deny],
        "subjects": [{"id": "all"}],
        "policies": [{"rules": ["deny"], "subjects": ["all"]}],
    }
    with (
        HubNetwork(zenoh={"mode": "client"}, router_zenoh={"access_control": access}) as network,
        Hub.open(network.settings("a")) as a,
        Hub.open(network.settings("b")) as b,
    ):
        see_each_other(a, b)
        deep, shallow = Subscriber(b, "/map", replace(LATCHED, depth=10)), Subscriber(b, "/map", LATCHED)
        volatile = Subscriber(b, "/map", STREAM)
        publisher = advertise(a, "/map", replace(LATCHED, depth=10))
        matched(publisher)
        for text in ("one", "two", "three"):
            publisher.put(text.encode())
        deep.expect("one", "two", "three")
        assert deep.texts() == ["one", "two", "three"]
        until(lambda: shallow.texts()[-1:] == ["three"], "the newest is recovered")
        publisher.put(b"four")
        deep.expect("one", "two", "three", "four")
        assert deep.subscription.lost == 0
        assert volatile.texts() == []


def test_a_gap_is_filled_from_the_cache(network: HubNetwork):
    """A live sample skips numbers. The missing samples are queried, and delivered in order before that sample."""
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        see_each_other(a, b)
        subscriber = Subscriber(b, "/map", replace(LATCHED, depth=10))
        publisher = advertise(a, "/map", replace(LATCHED, depth=10), "one")
        subscriber.expect("one")
        source = subscriber.subscription.sources[publisher.gid]
        subscriber.samples.clear()
        # as if the first sample had never arrived
        with subscriber.subscription._lock:
            source.sequence = 0
        publisher.put(b"two")
        subscriber.expect("one", "two")
        assert subscriber.texts() == ["one", "two"]
        assert subscriber.subscription.lost == 0


def test_a_gap_during_a_query_is_filled_after_it(network: HubNetwork):
    """The publisher may have replied to the query before it published the sample that was lost."""
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        see_each_other(a, b)
        subscriber = Subscriber(b, "/map", replace(LATCHED, depth=10))
        publisher = advertise(a, "/map", replace(LATCHED, depth=10), "one")
        subscriber.expect("one")
        subscription = subscriber.subscription
        assert isinstance(subscription, LatchedHubSubscription)
        source = subscription.sources[publisher.gid]
        subscription.on_query(source.zid)
        subscriber.samples.clear()
        # as if the first sample had never arrived, and were missing from the answer
        with subscription._lock:
            source.sequence = 0
        publisher.put(b"two")
        until(lambda: source.held, "the second sample is held")
        subscription.done(source.zid)
        subscriber.expect("one", "two")
        assert subscriber.texts() == ["one", "two"]
        assert subscription.lost == 0


def test_reply_on_another_key_is_ignored(network: HubNetwork) -> None:
    """Otherwise a client that may publish on one key could inject messages into latched topics on other keys."""
    key = topic_key(network.domain, "/goal", TYPE, HASH)
    other = topic_key(network.domain, "/harmless", TYPE, HASH)
    with Hub.open(network.settings("a")) as a, network.program() as forger:
        subscriber = Subscriber(a, "/goal", LATCHED)

        def answer(query: zenoh.Query) -> None:
            with query:
                query.reply(other, b"forged", attachment=pack_attachment(1, 1, bytes(16)))
                query.reply(key, b"kept", attachment=pack_attachment(1, 1, bytes(15) + b"x"))

        place = f"{key}/@adv/pub/{forger.zid()}/7/_"
        forger.declare_queryable(place, answer)
        token = forger.liveliness().declare_token(place)
        subscriber.expect("kept")
        token.undeclare()


def test_stalled_peer_does_not_delay_closing_a_latched_publisher(network: HubNetwork):
    """A heartbeat waits for the stalled peer. With zenoh's own heartbeats, every closing publisher would wait, too."""
    queue = {"congestion_control": {"block": {"wait_before_close": 60_000_000}}}
    patient = {"transport": {"link": {"tx": {"queue": queue}}}}
    blocking = Qos(history=History.KEEP_ALL)
    go_on, sent = threading.Event(), Counter[str]()

    def push() -> None:
        while not go_on.is_set():
            stream.put(bytes(1 << 20))
            sent["MB"] += 1

    with (
        Hub.open(replace(network.settings("a"), zenoh=patient, shared_memory=False)) as a,
        Hub.open(replace(network.settings("b"), shared_memory=False)) as b,
    ):
        see_each_other(a, b)
        b.subscription("/stream", TYPE, HASH, blocking, lambda _: go_on.wait(90.0) and None)
        stream, leaving = advertise(a, "/stream", blocking), advertise(a, "/map", LATCHED, "said", priority="state")
        pushing, closing = threading.Thread(target=push), threading.Thread(target=leaving.close)
        try:
            Subscriber(b, "/map", LATCHED).expect("said")
            matched(stream)
            pushing.start()
            until(lambda: sent["MB"] > 0, "b has something to read")
            leaving.put(b"more")
            looks = [-1]

            def stalled() -> bool:
                """Return whether nothing was sent during three heartbeats, counted in polls, as the test may stall."""
                looks[:] = [*looks, sent["MB"]] if looks[-1] == sent["MB"] else [sent["MB"]]
                return len(looks) * 0.02 > 3 * HEARTBEAT

            until(stalled, "the link is congested, and a heartbeat is pending")
            full = sent["MB"]
            closing.start()
            closing.join(30.0)  # less than the time for which a heartbeat waits on the congested link
            assert not closing.is_alive()
            assert sent["MB"] == full, "the link was not congested, so the test shows nothing"
        finally:
            go_on.set()
            pushing.join(10.0)


def test_publisher_without_a_reply_is_queried_again(network: HubNetwork, monkeypatch: pytest.MonkeyPatch):
    """While a link is being established, the publisher's token may be visible before its cache can be reached."""
    monkeypatch.setattr(latched, "AGAIN_SECONDS", (0.2, 5.0, 5.0))
    key, events = "late/cache", Events()
    executor, ends, delays = SerialExecutor("test-asking"), SerialExecutor("test-ends"), DelayedCalls("test-delays")
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        see_each_other(a, b)
        local_session, remote_session = a._session, b._session
        history = latched.LatchedHistory(local_session, key, 1, events, executor, ends, delays, recovers=False)
        history.open()
        try:
            publisher = f"{key}/@adv/pub/{remote_session.zid()}/7"
            token = remote_session.liveliness().declare_token(f"{publisher}/_")
            until(lambda: "done on test-ends" in events, "the first query ends")
            assert "came" not in events
            cache = remote_session.declare_queryable(f"{publisher}/**", lambda query: query.reply(key, b"kept"))
            until(lambda: "came" in events, "the cached sample arrives", 10)
            cache.undeclare()
            token.undeclare()
            until(lambda: not history._silent, "the publisher is forgotten")
            assert {event for event in events if event.startswith("done")} == {"done on test-ends"}
        finally:
            history.close()
            delays.close()
            executor.close()
            ends.close()


def test_a_query_that_a_closed_history_no_longer_needs_ends() -> None:
    """Otherwise the subscription would hold back the queried session's samples forever."""
    jobs: list[Callable[[], object]] = []
    executor, events = cast("Any", SimpleNamespace(submit=jobs.append)), Events()
    unused = cast("Any", None)
    history = latched.LatchedHistory(unused, "key", 1, events, executor, unused, unused, recovers=True)
    history.ask_session("1")
    history.close()
    jobs.pop()()
    assert [event.partition(" ")[0] for event in events] == ["asked", "done"]


class Events(list[str]):
    """Records what a history reports."""

    def on_query(self, _zid: str) -> None:
        self.append("asked")

    def on_stored(self, _sample: zenoh.Sample) -> None:
        self.append("came")

    def done(self, _zid: str) -> None:
        self.append(f"done on {threading.current_thread().name}")
