"""The module on a hub, with YARP, and with a robot in a room that follows the module's commands."""

from __future__ import annotations

import math
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge import kernels
from bridge.messages.actions import GoalState
from bridge.messages.velocities import TWIST, TWIST_STAMPED
from navigation.constraints import Constraints
from navigation.status import Fault, State
from tests.navigation.robot_goto.deployed import PLANNER, Goto, pose_of
from tests.navigation.robot_goto.test_obstacles import surface
from tests.navigation.uncompiled import uncompiled
from tests.peers.navigation.served import STATUS
from tests.support.wait import until
from yarp_compat.dev.client import ServiceClient
from yarp_compat.dev.inavigation2d import INavigation2DMsgs, NavigationMapTypeEnum, NavigationStatusEnum
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.rangefinder import LaserScan2D
from yarp_compat.dev.robotgoto_commands import RobotGotoMsgs
from yarp_compat.naming import connections
from yarp_compat.pythonic import Client, Reader, Writer
from yarp_compat.sig.vector import Vector

SLOW = Constraints(max_lin_speed=0.1).to_text()
"""The robot does not reach its goal before the test has stopped it."""


def test_a_hub_goal_is_reached_and_commands_end(place: Goto) -> None:
    states = place.far.subscribe(f"{PLANNER}/status", STATUS, latched=True)
    grids = place.far.subscribe(f"{PLANNER}/local_map", "nav_msgs/OccupancyGrid", latched=True)
    paths = place.far.subscribe(f"{PLANNER}/path", "nav_msgs/Path", latched=True)
    sent = place.robot.send(1.0, 0.5, 1.0, Constraints(tolerance_lin=0.08).to_text())
    assert sent.end() == (GoalState.SUCCEEDED, {"error_code": 0, "error_msg": ""})
    robot = place.robot
    assert math.hypot(robot.x - 1.0, robot.y - 0.5) < 0.2
    assert abs(math.remainder(robot.yaw - 1.0, math.tau)) < 0.3
    assert sent.feedback
    until(lambda: robot.commands[-1] == (0.0, 0.0, 0.0), "the robot is stopped", 20)
    until(lambda: not place.module._topics._zeros, "zero is no longer repeated", 20)
    until(lambda: place.far.wait(paths, 0, 0) and place.far.wait(grids, 0, 0), "path and local map are published", 20)
    grid = place.far.wait(grids, 0, 0)[-1]
    assert (grid["info"]["width"], grid["header"]["frame_id"]) == (100, "map")
    assert {0, -1} <= set(grid["data"])
    assert "moving" in [status["state"] for status in place.far.wait(states, 0, 0)]


def test_a_base_with_stamped_velocities_is_driven_and_stopped(place: Goto) -> None:
    robot = place.robot
    robot.loop.call(lambda: robot.subscribe_to(TWIST_STAMPED))
    try:
        assert robot.send(0.5, 0.0, 0.0, Constraints(tolerance_lin=0.08).to_text()).end()[0] is GoalState.SUCCEEDED
        assert math.hypot(robot.x - 0.5, robot.y) < 0.2
        until(lambda: robot.commands[-1] == (0.0, 0.0, 0.0), "the robot is stopped", 20)
    finally:
        robot.loop.call(lambda: robot.subscribe_to(TWIST))


def test_a_new_goal_preempts_the_first_and_a_canceled_goal_stops_the_robot(place: Goto) -> None:
    first = place.robot.send(2.0, 0.0, 0.0, SLOW)
    until(lambda: place.robot.x > 0.1, "the robot drives", 30)
    second = place.robot.send(-2.0, 0.0, 0.0, SLOW)
    assert first.end() == (GoalState.CANCELED, {"error_code": Fault.OTHER, "error_msg": "another goal replaced it"})
    until(lambda: place.robot.commands[-1][0] != 0.0 or place.robot.commands[-1][2] != 0.0, "the robot drives on", 30)
    second.cancel()
    assert second.end()[0] is GoalState.CANCELED
    until(lambda: place.robot.commands[-1] == (0.0, 0.0, 0.0), "the robot stops", 20)


