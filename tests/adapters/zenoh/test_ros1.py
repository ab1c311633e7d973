"""The ros1 dialect uses exactly the keys and bytes of zenoh-plugin-ros1."""

from __future__ import annotations

import threading
import time
from functools import partial
from typing import Any

import pytest
import zenoh

from bridge.adapters.zenoh.neighbors import new_zid
from bridge.adapters.zenoh.ros1 import SETTLE, Ros1KeysEdge
from bridge.adapters.zenoh.ros1_discovery import Aloha, AnnouncedTopic, data_key, discovery_key, parse
from bridge.hub.errors import HubWireError
from bridge.routing.edge import Kind
from tests.adapters.zenoh.conftest import Place, cross, until_linked
from tests.contract.zenohside import PERIOD
from tests.peers.zenoh.programs import Beacon, open_session
from tests.support.wait import until

STRING = "std_msgs/String"
KEY = "7374645f6d7367732f537472696e67/992ce8a1687cec8c8bd883ec73ca41d1/*/chatter"
HI = bytes.fromhex("02000000 6869")
SIDE = "zenoh_ros1"


def test_keys_are_written_as_the_plugin_writes_them() -> None:
    topic = AnnouncedTopic("/chatter", STRING, "992ce8a1687cec8c8bd883ec73ca41d1")
    assert data_key(topic, "*") == KEY
    assert discovery_key(Kind.PUBLISHER, topic, "*") == f"ros1_discovery_info/*/pub/{KEY}"
    assert discovery_key(Kind.SUBSCRIPTION, topic, "bot") == f"ros1_discovery_info/*/sub/{KEY.replace('*', 'bot')}"
    assert parse(f"ros1_discovery_info/*/pub/{KEY}") == (Kind.PUBLISHER, topic)
    assert parse(f"ros1_discovery_info/*/srv/{KEY}") == (Kind.SERVER, topic)
    assert parse(f"ros1_discovery_info/*/cl/{KEY}") == (Kind.CLIENT, topic)
    assert parse(f"ros1_discovery_info/*/sub/{KEY}/deep/er") == (
        Kind.SUBSCRIPTION, AnnouncedTopic("/chatter/deep/er", STRING, topic.md5)
    )  # fmt: skip


@pytest.mark.parametrize(
    "key",
    [
        "ros1_discovery_info/*/pub/7374/992ce8a1687cec8c8bd883ec73ca41d1/*/t",
        "ros1_discovery_info/*/pub/no hex/992ce8a1687cec8c8bd883ec73ca41d1/*/t",
        "ros1_discovery_info/*/pub/7374645f6d7367732f537472696e67/992ce8/*/t",
        "ros1_discovery_info/*/xyz/7374645f6d7367732f537472696e67/992ce8a1687cec8c8bd883ec73ca41d1/*/t",
        "ros1_discovery_info/*/pub/7374645f6d7367732f537472696e67/992ce8a1687cec8c8bd883ec73ca41d1/*",
        "ros1_discovery_info/*/pub/7374645f6d7367732f537472696e67/992ce8a1687cec8c8bd883ec73ca41d1/*/**",
        "other/*/pub/7374645f6d7367732f537472696e67/992ce8a1687cec8c8bd883ec73ca41d1/*/t",
        f"ros1_discovery_info/*/pub/{'41' * 3000}/992ce8a1687cec8c8bd883ec73ca41d1/*/t",
    ],
)
def test_invalid_keys_are_rejected(key: str) -> None:
    with pytest.raises(HubWireError):
        parse(key)


def test_a_bridge_receives_beacons_and_exact_samples(place: Place) -> None:
    bridge = place.ros1()
    place.bridge({"dialect": "ros1"})
    out = place.far.advertise("/chatter", STRING)
    until(lambda: f"ros1_discovery_info/*/pub/{KEY}" in bridge.beacons(), "Midspan's beacon arrives")
    samples: list[zenoh.Sample] = []
    bridge.session.declare_subscriber(KEY, zenoh.handlers.Callback(samples.append, indirect=False))

    def publish_and_check() -> bool:
        place.far.publish(out, {"data": "hi"})
        return bool(samples)

    until(publish_and_check, "the sample arrives")
    assert (str(samples[0].key_expr), samples[0].payload.to_bytes(), samples[0].attachment) == (KEY, HI, None)
    place.far.drop(out)
    until(lambda: f"ros1_discovery_info/*/pub/{KEY}" not in bridge.beacons(), "the beacon ends with the topic")


