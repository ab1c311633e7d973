"""The ros1 dialect, key for key and byte for byte."""

from __future__ import annotations

import threading
import time
from typing import Any

import pytest
import zenoh

from bridge.adapters.zenoh.neighbours import new_zid
from bridge.adapters.zenoh.ros1 import SETTLE, Ros1KeysEdge
from bridge.adapters.zenoh.ros1_discovery import Aloha, AnnouncedTopic, data_key, discovery_key, parse
from bridge.hub.errors import HubWireError
from bridge.routing.edge import Kind
from tests.adapters.zenoh.conftest import Place, cross
from tests.contract.zenohside import PERIOD
from tests.support.wait import until
from tests.support.zenoh_programs import Beacon, open_session

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
def test_keys_that_are_none(key: str) -> None:
    with pytest.raises(HubWireError):
        parse(key)


def test_out_what_a_bridge_sees(place: Place) -> None:
    """Our beacons, and the sample byte for byte."""
    bridge = place.ros1()
    place.bridge({"dialect": "ros1"})
    out = place.far.advertise("/chatter", STRING)
    until(lambda: f"ros1_discovery_info/*/pub/{KEY}" in bridge.beacons(), "our beacon")
    samples: list[zenoh.Sample] = []
    bridge.session.declare_subscriber(KEY, zenoh.handlers.Callback(samples.append, indirect=False))

    def heard() -> bool:
        place.far.publish(out, {"data": "hi"})
        return bool(samples)

    until(heard, "the sample")
    assert (str(samples[0].key_expr), samples[0].payload.to_bytes(), samples[0].attachment) == (KEY, HI, None)
    place.far.drop(out)
    until(lambda: f"ros1_discovery_info/*/pub/{KEY}" not in bridge.beacons(), "our beacon ends with the topic")


def test_in_what_a_bridge_says_and_that_it_is_gone_when_silent(place: Place) -> None:
    bridge = place.ros1()
    place.bridge({"dialect": "ros1"})
    out = bridge.advertise("/chatter", STRING)
    heard = place.far.subscribe("/chatter", STRING)
    assert cross(bridge, out, place.far, heard, {"data": "hi"}) == {"data": "hi"}
    until(lambda: f"ros1_discovery_info/*/sub/{KEY}" in bridge.beacons(), "we ask for it")
    bridge.drop(out)
    place.far.until_unpublished("/chatter")


@pytest.mark.thorough
def test_native_bridges_never_fall_silent_because_of_us(place: Place) -> None:
    """Both publish one topic, so that both beacon on one key; the native one is there all the time."""
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


def test_a_native_bridge_that_fell_silent_speaks_again(place: Place) -> None:
    """It heard us before we heard it."""
    place.bridge({"dialect": "ros1"})
    place.far.advertise("/chatter", STRING)
    bridge = place.ros1()
    until(lambda: f"ros1_discovery_info/*/pub/{KEY}" in bridge.beacons(), "our beacon")
    beacon = Beacon(bridge.session, bridge.discovery("pub", "/chatter", STRING), PERIOD, sending=False)
    try:
        place.far.until_published("/chatter", seconds=30)
    finally:
        beacon.undeclare()


def test_all_midspans_leave_the_same_pauses(place: Place) -> None:
    """Or there would be none; two are active where their hubs are not joined."""
    sessions = [open_session(place.router.endpoint, id=new_zid()) for _ in range(2)]
    first, second = (Aloha(s, "*", lambda: None, lambda _topic, _first: None) for s in sessions)
    what = (Kind.PUBLISHER, AnnouncedTopic("/chatter", STRING, "992ce8a1687cec8c8bd883ec73ca41d1"))
    first.announce(*what)
    due = first._own[what].due

    def rests() -> bool:
        second.announce(*what)()
        return first._own[what].due > due

    try:
        until(rests, "the first rests when the second beacons")
    finally:
        first.close()
        second.close()
        for session in sessions:
            session.close()


