"""The example planner and the example localizer, each selected by one line, with clients of every side."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from navigation.pose import Pose
from navigation.robot_path_planner.ground import Ground
from navigation.status import PlanError
from tests.peers.daemon.deployment import Deployment
from tests.peers.daemon.examples import EXAMPLES
from tests.peers.navigation.gateway import pose
from tests.peers.navigation.mix import OURS, Closing, Mix
from tests.peers.navigation.mix_clients import COMMAND, ROS1, ROS2, SECONDS, YARP, ZENOH, RosClient
from tests.peers.ros1.network import needs_ros1
from tests.peers.sim.point_robot import PointRobot
from tests.support.wait import until
from yarp_compat.dev.client import ServiceClient
from yarp_compat.dev.localization2d import ILocalization2DMsgs
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.naming.client import NameClient

FOLDERS = [str(EXAMPLES / name) for name in ("own_planner", "own_localizer")]


class OwnMix(Mix):
    """The clients of `Mix`, with the examples' configurations."""

    def _sections(self, planner: str) -> dict[str, Any]:
        sections = super()._sections(planner)
        del sections["modules"]["robot_path_planner"]
        for folder in FOLDERS:
            added = yaml.safe_load((Path(folder) / "midspan.yaml").read_text())
            for name, keys in added.items():
                sections[name] = {**sections[name], **keys}
        sections["modules"]["robot_goto"] = {**super()._sections(OURS)["modules"]["robot_goto"], "enabled": True}
        return sections

    def localization(self) -> ILocalization2DMsgs:
        """Return a YARP client of the localizer."""
        naming = NameClient(self._names, namespace="/root")
        client = ServiceClient(ILocalization2DMsgs, "/localizationServer/rpc", naming=naming, timeout=SECONDS)
        self.deployment.keep(Closing(client.open()))
        return client.remote


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[OwnMix]:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, (*FOLDERS, os.environ.get("PYTHONPATH", "")))))
    with Deployment(tmp_path) as deployment:
        mix = OwnMix(deployment)
        mix.planner = deployment.keep(PointRobot(deployment.settings("robot"), (60.0, 6.0), localized=False))

        def running() -> bool:
            workers = {worker.get("worker"): worker for worker in deployment.status()}
            parts = ("gateway", "wavefront", "robot_goto", "localization_server")
            return all(workers.get(part, {}).get("state") == "running" for part in parts)

        until(running, "the planner, its driver and the localizer run", SECONDS, 0.1)
        yield mix


@needs_ros1
def test_clients_of_all_sides_use_the_planner_and_the_localizer(own: OwnMix) -> None:
    robot, localization = own.planner, own.localization()
    for x, side in enumerate((YARP, ROS1, ROS2, ZENOH), 1):
        client = own.clients[side]
        client.goto(float(x))
        until(lambda client=client: client.end(), f"the goal of {side} ends", SECONDS)
        assert (client.end(), robot.x) == ("succeeded", pytest.approx(x, abs=0.1)), side
    at = pytest.approx(4.0, abs=0.1)
    until(lambda: localization.get_current_position1_RPC()[1].x == at, "the localizer has followed the robot", SECONDS)
    assert localization.get_current_position1_RPC()[0]

    ros2, poses = own.clients[ROS2], [pose(5.0), pose(6.0)]
    assert isinstance(ros2, RosClient)
    ros2.send("/navigate_through_poses", "nav2_msgs/NavigateThroughPoses", {"poses": poses})
    until(ros2.end, "the goal of several poses ends", SECONDS)
    assert (ros2.end(), robot.x) == ("succeeded", pytest.approx(6.0, abs=0.1))

    own.clients[ROS2].goto(40.0)
    until(lambda: own.clients[ROS2].progress() > 1, "the robot drives", SECONDS)
    answer_of = own.callers[COMMAND].ask("stop")
    _, trouble = until(answer_of, "the stop is answered", SECONDS)
    assert trouble == ""
    until(own.clients[ROS2].end, "the stopped goal ends", SECONDS)
    assert own.clients[ROS2].end() == "canceled"
    assert robot.x < 30.0
    own.clients[YARP].goto(900.0)
    until(lambda: own.clients[YARP].end(), "the goal off the map ends", SECONDS)
    assert own.clients[YARP].end() == "aborted"

    assert localization.set_initial_pose1_RPC(Map2DLocation("map", 10.0, 1.0, 90.0))
    until(
        lambda: localization.get_current_position1_RPC()[1].y == pytest.approx(1.0), "the initial pose is used", SECONDS
    )


def test_the_wave_finds_the_gap_in_a_wall(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(FOLDERS[0])
    from wave_search import plan

    flags = np.zeros((60, 100), np.uint8)
    flags[:45, 50] = 1  # a wall from the upper border, open for 1.5 m above the lower one
    grid = MapGrid2D.of(flags, name="wall", resolution=0.1)
    path = plan(Ground(grid, 0.3), Pose(2.0, 4.0, 0.0), Pose(8.0, 4.0, 1.0))
    assert path[-1] == Pose(8.0, 4.0, 1.0)
    legs = list(pairwise([Pose(2.0, 4.0, 0.0), *path]))
    crossing = [
        one.y + (5.05 - one.x) / (other.x - one.x) * (other.y - one.y) for one, other in legs if one.x < 5.05 < other.x
    ]
    assert len(crossing) == 1
    assert 0.3 < crossing[0] < 1.2, "the path stays 0.3 m away from the end of the wall"
    for closed, start, goal in ((50, 2.0, 5.05), (60, 2.0, 8.0), (45, -2.0, 8.0), (45, 2.0, 12.0)):
        flags[:closed, 50] = 1
        with pytest.raises(PlanError):
            plan(Ground(grid, 0.3), Pose(start, 4.0, 0.0), Pose(goal, 4.0, 0.0))
        flags[45:, 50] = 0
    sys.modules.pop("wave_search", None)