def test_a_bridges_topic_crosses_and_disappears_when_its_beacon_stops(place: Place) -> None:
    bridge = place.ros1()
    place.bridge({"dialect": "ros1"})
    out = bridge.advertise("/chatter", STRING)
    subscription = place.far.subscribe("/chatter", STRING)
    assert cross(bridge, out, place.far, subscription, {"data": "hi"}) == {"data": "hi"}
    until(lambda: f"ros1_discovery_info/*/sub/{KEY}" in bridge.beacons(), "Midspan's subscription beacon arrives")
    bridge.drop(out)
    place.far.until_unpublished("/chatter")


@pytest.mark.thorough
def test_midspans_beacons_never_silence_a_native_bridge(place: Place) -> None:
    """Both publish one topic and send beacons on one key; the native publisher stays discovered all the time."""
    place.bridge({"dialect": "ros1"})
    place.far.advertise("/chatter", STRING)
    place.until_route(SIDE, "/chatter", "out")
    bridge = place.ros1()
    bridge.advertise("/chatter", STRING)
    place.far.until_published("/chatter")
    gid = place.far.publishers("/chatter")[0].gid
    end = time.monotonic() + 10 * PERIOD
    while time.monotonic() < end:
        assert [p.gid for p in place.far.publishers("/chatter")] == [gid]
        time.sleep(PERIOD / 4)


def test_a_native_bridge_that_paused_its_beacons_resumes(place: Place) -> None:
    """The bridge pauses if it receives Midspan's beacon before it has sent one."""
    place.bridge({"dialect": "ros1"})
    place.far.advertise("/chatter", STRING)
    bridge = place.ros1()
    until(lambda: f"ros1_discovery_info/*/pub/{KEY}" in bridge.beacons(), "Midspan's beacon arrives")
    beacon = Beacon(bridge.session, bridge.discovery("pub", "/chatter", STRING), PERIOD, sending=False)
    try:
        place.far.until_published("/chatter", seconds=30)
    finally:
        beacon.undeclare()


def test_all_midspans_pause_their_beacons_together(place: Place) -> None:
    """Two daemons on separate hubs are active on one network; if their beacons were not aligned, none would pause."""
    sessions = [open_session(place.router.endpoint, id=new_zid()) for _ in range(2)]
    first, second = (Aloha(s, "*", lambda: None, lambda _topic, _first: None) for s in sessions)
    endpoint = (Kind.PUBLISHER, AnnouncedTopic("/chatter", STRING, "992ce8a1687cec8c8bd883ec73ca41d1"))
    first.announce(*endpoint)
    due = first._own[endpoint].due

    def paused() -> bool:
        second.announce(*endpoint)()
        return first._own[endpoint].due > due

    try:
        until(paused, "the first daemon pauses when the second sends a beacon")
    finally:
        first.close()
        second.close()
        for session in sessions:
            session.close()


def test_a_stall_of_the_worker_expires_no_bridge(place: Place) -> None:
    """A worker that hangs for longer than the beacon timeout keeps the bridges that it has discovered."""
    bridge = place.ros1()
    bridge.advertise("/chatter", STRING)
    crossing = place.bridge({"dialect": "ros1"})
    place.far.until_published("/chatter")
    edge = crossing.edges[SIDE]
    assert isinstance(edge, Ros1KeysEdge)
    endpoints = edge.endpoints()
    assert endpoints
    edge.tick(time.monotonic() + 100 * PERIOD)
    assert edge.endpoints() == endpoints