def test_while_we_stand_still_nobody_is_gone(place: Place) -> None:
    """A worker that was stopped for longer than a bridge may be silent keeps what it knew."""
    bridge = place.ros1()
    bridge.advertise("/chatter", STRING)
    crossing = place.bridge({"dialect": "ros1"})
    place.far.until_published("/chatter")
    edge = crossing.edges[SIDE]
    assert isinstance(edge, Ros1KeysEdge)
    before = edge.endpoints()
    assert before
    edge.tick(time.monotonic() + 100 * PERIOD)
    assert edge.endpoints() == before


def test_an_md5_that_is_not_known_here_is_reported(place: Place) -> None:
    bridge = place.ros1()
    place.bridge({"dialect": "ros1"})
    bridge.advertise("/odd", STRING, md5="0123456789abcdef0123456789abcdef")
    line = until(lambda: place.explain(SIDE, "/odd"), "an explanation", every=0.1)[0]
    assert line["decision"] == "refused"
    assert "0123456789abcdef0123456789abcdef" in line["why"]
    assert line["cure"]
    bridge.advertise("/strange", "nowhere_msgs/Nothing", md5="0123456789abcdef0123456789abcdef")
    line = until(lambda: place.explain(SIDE, "/strange"), "an explanation", every=0.1)[0]
    assert "nowhere_msgs" in line["why"]


def keep_one(place: Place) -> None:
    """Have a bridge that keeps one latched message."""
    place.bridge({"dialect": "ros1"})
    out = place.far.advertise("/state", STRING, latched=True, depth=1)
    place.far.publish(out, {"data": "kept"})
    until(lambda: (place.route(SIDE, "/state", "out") or {}).get("messages"), "it crossed", every=0.1)


def test_what_is_latched_is_put_again_for_the_first_subscriber_and_for_another_bridge(place: Place) -> None:
    keep_one(place)
    first = place.ros1()
    heard = first.subscribe("/state", STRING)
    assert first.wait(heard, 1) == [{"data": "kept"}]
    # a beacon before its session knows of us is lost, and the plugin may then be silent for ever: neither the first
    # program, which hears all beacons and those of /state, nor its own session is who must know of it
    first.deafen()
    list(first.session.liveliness().get("nothing"))  # once this is answered, the network knows it
    remote = zenoh.Locality.REMOTE

    def said_again() -> list[Any]:
        another = place.ros1()
        until(lambda: len(another.session.info.peers_zid()) > 1, "it is linked to us and to the first")
        other = another.discovery("sub", "/other", STRING)
        probe = another.session.declare_publisher(other, allowed_destination=remote)
        until(lambda: probe.matching_status.matching, "its beacons will be heard")  # type: ignore[attr-defined]
        found: list[Any] = another.wait(another.subscribe("/state", STRING), 1, 5)
        return found  # none where a busy machine lost its one beacon: a bridge that is known is not heard out again

    assert until(said_again, "it is put again")[0] == {"data": "kept"}


def test_who_tells_nobody_that_it_subscribes_takes_no_latched_message_from_another(place: Place) -> None:
    keep_one(place)
    mute = place.ros1()
    heard = threading.Event()
    mute.session.declare_subscriber(mute.key("/state", STRING), zenoh.handlers.Callback(lambda _sample: heard.set()))
    assert heard.wait(40)
    time.sleep(SETTLE)  # nobody is taken for the first one now
    second = place.ros1()
    assert second.wait(second.subscribe("/state", STRING), 1) == [{"data": "kept"}]


def test_what_is_latched_answers_a_get(place: Place) -> None:
    place.bridge({"dialect": "ros1"})
    outs = [place.far.advertise("/state", STRING, latched=True, depth=1) for _ in range(2)]
    for number, out in enumerate(outs):
        place.far.publish(out, {"data": f"of {number}"})
    bridge = place.ros1()
    key = bridge.key("/state", STRING)

    def got() -> list[str]:
        replies = bridge.session.get(key, consolidation=zenoh.ConsolidationMode.NONE)
        return sorted(bridge.decode(STRING, r.ok.payload.to_bytes())["data"] for r in replies if r.ok)

    until(lambda: got() == ["of 0", "of 1"], "both are answered", every=0.1)
    place.far.drop(outs[0])
    until(lambda: got() == ["of 1"], "one is gone with its publisher", every=0.1)


