"""RobotPathPlanner's map, laser and layers as received on the hub."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bridge.clock import SYSTEM
from bridge.messages.actions import GoalState
from navigation.maps.grid import to_grid
from navigation.status import Fault
from tests.peers.hub.modules import Place
from tests.peers.navigation.floors import ROOMS, floor
from tests.peers.navigation.planning import LATCHED, Planning, Robot
from tests.support.wait import until


def test_the_map_is_received_from_a_topic_and_completed_by_the_laser(tmp_path: Path) -> None:
    with Place(tmp_path) as place:
        robot = Robot(place.far.hub, place.far.registry)
        maps = robot.node.publisher("/map", "nav_msgs/msg/OccupancyGrid", LATCHED, priority="state")
        scans = robot.node.publisher("/scan", "sensor_msgs/msg/LaserScan")

        def scan() -> None:
            """Publish a scan of a closed door at x = 2.5 m, y = 1 m."""
            angles = np.arange(-200, 201) * 0.005 - robot.yaw
            to_door = (2.5 - robot.x) / np.cos(angles + robot.yaw)
            hits = np.abs(robot.y + np.tan(angles + robot.yaw) * (2.5 - robot.x) - 1.0) < 0.4
            header = {"stamp": SYSTEM.stamp(), "frame_id": "base_link"}
            scans.publish({
                "header": header, "angle_min": float(angles[0]), "angle_max": float(angles[-1]),
                "angle_increment": 0.005, "range_min": 0.05, "range_max": 10.0,
                "ranges": np.where(hits & (to_door > 0), to_door, np.inf).astype(np.float32),
            })  # fmt: skip

        timer = robot.loop.every(0.05, scan)
        try:
            maps.publish(to_grid(floor(*ROOMS)))
            section = {"enabled": True, "robot_radius": 0.2, "map": "/map", "prefix": "", "patience": 0.0}
            place.worker.start(place.config(modules={"robot_path_planner": section}))
            until(lambda: place.answer("robot_path_planner")["map"] == "map", "the planner has the map", 30)
            robot.speed, robot.y = 0.1, 2.3
            until(lambda: robot.client.ready, "the planner is available", 30)
            sent = robot.send(4.0, 2.3)
            until(lambda: any(y > 3.5 for _, y, _ in robot.asked), "the robot takes the other door", 30)
            sent.cancel()
            sent.end()
        finally:
            timer.close()
            robot.close()


def test_the_planner_waits_for_a_hub_layer_and_plans_around_it(tmp_path: Path) -> None:
    with Planning(tmp_path, obstacles=[{"topic": "/layer", "timeout": 0.5}]) as place:
        end = place.far.advertise("/layer", "nav_msgs/OccupancyGrid", latched=True)
        sent = place.robot.send(4.0, 1.0)
        status = lambda: place.module.planner.status.reason  # noqa: E731
        until(lambda: status() == "waiting for layer /layer", "the planner waits for the layer", 30)
        info = {"resolution": 0.1, "width": 7, "height": 11, "origin": {"position": {"x": 1.5, "y": 0.5}}}
        place.far.publish(end, {"header": {"frame_id": "map"}, "info": info, "data": [100]})
        until(
            lambda: "7 x 11 cells must not have 1" in place.module.health().text, "the health text gives the error", 30
        )
        assert not place.robot.asked
        # a table in front of the lower door
        place.far.publish(end, {"header": {"frame_id": "map"}, "info": info, "data": [100] * 77})
        assert sent.end()[0] is GoalState.SUCCEEDED
        assert max(y for _, y, _ in place.robot.asked) > 1.7
        assert place.module.health().state == "running"  # a latched layer may be silent while nothing changes


def test_a_layer_that_falls_silent_stops_the_robot_until_it_resumes(tmp_path: Path) -> None:
    place = Planning(tmp_path, obstacles=[{"topic": "/layer", "timeout": 0.5}])
    robot, planner = place.robot, place.module.planner
    layers = robot.node.publisher("/layer", "nav_msgs/msg/OccupancyGrid", LATCHED, priority="state")
    info = {"resolution": 0.1, "width": 1, "height": 1, "origin": {"position": {"x": 4.5, "y": 4.5}}}
    publish = lambda: layers.publish({"header": {"frame_id": "map"}, "info": info, "data": [0]})  # noqa: E731
    try:
        timer = robot.loop.every(0.05, publish)
        robot.speed = 0.02
        sent = robot.send(4.0, 1.0)
        until(lambda: robot.goal and robot.goal.status is GoalState.EXECUTING, "the robot drives", 30)
        until(lambda: place.module._layers._periodic, "the layer is received repeatedly", 30)
        robot.loop.call(timer.close)
        until(lambda: robot.goal and robot.goal.status is GoalState.CANCELED, "the navigator stops", 30)
        until(lambda: planner.status.fault is Fault.NO_LASER, "the status gives the fault", 30)
        assert "the layer /layer is silent: no message for" in planner.status.reason
        assert "layer /layer is silent" in place.module.health().text
        robot.speed = 3.0
        timer = robot.loop.every(0.05, publish)
        assert sent.end()[0] is GoalState.SUCCEEDED
        robot.loop.call(timer.close)
    finally:
        place.close()
