"""The ros2dds dialect uses exactly the plugin's tokens and bytes."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest
import zenoh
from zenoh import ext

from bridge.adapters.zenoh.neighbors import is_marked, new_zid
from bridge.adapters.zenoh.ros2dds_tokens import Token, action_key, parse, token_key
from bridge.hub.errors import HubWireError
from bridge.hub.wire.qos import Durability, History, Qos, Reliability
from bridge.routing.edge import Kind
from tests.adapters.zenoh.conftest import ROS2, Place, cross, until_linked
from tests.peers.zenoh.programs import open_session
from tests.support.wait import until

STRING = "std_msgs/String"
HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
HI = bytes.fromhex("00010000 03000000 686900")
SIDE = "zenoh_ros2dds"


def test_tokens_are_written_as_the_plugin_writes_them() -> None:
    latched = Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL, depth=1)
    token = Token("ab12", Kind.PUBLISHER, "bot1/map", "nav_msgs/msg/OccupancyGrid", "RIHS01_0123", latched)
    text = "@/ab12/@ros2_lv/MP/bot1§map/nav_msgs§msg§OccupancyGrid/:1:1:0,1:typehash=RIHS01_0123;"
    assert token_key(token) == text
    assert parse(text) == (token,)
    best_effort = Token("1", Kind.SUBSCRIPTION, "scan", "a/msg/B", "", Qos(Reliability.BEST_EFFORT, depth=5))
    assert token_key(best_effort) == "@/1/@ros2_lv/MS/scan/a§msg§B/:0:0:0,5"


@pytest.mark.parametrize(
    ("qos", "kind", "read"),
    [
        (":::", Kind.PUBLISHER, Qos(Reliability.RELIABLE, depth=1)),
        (":::", Kind.SUBSCRIPTION, Qos(Reliability.BEST_EFFORT, depth=1)),
        ("K:1:1:0,7", Kind.PUBLISHER, Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL, depth=7)),
        (":1:0:1,-1:typehash=x;", Kind.PUBLISHER, Qos(Reliability.RELIABLE, history=History.KEEP_ALL, depth=1)),
        (":1:3:0,2", Kind.PUBLISHER, Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL, depth=2)),
    ],
)
def test_the_qos_is_read_from_tokens(qos: str, kind: Kind, read: Qos) -> None:
    letters = "MP" if kind is Kind.PUBLISHER else "MS"
    (token,) = parse(f"@/1/@ros2_lv/{letters}/a/std_msgs§msg§String/{qos}")
    assert (token.qos, token.type_hash) == (read, "")


@pytest.mark.parametrize(
    "text",
    [
        "@/1/@ros2_lv/MP/a/std_msgs§msg§String",
        "@/1/@ros2_lv/MP/a/std_msgs§msg§String/:1:0",
        "@/1/@ros2_lv/MP/a/std_msgs§msg§String/:one:0:0,1",
        "@/1/@ros2_lv/MP/a/std_msgs§msg§String/:1:0:0",
        "@/1/@ros2_lv/MP/a/std_msgs§msg§String/:1:0:0,99999999999999",
        "@/1/@ros2_lv/MP/0§chatter§std_msgs::msg::dds_::String_§RIHS01_ab/std_msgs§msg§String/:::",
        "@/1/@ros2_lv/MP/§a/std_msgs§msg§String/:::",
        "@/1/@ros2_lv/MP/a/String/:::",
        "@/1/@ros2_lv/XX/a/std_msgs§msg§String/:::",
        "@/1/@ros2_lv/SS/a/std_srvs§msg§Trigger",
        "@/1/@ros2_lv/SS/a/std_srvs§srv§Trigger/:::",
        "@/1/@ros2_lv/AS/a/std_srvs§srv§Trigger",
        "@/1/@ros2_lv/AC/§a/nav2_msgs§action§NavigateToPose",
        "@/1/@other",
        "@ros2_lv/0/1/0/0/NN/%/%/node",
        "@/1/@ros2_lv/MP/a/std_msgs§msg§String/" + "1" * 5000,
    ],
)
def test_invalid_tokens_are_rejected(text: str) -> None:
    with pytest.raises(HubWireError):
        parse(text)


def test_tokens_of_services_and_actions_are_parsed_into_their_parts() -> None:
    assert parse("@/1/@ros2_lv") == ()
    text = "@/1/@ros2_lv/SS/bot§add/example_interfaces§srv§AddTwoInts"
    (token,) = parse(text)
    assert token == Token("1", Kind.SERVER, "bot/add", "example_interfaces/srv/AddTwoInts", "", Qos())
    assert token_key(token) == text
    assert parse(text.replace("SS", "SC"))[0].kind is Kind.CLIENT
    text = "@/1/@ros2_lv/AS/go/nav2_msgs§action§NavigateToPose"
    reported = parse(text)
    assert [(t.kind, t.key.removeprefix("go/_action/"), t.type, t.qos.latched) for t in reported] == [
        (Kind.SERVER, "send_goal", "nav2_msgs/action/NavigateToPose_SendGoal", False),
        (Kind.SERVER, "cancel_goal", "action_msgs/srv/CancelGoal", False),
        (Kind.SERVER, "get_result", "nav2_msgs/action/NavigateToPose_GetResult", False),
        (Kind.PUBLISHER, "feedback", "nav2_msgs/action/NavigateToPose_FeedbackMessage", False),
        (Kind.PUBLISHER, "status", "action_msgs/msg/GoalStatusArray", True),
    ]
    assert action_key(reported[0]) == action_key(reported[2]) == text
    kinds = {t.kind for t in parse(text.replace("AS", "AC"))}
    assert kinds == {Kind.CLIENT, Kind.SUBSCRIPTION}


def test_a_marked_id_is_random_and_accepted_by_zenoh() -> None:
    ids = {new_zid() for _ in range(100)}
    assert len(ids) == 100
    assert all(is_marked(zid) and zid[0] != "0" and len(zid) == 32 for zid in ids)
    assert not is_marked("6d7370616e7a")


def test_a_bridge_receives_exact_tokens_and_samples(place: Place) -> None:
    """The token and the sample of a hub publisher are correct byte for byte."""
    bridge = place.ros2dds()
    place.bridge({"dialect": "ros2dds"})
    out = place.far.advertise("/chatter", STRING, depth=7)
    token = until(lambda: bridge.tokens("/chatter"), "Midspan's token arrives")[0]
    zid = token.split("/")[1]
    assert token == f"@/{zid}/@ros2_lv/MP/chatter/std_msgs§msg§String/:1:0:0,1000:typehash={HASH};"
    assert f"@/{zid}/@ros2_lv" in bridge.all_tokens()
    samples: list[zenoh.Sample] = []
    bridge.session.declare_subscriber("chatter", zenoh.handlers.Callback(samples.append, indirect=False))

    def received() -> bool:
        place.far.publish_raw(out, HI)
        return bool(samples)

    until(received, "the sample arrives")
    assert samples[0].payload.to_bytes() == HI
    assert samples[0].attachment is None


def test_the_topic_of_a_bridge_crosses(place: Place) -> None:
    bridge = place.ros2dds()
    out = bridge.advertise("/chatter", STRING)
    place.bridge({"dialect": "ros2dds"})
    token = until(lambda: bridge.tokens("/chatter", "MS"), "Midspan's token arrives")[0]
    assert token.endswith(f"/MS/chatter/std_msgs§msg§String/:1:0:0,10:typehash={HASH};")
    subscription = place.far.subscribe("/chatter", STRING)
    assert cross(bridge, out, place.far, subscription, {"data": "hi"}) == {"data": "hi"}
    bridge.drop(out)
    until(lambda: not bridge.tokens("/chatter", "MS"), "Midspan's token is withdrawn with the publisher")


def test_only_the_bridge_in_the_configured_namespace_is_bridged(place: Place) -> None:
    robot = place.ros2dds("robot1")
    stranger = place.ros2dds("robot2")
    place.bridge({"dialect": "ros2dds", "namespace": "/robot1"})
    out = robot.advertise("/odom", STRING)
    other = stranger.advertise("/odom", STRING)
    subscription = place.far.subscribe("/odom", STRING)
    place.far.until_published("/odom")
    stranger.publish(other, {"data": "from another robot"})
    assert cross(robot, out, place.far, subscription, {"data": "here"}) == {"data": "here"}
    assert not [e for e in place.far.hub.graph.publishers() if "robot" in e.topic]
    back = robot.subscribe("/goal", STRING)
    goal = place.far.advertise("/goal", STRING)
    assert cross(place.far, goal, robot, back, {"data": "go"}) == {"data": "go"}


def test_the_history_of_a_deep_publisher_arrives_complete_and_in_order(place: Place) -> None:
    bridge = place.ros2dds()
    out = bridge.advertise("/log", STRING, latched=True, depth=5)
    for number in range(20):
        bridge.publish(out, {"data": str(number)})
    place.bridge({"dialect": "ros2dds"})
    until_linked(bridge)
    place.far.until_published("/log")
    until(lambda: (place.route(SIDE, "/log", "in") or {}).get("messages", 0) >= 5, "the history has arrived", every=0.1)
    subscription = place.far.subscribe("/log", STRING, latched=True)
    assert [m["data"] for m in place.far.wait(subscription, 5, 60)] == ["15", "16", "17", "18", "19"]
    bridge.publish(out, {"data": "20"})
    assert place.far.wait(subscription, 6, 60)[-1] == {"data": "20"}
    assert len(place.far.wait(subscription, 7, 0.3)) == 6


def test_all_static_transforms_of_several_nodes_behind_one_bridge_are_retained(place: Place) -> None:
    """The plugin has one cache for all writers of a topic, and the whole set counts, not only its last message."""
    bridge = place.ros2dds()
    out = bridge.advertise("/tf_static", "tf2_msgs/TFMessage", latched=True, depth=1)
    for child in ("laser", "camera", "imu"):
        bridge.publish(out, {"transforms": [{"header": {"frame_id": "base"}, "child_frame_id": child}]})
    place.bridge({"dialect": "ros2dds"})

    def frames() -> list[str]:
        subscription = place.far.subscribe("/tf_static", "tf2_msgs/TFMessage", latched=True)
        got = place.far.wait(subscription, 1, 1.0)
        place.far.drop(subscription)
        return sorted(t["child_frame_id"] for t in got[-1]["transforms"]) if got else []

    until(lambda: frames() == ["camera", "imu", "laser"], "all static transforms are retained")


def test_each_sample_of_a_numbering_publisher_arrives_once(place: Place) -> None:
    """A Python program has an advanced publisher whose history has numbers and time stamps, and arrives once."""
    session = open_session(place.router.endpoint)
    publisher = ext.declare_advanced_publisher(
        session, "state", cache=ext.CacheConfig(1), publisher_detection=True,
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5),
    )  # fmt: skip
    alive = session.liveliness().declare_token(f"@/{session.zid()}/@ros2_lv")
    token = session.liveliness().declare_token(f"@/{session.zid()}/@ros2_lv/MP/state/std_msgs§msg§String/:1:1:0,1")
    publisher.put(ROS2.encode(STRING, {"data": "old"}))
    publisher.put(ROS2.encode(STRING, {"data": "kept"}))
    try:
        place.bridge({"dialect": "ros2dds"})
        until(
            lambda: (place.route(SIDE, "/state", "in") or {}).get("messages"), "the message has arrived", 15, every=0.1
        )
        subscription = place.far.subscribe("/state", STRING, latched=True)
        assert place.far.wait(subscription, 1, 60) == [{"data": "kept"}]
        publisher.put(ROS2.encode(STRING, {"data": "new"}))
        assert place.far.wait(subscription, 2, 60) == [{"data": "kept"}, {"data": "new"}]
        until(lambda: place.route(SIDE, "/state", "in")["messages"] == 2, "both messages are counted")
        token.undeclare()
        alive.undeclare()
        place.far.until_unpublished("/state")
    finally:
        session.close()


def test_messages_of_a_plain_program_on_a_configured_key_are_bridged(place: Place) -> None:
    """Like free_fleet's clients, the program declares no token, and as a client of the router it sets no time stamp."""
    place.bridge({"dialect": "ros2dds", "keys": [{"topic": "/robot1/goal", "type": "std_msgs/msg/String"}]})
    subscription = place.far.subscribe("/robot1/goal", STRING)
    place.far.until_published("/robot1/goal")
    with contextlib.closing(open_session(place.router.endpoint, "client", timestamping={"enabled": False})) as session:

        def published() -> list[Any]:
            session.put("robot1/goal", HI)
            return place.far.wait(subscription, 1, 0.2)

        assert until(published, "the message is received")[0] == {"data": "hi"}
        session.put("robot1/goal", b"\0\1\0\0junk")
        until(
            lambda: place.route(SIDE, "/robot1/goal", "in")["drops"]["bad"] == 1,
            "malformed messages are counted",
            every=0.1,
        )


