"""Navigation goals from another machine, over TLS through the robot's external listener."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.config.model import Config
from bridge.modules.worker import ModulesWorker
from tests.peers.hub.machines import Machines, make_keys
from tests.peers.hub.node import HubNode
from tests.peers.navigation.gateway import ClientGoal, Planner, pose
from tests.support.wait import until


class Robot:
    """A robot with a gateway, a planner and an external listener; ``friend`` may command it, ``guest`` may not."""

    def __init__(self, folder: Path) -> None:
        self.machines = Machines(make_keys(folder))
        network = self.machines.network
        network.start_router()
        sections = {"navigation": {"planner": "robot_goto"}, "yarp": {"enabled": False}}
        config = {"name": "robot", "state": folder / "state", "hub": network.config(), **sections}
        self.worker = ModulesWorker()
        self.worker.start(Config.model_validate(config))
        self.planner = Planner(network.settings("robot_goto"), "robot_goto")
        module: Any = self.worker.running("gateway").module
        gateway = module.gateway
        until(lambda: gateway.link.reachable, "the planner is reachable", 20)

    def operator(self, name: str) -> HubNode:
        return HubNode(self.machines.settings(name))

    def close(self) -> None:
        self.planner.close()
        self.worker.stop()
        self.machines.network.stop_router()


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    with contextlib.closing(Robot(tmp_path_factory.mktemp("robot"))) as robot:
        yield robot


def test_the_operators_goal_and_its_feedback_and_its_end_cross(robot: Robot) -> None:
    operator = robot.operator("friend")
    try:
        client_goal = ClientGoal(operator, pose(2.0, 1.0))
        goal = robot.planner.until(1)
        assert goal.goal["pose"]["pose"]["position"]["x"] == 2.0

        def driving() -> bool:
            robot.planner.on(lambda: goal.feedback({"distance_remaining": 1.5}))
            return bool(client_goal.feedback)

        until(driving, "the operator receives the feedback", 20)
        robot.planner.give_up(goal, "a door is closed")
        assert client_goal.end() == ("ABORTED", "a door is closed")
        client_goal = ClientGoal(operator, pose(3.0))
        goal = robot.planner.until(2)
        client_goal.cancel()
        assert client_goal.end()[0] == "CANCELED"
        ClientGoal(operator, pose(4.0))
        goal = robot.planner.until(3)
    finally:
        operator.close()
    until(lambda: not goal.active, "the goal ends because its client has disconnected", 20)


def test_a_goal_of_an_untrusted_machine_is_rejected(robot: Robot) -> None:
    guest, count = robot.operator("guest"), len(robot.planner.goals)
    try:
        client_goal = ClientGoal(guest, pose(1.0))
        until(lambda: client_goal.ended, "the guest's goal has ended", 30)
        assert client_goal.sent.accepted is not True
        assert len(robot.planner.goals) == count
    finally:
        guest.close()