def test_a_goal_is_aborted_when_no_client_can_cancel_it(place: Goto) -> None:
    robot = place.robot
    robot.send(2.0, 0.0, 0.0, SLOW)
    until(lambda: robot.x > 0.1, "the robot drives", 30)
    robot.loop.call(robot.client.close)
    try:
        until(lambda: place.state == "idle" and robot.commands[-1] == (0.0, 0.0, 0.0), "the robot stops", 20)
        assert robot.x < 1.9
    finally:
        robot.connect()


def test_without_compiled_kernels_goals_are_refused_with_the_cure(place: Goto, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(place.module, "compiled", uncompiled(monkeypatch))
    status, result = place.robot.send(1.0, 0.0).end()
    assert status is GoalState.ABORTED
    assert "not compiled: navigation.algorithms.stopping" in result["error_msg"]
    assert kernels.CURE in result["error_msg"]
    assert kernels.CURE in place.module.health().text
    with ServiceClient(INavigation2DMsgs, place.registered("/robotGoto/rpc"), naming=place.names, timeout=20) as yarp:
        assert not yarp.remote.goto_target_by_absolute_location_RPC(Map2DLocation("", 1.0, 0.0, 0.0))
    assert not [command for command in place.robot.commands if any(command)]


def test_an_invalid_goal_is_aborted_with_the_reason(place: Goto) -> None:
    status, result = place.robot.send(math.nan, 0.0).end()
    assert (status, result["error_code"]) == (GoalState.ABORTED, Fault.BAD_GOAL)
    status, result = place.robot.send(1.0, 0.0, 0.0, "midspan: speed=2").end()
    assert (status, result["error_code"]) == (GoalState.ABORTED, Fault.BAD_GOAL)
    assert "unknown constraint 'speed'" in result["error_msg"]


@pytest.mark.parametrize("trouble", ["laser", "frames", "localization"])
def test_missing_inputs_stop_the_robot_until_they_return(place: Goto, trouble: str) -> None:
    robot, driver = place.robot, place.module.driver
    sent = robot.send(1.5, 0.0, 0.0, Constraints(max_lin_speed=0.2).to_text())  # slow enough for the test
    until(lambda: robot.x > 0.05, "the robot drives", 30)
    if trouble == "laser":
        robot.sees = False
    elif trouble == "frames":
        robot.knows = False
    else:
        robot.localized("error", "the scans do not fit")
    lost = "localization status is 'error': the scans do not fit"
    reason = {"laser": "the laser is silent", "frames": "stale", "localization": lost}[trouble]
    until(lambda: reason in driver.status.reason, "the status gives the reason", 30)
    assert place.state == "waiting_obstacle"
    until(lambda: robot.commands[-1] == (0.0, 0.0, 0.0), "pending commands have arrived", 20)
    robot.commands.clear()
    until(lambda: len(robot.commands) > 3, "it commands zero velocity", 20)
    assert set(robot.commands) == {(0.0, 0.0, 0.0)}
    stood = robot.x
    robot.sees = robot.knows = True
    if trouble == "localization":
        robot.localized("localized_ok")
    until(lambda: robot.x > stood + 0.1 and place.state == "moving", "the robot drives on", 30)
    sent.cancel()
    assert sent.end()[0] is GoalState.CANCELED


def test_yarp_clients_send_goals_and_receive_commands(place: Goto) -> None:
    names, robot = place.names, place.robot
    rpc = place.registered("/robotGoto/rpc")
    ok = NavigationStatusEnum
    with (
        ServiceClient(INavigation2DMsgs, rpc, naming=names) as client,
        Reader("/test/control", naming=names) as control,
    ):
        connections.connect(names, place.registered("/robotGoto/control:o"), "/test/control")
        robot.loop.call(lambda: robot.stand(0.0, 0.0, math.pi / 2))
        until(lambda: (pose := pose_of(place.module)) and pose.theta > 1.5, "the robot has turned", 20)
        driver = place.module.driver
        slowly = driver.settings.model_copy(update={"max_lin_speed": 0.2})
        place.host.loop.call(lambda: setattr(driver, "settings", slowly))  # slow enough to suspend it
        assert client.remote.goto_target_by_relative_location1_RPC(1.0, 0.0), "one meter ahead, which is north"
        until(lambda: robot.y > 0.2, "the robot drives", 30)
        assert client.remote.suspend_navigation_RPC(0.0)
        assert client.remote.get_navigation_status_RPC()[1] is ok.navigation_status_paused
        place.host.loop.call(place.module.driver.reset)
        assert client.remote.resume_navigation_RPC()
        target = client.remote.get_absolute_location_of_current_target_RPC()[1]
        assert (target.x, target.y) == pytest.approx((0.0, 1.0), abs=0.05)
        reached = ok.navigation_status_goal_reached
        until(lambda: client.remote.get_navigation_status_RPC()[1] is reached, "the robot arrives", 30)
        assert (robot.x, robot.y) == pytest.approx((0.0, 1.0), abs=0.2)
        command = control.read_now()
        assert command is not None
        assert (command.values[0], len(command.values), command.values[4]) == (2, 5, 100.0)
        sequence, seconds = map(float, command.envelope.split())
        assert (sequence > 0, seconds) == (True, pytest.approx(time.time(), abs=60.0))
        available, grid = client.remote.get_current_navigation_map_RPC(NavigationMapTypeEnum.local_map)
        assert available
        assert (np.asarray(grid.flags) == MapFlag.FREE).mean() > 0.5
        assert not client.remote.get_current_navigation_map_RPC(NavigationMapTypeEnum.global_map)[0]
        assert not client.remote.suspend_navigation_RPC(1.0), "no goal to suspend"
        assert client.remote.goto_target_by_absolute_location_RPC(Map2DLocation("", 0.0, -1.0, math.nan))
        assert client.remote.stop_navigation_RPC()
        assert client.remote.get_navigation_status_RPC()[1] is ok.navigation_status_idle


def test_clients_of_the_action_see_and_cancel_what_yarp_clients_request(place: Goto) -> None:
    robot, rpc = place.robot, place.registered("/robotGoto/rpc")
    topic = f"{PLANNER}/navigate_to_pose/_action/status"
    listed = place.far.subscribe(topic, "action_msgs/GoalStatusArray", latched=True)

    def states() -> list[int]:
        """Return the state of the newest goal."""
        return [entry["status"] for lists in place.far.wait(listed, 0, 0)[-1:] for entry in lists["status_list"][-1:]]

    def cancel_all() -> None:
        begin = robot.x
        until(lambda: robot.x > begin + 0.05, "the robot drives", 30)
        until(lambda: states() == [GoalState.EXECUTING], "the list shows the goal", 20)
        robot.loop.call(robot.client.cancel)
        until(lambda: place.state == "idle" and robot.commands[-1] == (0.0, 0.0, 0.0), "the robot stops", 20)
        until(lambda: states() == [GoalState.CANCELED], "the list shows the end", 20)

    until(lambda: robot.client.ready, "the planner is available", 30)
    slowly = place.module.driver.settings.model_copy(update={"max_lin_speed": 0.2})
    place.host.loop.call(lambda: setattr(place.module.driver, "settings", slowly))
    with ServiceClient(INavigation2DMsgs, rpc, naming=place.names) as client:
        assert client.remote.goto_target_by_absolute_location_RPC(Map2DLocation("", 2.0, 0.0, math.nan))
        cancel_all()
        assert not client.remote.goto_target_by_absolute_location_RPC(Map2DLocation("", math.inf, 0.0, 0.0))
    with Client(rpc, naming=place.names) as commander:
        commander.ask(["approach", 0.0, 0.3, 60.0])
        cancel_all()


def test_the_feedback_of_an_approach_has_its_own_navigation_time(place: Goto) -> None:
    topic, kind = f"{PLANNER}/navigate_to_pose/_action/feedback", "nav2_msgs/action/NavigateToPose_FeedbackMessage"
    robot, messages = place.robot, list[dict[str, Any]]()
    subscription = robot.loop.call(lambda: robot.node.subscription(topic, kind, messages.append))
    place.module._began = place.module.now() - 1000.0  # the previous goal
    place.host.loop.call(lambda: place.module.approach(0.0, 0.1, 60.0))
    until(lambda: messages, "feedback is published", 20)
    robot.loop.call(lambda: robot.node.release(subscription))
    assert messages[0]["feedback"]["navigation_time"]["sec"] < 60


def test_a_yarp_scan_is_stamped_on_reception(place: Goto, monkeypatch: pytest.MonkeyPatch) -> None:
    module, resume = place.module, threading.Event()
    patient = module.driver.settings.model_copy(update={"laser_timeout": 9.0})  # the scans wait for the test, too
    place.host.loop.call(lambda: setattr(module.driver, "settings", patient))
    stamps: list[int] = []
    monkeypatch.setattr(
        module.driver, "scan", lambda turn, *_where: stamps.append(turn.time_ns) if turn.farthest == 7.0 else None
    )
    scan = LaserScan2D(0.0, 360.0, 0.1, 7.0, Vector([1.0] * 90), 1)
    port, now = place.registered("/robotGoto/laser:i"), module.now
    with Writer("/test/laser:o", naming=place.names) as writer:
        writer.connect(port)

        def receive(count: int) -> None:
            """Send scans while the module's thread is busy."""
            earlier = place.received(port)
            resume.clear()
            place.host.loop.post(lambda: resume.wait(20))
            for _ in range(count):
                assert writer.write(scan, strict=True) == 1
            until(lambda: place.received(port) == earlier + count, "the scans are received", 20)

        before = now()
        receive(2)
        received = now()
        until(lambda: now() > received + 0.01, "some time passes")
        resume.set()
        place.host.loop.call(lambda: None)
        assert len(stamps) == 1, "only the newest"
        assert before - 1e-6 <= stamps[0] / 1e9 <= received + 1e-6
        for shift in (10.0, -10.0):
            receive(1)
            monkeypatch.setattr(module, "now", lambda shift=shift: now() + shift)
            resume.set()
            place.host.loop.call(lambda: None)
            monkeypatch.setattr(module, "now", now)
        assert len(stamps) == 1, "an old scan, and one from before a clock jump, are dropped"


def test_robot_gotos_own_commands_work_as_text_and_as_a_service(place: Goto) -> None:
    rpc = place.registered("/robotGoto/rpc")
    driver = place.module.driver
    with Client(rpc, naming=place.names) as rpc_client:
        assert rpc_client.ask(["set", "linear_tol", 0.2]) == ["linear_tol set."]
        assert rpc_client.ask(["set", "max_ang_speed", 20.0]) == ["max_ang_speed set."]
        assert (driver.settings.goal_tolerance_lin, driver.settings.max_ang_speed) == (0.2, 20.0)
        assert rpc_client.ask(["set", "obstacle_stop", 0]) == ["enable_obstacle_stop=false"]
        assert not driver.settings.enable_obstacles_emergency_stop
        assert rpc_client.ask(["get", "navigation_status"]) == ["navigation_status_idle"]
        assert rpc_client.ask(["reset_params"]) == ["params reset done"]
        assert driver.settings.goal_tolerance_lin == 0.1
        assert "approach" in " ".join(map(str, rpc_client.ask(["help"])))
        approach = ["approach", 0.0, 0.3, 60.0]
        assert rpc_client.ask(approach) == ["approach command received"]

        def moves() -> bool:
            if driver.status.state is State.ABORTED:  # the scans were late
                rpc_client.ask(approach)
            return bool(place.robot.x > 0.02)

        until(moves, "the robot moves forward", 20)
    with ServiceClient(RobotGotoMsgs, rpc, naming=place.names) as client:
        assert client.remote.SetMaxLinearSpeed(0.4)
        assert driver.settings.max_lin_speed == 0.4
        assert not client.remote.SetMaxLinearSpeed(-1.0)
        assert client.remote.GetNavigationStatus()[1].startswith("navigation_status_")


def test_a_step_that_fails_stops_the_robot_and_ends_the_goal(place: Goto, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, driver = place.robot, place.module.driver
    sent = robot.send(2.0, 0.0, 0.0, SLOW)
    until(lambda: robot.commands and robot.commands[-1][0] > 0.0, "the robot drives", 20)

    def step(*_: Any) -> None:
        raise ZeroDivisionError("of the test")

    with monkeypatch.context() as patch:
        patch.setattr(driver, "step", step)
        status, result = sent.end()
    assert (status, result["error_code"]) == (GoalState.ABORTED, Fault.OTHER)
    assert result["error_msg"] == "RobotGoto failed: ZeroDivisionError: of the test"
    until(lambda: robot.commands[-1] == (0.0, 0.0, 0.0), "the robot stops", 20)
    assert robot.send(0.5, 0.0).end()[0] is GoalState.SUCCEEDED


def test_halt_ends_every_goal(place: Goto) -> None:
    sent = place.robot.send(2.0, 0.0, 0.0, SLOW)
    until(lambda: place.robot.x > 0.05, "the robot drives", 30)
    assert place.far.hub.ask("halt", {}, worker="robot_goto", timeout=20.0)[0].value == {"halted": True}
    assert sent.end()[1]["error_msg"] == "halted"
    assert place.state == "idle"


def seen(*heights: float) -> dict[str, Any]:
    """Return a cloud of surfaces at heights in the base frame, always 1 to 1.4 m ahead."""
    points = np.concatenate([surface(1.2, 0.0, z, 0.4, 2.0) for z in heights]) if heights else np.zeros((0, 3), "<f4")
    fields = [{"name": name, "offset": 4 * i, "datatype": 7, "count": 1} for i, name in enumerate("xyz")]
    size = {"width": len(points), "height": 1, "point_step": 12, "row_step": 12 * len(points)}
    return {**size, "fields": fields, "data": points.view(np.uint8).ravel()}


def test_the_robot_waits_for_clouds_and_layers_on_the_hub(tmp_path: Path) -> None:
    sources = [{"topic": "/points", "type": "cloud", "timeout": 1.5}, {"topic": "/layer", "timeout": 0.5}]
    waits: dict[str, Any] = {"enable_obstacles_avoidance": False, "max_waiting_time": 300.0}  # longer than the test
    with Goto(tmp_path, obstacles=sources, floor=-0.2, **waits) as place:
        robot, driver = place.robot, place.module.driver
        layer = place.far.advertise("/layer", "nav_msgs/OccupancyGrid", latched=True)
        sent = robot.send(-2.0, 0.0)
        until(
            lambda: "the cloud /points has not arrived yet" in driver.status.reason, "the driver waits for a cloud", 30
        )
        robot.cloud = {**seen(-0.2), "fields": seen(-0.2)["fields"][:2]}
        until(lambda: "fields: no z" in place.module.health().text, "the health text names the missing field", 30)
        robot.cloud = {**seen(-0.2), "width": 100_000_000}
        until(
            lambda: "width, height: 100000000" in place.module.status().document()["obstacles"]["/points"],
            "the status gives the size",
            30,
        )
        robot.cloud = seen(-0.2)  # the floor
        until(
            lambda: "the layer /layer has not arrived yet" in driver.status.reason, "the driver waits for the layer", 30
        )
        assert not [command for command in robot.commands if any(command)]
        # in the odometry's frame, which is at x = 5: a cell 1.5 m behind the robot, and nothing else
        info = {"resolution": 0.1, "width": 2, "height": 1, "origin": {"position": {"x": -6.6, "y": -0.05}}}
        place.far.publish(layer, {"header": {"frame_id": "attic"}, "info": info, "data": [100, 0]})
        until(
            lambda: "attic" in place.module.status().document()["obstacles"].get("/layer", ""),
            "the status names the frame",
            30,
        )
        place.far.publish(layer, {"header": {"frame_id": "odom"}, "info": info, "data": [100, 0]})
        until(lambda: driver.status.fault is Fault.BLOCKED, "the robot stops at the layer's cell", 30)
        assert -1.5 + 0.27 < robot.x < -0.1
        robot.cloud = seen(0.5)  # the laser sees none of it
        sent.cancel()
        sent.end()
        ahead = robot.send(robot.x + 2.5, 0.0)
        until(
            lambda: driver.status.fault is Fault.BLOCKED and "obstacle" in driver.status.reason, "the robot stops", 30
        )
        robot.cloud = None
        until(lambda: "the cloud /points is silent" in driver.status.reason, "the silent cloud is reported", 30)
        robot.cloud = seen(-0.2)
        until(lambda: place.module.health().state == "running", "a latched layer that is published once suffices", 30)
        place.far.drop(layer)
        until(lambda: "has no publisher" in place.module.health().text, "the layer's publisher is gone", 30)
        until(lambda: "the layer /layer is silent" in driver.status.reason, "the robot does not drive", 30)
        ahead.cancel()