def test_keys_without_announcement_are_ignored(place: Place) -> None:
    """The hub's keys and rmw_zenoh's tokens on the same network do not belong to this dialect."""
    hub = {"listen": place.hubs.endpoint}
    bridge = place.bridge({"dialect": "ros2dds"}, zenoh={"dialects": [{"dialect": "ros2dds"}]}, hub=hub)
    out = place.far.advertise("/chatter", STRING)
    place.far.publish(out, {"data": "on the hub"})
    place.until_route(SIDE, "/chatter", "out")
    assert bridge.bridges[0].health().state == "running"
    status = place.answer(SIDE)
    assert [r["direction"] for r in status["routes"] if r["topic"] == "/chatter"] == ["out"]
    assert not [w for w in status["warnings"] if "ignored" in w]
    assert place.explain(SIDE, "/0/chatter") == []


def test_a_token_that_claims_a_key_of_the_hub_is_ignored_and_reported(place: Place) -> None:
    """The token is ignored and reported, and the hub's own topic is not affected."""
    bridge = place.ros2dds()
    place.bridge({"dialect": "ros2dds"})
    key = f"0§chatter§std_msgs::msg::dds_::String_§{HASH}"
    claim = bridge.session.liveliness().declare_token(f"@/{bridge.zid}/@ros2_lv/MP/{key}/std_msgs§msg§String/:::")
    until(lambda: [w for w in place.answer(SIDE)["warnings"] if "ignored" in w], "a warning is reported", every=0.1)
    assert not place.far.publishers("/chatter")
    claim.undeclare()


