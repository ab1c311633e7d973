"""YARP's clients at the gateway's door, as `INavigation2D` has it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

from bridge.hub.wire.qos import Qos
from bridge.stores.kinds import MAP
from navigation.maps.grid import to_grid
from navigation.status import State
from tests.navigation.gateway.rig import LATCHED, Asked, Rig, pose
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


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with Rig(tmp_path_factory.mktemp("gateway")) as made:
        store = made.worker.store
        store.put(MAP, "house", MapGrid2D.of([[0] * 4] * 3, name="house"))
        store.use_map("house")
        frames = made.client.node.publisher("/tf", TF, Qos(depth=10))
        # the robot stands at (1, 2), looking along y
        turn = {"z": math.sin(math.pi / 4), "w": math.cos(math.pi / 4)}
        at = {"translation": {"x": 1.0, "y": 2.0}, "rotation": turn}

        def say() -> None:
            head = {"stamp": made.client.node.clock.stamp(), "frame_id": "map"}
            frames.publish({"transforms": [{"header": head, "child_frame_id": "base_link", "transform": at}]})

        made.client.loop.every(0.1, say)
        until(made.gateway.robot, "it is known where the robot is", 20)
        yield made


@pytest.fixture
def rig(running: Rig) -> Rig:
    running.fresh()
    return running


@pytest.fixture(scope="module")
def yarp(running: Rig) -> Iterator[INavigation2DMsgs]:
    with ServiceClient(INavigation2DMsgs, "/navigationServer/rpc", naming=running.names, timeout=20) as client:
        yield client.remote


def place(goal: object) -> tuple[float, float, float]:
    """x, y and heading in degrees of a planner's goal."""
    found = goal.goal["pose"]["pose"]  # type: ignore[attr-defined]
    turn = found["orientation"]
    return found["position"]["x"], found["position"]["y"], math.degrees(2 * math.atan2(turn["z"], turn["w"]))


def test_goto_its_status_and_its_target(rig: Rig, yarp: INavigation2DMsgs) -> None:
    with Reader("/test/status:i", strict=True, naming=rig.names) as heard:
        connections.connect(rig.names, "/navigation2D_nws_yarp/status:o", heard.name)
        assert yarp.goto_target_by_absolute_location_and_set_name_RPC(Map2DLocation("house", 3.0, 1.0, 90.0), "kitchen")
        goal = rig.planner.until(1)
        assert place(goal) == pytest.approx((3.0, 1.0, 90.0))
        rig.state(State.MOVING)
        assert yarp.get_navigation_status_RPC()[1] is NavigationStatusEnum.navigation_status_moving
        assert yarp.get_name_of_current_target_RPC()[1] == "kitchen"
        found = yarp.get_absolute_location_of_current_target_RPC()[1]
        assert (found.map_id, found.x, found.y, found.theta) == ("house", 3.0, 1.0, pytest.approx(90.0))
        assert yarp.get_relative_location_of_current_target_RPC()[1:] == pytest.approx((-1.0, -2.0, 0.0))
        rig.planner.reach(goal)
        rig.state(State.REACHED)
        assert yarp.get_navigation_status_RPC()[1] is NavigationStatusEnum.navigation_status_goal_reached
        said = ""
        while said != "navigation_status_goal_reached":
            said = heard.read().values[0]  # type: ignore[union-attr]
    assert not yarp.get_absolute_location_of_current_target_RPC()[0]


def test_a_relative_target_is_in_the_robots_frame(rig: Rig, yarp: INavigation2DMsgs) -> None:
    assert yarp.goto_target_by_relative_location2_RPC(1.0, 0.0, 90.0)
    goal = rig.planner.until(1)
    assert place(goal)[:2] == pytest.approx((1.0, 3.0))
    assert abs(place(goal)[2]) == pytest.approx(180.0)
    assert yarp.goto_target_by_relative_location1_RPC(1.0, 0.0)
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
    assert [one.x for one in yarp.get_all_navigation_waypoints_RPC(TrajectoryTypeEnum.global_trajectory)[1]] == [
        2.0,
        3.0,
    ]
    assert yarp.resume_navigation_RPC()
    rig.planner.reach(rig.planner.until(3))
    rig.planner.reach(rig.planner.until(4))
    rig.state(State.REACHED)
    assert [place(goal)[0] for goal in rig.planner.goals] == [1.0, 2.0, 2.0, 3.0]


