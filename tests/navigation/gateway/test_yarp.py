"""YARP clients of the gateway's `INavigation2D` ports."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from bridge.hub.wire.qos import Qos
from bridge.stores.kinds import MAP
from navigation.gateway import velocities as commands
from navigation.maps.grid import to_grid
from navigation.messages import NAVIGATE
from navigation.status import State
from tests.peers.hub.node import HubNode
from tests.peers.navigation.gateway import LATCHED, ClientGoal, Rig, patient, pose
from tests.peers.zenoh.release_actions import ReleaseActionServer
from tests.peers.zenoh.releases import LYRICAL, ReleaseNode
from tests.support.wait import until
from yarp_compat.dev.client import ServiceClient
from yarp_compat.dev.inavigation2d import (
    INavigation2DMsgs,
    NavigationMapTypeEnum,
    NavigationStatusEnum,
    TrajectoryTypeEnum,
)
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.naming import connections
from yarp_compat.pythonic import Reader

TF = "tf2_msgs/msg/TFMessage"
PAUSE = 2 * commands._PAUSE_SECONDS
"""Seconds between two velocities of a client that may have been stopped while it drove, for example by `Rig.fresh`."""


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    lyrical = {"name": "lyrical", "side": "zenoh", "action": "/planner/lyrical/navigate_to_pose"}
    with patient(), Rig(tmp_path_factory.mktemp("gateway"), planners=[lyrical]) as rig:
        store = rig.worker.store
        store.put(MAP, "house", MapGrid2D.of([[0] * 4] * 3, name="house"))
        store.use_map("house")
        frames = rig.client.node.publisher("/tf", TF, Qos(depth=10))
        # the robot stands at (1, 2) and faces along y
        rotation = {"z": math.sin(math.pi / 4), "w": math.cos(math.pi / 4)}
        transform = {"translation": {"x": 1.0, "y": 2.0}, "rotation": rotation}

        def publish_pose() -> None:
            header = {"stamp": rig.client.node.clock.stamp(), "frame_id": "map"}
            frames.publish({"transforms": [{"header": header, "child_frame_id": "base_link", "transform": transform}]})

        rig.client.loop.every(0.1, publish_pose)
        until(rig.gateway.robot, "the gateway has the robot's pose", 20)
        yield rig


@pytest.fixture
def rig(running: Rig) -> Rig:
    running.fresh()
    return running


@pytest.fixture(scope="module")
def yarp(running: Rig) -> Iterator[INavigation2DMsgs]:
    with ServiceClient(INavigation2DMsgs, "/navigationServer/rpc", naming=running.names, timeout=20) as client:
        yield client.remote


def place(goal: object) -> tuple[float, float, float]:
    """Return x, y (m) and heading (degrees) of a planner's goal."""
    target = goal.goal["pose"]["pose"]  # type: ignore[attr-defined]
    position, q = target["position"], target["orientation"]
    return position["x"], position["y"], math.degrees(2 * math.atan2(q["z"], q["w"]))


def test_a_goto_reports_its_status_and_its_target(rig: Rig, yarp: INavigation2DMsgs) -> None:
    with Reader("/test/status:i", strict=True, naming=rig.names) as reader:
        connections.connect(rig.names, "/navigation2D_nws_yarp/status:o", reader.name)
        assert yarp.goto_target_by_absolute_location_and_set_name_RPC(Map2DLocation("house", 3.0, 1.0, 90.0), "kitchen")
        goal = rig.planner.until(1)
        assert place(goal) == pytest.approx((3.0, 1.0, 90.0))
        rig.state(State.MOVING)
        assert yarp.get_navigation_status_RPC()[1] is NavigationStatusEnum.navigation_status_moving
        assert yarp.get_name_of_current_target_RPC()[1] == "kitchen"
        target = yarp.get_absolute_location_of_current_target_RPC()[1]
        assert (target.map_id, target.x, target.y, target.theta) == ("house", 3.0, 1.0, pytest.approx(90.0))
        relative = yarp.get_relative_location_of_current_target_RPC
        # the robot's pose is unknown while its transform is late
        until(lambda: relative()[1:] == pytest.approx((-1.0, -2.0, 0.0)), "the target is behind the robot", 20)
        rig.planner.reach(goal)
        rig.state(State.REACHED)
        assert yarp.get_navigation_status_RPC()[1] is NavigationStatusEnum.navigation_status_goal_reached
        status = ""
        while status != "navigation_status_goal_reached":
            status = reader.read().values[0]  # type: ignore[union-attr]
    assert not yarp.get_absolute_location_of_current_target_RPC()[0]


