"""The module on a hub, with YARP, and with a local navigator that goes straight to where it is sent."""

from __future__ import annotations

import base64
import io
import math
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from bridge import kernels
from bridge.clock import SYSTEM
from bridge.hub.session import Hub
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.actions import GoalState
from bridge.messages.registry import Registry
from bridge.modules.action_server import Goal
from bridge.stores.kinds import MAP
from navigation.constraints import Constraints
from navigation.maps.grid import to_grid, yaw_of
from navigation.status import Fault, PlannerStatus, State, status_message
from tests.modules.place import Place
from tests.navigation.robot_path_planner.floors import ROOMS, floor
from tests.navigation.served import ACTION, STATUS, Program, Served
from tests.navigation.uncompiled import uncompiled
from tests.support.wait import until
from yarp_compat.dev.client import ServiceClient
from yarp_compat.dev.inavigation2d import (
    INavigation2DMsgs,
    NavigationMapTypeEnum,
    NavigationStatusEnum,
    TrajectoryTypeEnum,
)
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.naming import connections
from yarp_compat.pythonic import Client, Reader, Writer
from yarp_compat.sig.image import ImageRgb

PLANNER = "/planner/robot_path_planner"
TICK = 0.02
LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)


class Robot(Program):
    """A local navigator on the hub, whose robot is where it is sent; and a client of the planner."""

    def __init__(self, hub: Hub, registry: Registry) -> None:
        super().__init__(hub, registry, PLANNER)
        self.x, self.y, self.yaw = 1.0, 1.0, 0.0
        self.goal: Goal | None = None
        self.asked: list[tuple[float, float, Constraints]] = []
        self.fails, self.code = "", Fault.BLOCKED
        self.speed = 3.0
        self._tf = self.node.publisher("/tf", "tf2_msgs/msg/TFMessage")
        self._status = self.node.publisher("/planner/robot_goto/status", "midspan_msgs/msg/NavigationStatus", LATCHED)
        self.node.action_server("/planner/robot_goto/navigate_to_pose", ACTION, self._take, self._cancel)
        self.beat(TICK, self._tick)

    def _take(self, goal: Goal) -> bool:
        if self.goal is not None and self.goal.active:
            self.goal.abort()
        self.goal = goal
        pose = goal.goal["pose"]["pose"]["position"]
        self.asked.append((pose["x"], pose["y"], Constraints.from_text(goal.goal["behavior_tree"])))
        goal.execute()
        if self.fails:
            goal.abort({"error_code": int(self.code), "error_msg": self.fails})
        return True

    def says(self, state: State, reason: str) -> None:
        """Tell of the goal at hand what the action has no word for."""
        assert self.goal is not None
        told = status_message(SYSTEM.stamp(), PlannerStatus(state, reason), goal_id=self.goal.id)
        self.loop.call(lambda: self._status.publish(told))

    def _cancel(self, goal: Goal) -> bool:
        self.loop.post(goal.canceled)
        return True

    def _tick(self) -> None:
        goal = self.goal
        if goal is not None and goal.active and goal.status is GoalState.EXECUTING:
            pose = goal.goal["pose"]["pose"]
            dx, dy = pose["position"]["x"] - self.x, pose["position"]["y"] - self.y
            away = math.hypot(dx, dy)
            share = min(1.0, self.speed * TICK / away) if away else 1.0
            self.x, self.y = self.x + dx * share, self.y + dy * share
            if share == 1.0:
                self.yaw = yaw_of(pose["orientation"])
                goal.succeed()
        turn = {"x": 0.0, "y": 0.0, "z": math.sin(self.yaw / 2), "w": math.cos(self.yaw / 2)}
        transform = {"translation": {"x": self.x, "y": self.y, "z": 0.0}, "rotation": turn}
        header = {"stamp": SYSTEM.stamp(), "frame_id": "map"}
        self._tf.publish({"transforms": [{"header": header, "child_frame_id": "base_link", "transform": transform}]})