def test_a_suspension_ends_by_itself_and_a_path_is_found_anew(rig: Rig, yarp: INavigation2DMsgs) -> None:
    assert yarp.goto_target_by_absolute_location_RPC(Map2DLocation("house", 3.0, 1.0, 0.0))
    rig.planner.until(1)
    assert yarp.suspend_navigation_RPC(0.3)
    rig.planner.until(2)
    assert yarp.recompute_current_navigation_path_RPC()
    rig.planner.until(3)
    rig.state(State.MOVING)
    assert yarp.stop_navigation_RPC()
    idle = NavigationStatusEnum.navigation_status_idle
    until(lambda: yarp.get_navigation_status_RPC()[1] is idle, "it stands", 20)
    assert not yarp.recompute_current_navigation_path_RPC()
    assert not yarp.resume_navigation_RPC()


def test_what_is_suspended_for_a_time_does_not_go_on_after_a_halt(rig: Rig, yarp: INavigation2DMsgs) -> None:
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


def test_another_clients_goal_is_seen_and_can_be_stopped(rig: Rig, yarp: INavigation2DMsgs) -> None:
    asked = Asked(rig.client, pose(4.0))
    rig.planner.until(1)
    rig.state(State.MOVING)
    assert yarp.get_absolute_location_of_current_target_RPC()[1].x == 4.0
    assert yarp.get_name_of_current_target_RPC()[1] == ""
    assert yarp.stop_navigation_RPC()
    assert asked.end() == ("CANCELED", "it was stopped")


def test_the_way_and_the_maps(rig: Rig, yarp: INavigation2DMsgs) -> None:
    assert yarp.goto_target_by_absolute_location_RPC(Map2DLocation("house", 5.0, 2.0, 0.0))
    rig.planner.until(1)
    out = rig.planner.node.publisher("/planner/robot_goto/path", "nav_msgs/msg/Path", LATCHED)
    out.publish({"header": {"frame_id": "map"}, "poses": [pose(float(x), 2.0) for x in range(6)]})
    until(lambda: len(yarp.get_all_navigation_waypoints_RPC(TrajectoryTypeEnum.global_trajectory)[1].waypoints) == 6,
          "the path is there", 20)  # fmt: skip
    assert yarp.get_current_nav_waypoint_RPC()[1].x == 2.0
    grid = yarp.get_current_navigation_map_RPC(NavigationMapTypeEnum.global_map)[1]
    assert (grid.name, grid.m_width, grid.m_height) == ("house", 4, 3)
    local = rig.planner.node.publisher("/planner/robot_goto/local_map", "nav_msgs/msg/OccupancyGrid", LATCHED)
    local.publish(to_grid(MapGrid2D.of([[0] * 7] * 7)))
    kind = NavigationMapTypeEnum.local_map
    until(lambda: yarp.get_current_navigation_map_RPC(kind)[1].m_width == 7, "the local map is there", 20)
    assert len(yarp.get_all_navigation_waypoints_RPC(TrajectoryTypeEnum.local_trajectory)[1].waypoints) == 6
    assert not yarp.goto_target_by_absolute_location_RPC(Map2DLocation("cellar", 1.0, 2.0))  # there is no such map
    rig.state(State.MOVING)


def test_velocities_are_commanded_while_nothing_drives(rig: Rig, yarp: INavigation2DMsgs) -> None:
    told: list[tuple[float, float]] = []
    rig.client.node.subscription(
        "/cmd_vel", "geometry_msgs/msg/Twist", lambda m: told.append((m["linear"]["x"], m["angular"]["z"]))
    )
    until(lambda: yarp.apply_velocity_command_RPC(0.2, 0.0, 90.0, 0.2) and told, "a velocity is heard", 20)
    assert (0.2, pytest.approx(math.pi / 2)) in told
    until(lambda: told[-1] == (0.0, 0.0), "its time is over", 20)
    until(lambda: not yarp.get_last_velocity_command_RPC()[0], "nothing is commanded", 20)
    until(lambda: yarp.apply_velocity_command_RPC(0.2, 0.0, 90.0, 1.0), "it is commanded", 20)
    assert rig.ask("stop")["success"]
    assert not yarp.get_last_velocity_command_RPC()[0]

    def commanded() -> bool:
        """While it is: a slow machine may ask once its time is over."""
        taken = yarp.apply_velocity_command_RPC(0.2, 0.0, 90.0, 1.0)
        return bool(taken) and yarp.get_last_velocity_command_RPC()[1:] == (0.2, 0.0, 90.0)

    until(commanded, "what is commanded is told", 20)
    assert yarp.goto_target_by_absolute_location_RPC(Map2DLocation("house", 3.0, 1.0, 0.0))
    rig.planner.until(1)
    rig.state(State.MOVING)
    until(lambda: told[-1] == (0.0, 0.0), "the planner has the base for itself", 20)
    assert not yarp.apply_velocity_command_RPC(0.2, 0.0, 0.0, 0.2)
