"""The console on a real hub, through its protocol."""

from __future__ import annotations

import json
import math
import threading
import time
from typing import Any

import pytest

from bridge.config.sections.navigation import ACTION
from bridge.modules.action_server import Goal
from bridge.web.verbs import robot
from bridge.web.verbs.hold import HOLD_SECONDS
from navigation.messages import NAVIGATE
from tests.peers.browser.page import TestPage
from tests.peers.hub.node import HubNode
from tests.support.wait import until
from tests.web.conftest import Desk
from tests.web.test_hold import Base

TF = "tf2_msgs/TFMessage"


def transform(parent: str, child: str, x: float, y: float, yaw: float = 0.0) -> dict[str, Any]:
    now = time.time_ns()
    return {
        "header": {"stamp": {"sec": now // 10**9, "nanosec": now % 10**9}, "frame_id": parent},
        "child_frame_id": child,
        "transform": {
            "translation": {"x": x, "y": y, "z": 0.0},
            "rotation": {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)},
        },
    }


@pytest.fixture
def frames(desk: Desk) -> Any:
    """Publish the robot's pose periodically."""
    out = desk.far.advertise("/tf", TF)
    over = threading.Event()

    def publish_frames() -> None:
        while not over.wait(0.05):
            moved = [transform("map", "odom", 1.0, 2.0), transform("odom", "base_link", 0.5, 0.0, math.pi / 2)]
            desk.far.publish(out, {"transforms": moved})

    thread = threading.Thread(target=publish_frames)
    thread.start()
    yield
    over.set()
    thread.join()


def test_the_hello_describes_the_console(desk: Desk) -> None:
    with TestPage(desk.port) as page:
        page.until(lambda: page.others, "the hello arrives")
        assert page.others[0] | {"version": ""} == {
            "op": "hello", "daemon": "here", "version": "", "role": "drive", "who": "", "frame": "map",
            "hold_seconds": HOLD_SECONDS, "speed": {"x": 0.3, "y": 0.3, "turn": 0.6},
        }  # fmt: skip


@pytest.mark.usefixtures("frames")
def test_the_robots_pose_is_shown(desk: Desk) -> None:
    with TestPage(desk.port) as page:
        page.watch("robot", "frames")
        robot = page.value("robot")
        assert robot["pose"] == pytest.approx({"x": 1.5, "y": 2.0, "theta": math.pi / 2}, abs=1e-3)
        names = {frame["name"]: frame["parent"] for frame in page.value("frames")}
        assert names == {"odom": "map", "base_link": "odom"}


@pytest.mark.usefixtures("frames")
def test_a_configured_footprint_is_shown(desk: Desk) -> None:
    corners = [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]
    desk.open_with(web={"footprint": corners})
    with TestPage(desk.port) as page:
        page.watch("robot")
        assert page.value("robot")["footprint"] == corners


@pytest.mark.usefixtures("frames")
def test_other_robots_are_shown(desk: Desk) -> None:
    robots = [{"name": "r2", "base_frame": "odom", "path": "/r2/plan"}, {"name": "r3", "base_frame": "r3/base_link"}]
    desk.open_with(web={"robots": robots})
    plan = desk.far.advertise("/r2/plan", "nav_msgs/Path", latched=True)
    spots = [{"pose": {"position": {"x": float(x), "y": 2.0}}} for x in range(3)]
    desk.far.publish(plan, {"header": {"frame_id": "map"}, "poses": spots})
    with TestPage(desk.port) as page:
        page.watch("robots")
        robots_ = page.value("robots", lambda robots: robots and robots[0]["pose"] and robots[0]["path"])
        assert robots_[0]["pose"] == pytest.approx({"x": 1.0, "y": 2.0, "theta": 0.0})
        assert robots_[0]["path"] == [0.0, 2.0, 1.0, 2.0, 2.0, 2.0]
        assert max(x for x, _ in robots_[0]["footprint"]) == 0.3
        assert robots_[1]["name"] == "r3"
        assert robots_[1]["pose"] is None
        assert "r3/base_link" in robots_[1]["why"]


@pytest.mark.usefixtures("frames")
def test_a_pose_feed_has_the_pose_of_one_frame_in_another(desk: Desk) -> None:
    with TestPage(desk.port) as page:
        page.watch("pose:map>base_link", "pose:base_link>odom", "pose:map>camera", "pose:map", "pose:>map")
        pose = page.value("pose:map>base_link")
        assert pose["position"] == pytest.approx({"x": 1.5, "y": 2.0, "z": 0.0}, abs=1e-3)
        assert pose["angles"] == pytest.approx({"roll": 0.0, "pitch": 0.0, "yaw": math.pi / 2}, abs=1e-3)
        assert pose["age"] < 30.0
        back = page.value("pose:base_link>odom")
        assert back["position"] == pytest.approx({"x": 0.0, "y": 0.5, "z": 0.0}, abs=1e-3)
        camera = "pose:map>camera"
        page.until(lambda: "camera" in page.values.get(camera, {}).get("why", ""), "the reason is given")
        page.until(lambda: len(page.errors()) == 2, "the invalid names are reported")
        assert "'pose:map' is not a pose feed: use pose:REFERENCE>FRAME" in page.errors()


def test_an_unknown_pose_has_a_reason(desk: Desk) -> None:
    with TestPage(desk.port) as page:
        page.watch("robot")
        page.until(lambda: "robot" in page.values, "the robot has a value")
        assert page.values["robot"]["value"] is None
        assert "no transform from" in page.values["robot"]["why"]


@pytest.mark.usefixtures("frames")
def test_the_laser_is_shown_on_the_map(desk: Desk) -> None:
    with TestPage(desk.port) as page:
        page.watch("robot", "laser")
        page.value("robot")
        scan = desk.far.advertise("/scan", "sensor_msgs/LaserScan")

        def publish() -> bool:
            stamp = transform("", "", 0, 0)["header"]["stamp"]
            ranges = [1.0, 2.0, math.inf, 0.01]
            head = {"header": {"stamp": stamp, "frame_id": "base_link"}, "range_min": 0.05, "range_max": 10.0}
            turned = {"angle_min": 0.0, "angle_increment": math.pi / 2, "ranges": ranges}
            desk.far.publish(scan, {**head, **turned})
            page.read()
            return bool(page.values.get("laser", {}).get("value"))

        until(publish, "the laser is shown", every=0.05)
        # the robot heads along y: the first point is 1 m ahead of it, the second 2 m to its left
        assert page.values["laser"]["value"]["points"] == pytest.approx([1.5, 3.0, -0.5, 2.0], abs=0.02)


@pytest.mark.usefixtures("frames")
def test_the_planners_obstacles_are_shown(desk: Desk) -> None:
    out = desk.far.advertise("/local_costmap/costmap", "nav_msgs/OccupancyGrid", latched=True)
    status = desk.far.advertise("/navigation/status", "midspan_msgs/NavigationStatus", latched=True)
    desk.far.publish(status, {"state": "moving"})
    origin = {"position": {"x": 1.0, "y": 0.0, "z": 0.0}, "orientation": {"z": 0.0, "w": 1.0}}
    info = {"resolution": 0.5, "width": 3, "height": 2, "origin": origin}
    with TestPage(desk.port) as page:
        page.watch("obstacles", "driving", "robot")
        page.value("driving", lambda value: value and value["state"] == "moving")
        page.value("robot")
        desk.far.publish(out, {"header": {"frame_id": "odom"}, "info": info, "data": [0, 99, 100, -1, 0, 0]})
        obstacles = page.value("obstacles", lambda value: value and value["points"])
        # the odometry frame is at (1, 2), the cell's center at (1.25, 0.25) from the grid's corner
        assert obstacles == {"points": [3.25, 2.25], "size": 0.5}
        desk.far.publish(status, {"state": "goal_reached"})
        page.value("obstacles", lambda value: not value["points"])
        desk.far.publish(status, {"state": "moving"})
        large = {**info, "width": 1100, "height": 1000}
        desk.far.publish(out, {"header": {"frame_id": "odom"}, "info": large, "data": [0] * 1_100_000})
        page.until(lambda: "up to 1048576 are shown" in page.values["obstacles"].get("why", ""), "the grid is refused")


def test_feeds_are_subscribed_only_while_watched(desk: Desk) -> None:
    graph = desk.far.hub.graph
    assert not graph.subscriptions("/tf")
    with TestPage(desk.port) as first, TestPage(desk.port) as other:
        for page in (first, other):
            page.watch("robot", "topic:/heard")
        until(lambda: len(graph.subscriptions("/tf")) == 1, "one subscription serves both pages")
        first.send(op="unwatch", feed="robot")
        other.until(lambda: "robot" in other.values, "the other page is still served")
        assert graph.subscriptions("/tf")
    until(lambda: not graph.subscriptions("/tf"), "the frames no longer have a subscriber")


def test_a_topic_is_shown_as_a_tree(desk: Desk) -> None:
    out = desk.far.advertise("/heard", "std_msgs/Int32MultiArray")
    with TestPage(desk.port) as page:
        page.watch("topic:/heard")

        def publish() -> bool:
            desk.far.publish(out, {"data": list(range(100))})
            page.read()
            return bool(page.values.get("topic:/heard", {}).get("value"))

        until(publish, "the message is shown", every=0.05)
        message = page.values["topic:/heard"]["value"]
        assert message["type"] == "std_msgs/msg/Int32MultiArray"
        assert message["message"]["data"] == [*range(32), {"...": 100}]


def test_a_large_message_is_not_shown(desk: Desk) -> None:
    out = desk.far.advertise("/heard", "std_msgs/String")
    with TestPage(desk.port) as page:
        page.watch("topic:/heard")

        def is_reported() -> bool:
            desk.far.publish(out, {"data": "x" * (4 << 20)})
            page.read()
            return "is not shown" in page.values.get("topic:/heard", {}).get("why", "")

        until(is_reported, "the reason is given", every=0.05)


@pytest.mark.usefixtures("frames")
def test_a_slow_page_gets_only_the_newest_value(desk: Desk) -> None:
    with TestPage(desk.port, takes=False) as slow, TestPage(desk.port) as quick:
        for page in (slow, quick):
            page.watch("frames")
        first = slow.until(lambda: slow.values.get("frames"), "a first value arrives")
        quick.until(
            lambda: quick.values.get("frames", first)["n"] > first["n"] + 1,
            "a page that acknowledges values gets further ones",
        )
        while slow.read():
            pass
        assert slow.counts["frames"] == 1
        slow.send(op="took", feed="frames", n=first["n"])
        slow.until(lambda: slow.counts["frames"] == 2, "the next value arrives after the acknowledgment")
        assert slow.values["frames"]["n"] > first["n"] + 1


def test_topics_and_workers_are_listed(desk: Desk) -> None:
    desk.far.advertise("/said", "std_msgs/String")
    with TestPage(desk.port) as page:
        page.watch("topics", "status")
        topics_ = page.value(
            "topics", lambda topics: any(said_topic["topic"] == "/said" for said_topic in topics or ())
        )
        said_topic = next(said_topic for said_topic in topics_ if said_topic["topic"] == "/said")
        assert said_topic == {"topic": "/said", "type": "std_msgs/msg/String", "publishers": 1, "subscribers": 0}
        status = page.value("status")
        assert isinstance(status["workers"], list)
        assert status["machines"] == []


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "1", '"hold"', "{}", '{"op": "hold"}', '{"op": "hold", "x": NaN, "y": 0, "turn": 0}',
     '{"op": "hold", "x": true, "y": 0, "turn": 0}', '{"op": "hold", "x": 1e999, "y": 0, "turn": 0}',
     '{"op": "hold", "x": ' + "9" * 400 + ', "y": 0, "turn": 0}',
     '{"op": "watch"}', '{"op": "watch", "feed": 3}', '{"op": "watch", "feed": "robot", "more": 1}',
     '{"op": "call", "id": "1", "verb": "stop"}', '{"op": "call", "id": 1, "verb": "stop", "args": []}', "[" * 5000],
)  # fmt: skip
def test_invalid_messages_are_reported(desk: Desk, text: str) -> None:
    base = Base(desk)
    with TestPage(desk.port) as page:
        page.socket.send(text)
        page.until(page.errors, "the message is refused")
        reply = page.call("explain", name="/x")
        assert reply["ok"], "the socket stays open"
    assert not base.drives()


