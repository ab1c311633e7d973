"""The bridge follows changes of the graph, rejoins a network that died, and is replaced if it dies itself."""

from __future__ import annotations

import contextlib

from tests.contract.hubside import HubSide
from tests.contract.side import Bridge, PeerLike, Side
from tests.support.wait import until

STRING = "std_msgs/String"


def test_a_route_goes_with_its_publisher_and_comes_again(side: Side, bridge: Bridge, far: HubSide) -> None:
    peer = side.peer()
    out = peer.advertise("/coming", STRING)
    far.until_published("/coming")
    peer.drop(out)
    far.until_unpublished("/coming")
    again = peer.advertise("/coming", STRING)
    subscription = far.subscribe("/coming", STRING)
    far.until_route("/coming", "in")
    far.publish_until(peer, again, {"data": "again"}, lambda: far.wait(subscription, 1, 0.2))
    assert far.wait(subscription, 1)[0] == {"data": "again"}


def test_a_route_out_goes_with_its_publisher(side: Side, bridge: Bridge, far: HubSide) -> None:
    peer = side.peer()
    out = far.advertise("/going", STRING)
    until(lambda: peer.graph()["publishers"].get("/going"), "/going is published on the side", 15)
    far.drop(out)
    until(lambda: not peer.graph()["publishers"].get("/going"), "/going is no longer published on the side", 15)


def test_a_killed_program_takes_its_routes_along(side: Side, bridge: Bridge, far: HubSide) -> None:
    peer = side.mortal()
    peer.advertise("/mortal", STRING)
    far.until_published("/mortal")
    peer.stop(0)
    far.until_unpublished("/mortal", 30)


def test_the_network_dies_and_returns(side: Side, bridge: Bridge, far: HubSide) -> None:
    peer = side.peer()
    peer.advertise("/before", STRING)
    far.until_published("/before")
    kept = far.advertise("/kept", STRING, latched=True, depth=1)
    far.publish(kept, {"data": "kept"})
    peer.stop()
    side.restart_network()
    far.until_unpublished("/before", 30)
    peer = side.peer()
    out = peer.advertise("/after", STRING)
    subscription = far.subscribe("/after", STRING)
    far.until_published("/after", seconds=30)
    far.publish_until(peer, out, {"data": "after"}, lambda: far.wait(subscription, 1, 0.2))
    assert far.wait(subscription, 1)[0] == {"data": "after"}
    heard_kept = peer.subscribe("/kept", STRING, latched=True)
    assert peer.wait(heard_kept, 1, 20) == [{"data": "kept"}]


def test_a_clean_stop_leaves_nothing(side: Side, far: HubSide, config) -> None:
    peer = side.peer()
    peer.advertise("/mine", STRING)
    before = peer.graph()
    bridge = side.bridge(config())
    out = far.advertise("/theirs", STRING, latched=True)
    far.publish(out, {"data": "x"})
    far.until_published("/mine")
    until(lambda: peer.graph()["publishers"].get("/theirs"), "/theirs is published on the side", 15)
    bridge.stop()
    _until_graph_is(peer, before)
    far.until_unpublished("/mine")


def test_a_killed_bridge_leaves_no_endpoints_after_its_restart(side: Side, far: HubSide, config) -> None:
    peer = side.peer()
    out = peer.advertise("/survivor", STRING)
    far_out = far.advertise("/from_hub", STRING)
    bridge = side.bridge(config())
    far.until_published("/survivor")
    until(lambda: peer.graph()["publishers"].get("/from_hub"), "/from_hub is published on the side", 15)
    bridge.kill()
    side.bridge(config())
    subscription = far.subscribe("/survivor", STRING)
    far.until_route("/survivor", "in")
    far.publish_until(peer, out, {"data": "still"}, lambda: far.wait(subscription, 1, 0.2))
    assert {m["data"] for m in far.wait(subscription, 1)} == {"still"}
    far.drop(far_out)
    until(lambda: not peer.graph()["publishers"].get("/from_hub"), "the endpoints of the killed bridge are gone", 30)


def _until_graph_is(peer: PeerLike, before: dict) -> None:
    """Wait for these endpoints; types are ignored, because a ROS master keeps those of topics that no longer exist."""
    kinds = ("publishers", "subscriptions")
    now: dict = {}

    def restored() -> bool:
        now.update(peer.graph())
        return all(now[kind] == before[kind] for kind in kinds)

    with contextlib.suppress(AssertionError):  # the comparison below shows the difference
        until(restored, "the graph is restored")
    assert [now[kind] for kind in kinds] == [before[kind] for kind in kinds]