def test_nav2_of_lyrical_drives_for_a_yarp_client(rig: Rig, yarp: INavigation2DMsgs) -> None:
    """NavigateToPose of Lyrical has more fields."""
    node = ReleaseNode(rig.hubs.endpoint, rig.hubs.domain, "bt_navigator", LYRICAL)
    nav2 = ReleaseActionServer(node, "/planner/lyrical/navigate_to_pose", NAVIGATE, {"distance_remaining": 1.0}, {})
    assert rig.ask("choose_planner", name="lyrical")["success"]
    try:
        until(lambda: rig.gateway.planner == "lyrical" and rig.gateway.link.reachable, "Nav2 is reachable", 20)
        assert yarp.goto_target_by_absolute_location_RPC(Map2DLocation("house", 3.0, 1.0, 90.0))
        rig.state(State.REACHED)
        assert nav2.goals[-1]["goal"]["pose"]["pose"]["position"]["x"] == 3.0
        assert yarp.get_navigation_status_RPC()[1] is NavigationStatusEnum.navigation_status_goal_reached
    finally:
        rig.ask("choose_planner", name="robot_goto")
        nav2.close()
        node.close()
    until(
        lambda: rig.gateway.planner == "robot_goto" and rig.gateway.link.reachable,
        "the planner robot_goto is reachable",
        20,
    )


def test_a_relative_target_is_in_the_robots_frame(rig: Rig, yarp: INavigation2DMsgs) -> None:
    # the robot's pose is unknown while its transform is late
    until(lambda: yarp.goto_target_by_relative_location2_RPC(1.0, 0.0, 90.0), "the goal is accepted", 20)
    goal = rig.planner.until(1)
    assert place(goal)[:2] == pytest.approx((1.0, 3.0))
    assert abs(place(goal)[2]) == pytest.approx(180.0)
    until(lambda: yarp.goto_target_by_relative_location1_RPC(1.0, 0.0), "the goal is accepted", 20)
    goal = rig.planner.until(2)
    assert place(goal)[:2] == pytest.approx((1.0, 3.0))
    assert goal.goal["behavior_tree"] == "midspan: heading=false"


def test_a_path_is_followed_goal_by_goal_through_a_pause(rig: Rig, yarp: INavigation2DMsgs) -> None:
    path = Map2DPath([Map2DLocation("house", float(x), 0.0, 0.0) for x in (1, 2, 3)])
    assert yarp.follow_path_RPC(path)
    rig.planner.reach(rig.planner.until(1))
    assert place(rig.planner.until(2))[0] == 2.0
    assert yarp.suspend_navigation_RPC(math.inf)
    rig.state(State.PAUSED)
    waypoints = yarp.get_all_navigation_waypoints_RPC(TrajectoryTypeEnum.global_trajectory)[1]
    assert [waypoint.x for waypoint in waypoints] == [2.0, 3.0]
    assert yarp.resume_navigation_RPC()
    rig.planner.reach(rig.planner.until(3))
    rig.planner.reach(rig.planner.until(4))
    rig.state(State.REACHED)
    assert [place(goal)[0] for goal in rig.planner.goals] == [1.0, 2.0, 2.0, 3.0]


def test_a_timed_suspension_ends_by_itself_and_the_path_can_be_recomputed(rig: Rig, yarp: INavigation2DMsgs) -> None:
    assert yarp.goto_target_by_absolute_location_RPC(Map2DLocation("house", 3.0, 1.0, 0.0))
    rig.planner.until(1)
    assert yarp.suspend_navigation_RPC(0.3)
    rig.planner.until(2)
    assert yarp.recompute_current_navigation_path_RPC()
    rig.planner.until(3)
    rig.state(State.MOVING)
    assert yarp.stop_navigation_RPC()
    idle = NavigationStatusEnum.navigation_status_idle
    until(lambda: yarp.get_navigation_status_RPC()[1] is idle, "the status is idle", 20)
    assert not yarp.recompute_current_navigation_path_RPC()
    assert not yarp.resume_navigation_RPC()


def test_a_halt_ends_a_timed_suspension_for_good(rig: Rig, yarp: INavigation2DMsgs) -> None:
    assert yarp.goto_target_by_absolute_location_RPC(Map2DLocation("house", 3.0, 1.0, 0.0))
    goal = rig.planner.until(1)
    assert yarp.suspend_navigation_RPC(60.0)
    until(lambda: not goal.active, "the planner stopped", 20)
    rig.state(State.PAUSED)
    assert [answer.value for answer in rig.far.hub.ask("halt", {}, worker="gateway", timeout=20.0)] == [
        {"halted": True}
    ]
    rig.state(State.IDLE, "it was stopped")
    assert rig.gateway.execution._pause is None
    assert not yarp.resume_navigation_RPC()