def test_a_page_that_sends_only_invalid_messages_is_closed(desk: Desk) -> None:
    def send_until_closed(page: TestPage) -> None:
        for _ in range(30):
            page.socket.send("{")
        page.until(lambda: False, "the socket is closed")

    with TestPage(desk.port) as page, pytest.raises(Exception, match="1008"):
        send_until_closed(page)
    with TestPage(desk.port) as page:
        page.until(lambda: page.others, "other pages are served")


LIMITS = "must be a number between -1,000,000 and 1,000,000"


@pytest.mark.parametrize(
    ("verb", "args", "why"),
    [
        ("fly", {}, "unknown verb 'fly'; known: goto"),
        ("goto", {"x": 1.0}, "goto needs y"),
        ("goto", {"x": 1.0, "y": "2"}, f"goto: y {LIMITS}, not '2'"),
        ("goto", {"x": 1e300, "y": 1.0}, f"goto: x {LIMITS}, not 1e+300"),
        ("goto", {"x": 1.0, "y": -(10**30)}, f"goto: y {LIMITS}, not -1000"),
        ("goto", {"x": 1.0, "y": 1.0, "theta": True}, f"goto: theta {LIMITS}, not True"),
        (
            "keep_area",
            {"name": "a", "points": [[0, 0], [1e300, 0], [0, 1]]},
            "in meters between -1,000,000 and 1,000,000",
        ),
        ("goto", {"x": 1.0, "y": 2.0, "z": 3.0}, "goto has no argument 'z'; it has x, y, theta"),
        ("keep_place", {"name": " ", "x": 0, "y": 0, "theta": 0}, "name must be a name of up to 255 characters"),
        ("set_pose", {"x": 0, "y": 0, "theta": 0}, "/initialpose has no subscriber"),
        ("use_map", {"name": "house"}, "no daemon on the hub has a store"),
    ],
)
def test_invalid_calls_are_refused(desk: Desk, verb: str, args: dict[str, Any], why: str) -> None:
    with TestPage(desk.port) as page:
        reply = page.call(verb, **args)
        assert not reply["ok"]
        assert why in reply["error"]


