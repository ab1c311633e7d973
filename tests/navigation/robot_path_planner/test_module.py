"""The module on a hub, with YARP, and with a local navigator that drives straight to each goal."""

from __future__ import annotations

import base64
import io
import math
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image

from bridge import kernels
from bridge.messages.actions import GoalState
from navigation.messages import THROUGH
from navigation.status import Fault, State
from tests.navigation.uncompiled import uncompiled
from tests.peers.navigation.gateway import pose
from tests.peers.navigation.planning import PLANNER, Planning, pose_of
from tests.peers.navigation.served import STATUS
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


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Planning]:
    with Planning(tmp_path_factory.mktemp("planner")) as planning:
        yield planning


@pytest.fixture
def place(running: Planning) -> Planning:
    """The idle planner, with its robot in the western room."""
    robot = running.robot
    robot.fails, robot.speed = "", 3.0
    until(lambda: not running.module.planner.active, "the planner is idle", 60)
    robot.loop.call(lambda: setattr(robot, "goal", None))
    running.put(1.0, 1.0)
    robot.asked.clear()
    return running


def test_a_hub_goal_of_several_poses_is_driven_without_stops(place: Planning) -> None:
    robot, ends, left = place.robot, list[tuple[GoalState, Any]](), set[int]()
    client = robot.loop.call(lambda: robot.node.action_client(f"{PLANNER}/navigate_through_poses", THROUGH))
    until(lambda: client.ready, "the action is served", 20)
    robot.speed = 1.0

    def send(goal: dict[str, Any]) -> None:
        robot.loop.call(
            lambda: client.send(
                goal,
                lambda sent, result, _why: ends.append((sent.status, result)),
                lambda feedback: left.add(feedback["number_of_poses_remaining"]),
            )
        )

    send({"poses": [pose(2.0, 1.0, yaw=1.0), pose(1.0, 2.0, yaw=1.5)]})
    until(lambda: ends, "the goal ends", 60)
    assert ends[-1][0] is GoalState.SUCCEEDED
    assert (robot.x, robot.y, robot.yaw) == pytest.approx((1.0, 2.0, 1.5))
    assert left == {1, 2}
    assert {constraints.through for x, y, constraints in robot.asked if (x, y) == (2.0, 1.0)} == {True}
    send({"poses": []})
    until(lambda: len(ends) > 1, "the goal ends", 20)
    assert ends[-1] == (
        GoalState.ABORTED,
        {"error_code": int(Fault.BAD_GOAL), "error_msg": "the goal has 0 poses; send 1 to 1000"},
    )
    robot.loop.call(client.close)


def test_a_hub_goal_is_reached_through_waypoints(place: Planning) -> None:
    path = place.far.subscribe(f"{PLANNER}/path", "nav_msgs/Path", latched=True)
    states = place.far.subscribe(f"{PLANNER}/status", STATUS, latched=True)
    markers = place.far.subscribe(f"{PLANNER}/markers", "visualization_msgs/MarkerArray", latched=True)
    place.put(1.0, 2.5)
    sent = place.robot.send(4.0, 2.5, 1.0)
    assert sent.end()[0] is GoalState.SUCCEEDED
    assert (place.robot.x, place.robot.y, place.robot.yaw) == pytest.approx((4.0, 2.5, 1.0))
    *waypoints, last = [constraints for _, _, constraints in place.robot.asked]
    assert waypoints
    assert all(waypoint.through and not waypoint.heading for waypoint in waypoints)
    assert last.heading
    assert sent.feedback
    distances = [feedback["distance_remaining"] for feedback in sent.feedback]
    assert distances[0] > distances[-1]
    until(lambda: any(len(m["poses"]) > 1 for m in place.far.wait(path, 0, 0)), "the path is published", 20)
    until(lambda: any(len(m["markers"]) == 4 for m in place.far.wait(markers, 0, 0)), "the markers are published", 20)

    def reached() -> bool:
        statuses = place.far.wait(states, 0, 0)
        return bool(statuses) and statuses[-1]["state"] == "goal_reached"

    until(reached, "the status is goal_reached", 20)
    moving = next(m for m in place.far.wait(states, 0, 0) if m["state"] == "moving")
    assert base64.b64decode(moving["goal_id"]) == sent.goal.id


