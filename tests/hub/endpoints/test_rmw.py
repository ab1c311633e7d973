"""What subscriptions and publishers of rmw_zenoh, which are zenoh's advanced ones, exchange with the hub."""

from __future__ import annotations

from dataclasses import replace

import pytest
import zenoh

from bridge.hub.endpoints.publisher import LARGE
from bridge.hub.session import Hub
from bridge.hub.wire.keys import topic_key
from bridge.hub.wire.qos import History, Qos
from tests.hub.parts import HASH, LATCHED, STREAM, TYPE, matched, talk
from tests.support.hub import HubNetwork
from tests.support.wait import until
from tests.support.zenoh_rmw import RmwSubscription

BLOCKING = replace(STREAM, history=History.KEEP_ALL)


def subscription(session: zenoh.Session, hub: Hub, topic: str, qos: Qos = STREAM) -> RmwSubscription:
    """An rmw_zenoh subscription to a topic of the hub."""
    return RmwSubscription(session, topic_key(hub.domain, topic, TYPE, HASH), qos)


def test_messages_that_nobody_received_leave_no_gap(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a, network.rmw_session() as rmw:
        publisher = talk(a, "/chatter")
        assert [publisher.pass_over() for _ in range(3)] == [True] * 3
        received = subscription(rmw, a, "/chatter")
        matched(publisher)
        publisher.put(b"1")
        publisher.put(b"2")
        received.expect("1", "2")
        assert received.missed == 0


def test_all_messages_arrive_around_one_that_is_too_large_for_the_shared_memory(network: HubNetwork) -> None:
    """From the large message on the publisher puts with a second zenoh publisher, of another priority."""
    with Hub.open(network.settings("a")) as a, network.rmw_session() as rmw:
        received = subscription(rmw, a, "/map")
        publisher = talk(a, "/map")
        matched(publisher)
        sent = [b"%d" % number for number in range(10)]
        for payload in (*sent[:5], large := bytes(LARGE + 1), *sent[5:]):
            publisher.put(payload)
        until(lambda: len(received.payloads) == len(sent) + 1, "all arrive")
        assert received.payloads == [*sent[:5], large, *sent[5:]]
        assert received.missed == 0


@pytest.mark.parametrize("qos", [STREAM, LATCHED], ids=["volatile", "latched"])
def test_a_subscription_follows_source_numbers_across_the_32nd_bit(network: HubNetwork, qos: Qos) -> None:
    with Hub.open(network.settings("a")) as a, network.rmw_session() as rmw:
        received = subscription(rmw, a, "/chatter", qos)
        publisher = talk(a, "/chatter")
        publisher._sink._number = (1 << 32) - 2  # type: ignore[union-attr]
        matched(publisher)
        for number in range(5):
            publisher.put(b"%d" % number)
        received.expect("0", "1", "2", "3", "4")
        assert received.missed == 0


@pytest.mark.parametrize("qos", [STREAM, BLOCKING, LATCHED], ids=["volatile", "blocking", "latched"])
@pytest.mark.parametrize("priority", ["command", "state", "stream"])
def test_a_subscription_receives_every_message(network: HubNetwork, qos: Qos, priority: str) -> None:
    """Only the first one arrived: all had the same source number."""
    with Hub.open(network.settings("a")) as a, network.rmw_session() as rmw:
        received = subscription(rmw, a, "/cmd_vel", qos)
        publisher = talk(a, "/cmd_vel", qos, priority=priority)
        matched(publisher)
        sent = ["0.2"] * 10 + ["0.0"] * 10
        for text in sent:
            publisher.put(text.encode())
        received.expect(*sent)