@pytest.mark.parametrize("topic", ["/initialpose", "/r1/start"])
def test_set_pose_publishes_the_initial_pose(desk: Desk, topic: str) -> None:
    desk.open_with(modules={"localization_server": {"initialpose": topic}})
    subscription = desk.far.subscribe(topic, "geometry_msgs/PoseWithCovarianceStamped")
    with TestPage(desk.port) as page:
        reply: dict[str, Any] = {}

        def is_reported() -> bool:
            reply.update(page.call("set_pose", x=1.0, y=2.0, theta=math.pi))
            return bool(reply["ok"])

        until(is_reported, "the pose is published once the subscriber is discovered")
        message = desk.far.wait(subscription, 1)[0]
        assert message["header"]["frame_id"] == "map"
        assert message["pose"]["pose"]["position"] == {"x": 1.0, "y": 2.0, "z": 0.0}
        assert message["pose"]["pose"]["orientation"]["z"] == pytest.approx(1.0)


def test_a_goal_without_a_reply_is_canceled(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot, "GOAL_SECONDS", 0.5)
    gateway = LateGateway(desk.hubs.settings("gateway"))
    try:
        with TestPage(desk.port) as page:
            page.until(lambda: desk.far.hub.graph.servers(f"{ACTION}/_action/send_goal"), "the gateway is discovered")
            reply: dict[str, Any] = {}

            def is_sent() -> bool:
                reply.update(page.call("goto", x=1.0, y=2.0))
                return gateway.asked.is_set()

            until(is_sent, "the gateway receives the goal")
            assert "the gateway did not accept or reject the goal within 0.5 s" in reply["error"]
        gateway.may_answer.set()
        assert gateway.canceled.wait(30)
    finally:
        gateway.may_answer.set()
        gateway.close()


