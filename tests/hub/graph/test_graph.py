"""The graph: the hub's participants and their origins."""

from __future__ import annotations

import itertools
import logging
import signal

import pytest

from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import BRIDGE_ENCLAVE, EndpointKind, NodeToken, Origin, node_key
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Reliability
from tests.peers.hub.endpoints import HASH, LATCHED, STREAM, TYPE, Subscriber, advertise
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until


def _settled(hub: Hub) -> list[HubEndpoint]:
    return [endpoint for endpoint in hub.graph.publishers() if endpoint.origin is not None]


ROBOT = Origin("ros1", "http://robot:11311/ run 7", "robot/1")


def test_nodes_and_endpoints_appear_and_disappear(network: HubNetwork):
    with Hub.open(network.settings("early")) as early:
        with Hub.open(network.settings("a", namespace="/robot/arm")) as a:
            publisher = advertise(a, "/map", LATCHED)
            subscriber = Subscriber(a, "/chatter")
            with Hub.open(network.settings("late")) as late:
                for hub in (early, late, a):
                    until(lambda hub=hub: len(hub.graph.endpoints()) == 2, "both endpoints are seen")
                    named_a = lambda hub=hub: [n for n in hub.graph.nodes() if n.node == "a"]  # noqa: E731
                    (node,) = until(named_a, "the node is seen")
                    assert (node.zid, node.namespace, node.own) == (a.zid, "/robot/arm", hub is a)
                    (seen,) = hub.graph.publishers("/map")
                    assert (seen.zid, seen.node, seen.namespace, seen.kind) == (
                        a.zid,
                        "a",
                        "/robot/arm",
                        EndpointKind.PUBLISHER,
                    )
                    assert (seen.topic, seen.type_name, seen.type_hash, seen.qos) == ("/map", TYPE, HASH, LATCHED)
                    assert (seen.gid, seen.origin, seen.pending, seen.own) == (publisher.gid, None, False, hub is a)
                    assert hub.graph.zid_of(publisher.gid) == a.zid
                    (subscription,) = hub.graph.subscriptions()
                    assert subscription.topic == "/chatter"
                    assert hub.graph.publishers("/chatter") == hub.graph.subscriptions("/none") == []
                publisher.close()
                until(lambda: not late.graph.publishers(), "the publisher is gone")
                subscriber.subscription.close()
                until(lambda: not late.graph.endpoints(), "the subscription is gone")
        until(lambda: [n.node for n in early.graph.nodes()] == ["early"], "the node is gone")