def test_an_unknown_md5_is_reported(place: Place) -> None:
    bridge = place.ros1()
    place.bridge({"dialect": "ros1"})
    bridge.advertise("/odd", STRING, md5="0123456789abcdef0123456789abcdef")
    line = until(lambda: place.explain(SIDE, "/odd"), "it is explained", every=0.1)[0]
    assert line["decision"] == "refused"
    assert "0123456789abcdef0123456789abcdef" in line["why"]
    assert line["cure"]
    bridge.advertise("/strange", "nowhere_msgs/Nothing", md5="0123456789abcdef0123456789abcdef")
    line = until(lambda: place.explain(SIDE, "/strange"), "it is explained", every=0.1)[0]
    assert "nowhere_msgs" in line["why"]


def cross_latched(place: Place) -> None:
    """Start a bridge, and publish a latched message to it."""
    place.bridge({"dialect": "ros1"})
    out = place.far.advertise("/state", STRING, latched=True, depth=1)
    place.far.publish(out, {"data": "kept"})
    until(lambda: (place.route(SIDE, "/state", "out") or {}).get("messages"), "the message has crossed", every=0.1)


def test_a_latched_message_is_republished_for_the_first_subscriber_and_for_another_bridge(place: Place) -> None:
    cross_latched(place)
    first = place.ros1()
    until_linked(first)
    subscription = first.subscribe("/state", STRING)
    assert first.wait(subscription, 1)[:1] == [{"data": "kept"}]
    # A beacon is lost if its session is not linked to Midspan yet, and the plugin may not send another one. The wait
    # below is for a link to Midspan, so the first program must no longer subscribe to these beacons.
    first.ignore_beacons()
    list(first.session.liveliness().get("nothing"))  # when this ends, the network has processed the change
    remote = zenoh.Locality.REMOTE

    def received_by_another_bridge() -> list[Any]:
        another = place.ros1()
        until(
            lambda: len(another.session.info.peers_zid()) > 1, "the bridge is linked to Midspan and to the first bridge"
        )
        other = another.discovery("sub", "/other", STRING)
        probe = another.session.declare_publisher(other, allowed_destination=remote)
        until(lambda: probe.matching_status.matching, "the bridge's beacons have a subscriber")  # type: ignore[attr-defined]
        messages: list[Any] = another.wait(another.subscribe("/state", STRING), 1, 5)
        return messages  # empty if a busy machine lost the only beacon; then only a new bridge receives the message

    assert until(received_by_another_bridge, "the latched message arrives")[0] == {"data": "kept"}


def test_a_subscriber_without_beacon_does_not_deprive_another_of_latched_messages(place: Place) -> None:
    cross_latched(place)
    mute = place.ros1()
    until_linked(mute)
    received = threading.Event()
    callback = zenoh.handlers.Callback(lambda _sample: received.set())
    mute.session.declare_subscriber(mute.key("/state", STRING), callback)
    assert received.wait(40)
    time.sleep(SETTLE)  # until the next subscriber no longer counts as the first
    second = place.ros1()
    until_linked(second, 2)
    assert second.wait(second.subscribe("/state", STRING), 1)[:1] == [{"data": "kept"}]


def test_a_get_returns_latched_messages(place: Place) -> None:
    place.bridge({"dialect": "ros1"})
    outs = [place.far.advertise("/state", STRING, latched=True, depth=1) for _ in range(2)]
    for number, out in enumerate(outs):
        place.far.publish(out, {"data": f"of {number}"})
    bridge = place.ros1()
    key = bridge.key("/state", STRING)

    def latched() -> list[str]:
        replies = bridge.session.get(key, consolidation=zenoh.ConsolidationMode.NONE)
        return sorted(bridge.decode(STRING, r.ok.payload.to_bytes())["data"] for r in replies if r.ok)

    until(lambda: latched() == ["of 0", "of 1"], "the messages of both publishers are retained", every=0.1)
    place.far.drop(outs[0])
    until(lambda: latched() == ["of 1"], "the other message is dropped with its publisher", every=0.1)


def test_topics_configured_as_latched_are_cached(place: Place) -> None:
    bridge = place.ros1()
    place.bridge({"dialect": "ros1", "latched": ["/maps/*"]})
    out = bridge.advertise("/maps/one", STRING)
    subscription = place.far.subscribe("/maps/one", STRING)
    cross(bridge, out, place.far, subscription, {"data": "map"})
    late = place.far.subscribe("/maps/one", STRING, latched=True)
    assert place.far.wait(late, 1, 60)[:1] == [{"data": "map"}]