def test_a_goal_that_the_gateway_accepts_after_a_stop_is_canceled(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot, "GOAL_SECONDS", 60.0)
    gateway = LateGateway(desk.hubs.settings("gateway"))
    try:
        with TestPage(desk.port) as page, TestPage(desk.port) as other:
            page.until(lambda: desk.far.hub.graph.servers(f"{ACTION}/_action/send_goal"), "the gateway is discovered")

            def is_sent() -> bool:
                page.send(op="call", id=1, verb="goto", args={"x": 1.0, "y": 2.0})
                page.read(0.2)
                return gateway.asked.is_set()

            until(is_sent, "the gateway receives the goal")
            other.call("stop")
            desk.console.host.loop.call(lambda: None)
            gateway.may_answer.set()
            assert gateway.canceled.wait(30)
    finally:
        gateway.may_answer.set()
        gateway.close()


class LateGateway(HubNode):
    """A gateway that accepts a goal only when the test allows it (or after 30 s)."""

    def __init__(self, settings: Any) -> None:
        super().__init__(settings)
        self.asked, self.may_answer, self.canceled = threading.Event(), threading.Event(), threading.Event()
        self.on(lambda: self.node.action_server(ACTION, NAVIGATE, self._on_message, self._cancel))

    def _on_message(self, goal: Goal) -> bool:
        self.asked.set()
        self.may_answer.wait(30)
        goal.execute()
        return True

    def _cancel(self, goal: Goal) -> bool:
        self.canceled.set()
        self.loop.post(lambda: goal.canceled({}))
        return True


def test_the_number_of_watched_feeds_is_limited(desk: Desk) -> None:
    with TestPage(desk.port) as page:
        for number in range(70):
            page.watch(f"topic:/t{number}")
        page.until(page.errors, "the limit is named")
        assert "at most 64 feeds" in page.errors()[0]


def test_an_unknown_feed_is_refused_and_does_not_affect_others(desk: Desk) -> None:
    with TestPage(desk.port) as page:
        page.watch("topics", "nothing:of this name")
        page.until(page.errors, "the feed is refused")
        page.send(op="unwatch", feed="nothing:of this name")
        page.value("topics", lambda topics: topics is not None)


def test_the_size_of_messages_is_limited(desk: Desk) -> None:
    with TestPage(desk.port) as page:
        page.socket.send(json.dumps({"op": "watch", "feed": "x" * 100_000}))
        with pytest.raises(Exception, match="1009"):
            page.until(lambda: False, "the socket is closed")