def test_topics_that_are_configured_as_latched_are_kept(place: Place) -> None:
    bridge = place.ros1()
    place.bridge({"dialect": "ros1", "latched": ["/maps/*"]})
    out = bridge.advertise("/maps/one", STRING)
    heard = place.far.subscribe("/maps/one", STRING)
    cross(bridge, out, place.far, heard, {"data": "map"})
    late = place.far.subscribe("/maps/one", STRING, latched=True)
    assert place.far.wait(late, 1) == [{"data": "map"}]


def test_free_fleet(place: Place) -> None:
    """Its client knows the robot's namespace, tells nothing, and reads the same keys (free_fleet, ``utils.py``)."""
    goal = {"topic": "/move_base_simple/goal", "type": "geometry_msgs/msg/PoseStamped"}
    place.bridge({"dialect": "ros1", "namespace": "nav1_tb3", "keys": [goal]})
    fleet = place.ros1("nav1_tb3")
    pose = "geometry_msgs/PoseStamped"
    publisher = fleet.session.declare_publisher(fleet.key("/move_base_simple/goal", pose))
    heard = place.far.subscribe("/move_base_simple/goal", pose)
    place.far.until_published("/move_base_simple/goal")

    def said() -> list:
        publisher.put(fleet.encode(pose, {"header": {"frame_id": "map"}, "pose": {"position": {"x": 1.5}}}))
        return place.far.wait(heard, 1, 0.2)

    assert until(said, "the goal")[0]["pose"]["position"]["x"] == 1.5
    transforms = "tf2_msgs/TFMessage"
    out = place.far.advertise("/tf", transforms)
    read, hear = fleet.listener("/tf", transforms)
    fleet.session.declare_subscriber(
        "7466325f6d7367732f54464d657373616765/94810edda583a504dfda3829e70d7eec/nav1_tb3/tf", hear
    )
    got = cross(place.far, out, fleet, read, {"transforms": [{"child_frame_id": "base_footprint"}]})
    assert got["transforms"][0]["child_frame_id"] == "base_footprint"


def test_services_byte_for_byte(place: Place) -> None:
    """Keys, beacons, requests and responses; a request without bytes is one, and a bridge of any namespace may ask."""
    set_bool, trigger, yes = "std_srvs/SetBool", "std_srvs/Trigger", {"success": True, "message": "hi"}
    bridge, named = place.ros1(), place.ros1("robot1")
    place.bridge({"dialect": "ros1"})
    served = bridge.ask("serve", service="/in", type=trigger, reply=yes)["id"]
    assert place.far.call("/in", trigger).result()["reply"] == yes
    key = "7374645f737276732f54726967676572/937c9679a518e3a18d831e57125ea522/*/in"
    until(lambda: f"ros1_discovery_info/*/cl/{key}" in bridge.beacons(), "we tell that we call it")
    assert bridge.ask("requests", id=served)["requests"] == [{"structure_needs_at_least_one_member": 0}]
    serving = place.far.serve("/out", set_bool, reply=yes)
    key = "7374645f737276732f536574426f6f6c/09fb03525b03e7ea1fd3992bafd87e16/*/out"
    until(lambda: f"ros1_discovery_info/*/srv/{key}" in bridge.beacons(), "our beacon")
    for asker in (bridge, named):
        its = key.replace("*", asker.namespace)
        reply = until(lambda k=its, a=asker: list(a.session.get(k, payload=b"\1", timeout=20.0)), "a reply")[0]
        assert reply.ok.payload.to_bytes() == b"\1" + HI
    assert serving.requests(2) == [{"data": True}] * 2
    for bad in (b"", b"\1\1"):
        assert "does not match its type" in bridge.call("/out", set_bool, bad).result()["error"]
    bridge.drop(served)
    until(lambda: not place.far.hub.graph.servers("/in"), "it is gone")


def test_services_of_actions_stay_away(place: Place) -> None:
    """ROS 1 has none: explain says so, and nothing is served."""
    bridge = place.ros1()
    place.bridge({"dialect": "ros1"})
    place.node.action_server("/lookup", "tf2_msgs/action/LookupTransform", lambda _goal: True)
    lines = until(lambda: place.explain(SIDE, "/lookup/_action/send_goal"), "it is decided", every=0.1)
    assert "actions" in lines[0]["why"]
    assert not [key for key in bridge.beacons() if "_action" in key]
