"""Latched ros2dds publishers are announced again: their messages stay, or come back."""

from __future__ import annotations

import json
from functools import partial

import pytest
import zenoh

from bridge.routing.side_to_hub import SideToHubRoute
from tests.adapters.zenoh.conftest import ROS2, Place
from tests.peers.zenoh import programs
from tests.peers.zenoh.programs import Ros2ddsBridge, open_session
from tests.support.ports import free_port
from tests.support.wait import until
from tests.support.zenoh_router import open_router

STRING = "std_msgs/String"
TOPIC = "/state"


def late(place: Place, expected: list[str]) -> list[str]:
    """Wait until a late subscription receives exactly these messages, and return them."""
    received: list[list[str]] = []

    def once() -> bool:
        subscription = place.far.subscribe(TOPIC, STRING, latched=True)
        place.far.wait(subscription, len(expected), 5)
        received.append(sorted(m["data"] for m in place.far.wait(subscription, len(expected) + 1, 0.3)))
        place.far.drop(subscription)
        return received[-1] == expected

    try:
        until(once, "all retained messages arrive", 20)
    except AssertionError as err:
        raise AssertionError(f"{err}: received {received}") from None
    return received[-1]


def test_message_that_overtakes_the_change_from_volatile_to_latched_is_retained(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program advertises a topic again and publishes at once, while the engine still uses the previous graph."""
    delivered: list[bytes] = []
    deliver = SideToHubRoute.deliver

    def recorded(route: SideToHubRoute, payload: bytes, source: str, time_ns: int | None) -> None:
        deliver(route, payload, source, time_ns)
        delivered.append(payload)

    monkeypatch.setattr(SideToHubRoute, "deliver", recorded)
    peer, (edge,) = place.ros2dds(), place.bridge({"dialect": "ros2dds"}).edges.values()
    out = peer.advertise(TOPIC, STRING, latched=False, depth=1)
    place.far.until_published(TOPIC)
    graph = edge.endpoints()
    with monkeypatch.context() as frozen:
        frozen.setattr(edge, "endpoints", lambda: graph)
        peer.drop(out)
        out = peer.advertise(TOPIC, STRING, latched=True, depth=1)
        peer.publish(out, {"data": "again"})
        until(lambda: delivered, "the message arrives", 20)
    edge._graph_changed()  # type: ignore[attr-defined]
    assert late(place, ["again"]) == ["again"]


class Hop:
    """A router between the side's router and programs in client mode, which lose their link while it is stopped."""

    def __init__(self, upstream: str) -> None:
        self.endpoint, self._upstream = f"tcp/127.0.0.1:{free_port()}", upstream
        self.start()

    def start(self) -> None:
        tree = {
            "mode": "router",
            "scouting": {"delay": 0, "multicast": {"enabled": False}},
            "listen": {"endpoints": [self.endpoint]},
            "connect": {"endpoints": [self._upstream]},
        }
        self.session = open_router(zenoh.Config.from_json5(json.dumps(tree)))

    def stop(self) -> None:
        self.session.close()


def test_messages_of_a_bridge_whose_link_was_lost_are_retained_again(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    hop = place.keep(Hop(place.router.endpoint))
    near = place.ros2dds()
    retry = {"period_init_ms": 100, "period_max_ms": 100}
    with monkeypatch.context() as patch:
        connect = {"endpoints": [hop.endpoint], "retry": retry}
        patch.setattr(programs, "open_session", partial(open_session, mode="client", connect=connect))
        distant = place.keep(Ros2ddsBridge(hop.endpoint, ROS2))
    place.bridge({"dialect": "ros2dds"})
    for peer, text in ((near, "near"), (distant, "distant")):
        peer.publish(peer.advertise(TOPIC, STRING, latched=True, depth=1), {"data": text})
    assert late(place, ["distant", "near"]) == ["distant", "near"]
    hop.stop()
    assert late(place, ["near"]) == ["near"]
    hop.start()
    assert late(place, ["distant", "near"]) == ["distant", "near"]
