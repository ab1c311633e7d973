"""Topics between the hub and rmw_zenoh, which uses zenoh's advanced publishers and subscribers."""

from __future__ import annotations

import signal
import time
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import pytest
import zenoh

from bridge.hub.endpoints.keyspace import KeyItem
from bridge.hub.endpoints.sinks import LARGE
from bridge.hub.node import Hub
from bridge.hub.wire.keys import topic_key
from bridge.hub.wire.qos import History, Qos
from bridge.hub.zenoh_compat import SOURCE_NUMBERS, source_infos
from bridge.hub.zenoh_config import LEASE_MS
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
from tests.peers.zenoh.rmw import RmwPublisher, RmwSubscription, subscribe
from tests.support.wait import until

BLOCKING = replace(STREAM, history=History.KEEP_ALL)
EACH_QOS = pytest.mark.parametrize(
    "qos",
    [STREAM, BLOCKING, replace(LATCHED, depth=20), replace(BEST_EFFORT_LATCHED, depth=20)],
    ids=["volatile", "blocking", "latched", "best effort latched"],
)
EACH_LATCHED = pytest.mark.parametrize("qos", [LATCHED, BEST_EFFORT_LATCHED], ids=["reliable", "best effort"])


def key(network: HubNetwork, topic: str) -> str:
    """Return the key of a hub topic."""
    return topic_key(network.domain, topic, TYPE, HASH)


# Midspan publishes, a subscription of rmw_zenoh receives


@EACH_QOS
@pytest.mark.parametrize("priority", ["command", "state", "stream"])
def test_a_subscription_receives_every_message(network: HubNetwork, qos: Qos, priority: str) -> None:
    """Nodes once received only the first message of a volatile topic: all messages had the same source number."""
    with Hub.open(network.settings("a")) as a, network.rmw_session() as rmw:
        received = RmwSubscription(rmw, key(network, "/cmd_vel"), qos)
        publisher = advertise(a, "/cmd_vel", qos, priority=priority)
        matched(publisher)
        publisher.put(b"first")
        received.expect("first")  # until then a latched subscription queries stored messages, and skips older ones
        sent = ["0.2"] * 10 + ["0.0"] * 10
        for text in sent:
            publisher.put(text.encode())
        received.expect("first", *sent)