class Planning(Served):
    """A running planner."""

    def __init__(self, folder: Path, **more: Any) -> None:
        super().__init__(folder, "robot_path_planner")
        self.robot = Robot(self.far.hub, self.far.registry)
        section = {
            "enabled": True,
            "robot_radius": 0.2,
            "clearance": 0.1,
            "image_hz": 20.0,
            "goal": {"tolerance_lin": 0.05},
            **more,
        }
        self.worker.start(self.config(modules={"robot_path_planner": section}))
        store = self.worker.store
        store.put(MAP, "floor", floor(*ROOMS))
        store.use_map("floor")
        until(lambda: self.told().get("map") == "floor", "the map is taken", 30)
        until(lambda: self.told()["navigator"]["state"] == "idle", "the local navigator is there", 30)

    def told(self) -> dict[str, Any]:
        return self.answer("robot_path_planner")

    def close(self) -> None:
        self.robot.close()
        super().close()


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Planning]:
    made = Planning(tmp_path_factory.mktemp("planner"))
    try:
        yield made
    finally:
        made.close()


@pytest.fixture
def place(running: Planning) -> Planning:
    """The planner with nothing to do, its robot in the west."""
    robot = running.robot
    robot.fails, robot.speed = "", 3.0
    until(lambda: not running.module.planner.active, "it is at rest", 60)
    robot.loop.call(lambda: setattr(robot, "goal", None))
    robot.x, robot.y, robot.yaw = 1.0, 1.0, 0.0
    until(lambda: abs(pose_of(running.module).x - 1.0) < 1e-6, "the robot is in the west", 30)
    robot.asked.clear()
    return running


def pose_of(module: Any) -> Any:
    try:
        return module.pose()
    except RuntimeError:
        return type("Nowhere", (), {"x": math.inf})


def test_a_goal_of_the_hub_is_driven_to_by_waypoints(place: Planning) -> None:
    path = place.far.subscribe(f"{PLANNER}/path", "nav_msgs/Path", latched=True)
    states = place.far.subscribe(f"{PLANNER}/status", STATUS, latched=True)
    markers = place.far.subscribe(f"{PLANNER}/markers", "visualization_msgs/MarkerArray", latched=True)
    place.robot.y = 2.5
    sent = place.robot.send(4.0, 2.5, 1.0)
    assert sent.end()[0] is GoalState.SUCCEEDED
    assert (place.robot.x, place.robot.y, place.robot.yaw) == pytest.approx((4.0, 2.5, 1.0))
    last = place.robot.asked[-1]
    ways = [asked for asked in place.robot.asked if asked[:2] != (4.0, 2.5)]  # a loaded machine may be sent again
    assert ways
    assert all(each[2].through and not each[2].heading for each in ways)
    assert last[2].heading
    assert sent.feedback
    left = [each["distance_remaining"] for each in sent.feedback]
    assert left[0] > left[-1]
    until(lambda: any(len(m["poses"]) > 1 for m in place.far.wait(path, 0, 0)), "the path is told", 20)
    until(lambda: any(len(m["markers"]) == 4 for m in place.far.wait(markers, 0, 0)), "and drawn", 20)

    def reached() -> bool:
        told = place.far.wait(states, 0, 0)
        return bool(told) and told[-1]["state"] == "goal_reached"

    until(reached, "the status tells it", 20)
    moving = next(m for m in place.far.wait(states, 0, 0) if m["state"] == "moving")
    assert base64.b64decode(moving["goal_id"]) == sent.goal.id


