"""A control board of a YARP robot on the hub: joint states, and commands; a velocity expires unless it is repeated."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.boards import module
from bridge.routing.stall import AgeGate
from tests.peers.hub.modules import Place
from tests.peers.yarp.joints import Joints
from tests.support.wait import until
from yarp_compat.dev.controlboard import modes
from yarp_compat.dev.controlboard.server import ControlBoardServer
from yarp_compat.naming.server import NameServer

JOINTS = "sensor_msgs/JointState"
BOARD = {"remote": "/robot/arm", "joint_states": "/arm/joint_states", "command": "/arm/command", "timeout": 0.5}


class Robot(Place):
    """A hub with the module, a name server, and a board."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.board = Joints()
        self.server: ControlBoardServer
        self.seen = 0
        self.states = self.far.subscribe("/arm/joint_states", JOINTS)
        self.commands = self.far.advertise("/arm/command", JOINTS)

    def state(self) -> dict[str, Any]:
        """Wait for the next joint state."""
        states = self.far.wait(self.states, self.seen + 1, 40.0)
        assert len(states) > self.seen
        self.seen = len(states)
        return states[-1]

    def command(self, **message: Any) -> None:
        self.far.publish(self.commands, message)

    @property
    def speeds(self) -> list[float]:
        return self.board.of("velocity")


def served(robot: Robot) -> ControlBoardServer:
    return ControlBoardServer("/robot/arm", robot.board, naming=robot.names, period=0.01)


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    with Robot(tmp_path) as robot, NameServer(port=robot.port, gc_seconds=0), served(robot) as robot.server:
        robot.worker.start(robot.config(modules={"control_boards": {"enabled": True, "boards": [BOARD]}}))
        robot.state()
        until(lambda: robot.far.hub.graph.subscriptions("/arm/command"), "the command topic has a subscriber")
        yield robot
        robot.worker.stop()


def test_the_state_has_names_and_radians(robot: Robot) -> None:
    robot.board.of("position")[:] = [180.0, 90.0, 0.0]
    robot.board.of("torque")[:] = [1.0, 2.0, 3.0]
    state = until(
        lambda: next((s for s in [robot.state()] if s["position"][0] and len(s["effort"])), None),
        "a joint state arrives",
    )
    assert state is not None
    assert list(state["name"]) == ["joint0", "joint1", "joint2"]
    assert list(state["position"]) == pytest.approx([math.pi, math.pi / 2, 0.0])
    assert list(state["effort"]) == [1.0, 2.0, 3.0]
    assert state["header"]["stamp"]["sec"] > 1_700_000_000


def test_a_velocity_stops_if_it_is_not_repeated(robot: Robot) -> None:
    def repeat_command() -> bool:
        robot.command(name=["joint2", "joint0"], velocity=[math.pi / 2, 0.1])
        return robot.speeds == pytest.approx([math.degrees(0.1), 0.0, 90.0])  # the board sets one after the other

    until(repeat_command, "the joints move", every=0.05)
    assert robot.board.modes == [modes.VOCAB_CM_VELOCITY, modes.VOCAB_CM_POSITION, modes.VOCAB_CM_VELOCITY]
    until(lambda: robot.speeds == [0.0, 0.0, 0.0], "the joints stand still", every=0.01)
    assert robot.board.control_mode(2) == modes.VOCAB_CM_VELOCITY


def test_joints_moving_at_a_connection_loss_are_stopped_on_reconnect(robot: Robot) -> None:
    """A real board keeps moving at the last velocity."""

    def repeat_command() -> bool:
        robot.command(name=["joint0"], velocity=[1.0])
        return robot.speeds[0] != 0.0

    boards: Any = robot.worker.running("control_boards").module
    (link,) = boards._links
    # the velocity must not expire before the loss, even if this test stands still meanwhile
    link._section = link._section.model_copy(update={"timeout": 5.0})
    until(repeat_command, "the joint moves", every=0.05)
    closing = threading.Thread(target=robot.server.close)
    closing.start()
    until(
        lambda: repeat_command() and robot.answer("control_boards")["boards"][0]["trouble"],
        "the loss is reported",
        every=0.05,
    )
    closing.join()
    assert robot.speeds[0] != 0.0
    with served(robot):

        def stopped() -> bool:
            return robot.speeds[0] == 0.0

        try:
            until(stopped, "the joint stands still")
        except AssertionError as err:
            status = robot.answer("control_boards")["boards"]
            raise AssertionError(f"{err}; {status}, {robot.board.calls[-6:]}, {threading.enumerate()}") from None


def test_a_position_command_moves_the_joint(robot: Robot) -> None:
    def repeat_command() -> bool:
        robot.command(name=["joint1"], position=[math.pi / 4])
        return robot.board.of("target")[1] != 0.0

    until(repeat_command, "the joint moves", every=0.05)
    assert robot.board.of("target") == pytest.approx([0.0, 45.0, 0.0])


def test_invalid_commands_are_refused_and_halt_stops_all_joints(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_HALT_SECONDS", 20.0)
    robot.board.modes[:] = [modes.VOCAB_CM_VELOCITY] * 3

    def refused() -> bool:
        robot.command(name=["joint9"], velocity=[1.0])
        robot.command(name=["joint0"], velocity=[math.nan])
        return bool(robot.answer("control_boards")["refused"].get("/arm/command"))

    until(refused, "the command is refused")
    assert robot.speeds == [0.0, 0.0, 0.0]
    robot.speeds[:] = [5.0, 5.0, 5.0]  # moved by a YARP client
    answers = robot.far.hub.ask("halt", {}, worker="control_boards", timeout=40.0)
    assert [answer.value for answer in answers] == [{"halted": True}]
    until(lambda: robot.speeds == [0.0, 0.0, 0.0], "all joints are stopped")


def test_a_late_zero_stops_the_joints(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    def command(velocity: float) -> None:
        robot.command(name=["joint0"], velocity=[velocity])

    until(lambda: (command(1.0), robot.speeds[0] != 0.0)[1], "the joint moves", every=0.05)
    monkeypatch.setattr(AgeGate, "age", lambda *_: 5.0)
    until(lambda: robot.speeds[0] == 0.0, "the joint's last velocity expires", every=0.01)
    robot.speeds[0] = 5.0
    command(0.0)
    until(lambda: robot.speeds[0] == 0.0, "zero stops the joint", every=0.01)


def test_a_board_that_cannot_be_halted_does_not_keep_the_others_moving(tmp_path: Path) -> None:
    missing = {"remote": "/robot/leg", "joint_states": "/leg/joint_states"}
    with Robot(tmp_path) as robot, NameServer(port=robot.port, gc_seconds=0), served(robot) as robot.server:
        robot.worker.start(robot.config(modules={"control_boards": {"enabled": True, "boards": [missing, BOARD]}}))
        robot.state()
        robot.board.modes[:] = [modes.VOCAB_CM_VELOCITY] * 3
        robot.speeds[:] = [5.0, 5.0, 5.0]  # moved by a YARP client
        (answer,) = robot.far.hub.ask("halt", {}, worker="control_boards", timeout=40.0)
        assert "/robot/leg cannot be stopped" in answer.error
        until(lambda: robot.speeds == [0.0, 0.0, 0.0], "all joints of the other board are stopped")
        robot.worker.stop()