def test_messages_without_a_subscription_leave_no_gap(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a, network.rmw_session() as rmw:
        publisher = advertise(a, "/chatter")
        assert [publisher.pass_over() for _ in range(3)] == [True] * 3
        received = RmwSubscription(rmw, key(network, "/chatter"), STREAM)
        matched(publisher)
        publisher.put(b"1")
        publisher.put(b"2")
        received.expect("1", "2")
        assert received.missed == 0


def test_messages_around_one_that_exceeds_the_shared_memory_arrive(network: HubNetwork) -> None:
    """From the large message on, the hub publisher uses a second zenoh publisher with another priority."""
    with Hub.open(network.settings("a")) as a, network.rmw_session() as rmw:
        received = RmwSubscription(rmw, key(network, "/map"), STREAM)
        publisher = advertise(a, "/map")
        matched(publisher)
        sent = [b"%d" % number for number in range(10)]
        for payload in (*sent[:5], large := bytes(LARGE + 1), *sent[5:]):
            publisher.put(payload)
        until(lambda: len(received.payloads) == len(sent) + 1, "all messages arrive")
        assert received.payloads == [*sent[:5], large, *sent[5:]]
        assert received.missed == 0


@pytest.mark.parametrize("qos", [STREAM, LATCHED], ids=["volatile", "latched"])
def test_source_numbers_wrap_after_the_highest(network: HubNetwork, qos: Qos) -> None:
    with network.program() as program, network.rmw_session() as rmw:
        received = RmwSubscription(rmw, key(network, "/chatter"), qos)
        publisher = program.declare_publisher(key(network, "/chatter"))
        until(lambda: publisher.matching_status.matching, "the publisher is matched")  # type: ignore[attr-defined]
        infos = source_infos(publisher, first=SOURCE_NUMBERS - 2)
        for number in range(5):
            publisher.put(b"%d" % number, attachment=bytes(33), source_info=next(infos))
        received.expect("0", "1", "2", "3", "4")
        assert received.missed == 0


def test_two_publishers_of_one_session_are_two_sources(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a, network.rmw_session() as rmw:
        received = RmwSubscription(rmw, key(network, "/tf"), STREAM)
        first, second = advertise(a, "/tf"), advertise(a, "/tf")
        matched(first)
        matched(second)
        for number in range(5):
            first.put(b"first %d" % number)
            second.put(b"second %d" % number)
        received.expect(*(f"{name} {number}" for number in range(5) for name in ("first", "second")))


def test_all_messages_of_a_standby_that_takes_over_arrive(network: HubNetwork) -> None:
    with network.rmw_session() as rmw:
        received = RmwSubscription(rmw, key(network, "/odom"), STREAM)
        for name in ("active", "standby"):
            with Hub.open(network.settings(name)) as hub:
                publisher = advertise(hub, "/odom")
                matched(publisher)
                for number in range(3):
                    publisher.put(f"{name} {number}".encode())
                until(
                    lambda name=name: f"{name} 2" in received.texts(), f"{received.texts()} contains the last message"
                )
        assert received.texts() == [f"{name} {number}" for name in ("active", "standby") for number in range(3)]


@EACH_LATCHED
@pytest.mark.parametrize(("published", "requested", "expected"), [(5, 5, 5), (5, 2, 2), (2, 5, 2), (1, 1, 1)])
def test_a_late_subscription_receives_the_cached_messages(
    network: HubNetwork, qos: Qos, published: int, requested: int, expected: int
) -> None:
    with Hub.open(network.settings("a")) as a, network.rmw_session() as rmw:
        early = RmwSubscription(rmw, key(network, "/map"), replace(qos, depth=10))
        sent = [str(number) for number in range(10)]
        publisher = advertise(a, "/map", replace(qos, depth=published), *sent)
        until(lambda: early.texts()[-1:] == sent[-1:], "all messages have arrived, so none can arrive live below")
        early.close()

        def subscribed() -> RmwSubscription | None:
            """Return a subscription that received exactly the cached messages.

            zenoh's subscriber queries twice, and drops the older part of a history if the two answers interleave.
            """
            subscription = RmwSubscription(rmw, key(network, "/map"), replace(qos, depth=requested))
            until(lambda: subscription.texts()[-1:] == sent[-1:], "the last message arrives, after all others")
            if subscription.texts() == sent[-expected:]:
                return subscription
            subscription.close()
            return None

        received = until(subscribed, "a subscription receives exactly the cached messages")
        matched(publisher)
        publisher.put(b"live")
        received.expect(*sent[-expected:], "live")


def test_values_of_a_store_arrive_in_any_order_of_their_times(network: HubNetwork) -> None:
    """Without source numbers, zenoh's advanced subscriber drops values older than the last one of the same writer."""
    received: list[tuple[str, str]] = []

    def add(sample: zenoh.Sample) -> None:
        received.append((str(sample.key_expr).rpartition("/")[2], str(sample.kind).rpartition(".")[2]))

    with Hub.open(network.settings("a")) as a, network.rmw_session() as rmw:
        end = subscribe(rmw, "midspan/store/0/**", add, STREAM)
        space, now = a.keyspace("midspan/store/0"), time.time_ns()
        probe = KeyItem("location/probe", b"", ns=now, writer="aa" * 8)
        until(lambda: space.send(probe) or received, "the subscriber is there", every=0.1)
        for name, body, age in (("new", b"", 1), ("older", b"", 2), ("deleted", None, 2), ("last", b"", 0)):
            space.send(KeyItem(f"location/{name}", body, ns=now - age * 1000, writer="aa" * 8))
        expected = [("new", "PUT"), ("older", "PUT"), ("deleted", "DELETE"), ("last", "PUT")]
        until(lambda: received[-1:] == expected[-1:], "the last value arrives")
        assert [change for change in received if change[0] != "probe"] == expected
        end.undeclare()


# a publisher of rmw_zenoh publishes, Midspan receives


@EACH_QOS
@pytest.mark.parametrize("first", [1, 1000, 1 << 40])
def test_every_message_of_a_publisher_is_received(network: HubNetwork, qos: Qos, first: int) -> None:
    with Hub.open(network.settings("a")) as a, network.rmw_session() as rmw:
        received = Subscriber(a, "/scan", qos)
        publisher = RmwPublisher(rmw, key(network, "/scan"), qos, first=first)
        publisher.until_matched()
        sent = [str(number) for number in range(20)]
        for text in sent:
            publisher.put(text.encode())
        received.expect(*sent)
        assert received.texts() == sent
        assert received.subscription.lost == 0


@EACH_LATCHED
@pytest.mark.parametrize("first", [1, 1000])
def test_cached_messages_are_received_late(network: HubNetwork, qos: Qos, first: int) -> None:
    with network.rmw_session() as rmw, Hub.open(network.settings("a")) as a:
        early = Subscriber(a, "/map", replace(qos, depth=10))
        publisher = RmwPublisher(rmw, key(network, "/map"), replace(qos, depth=5), first=first)
        for number in range(10):
            publisher.put(b"%d" % number)
        until(lambda: early.texts()[-1:] == ["9"], "all messages have arrived, so none can arrive live below")
        early.subscription.close()
        for depth, expected in ((1, ["9"]), (5, ["5", "6", "7", "8", "9"]), (20, ["5", "6", "7", "8", "9"])):
            late = Subscriber(a, "/map", replace(qos, depth=depth))
            late.expect(*expected)
            assert late.texts() == expected
            assert late.subscription.lost == 0


@EACH_QOS
def test_all_messages_of_a_restarted_node_are_received(network: HubNetwork, qos: Qos) -> None:
    with Hub.open(network.settings("a")) as a:
        received = Subscriber(a, "/scan", qos)
        expected = []
        for life in ("first", "second"):
            with network.rmw_session() as rmw:
                publisher = RmwPublisher(rmw, key(network, "/scan"), qos)
                publisher.until_matched()
                for number in range(3):
                    publisher.put(f"{life} {number}".encode())
                    expected.append(f"{life} {number}")
                received.expect(*expected)
        assert received.texts() == expected
        assert received.subscription.lost == 0


def test_messages_that_a_link_dropped_are_recovered_both_ways() -> None:
    """The router drops all live messages of /map; only those requested from the publishers arrive."""
    deny = {"id": "deny", "permission": "deny", "messages": ["put"], "flows": ["egress"], "key_exprs": ["*/map/**"]}
    policy = {"subjects": [{"id": "all"}], "policies": [{"rules": ["deny"], "subjects": ["all"]}]}
    access: Any = {"enabled": True, "default_permission": "allow", "rules": [deny], **policy}
    deep = replace(LATCHED, depth=10)
    with (
        HubNetwork(zenoh={"mode": "client"}, router_zenoh={"access_control": access}) as network,
        Hub.open(network.settings("a")) as a,
        Hub.open(network.settings("b")) as b,
        network.rmw_session(mode="client") as rmw,
    ):
        see_each_other(a, b)
        at_hub, at_rmw = Subscriber(b, "/map", deep), RmwSubscription(rmw, key(network, "/map"), deep)
        ours, theirs = advertise(a, "/map", deep), RmwPublisher(rmw, key(network, "/map"), deep)
        matched(ours)
        for text in ("one", "two", "three"):
            ours.put(b"ours " + text.encode())
            theirs.put(b"theirs " + text.encode())
        at_hub.expect(*(f"{whose} {text}" for whose in ("ours", "theirs") for text in ("one", "two", "three")))
        until(lambda: [t for t in at_rmw.texts() if t.startswith("ours")][2:], "all messages of the hub are recovered")
        assert [t for t in at_rmw.texts() if t.startswith("ours")] == ["ours one", "ours two", "ours three"]
        assert at_hub.subscription.lost == 0


# leases


def test_a_frozen_node_leaves_after_the_lease_of_its_own_session(network: HubNetwork) -> None:
    """The default lease of an rmw_zenoh node is 60 s; Midspan uses 3 s for its sessions."""
    leases = {"short": 1.0, "long": 8.0}

    def present() -> set[str]:
        return {node.node for node in a.graph.nodes()} & leases.keys()

    with Hub.open(network.settings("a")) as a, ExitStack() as ends:
        nodes = []
        for name, lease in leases.items():
            nodes.append(network.rmw_process(name, lease))
            ends.callback(nodes[-1].stop, 0.0)
        until(lambda: present() == leases.keys() and len(a.graph.subscriptions()) == 2, "both nodes are seen")
        frozen = time.monotonic()
        for node in nodes:
            node.signal(signal.SIGSTOP)
        until(lambda: present() == {"long"}, "the node with the short lease leaves", every=0.05)
        until(lambda: not present(), "the node with the long lease leaves", every=0.05)
        assert time.monotonic() - frozen > LEASE_MS / 1000 + 1.0
        until(lambda: not a.graph.subscriptions(), "all subscriptions leave")