def test_without_compiled_kernels_goals_are_refused_with_the_cure(
    place: Planning, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(place.module, "compiled", uncompiled(monkeypatch))
    status, result = place.robot.send(4.0, 1.0).end()
    assert status is GoalState.ABORTED
    assert "not compiled: navigation.some_kernel" in result["error_msg"]
    assert kernels.CURE in result["error_msg"]
    assert kernels.CURE in place.module.health().text
    rpc = place.registered("/robotPathPlanner/rpc")
    with ServiceClient(INavigation2DMsgs, rpc, naming=place.names, timeout=20) as yarp:
        assert not yarp.remote.goto_target_by_absolute_location_RPC(Map2DLocation("floor", 4.0, 1.0, 0.0))
    assert not place.robot.asked


@pytest.mark.parametrize("by", ["action", "YARP"])
def test_a_stop_reaches_who_drives_while_the_planner_plans(place: Planning, by: str) -> None:
    rpc = place.registered("/robotPathPlanner/rpc")
    place.robot.speed, before = 0.1, place.robot.speed
    planned = threading.Event()
    stopping = threading.Thread(target=lambda: None)
    try:
        sent = place.robot.send(4.0, 1.0)
        until(lambda: place.robot.goal and place.robot.goal.status is GoalState.EXECUTING, "it drives", 20)
        place.host.loop.post(lambda: planned.wait(30))  # as a large map keeps it
        if by == "YARP":

            def stop() -> None:
                with ServiceClient(INavigation2DMsgs, rpc, naming=place.names) as client:
                    client.remote.stop_navigation_RPC()

            stopping = threading.Thread(target=stop)
            stopping.start()
        else:
            sent.cancel()
        until(lambda: place.robot.goal and place.robot.goal.status is GoalState.CANCELED, "who drives stops", 20)
        asked = len(place.robot.asked)
        planned.set()
        assert sent.end()[0] is GoalState.CANCELED
        assert len(place.robot.asked) == asked, "it is sent nowhere any more"
    finally:
        planned.set()
        place.robot.speed = before
        if stopping.is_alive():
            stopping.join(30)


def test_a_new_goal_takes_the_place_and_a_cancelled_one_stops(place: Planning) -> None:
    first = place.robot.send(4.0, 1.0)
    until(lambda: place.robot.asked, "it drives", 30)
    second = place.robot.send(1.0, 4.0)
    status, result = first.end()
    assert (status, result["error_msg"]) == (GoalState.CANCELED, "another goal took its place")
    assert second.end()[0] is GoalState.SUCCEEDED
    place.robot.speed = 0.3
    third = place.robot.send(4.0, 4.0)
    until(lambda: place.robot.x > 1.5, "it drives on", 30)
    third.cancel()
    status, result = third.end()
    assert (status, result["error_msg"]) == (GoalState.CANCELED, "cancelled")
    until(lambda: not place.robot.goal or not place.robot.goal.active, "the navigator stopped", 20)
    assert place.robot.x < 3.9


def test_a_cancel_that_stops_the_navigator_late_stops_no_later_goal(
    place: Planning, monkeypatch: pytest.MonkeyPatch
) -> None:
    late: list[Callable[[], None]] = []
    monkeypatch.setattr(place.module._executor, "submit", late.append)
    place.robot.speed = 0.3
    first = place.robot.send(4.0, 1.0)
    until(lambda: place.robot.asked, "it drives", 30)
    first.cancel()
    assert first.end()[0] is GoalState.CANCELED
    until(lambda: not place.robot.goal.active, "the navigator stopped", 20)
    second = place.robot.send(1.0, 4.0)
    until(lambda: place.robot.goal.active, "it drives on", 20)
    (stop,) = late
    stop()
    place.robot.speed = 3.0
    assert second.end()[0] is GoalState.SUCCEEDED


@pytest.mark.parametrize(
    ("goal", "frame", "fault", "said"),
    [
        ((2.5, 2.5), "map", Fault.GOAL_OCCUPIED, "in a wall"),
        ((1.0, 1.0), "moon", Fault.UNKNOWN_FRAME, "moon"),
        ((99.0, 1.0), "map", Fault.OFF_THE_MAP, "off the map"),
        ((math.nan, 1.0), "map", Fault.BAD_GOAL, "finite"),
        ((1e308, 1.0), "map", Fault.BAD_GOAL, "farther than 1e+06 m"),
    ],
)
def test_a_goal_that_cannot_be_says_why(
    place: Planning, goal: tuple[float, float], frame: str, fault: Fault, said: str
) -> None:
    status, result = place.robot.send(*goal, frame=frame).end()
    assert (status, result["error_code"]) == (GoalState.ABORTED, fault)
    assert said in result["error_msg"]


def test_a_goal_in_the_robots_frame_is_turned_into_the_maps(place: Planning) -> None:
    place.robot.yaw = math.pi / 2
    until(lambda: pose_of(place.module).theta > 1.5, "the robot has turned", 20)
    assert place.robot.send(1.0, 0.0, frame="base_link").end()[0] is GoalState.SUCCEEDED
    assert (place.robot.x, place.robot.y) == pytest.approx((1.0, 2.0), abs=0.01)


def test_yarp_asks_clicks_and_sees(place: Planning) -> None:
    names, robot = place.names, place.robot
    port = place.registered("/robotPathPlanner/rpc")
    with Client(port, naming=names) as words:
        assert words.ask(["get_robot_radius"]) == [0.2]
        assert words.ask(["set_robot_radius", 0.21]) == ["ok"]
        assert words.ask(["get_robot_radius"]) == [0.21]
        assert words.ask(["set_robot_radius", 0.2]) == ["ok"]
        assert "one number" in words.ask(["set_robot_radius", "wide"])[1]
    with ServiceClient(INavigation2DMsgs, port, naming=names) as client:
        assert client.remote.goto_target_by_absolute_location_RPC(Map2DLocation("floor", 1.0, 4.0, 90.0))
        until(lambda: robot.y > 3.99, "it is there", 30)
        reached = NavigationStatusEnum.navigation_status_goal_reached
        until(lambda: client.remote.get_navigation_status_RPC()[1] is reached, "YARP hears of it", 20)
        for kind in TrajectoryTypeEnum:
            assert not client.remote.get_all_navigation_waypoints_RPC(kind)[1].waypoints
        assert not client.remote.resume_navigation_RPC()
        assert client.remote.stop_navigation_RPC()
        idle = NavigationStatusEnum.navigation_status_idle
        until(lambda: client.remote.get_navigation_status_RPC()[1] is idle, "a stop forgets how it ended", 20)
    with (
        Reader("/test/view", naming=names) as view,
        Reader("/test/status", naming=names) as status,
        Writer("/test/clicks", naming=names) as clicks,
    ):
        connections.connect(names, place.registered("/robotPathPlanner/map:o"), "/test/view")
        connections.connect(names, place.registered("/robotPathPlanner/plannerStatus:o"), "/test/status")
        connections.connect(names, "/test/clicks", place.registered("/robotPathPlanner/yarpviewTarget:i"))
        clicks.write(["nowhere"])

        def refused() -> bool:
            ports = {port["port"]: port for port in place.told()["ports"]}
            return "is neither" in str(ports["/robotPathPlanner/yarpviewTarget:i"]["error"])

        until(refused, "what is no click is counted", 20)
        clicks.write([80, 80, 80, 60])  # a drag upwards, from row 80 of 100

        until(lambda: robot.x == pytest.approx(4.025) and robot.yaw == pytest.approx(math.pi / 2), "the drag", 30)
        assert robot.y == pytest.approx(0.975)
        until(
            lambda: (said := status.read_now()) is not None and "navigation_status" in str(said.values),
            "its status",
            20,
        )
        seen: list[ImageRgb] = []

        def shown() -> bool:
            received = view.read_now()
            if received is not None:
                seen.append(received.to(ImageRgb))
            return bool(seen)

        until(shown, "a picture comes", 20)
        assert (seen[0].width(), seen[0].height()) == (100, 100)
    answer = place.far.hub.ask("picture", {}, worker="robot_path_planner", timeout=20.0)[0].value
    image = np.asarray(Image.open(io.BytesIO(base64.b64decode(answer["png"]))).convert("RGB"))
    assert image.shape == (600, 600, 3)
    assert (image == (0, 0, 0)).all(axis=2).any()
    assert (image == (0, 120, 0)).all(axis=2).any(), "the robot is on it"


def test_a_navigator_that_fails_is_said(place: Planning) -> None:
    place.robot.fails = "somebody is too near"
    sent = place.robot.send(4.0, 1.0)
    until(lambda: place.module.planner.recoveries, "it tries again", 30)
    assert "somebody is too near" in place.module.planner.status.reason
    place.robot.fails = ""
    assert sent.end()[0] is GoalState.SUCCEEDED


def test_a_step_that_fails_stops_the_robot_and_ends_the_goal(place: Planning, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, planner = place.robot, place.module.planner
    robot.speed = 0.1
    try:
        sent = robot.send(4.0, 1.0)
        until(lambda: robot.goal and robot.goal.status is GoalState.EXECUTING, "it drives", 20)

        def step(*_: Any) -> None:
            raise ZeroDivisionError("of the test")

        with monkeypatch.context() as patch:
            patch.setattr(planner, "step", step)
            status, result = sent.end()
        assert (status, result["error_code"]) == (GoalState.ABORTED, Fault.OTHER)
        assert result["error_msg"] == "RobotPathPlanner failed: ZeroDivisionError: of the test"
        until(lambda: robot.goal and not robot.goal.active, "it stands", 20)
    finally:
        robot.speed = 3.0
    assert robot.send(4.0, 1.0).end()[0] is GoalState.SUCCEEDED


def test_a_navigator_that_pauses_in_a_deadlock_is_heard_and_told_to_go_on(place: Planning) -> None:
    robot, planner, reason = place.robot, place.module.planner, "deadlock: no progress for 20 s"
    robot.speed = 0.0
    try:
        sent = robot.send(4.0, 1.0)
        until(lambda: robot.goal and robot.goal.status is GoalState.EXECUTING, "it is to drive", 20)

        def paused() -> bool:
            robot.says(State.PAUSED, reason)  # again: on a loaded machine it may have been sent again
            return bool(planner.status[:2] == (State.PAUSED, reason))

        until(paused, "the planner hears that it paused", 20)
    finally:
        robot.speed = 3.0
    place.host.loop.call(planner.resume)
    assert sent.end()[0] is GoalState.SUCCEEDED


def test_yarp_has_a_path_followed_and_sees_the_way(place: Planning) -> None:
    port = place.registered("/robotPathPlanner/rpc")
    places = [Map2DLocation("floor", 4.0, 1.0, 0.0), Map2DLocation("floor", 4.0, 4.0, 90.0)]
    with ServiceClient(INavigation2DMsgs, port, naming=place.names) as client:
        assert client.remote.follow_path_RPC(Map2DPath(places))
        until(lambda: place.robot.x > 3.99, "it is at the first", 30)
        until(lambda: place.robot.y > 3.99 and not place.module.planner.active, "and at the second", 30)
        headed = [asked[:2] for asked in place.robot.asked if asked[2].heading]
        assert list(dict.fromkeys(headed)) == [(4.0, 1.0), (4.0, 4.0)]
        place.robot.speed = 0.0
        try:
            assert client.remote.goto_target_by_absolute_location_RPC(places[0])
            until(lambda: place.module.planner.waypoints, "there is a way", 20)
            way = client.remote.get_all_navigation_waypoints_RPC(TrajectoryTypeEnum.global_trajectory)[1]
            assert (way.waypoints[-1].map_id, way.waypoints[-1].x, way.waypoints[-1].y) == ("floor", 4.0, 1.0)
            here = client.remote.get_current_nav_waypoint_RPC()[1]
            assert (here.x, here.y) == (way.waypoints[0].x, way.waypoints[0].y)
            target = client.remote.get_absolute_location_of_current_target_RPC()[1]
            assert (target.x, target.y) == (4.0, 1.0)
            found, grid = client.remote.get_current_navigation_map_RPC(NavigationMapTypeEnum.local_map)
            assert found
            assert (grid.m_map_name, grid.width(), grid.height()) == ("floor", 100, 100)
        finally:
            place.robot.speed = 3.0
            assert client.remote.stop_navigation_RPC()


def test_a_navigator_that_sees_nothing_ends_the_goal(place: Planning) -> None:
    place.robot.fails, place.robot.code = "the laser is silent", Fault.NO_LASER
    try:
        sent = place.robot.send(1.5, 1.0)
        assert sent.end() == (GoalState.ABORTED, {"error_code": Fault.NO_LASER, "error_msg": "the laser is silent"})
    finally:
        place.robot.fails, place.robot.code = "", Fault.BLOCKED
    assert len(place.robot.asked) == 1


def test_the_map_comes_by_a_topic_and_the_laser_shows_what_it_lacks(tmp_path: Path) -> None:
    with Place(tmp_path) as place:
        robot = Robot(place.far.hub, place.far.registry)
        maps = robot.node.publisher("/map", "nav_msgs/msg/OccupancyGrid", LATCHED, priority="state")
        scans = robot.node.publisher("/scan", "sensor_msgs/msg/LaserScan")

        def look() -> None:
            """A closed door at x 2.5, y 1."""
            angles = np.arange(-200, 201) * 0.005 - robot.yaw
            to_door = (2.5 - robot.x) / np.cos(angles + robot.yaw)
            seen = np.abs(robot.y + np.tan(angles + robot.yaw) * (2.5 - robot.x) - 1.0) < 0.4
            header = {"stamp": SYSTEM.stamp(), "frame_id": "base_link"}
            scans.publish({
                "header": header, "angle_min": float(angles[0]), "angle_max": float(angles[-1]),
                "angle_increment": 0.005, "range_min": 0.05, "range_max": 10.0,
                "ranges": np.where(seen & (to_door > 0), to_door, np.inf).astype(np.float32),
            })  # fmt: skip

        timer = robot.loop.every(0.05, look)
        try:
            maps.publish(to_grid(floor(*ROOMS)))
            section = {"enabled": True, "robot_radius": 0.2, "map": "/map", "prefix": "", "patience": 0.0}
            place.worker.start(place.config(modules={"robot_path_planner": section}))
            until(lambda: place.answer("robot_path_planner")["map"] == "map", "the map has come", 30)
            robot.speed, robot.y = 0.1, 2.3
            until(lambda: robot.client.ready, "the planner is there", 30)
            sent = robot.send(4.0, 2.3)
            until(lambda: any(y > 3.5 for _, y, _ in robot.asked), "it goes round by the other door", 30)
            sent.cancel()
            sent.end()
        finally:
            timer.close()
            robot.close()


def test_a_layer_of_the_hub_is_waited_for_and_planned_around(tmp_path: Path) -> None:
    place = Planning(tmp_path, obstacles=[{"topic": "/layer", "timeout": 0.5}])
    try:
        end = place.far.advertise("/layer", "nav_msgs/OccupancyGrid", latched=True)
        sent = place.robot.send(4.0, 1.0)
        status = lambda: place.module.planner.status.reason  # noqa: E731
        until(lambda: status() == "the layer /layer has not come yet", "it waits for the layer", 30)
        info = {"resolution": 0.1, "width": 7, "height": 11, "origin": {"position": {"x": 1.5, "y": 0.5}}}
        place.far.publish(end, {"header": {"frame_id": "map"}, "info": info, "data": [100]})
        until(lambda: "7 x 11 cells does not have 1" in place.module.health().text, "it says what is wrong", 30)
        assert not place.robot.asked
        # before the low door: a table
        place.far.publish(end, {"header": {"frame_id": "map"}, "info": info, "data": [100] * 77})
        assert sent.end()[0] is GoalState.SUCCEEDED
        assert max(y for _, y, _ in place.robot.asked) > 1.7
        assert place.module.health().state == "running"  # latched, it says no more as nothing changes
    finally:
        place.close()


def test_a_layer_that_falls_silent_stops_the_robot_until_it_is_heard(tmp_path: Path) -> None:
    place = Planning(tmp_path, obstacles=[{"topic": "/layer", "timeout": 0.5}])
    robot, planner = place.robot, place.module.planner
    layers = robot.node.publisher("/layer", "nav_msgs/msg/OccupancyGrid", LATCHED, priority="state")
    info = {"resolution": 0.1, "width": 1, "height": 1, "origin": {"position": {"x": 4.5, "y": 4.5}}}
    say = lambda: layers.publish({"header": {"frame_id": "map"}, "info": info, "data": [0]})  # noqa: E731
    try:
        timer = robot.loop.every(0.05, say)
        robot.speed = 0.02
        sent = robot.send(4.0, 1.0)
        until(lambda: robot.goal and robot.goal.status is GoalState.EXECUTING, "it drives", 30)
        until(lambda: place.module._layers._going_on, "the layer is said again and again", 30)
        robot.loop.call(timer.close)
        until(lambda: robot.goal and robot.goal.status is GoalState.CANCELED, "who drives stops", 30)
        until(lambda: planner.status.fault is Fault.NO_LASER, "it says why", 30)
        assert "the layer /layer is silent: it said nothing for" in planner.status.reason
        assert "layer /layer is silent" in place.module.health().text
        robot.speed = 3.0
        timer = robot.loop.every(0.05, say)
        assert sent.end()[0] is GoalState.SUCCEEDED
        robot.loop.call(timer.close)
    finally:
        place.close()