def test_another_clients_goal_is_reported_and_can_be_stopped(rig: Rig, yarp: INavigation2DMsgs) -> None:
    client_goal = ClientGoal(rig.client, pose(4.0))
    rig.planner.until(1)
    rig.state(State.MOVING)
    assert yarp.get_absolute_location_of_current_target_RPC()[1].x == 4.0
    assert yarp.get_name_of_current_target_RPC()[1] == ""
    assert yarp.stop_navigation_RPC()
    assert client_goal.end() == ("CANCELED", "it was stopped")


def test_the_path_and_the_maps_are_returned(rig: Rig, yarp: INavigation2DMsgs) -> None:
    assert yarp.goto_target_by_absolute_location_RPC(Map2DLocation("house", 5.0, 2.0, 0.0))
    rig.planner.until(1)
    out = rig.planner.node.publisher("/planner/robot_goto/path", "nav_msgs/msg/Path", LATCHED)
    out.publish({"header": {"frame_id": "map"}, "poses": [pose(float(x), 2.0) for x in range(6)]})
    until(lambda: len(yarp.get_all_navigation_waypoints_RPC(TrajectoryTypeEnum.global_trajectory)[1].waypoints) == 6,
          "the gateway returns the path", 20)  # fmt: skip
    # the robot's pose is unknown while its transform is late
    until(lambda: yarp.get_current_nav_waypoint_RPC()[1].x == 2.0, "the next waypoint is 1 m ahead", 20)
    grid = yarp.get_current_navigation_map_RPC(NavigationMapTypeEnum.global_map)[1]
    assert (grid.name, grid.m_width, grid.m_height) == ("house", 4, 3)
    local = rig.planner.node.publisher("/planner/robot_goto/local_map", "nav_msgs/msg/OccupancyGrid", LATCHED)
    local.publish(to_grid(MapGrid2D.of([[0] * 7] * 7)))
    kind = NavigationMapTypeEnum.local_map
    until(lambda: yarp.get_current_navigation_map_RPC(kind)[1].m_width == 7, "the gateway returns the local map", 20)
    assert len(yarp.get_all_navigation_waypoints_RPC(TrajectoryTypeEnum.local_trajectory)[1].waypoints) == 6
    assert not yarp.goto_target_by_absolute_location_RPC(Map2DLocation("cellar", 1.0, 2.0))  # this map is missing
    rig.state(State.MOVING)


@pytest.fixture
def base(rig: Rig) -> Iterator[HubNode]:
    with HubNode(rig.hubs.settings("base")) as node:
        yield node


def test_velocities_have_the_form_of_the_base(base: HubNode, yarp: INavigation2DMsgs) -> None:
    velocities: list[dict[str, Any]] = []
    base.node.subscription("/cmd_vel", "geometry_msgs/msg/TwistStamped", velocities.append)

    def commanded() -> dict[str, Any] | None:
        yarp.apply_velocity_command_RPC(0.2, 0.0, 90.0, 0.2)
        return next((velocity for velocity in velocities if velocity["twist"]["linear"]["x"]), None)

    velocity = until(commanded, "a velocity is published", 20, PAUSE)
    assert (velocity["header"]["frame_id"], velocity["twist"]["linear"]["x"]) == ("base_link", 0.2)
    assert velocity["header"]["stamp"]["sec"]
    until(lambda: velocities[-1]["twist"]["linear"]["x"] == 0.0, "the command has expired", 20)


def test_velocities_are_commanded_while_no_goal_is_active(
    rig: Rig, base: HubNode, yarp: INavigation2DMsgs, monkeypatch: pytest.MonkeyPatch
) -> None:
    velocities: list[tuple[float, float]] = []
    base.node.subscription(
        "/cmd_vel", "geometry_msgs/msg/Twist", lambda m: velocities.append((m["linear"]["x"], m["angular"]["z"]))
    )
    given = (0.2, pytest.approx(math.pi / 2))  # the first velocities may be zeros that end an earlier command
    until(
        lambda: yarp.apply_velocity_command_RPC(0.2, 0.0, 90.0, 0.2) and given in velocities,
        "the velocity is published",
        20,
        PAUSE,
    )
    until(lambda: velocities[-1] == (0.0, 0.0), "the command has expired", 20)
    until(lambda: not yarp.get_last_velocity_command_RPC()[0], "no command is active", 20)
    monkeypatch.setattr(commands, "LONGEST_SECONDS", 600.0)  # from here on, no command expires during the test
    until(lambda: yarp.apply_velocity_command_RPC(0.2, 0.0, 90.0, 600.0), "the command is accepted", 20)
    assert yarp.get_last_velocity_command_RPC()[1:] == (0.2, 0.0, 90.0)
    assert rig.ask("stop")["success"]
    assert not yarp.get_last_velocity_command_RPC()[0]
    until(lambda: velocities[-1] == (0.0, 0.0), "the base stops", 20)
    assert not yarp.apply_velocity_command_RPC(0.3, 0.0, 90.0, 0.2)
    until(lambda: yarp.apply_velocity_command_RPC(0.3, 0.0, 90.0, 0.2), "it drives after a pause", 20, PAUSE)
    until(lambda: yarp.apply_velocity_command_RPC(0.3, 0.0, 90.0, 600.0), "the command is accepted", 20)
    until(lambda: velocities[-1][0] == 0.3, "the command is published", 20)
    assert yarp.goto_target_by_absolute_location_RPC(Map2DLocation("house", 3.0, 1.0, 0.0))
    rig.planner.until(1)
    rig.state(State.MOVING)
    until(lambda: velocities[-1] == (0.0, 0.0), "only the planner commands the base", 20)
    assert not yarp.get_last_velocity_command_RPC()[0]
    assert not yarp.apply_velocity_command_RPC(0.2, 0.0, 0.0, 0.2)