def test_a_watch_is_notified_until_it_is_closed(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        # the tokens of a session arrive in any order
        until(lambda: len(a.graph.nodes()) == len(a.graph.midspan()) == 2, "all tokens of both nodes are seen")
        calls: list[list[str]] = []  # the watch may also be notified of the last of these tokens, after it is seen
        stop = a.graph.watch(lambda: calls.append([publisher.topic for publisher in a.graph.publishers()]))
        publisher = advertise(b, "/chatter")
        until(lambda: calls[-1:] == [["/chatter"]], "the watch is notified of the publisher")
        publisher.close()
        until(lambda: calls[-1] == [], "the watch is notified of the publisher's end")
        stop()
        stop()
        count = len(calls)
        advertise(b, "/map")
        until(lambda: a.graph.publishers("/map"), "the second publisher is seen")
        assert len(calls) == count


def test_a_sessions_origin_applies_to_its_endpoints(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        until(lambda: len(b.graph.nodes()) == 2, "both nodes are seen")
        a.set_origin(ROBOT)
        advertise(a, "/map", LATCHED)
        # the tokens of a session arrive in any order
        until(lambda: [p.origin for p in b.graph.publishers("/map")] == [ROBOT], "the publisher's origin is known")
        assert b.graph.origins() == {a.zid: ROBOT}
        assert b.graph.origin_of(a.zid) == ROBOT
        assert {n.node: n.origin for n in b.graph.nodes()} == {"a": ROBOT, "b": None}
        other = Origin("ros1", "another run", "robot1")
        a.set_origin(other)
        a.set_origin(other)
        until(lambda: b.graph.publishers("/map")[0].origin == other, "the new origin is known")
        assert b.graph.origins() == {a.zid: other}


def test_an_endpoint_of_a_bridge_is_pending_while_its_origin_is_unknown(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        a.set_origin(ROBOT)
        advertise(a, "/map", LATCHED)
        until(lambda: [p.origin for p in b.graph.publishers("/map")] == [ROBOT], "the publisher's origin is known")
        a.set_origin(None)
        until(lambda: b.graph.publishers("/map")[0].pending, "the origin is no longer known")
        assert b.graph.publishers("/map")[0].origin is None
        native = advertise(a, "/chatter")
        until(lambda: b.graph.publishers("/chatter"), "the publisher is seen")
        assert not b.graph.publishers("/chatter")[0].pending
        assert native.gid


def test_bridged_endpoint_is_never_native(network: HubNetwork):
    """Zenoh delivers the tokens of a session in any order.

    Until the origin's token arrives, the mark in an endpoint's token shows that a bridge created the endpoint.
    """
    with Hub.open(network.settings("watcher")) as watcher:
        mistaken: list[HubEndpoint] = []

        def check() -> None:
            mistaken.extend(e for e in watcher.graph.publishers() if e.origin is None and not e.pending)

        watcher.graph.watch(check)
        for number in range(10):
            with Hub.open(network.settings("bridge")) as bridge:
                bridge.set_origin(Origin("ros1", f"run {number}", "robot"))
                for topic in range(10):
                    advertise(bridge, f"/t{topic}", LATCHED if topic % 2 else STREAM)
                with Hub.open(network.settings("late")) as late:
                    for hub in (watcher, late):
                        until(lambda hub=hub: len(_settled(hub)) == 10, "all endpoints are seen with their origin")
            until(lambda: not watcher.graph.publishers(), "all publishers are gone")
        assert mistaken == []


def test_killed_node_disappears(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, network.hub_peer("victim") as victim:
        victim.ask("origin", side="ros1", network="n", daemon="d")
        victim.ask("put", id=victim.ask("publisher", topic="/map", latched=True)["id"], text="x")
        Subscriber(a, "/map", LATCHED).expect("x")
        victim.signal(signal.SIGKILL)
        until(lambda: len(a.graph.nodes()) == 1, "the node is gone")
        until(lambda: not a.graph.publishers("/map") and not a.graph.origins(), "the publisher and the origin are gone")


def test_suspended_node_disappears_and_returns(network: HubNetwork):
    """No socket closes when a process is suspended, so only the lease reveals it; the process notices it afterwards."""
    with Hub.open(network.settings("a")) as a, network.hub_peer("victim") as victim:
        publisher = victim.ask("publisher", topic="/map", latched=True)["id"]
        until(lambda: a.graph.publishers("/map"), "the publisher is seen")
        ended = victim.ask("ended_links")["links"]
        victim.signal(signal.SIGSTOP)
        until(lambda: not a.graph.publishers("/map"), "the publisher is gone after the lease")
        victim.signal(signal.SIGCONT)
        until(lambda: victim.ask("ended_links")["links"] > ended, "the process notices that links have ended")
        until(lambda: a.graph.publishers("/map"), "the publisher is seen again")
        victim.ask("put", id=publisher, text="back")
        Subscriber(a, "/map", LATCHED).expect("back")


def test_malformed_tokens_are_left_out(network: HubNetwork, caplog: pytest.LogCaptureFixture):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b, network.program() as program:
        space = f"@ros2_lv/{a.domain}"
        bad = [
            f"{space}/x",
            f"{space}/z/0/1/MP/%/%/n",
            f"{space}/z/0/1/XX/%/%/n",
            f"{space}/z/0/1/MP/%/%/n/%t/no_type/{HASH}/::,7:,:,:,,",
            f"{space}/z/0/1/MP/%/%/n/%t/a::msg::dds_::B_/{HASH}/nonsense",
            f"{space}/z/0/1/MP/%/%/n/%a b/a::msg::dds_::B_/{HASH}/::,7:,:,:,,",
            f"@midspan/{a.domain}/velocity/z/%2F%2A%2Fcmd_vel/a%2Fmsg%2FB",
            f"@midspan/{a.domain}/velocity/z/%2Fcmd_vel/nonsense",
            f"@midspan/{a.domain}/driver/z/%2F%2A%2Fcmd_vel/anna",
            f"@midspan/{a.domain}/origin/z",
            f"@midspan/{a.domain}/origin/z/a/b/c/d/e",
        ]
        with caplog.at_level(logging.WARNING):
            tokens = [program.liveliness().declare_token(key) for key in bad]
            good = advertise(b, "/chatter")
            until(lambda: a.graph.publishers("/chatter"), "the valid token is seen")
            until(lambda: a.graph.refused == len(bad), "the invalid tokens are counted")
        assert len([r for r in caplog.records if r.name.startswith("bridge.hub.graph")]) <= 2
        assert [e.gid for e in a.graph.endpoints()] == [good.gid]
        for token in tokens:
            token.undeclare()
        good.close()
        until(lambda: not a.graph.endpoints(), "all endpoints are gone")


def test_camera_of_a_later_release_is_seen(network: HubNetwork, caplog: pytest.LogCaptureFixture):
    """rmw_zenoh_cpp 0.10.5 announces it with another part after the QoS."""
    with Hub.open(network.settings("a")) as a, network.program() as program:
        camera = f"@ros2_lv/{a.domain}/z/0/1/MP/%/%/camera/%image/sensor_msgs::msg::dds_::Image_/{HASH}"
        token = program.liveliness().declare_token(f"{camera}/2::,7:,:,:,,/backends:cpu:")
        (seen,) = until(lambda: a.graph.publishers("/image"), "the camera is seen")
        assert (seen.type_name, seen.qos.reliability, seen.qos.depth) == (
            "sensor_msgs/msg/Image",
            Reliability.BEST_EFFORT,
            7,
        )
        assert a.graph.refused == 0
        assert not [r for r in caplog.records if r.name.startswith("bridge.hub.graph")]
        token.undeclare()
        until(lambda: not a.graph.endpoints(), "the camera is gone")


def test_tokens_are_bounded(network: HubNetwork):
    with Hub.open(network.settings("a", max_tokens=20)) as a, network.program() as program:
        liveliness = program.liveliness()
        ids = itertools.count()
        owner = [NodeToken(a.domain, f"z{next(ids)}", "0", "/", "n", BRIDGE_ENCLAVE) for _ in range(40)]
        tokens = [liveliness.declare_token(node_key(token)) for token in owner]
        until(lambda: a.graph.refused >= 20, "the tokens beyond the limit are refused")
        assert len(a.graph.nodes()) == 20
        for token in tokens:
            token.undeclare()
        until(lambda: len(a.graph.nodes()) <= 2, "the nodes are gone")


def test_other_domains_are_not_seen(network: HubNetwork):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b", domain=0)) as b:
        b.set_origin(ROBOT)
        advertise(b, "/chatter")
        until(lambda: b.graph.publishers(), "the publisher is seen in its own domain")
        with Hub.open(network.settings("c")) as c:
            until(lambda: len(a.graph.nodes()) == 2, "both nodes of the domain are seen")
            assert {n.zid for n in a.graph.nodes()} == {a.zid, c.zid}
        assert a.graph.endpoints() == []
        assert a.graph.origins() == {}