def test_without_compiled_kernels_goals_are_refused_with_the_cure(
    place: Planning, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(place.module, "compiled", uncompiled(monkeypatch))
    status, result = place.robot.send(4.0, 1.0).end()
    assert status is GoalState.ABORTED
    assert "not compiled: navigation.algorithms.stopping" in result["error_msg"]
    assert kernels.CURE in result["error_msg"]
    assert kernels.CURE in place.module.health().text
    rpc = place.registered("/robotPathPlanner/rpc")
    with ServiceClient(INavigation2DMsgs, rpc, naming=place.names, timeout=20) as yarp:
        assert not yarp.remote.goto_target_by_absolute_location_RPC(Map2DLocation("floor", 4.0, 1.0, 0.0))
    assert not place.robot.asked


@pytest.mark.parametrize("by", ["action", "YARP"])
def test_a_stop_reaches_the_navigator_while_the_planner_plans(place: Planning, by: str) -> None:
    rpc = place.registered("/robotPathPlanner/rpc")
    place.robot.speed, speed = 0.1, place.robot.speed
    planned = threading.Event()
    stopping = threading.Thread(target=lambda: None)
    try:
        sent = place.robot.send(4.0, 1.0)
        until(lambda: place.robot.goal and place.robot.goal.status is GoalState.EXECUTING, "the robot drives", 20)
        place.host.loop.post(lambda: planned.wait(30))  # blocks the module's thread as planning on a large map does
        if by == "YARP":

            def stop() -> None:
                with ServiceClient(INavigation2DMsgs, rpc, naming=place.names) as client:
                    client.remote.stop_navigation_RPC()

            stopping = threading.Thread(target=stop)
            stopping.start()
        else:
            sent.cancel()
        until(lambda: place.robot.goal and place.robot.goal.status is GoalState.CANCELED, "the navigator stops", 20)
        count = len(place.robot.asked)
        planned.set()
        assert sent.end()[0] is GoalState.CANCELED
        assert len(place.robot.asked) == count, "the planner sends nothing after the stop"
    finally:
        planned.set()
        place.robot.speed = speed
        if stopping.is_alive():
            stopping.join(30)


def test_clients_of_the_action_can_cancel_the_goal_of_a_yarp_client(place: Planning) -> None:
    robot, rpc = place.robot, place.registered("/robotPathPlanner/rpc")
    robot.speed, speed = 0.1, robot.speed
    until(lambda: robot.client.ready, "the planner is available", 30)
    try:
        with ServiceClient(INavigation2DMsgs, rpc, naming=place.names) as client:
            assert client.remote.goto_target_by_absolute_location_RPC(Map2DLocation("floor", 4.0, 1.0, 0.0))
            until(lambda: robot.goal and robot.goal.status is GoalState.EXECUTING, "the robot drives", 20)
            robot.loop.call(robot.client.cancel)
            until(lambda: robot.goal and robot.goal.status is GoalState.CANCELED, "the navigator stops", 20)
            # the brake stops the navigator before the planner's thread handles the request
            idle = NavigationStatusEnum.navigation_status_idle
            until(lambda: client.remote.get_navigation_status_RPC()[1] is idle, "the status is idle", 20)
    finally:
        robot.speed = speed


def test_a_new_goal_preempts_the_first_and_a_canceled_goal_stops_the_robot(place: Planning) -> None:
    place.robot.speed = 0.3
    first = place.robot.send(4.0, 1.0)
    until(lambda: place.robot.asked, "the robot drives", 30)
    second = place.robot.send(1.0, 4.0)
    status, result = first.end()
    assert (status, result["error_msg"]) == (GoalState.CANCELED, "another goal replaced it")
    place.robot.speed = 3.0
    assert second.end()[0] is GoalState.SUCCEEDED
    place.robot.speed = 0.3
    third = place.robot.send(4.0, 4.0)
    until(lambda: place.robot.x > 1.5, "the robot drives on", 30)
    third.cancel()
    status, result = third.end()
    assert (status, result["error_msg"]) == (GoalState.CANCELED, "canceled")
    until(lambda: not place.robot.goal or not place.robot.goal.active, "the navigator has stopped", 20)
    assert place.robot.x < 3.9


def test_a_delayed_cancel_does_not_stop_a_later_goal(place: Planning, monkeypatch: pytest.MonkeyPatch) -> None:
    late: list[Callable[[], None]] = []
    monkeypatch.setattr(place.module._executor, "submit", late.append)
    place.robot.speed = 0.3
    first = place.robot.send(4.0, 1.0)
    until(lambda: place.robot.asked, "the robot drives", 30)
    first.cancel()
    assert first.end()[0] is GoalState.CANCELED
    until(lambda: not place.robot.goal.active, "the navigator has stopped", 20)
    second = place.robot.send(1.0, 4.0)
    until(lambda: place.robot.goal.active, "the robot drives on", 20)
    (stop,) = late
    stop()
    place.robot.speed = 3.0
    assert second.end()[0] is GoalState.SUCCEEDED


@pytest.mark.parametrize(
    ("goal", "frame", "fault", "reason"),
    [
        ((2.5, 2.5), "map", Fault.GOAL_OCCUPIED, "in a wall"),
        ((1.0, 1.0), "moon", Fault.UNKNOWN_FRAME, "moon"),
        ((99.0, 1.0), "map", Fault.OFF_THE_MAP, "outside the map"),
        ((math.nan, 1.0), "map", Fault.BAD_GOAL, "finite"),
        ((1e308, 1.0), "map", Fault.BAD_GOAL, "farther than 1e+06 m"),
    ],
)
def test_an_impossible_goal_is_aborted_with_the_reason(
    place: Planning, goal: tuple[float, float], frame: str, fault: Fault, reason: str
) -> None:
    status, result = place.robot.send(*goal, frame=frame).end()
    assert (status, result["error_code"]) == (GoalState.ABORTED, fault)
    assert reason in result["error_msg"]


def test_a_goal_in_the_robots_frame_is_transformed_to_the_map(place: Planning) -> None:
    place.robot.yaw = math.pi / 2
    until(lambda: pose_of(place.module).theta > 1.5, "the robot has turned", 20)
    assert place.robot.send(1.0, 0.0, frame="base_link").end()[0] is GoalState.SUCCEEDED
    assert (place.robot.x, place.robot.y) == pytest.approx((1.0, 2.0), abs=0.01)


def test_yarp_rpc_and_clicks_are_handled_and_views_published(place: Planning) -> None:
    names, robot = place.names, place.robot
    port = place.registered("/robotPathPlanner/rpc")
    with Client(port, naming=names) as rpc:
        assert rpc.ask(["get_robot_radius"]) == [0.2]
        assert rpc.ask(["set_robot_radius", 0.21]) == ["ok"]
        assert rpc.ask(["get_robot_radius"]) == [0.21]
        assert rpc.ask(["set_robot_radius", 0.2]) == ["ok"]
        assert "one number" in rpc.ask(["set_robot_radius", "wide"])[1]
    with ServiceClient(INavigation2DMsgs, port, naming=names) as client:
        assert client.remote.goto_target_by_absolute_location_RPC(Map2DLocation("floor", 1.0, 4.0, 90.0))
        until(lambda: robot.y > 3.99, "the robot arrives", 30)
        reached = NavigationStatusEnum.navigation_status_goal_reached
        until(lambda: client.remote.get_navigation_status_RPC()[1] is reached, "the YARP status is goal_reached", 20)
        for kind in TrajectoryTypeEnum:
            assert not client.remote.get_all_navigation_waypoints_RPC(kind)[1].waypoints
        assert not client.remote.resume_navigation_RPC()
        assert client.remote.stop_navigation_RPC()
        idle = NavigationStatusEnum.navigation_status_idle
        until(lambda: client.remote.get_navigation_status_RPC()[1] is idle, "a stop resets the status", 20)
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
            ports = {port["port"]: port for port in place.planner_status()["ports"]}
            return "is neither" in str(ports["/robotPathPlanner/yarpviewTarget:i"]["error"])

        until(refused, "the port reports the invalid click", 20)
        clicks.write([80, 80, 80, 60])  # a drag upwards, from row 80 of 100

        until(
            lambda: robot.x == pytest.approx(4.025) and robot.yaw == pytest.approx(math.pi / 2),
            "the robot reaches the dragged pose",
            30,
        )
        assert robot.y == pytest.approx(0.975)
        until(
            lambda: (received := status.read_now()) is not None and "navigation_status" in str(received.values),
            "the planner's status is published",
            20,
        )
        images: list[ImageRgb] = []

        def image_received() -> bool:
            received = view.read_now()
            if received is not None:
                images.append(received.to(ImageRgb))
            return bool(images)

        until(image_received, "an image of the map arrives", 20)
        assert (images[0].width(), images[0].height()) == (100, 100)
    answer = place.far.hub.ask("picture", {}, worker="robot_path_planner", timeout=20.0)[0].value
    image = np.asarray(Image.open(io.BytesIO(base64.b64decode(answer["png"]))).convert("RGB"))
    assert image.shape == (600, 600, 3)
    assert (image == (0, 0, 0)).all(axis=2).any()
    assert (image == (0, 120, 0)).all(axis=2).any(), "the image shows the robot"


def test_the_status_gives_the_navigators_failure(place: Planning) -> None:
    place.robot.fails = "a person is too close"
    sent = place.robot.send(4.0, 1.0)
    until(lambda: place.module.planner.recoveries, "the planner tries again", 30)
    until(lambda: "a person is too close" in place.module.planner.status.reason, "the status gives the reason", 20)
    place.robot.fails = ""
    assert sent.end()[0] is GoalState.SUCCEEDED


def test_a_step_that_fails_stops_the_robot_and_ends_the_goal(place: Planning, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, planner = place.robot, place.module.planner
    robot.speed = 0.1
    try:
        sent = robot.send(4.0, 1.0)
        until(lambda: robot.goal and robot.goal.status is GoalState.EXECUTING, "the robot drives", 20)

        def step(*_: Any) -> None:
            raise ZeroDivisionError("of the test")

        with monkeypatch.context() as patch:
            patch.setattr(planner, "step", step)
            status, result = sent.end()
        assert (status, result["error_code"]) == (GoalState.ABORTED, Fault.OTHER)
        assert result["error_msg"] == "RobotPathPlanner failed: ZeroDivisionError: of the test"
        until(lambda: robot.goal and not robot.goal.active, "the navigator has stopped", 20)
    finally:
        robot.speed = 3.0
    assert robot.send(4.0, 1.0).end()[0] is GoalState.SUCCEEDED


def test_a_navigator_that_pauses_in_a_deadlock_can_be_resumed(place: Planning) -> None:
    robot, planner, reason = place.robot, place.module.planner, "deadlock: no progress for 20 s"
    robot.speed = 0.0
    try:
        sent = robot.send(4.0, 1.0)
        until(lambda: robot.goal and robot.goal.status is GoalState.EXECUTING, "the navigator has the goal", 20)

        def paused() -> bool:
            robot.report(State.PAUSED, reason)  # repeated: on a loaded machine the planner may have sent the goal twice
            return bool(planner.status[:2] == (State.PAUSED, reason))

        until(paused, "the planner reports the pause", 20)
    finally:
        robot.speed = 3.0
    place.host.loop.call(planner.resume)
    assert sent.end()[0] is GoalState.SUCCEEDED


def test_yarp_follows_a_path_and_reads_its_waypoints(place: Planning) -> None:
    port = place.registered("/robotPathPlanner/rpc")
    places = [Map2DLocation("floor", 4.0, 1.0, 0.0), Map2DLocation("floor", 4.0, 4.0, 90.0)]
    with ServiceClient(INavigation2DMsgs, port, naming=place.names) as client:
        assert client.remote.follow_path_RPC(Map2DPath(places))
        until(lambda: place.robot.x > 3.85, "the first location is passed", 30)
        until(lambda: place.robot.y > 3.99 and not place.module.planner.active, "the second location is reached", 30)
        with_heading = [(x, y) for x, y, constraints in place.robot.asked if constraints.heading]
        assert list(dict.fromkeys(with_heading)) == [(4.0, 4.0)]
        place.robot.speed = 0.0
        try:
            assert client.remote.goto_target_by_absolute_location_RPC(places[0])
            until(lambda: place.module.planner.waypoints, "the planner has a path", 20)
            path = client.remote.get_all_navigation_waypoints_RPC(TrajectoryTypeEnum.global_trajectory)[1].waypoints
            assert (path[-1].map_id, path[-1].x, path[-1].y) == ("floor", 4.0, 1.0)
            current = client.remote.get_current_nav_waypoint_RPC()[1]
            assert (current.x, current.y) == (path[0].x, path[0].y)
            target = client.remote.get_absolute_location_of_current_target_RPC()[1]
            assert (target.x, target.y) == (4.0, 1.0)
            available, grid = client.remote.get_current_navigation_map_RPC(NavigationMapTypeEnum.local_map)
            assert available
            assert (grid.m_map_name, grid.width(), grid.height()) == ("floor", 100, 100)
        finally:
            place.robot.speed = 3.0
            assert client.remote.stop_navigation_RPC()


def test_a_navigator_without_laser_ends_the_goal(place: Planning) -> None:
    place.robot.fails, place.robot.code = "the laser is silent", Fault.NO_LASER
    try:
        sent = place.robot.send(1.5, 1.0)
        assert sent.end() == (GoalState.ABORTED, {"error_code": Fault.NO_LASER, "error_msg": "the laser is silent"})
    finally:
        place.robot.fails, place.robot.code = "", Fault.BLOCKED
    assert len(place.robot.asked) == 1