@pytest.mark.parametrize("how", ["nav stop", "halt", "stopNavigation"])
def test_a_client_that_repeats_its_velocity_does_not_drive_after_a_stop(
    rig: Rig, yarp: INavigation2DMsgs, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    until(lambda: yarp.apply_velocity_command_RPC(0.2, 0.0, 0.0, 0.2), "the client drives", 20, PAUSE)
    monkeypatch.setattr(commands, "LONGEST_SECONDS", 600.0)  # on a busy machine, a second passes between two commands
    until(lambda: yarp.apply_velocity_command_RPC(0.2, 0.0, 0.0, 600.0), "the client drives on", 20)
    if how == "nav stop":
        rig.ask("stop")
    elif how == "halt":
        rig.far.hub.ask("halt", {}, worker="gateway", timeout=20.0)
    else:
        yarp.stop_navigation_RPC()
    for _ in range(3):
        assert not yarp.apply_velocity_command_RPC(0.2, 0.0, 0.0, 600.0)
    assert not yarp.get_last_velocity_command_RPC()[0]
    assert not yarp.apply_velocity_command_RPC(0.2, 0.0, 0.0, 0.0)
    until(lambda: yarp.apply_velocity_command_RPC(0.2, 0.0, 0.0, 0.0), "it drives after a pause", 20, PAUSE)


def test_a_stall_of_the_gateway_after_a_stop_is_no_pause_of_a_client(
    rig: Rig, yarp: INavigation2DMsgs, monkeypatch: pytest.MonkeyPatch
) -> None:
    until(lambda: yarp.apply_velocity_command_RPC(0.2, 0.0, 0.0, 0.2), "the client drives", 20, PAUSE)
    monkeypatch.setattr(commands, "LONGEST_SECONDS", 600.0)  # on a busy machine, a second passes between two commands
    until(lambda: yarp.apply_velocity_command_RPC(0.2, 0.0, 0.0, 600.0), "the client drives on", 20)
    stop = rig.far.call("/navigation/stop", "std_srvs/Trigger")
    refused = lambda: not yarp.apply_velocity_command_RPC(0.2, 0.0, 0.0, 3.0)  # noqa: E731
    until(lambda: refused() and stop.result(0.0)["done"], "the robot is stopped", 20)
    never, over = threading.Event(), threading.Event()
    rig.module._host.loop.post(lambda: (never.wait(3.5), over.set()))
    while not over.is_set():
        assert refused()
    for _ in range(3):
        assert refused()


def test_a_client_that_repeats_its_velocity_does_not_drive_after_the_planner(
    rig: Rig, yarp: INavigation2DMsgs, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commands, "LONGEST_SECONDS", 600.0)  # on a busy machine, a second passes between two commands
    assert yarp.goto_target_by_absolute_location_RPC(Map2DLocation("house", 3.0, 1.0, 0.0))
    goal = rig.planner.until(1)
    rig.state(State.MOVING)
    assert not yarp.apply_velocity_command_RPC(0.2, 0.0, 0.0, 600.0)
    rig.planner.reach(goal)
    rig.state(State.REACHED)
    for _ in range(3):
        assert not yarp.apply_velocity_command_RPC(0.2, 0.0, 0.0, 600.0)
    assert not yarp.apply_velocity_command_RPC(0.2, 0.0, 0.0, 0.0)
    until(lambda: yarp.apply_velocity_command_RPC(0.2, 0.0, 0.0, 0.0), "it drives after a pause", 20, PAUSE)