def test_a_type_hash_that_differs_is_reported(place: Place) -> None:
    bridge = place.ros2dds()
    place.bridge({"dialect": "ros2dds"})
    other = "RIHS01_" + "ab" * 32
    text = bridge.token("MP", "/odd", STRING, latched=False, depth=1, best_effort=False).replace(HASH, other)
    token = bridge.session.liveliness().declare_token(text)
    line = until(lambda: place.explain(SIDE, "/odd"), "it is explained", every=0.1)[0]
    assert line["decision"] == "refused"
    assert other in line["why"]
    assert line["cure"]
    token.undeclare()


def test_topics_of_actions_have_no_tokens(place: Place) -> None:
    """The plugin announces actions as a whole; free_fleet receives their feedback nevertheless."""
    bridge = place.ros2dds()
    place.bridge({"dialect": "ros2dds"})
    out = place.far.advertise("/go/_action/feedback", STRING)
    place.until_route(SIDE, "/go/_action/feedback", "out")
    samples: list[bytes] = []
    bridge.session.declare_subscriber(
        "go/_action/feedback", zenoh.handlers.Callback(lambda s: samples.append(s.payload.to_bytes()), indirect=False)
    )

    def received() -> bool:
        place.far.publish_raw(out, HI)
        return bool(samples)

    until(received, "the sample arrives")
    assert bridge.tokens("/go/_action/feedback") == []