def test_a_free_fleet_client_exchanges_goals_and_transforms(place: Place) -> None:
    """The client uses the robot's namespace, sends no beacons, and uses the same keys (free_fleet, ``utils.py``)."""
    goal = {"topic": "/move_base_simple/goal", "type": "geometry_msgs/msg/PoseStamped"}
    place.bridge({"dialect": "ros1", "namespace": "nav1_tb3", "keys": [goal]})
    fleet = place.ros1("nav1_tb3")
    pose = "geometry_msgs/PoseStamped"
    publisher = fleet.session.declare_publisher(fleet.key("/move_base_simple/goal", pose))
    subscription = place.far.subscribe("/move_base_simple/goal", pose)
    place.far.until_published("/move_base_simple/goal")

    def publish_goal() -> list:
        publisher.put(fleet.encode(pose, {"header": {"frame_id": "map"}, "pose": {"position": {"x": 1.5}}}))
        return place.far.wait(subscription, 1, 0.2)

    assert until(publish_goal, "the goal arrives")[0]["pose"]["position"]["x"] == 1.5
    transforms = "tf2_msgs/TFMessage"
    out = place.far.advertise("/tf", transforms)
    read, callback = fleet.listener("/tf", transforms)
    fleet.session.declare_subscriber(
        "7466325f6d7367732f54464d657373616765/94810edda583a504dfda3829e70d7eec/nav1_tb3/tf", callback
    )
    received = cross(place.far, out, fleet, read, {"transforms": [{"child_frame_id": "base_footprint"}]})
    assert received["transforms"][0]["child_frame_id"] == "base_footprint"


def test_keys_beacons_requests_and_replies_of_services_are_exact(place: Place) -> None:
    """Keys, beacons, requests and responses are exact; empty requests are valid, and any bridge may call a service."""
    set_bool, trigger, yes = "std_srvs/SetBool", "std_srvs/Trigger", {"success": True, "message": "hi"}
    bridge, named = place.ros1(), place.ros1("robot1")
    place.bridge({"dialect": "ros1"})
    until_linked(bridge, 2)
    served = bridge.ask("serve", service="/in", type=trigger, reply=yes)["id"]
    assert place.far.call("/in", trigger).result()["reply"] == yes
    key = "7374645f737276732f54726967676572/937c9679a518e3a18d831e57125ea522/*/in"
    until(lambda: f"ros1_discovery_info/*/cl/{key}" in bridge.beacons(), "Midspan's client beacon arrives")
    assert bridge.ask("requests", id=served)["requests"] == [{"structure_needs_at_least_one_member": 0}]
    serving = place.far.serve("/out", set_bool, reply=yes)
    key = "7374645f737276732f536574426f6f6c/09fb03525b03e7ea1fd3992bafd87e16/*/out"
    until(lambda: f"ros1_discovery_info/*/srv/{key}" in bridge.beacons(), "Midspan's server beacon arrives")
    for client in (bridge, named):
        client_key = key.replace("*", client.namespace)
        query = partial(client.session.get, client_key, payload=b"\1", timeout=20.0)
        reply = until(lambda query=query: list(query()), "a reply arrives")[0]
        assert reply.ok.payload.to_bytes() == b"\1" + HI
    assert serving.requests(2) == [{"data": True}] * 2
    for invalid in (b"", b"\1\1"):
        assert "does not match its type" in bridge.call("/out", set_bool, invalid).result()["error"]
    bridge.drop(served)
    until(lambda: not place.far.hub.graph.servers("/in"), "the server has left the hub")


def test_services_of_actions_do_not_cross(place: Place) -> None:
    """ROS 1 has no action services, which is the reason that explain gives."""
    bridge = place.ros1()
    place.bridge({"dialect": "ros1"})
    place.node.action_server("/lookup", "tf2_msgs/action/LookupTransform", lambda _goal: True)
    lines = until(lambda: place.explain(SIDE, "/lookup/_action/send_goal"), "it is explained", every=0.1)
    assert "actions" in lines[0]["why"]
    assert not [key for key in bridge.beacons() if "_action" in key]
