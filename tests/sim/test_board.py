"""The wheels' control board: positions, velocities, duty cycles, modes, and the emergency stop."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

import yarp_compat as yarp
from sim.base import Twist
from sim.board import WheelBoard
from sim.section import SimSection
from sim.simulation import Simulation
from tests.peers.yarp.network import network_of
from tests.sim.test_hub import Place
from tests.support.wait import until
from yarp_compat.dev.controlboard import modes
from yarp_compat.dev.controlboard.board import answer
from yarp_compat.dev.returnvalue import CallFailed
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return Simulation(SimSection(plan="hall", start=(0.0, 0.0, 0.0)))


@pytest.fixture
def board(simulation: Simulation) -> WheelBoard:
    simulation.begin()
    return WheelBoard(lambda: simulation.wheels.board, lambda action: action())


def test_position_moves_reach_their_targets(simulation: Simulation, board: WheelBoard) -> None:
    answer(board, "setControlModeAllRPC", [[modes.VOCAB_CM_POSITION] * 2])
    answer(board, "setTrajSpeedAllRPC", [[60.0, 60.0]])
    answer(board, "resetEncoderAllRPC", [])
    answer(board, "positionMoveAllRPC", [[45.0, -45.0]])
    assert answer(board, "checkMotionDoneAllRPC", [])[1] is False
    simulation.run(2.5)
    left, right = simulation.wheels.board.positions()
    assert (left, right) == pytest.approx((45.0, -45.0), abs=0.5)
    assert answer(board, "checkMotionDoneAllRPC", [])[1] is True
    assert abs(simulation.wheels.board.measured_velocities()).max() < 1.0
    assert simulation.base.pose().yaw < -0.1


def test_velocity_commands_expire(simulation: Simulation, board: WheelBoard) -> None:
    answer(board, "velocityMoveAllRPC", [[60.0, 60.0]])
    simulation.run(simulation.robot.limits.timeout - 0.05)
    assert simulation.wheels.board.measured_velocities() == pytest.approx([60.0, 60.0], abs=5.0)
    simulation.run(0.3)
    assert simulation.wheels.board.measured_velocities() == pytest.approx([0.0, 0.0], abs=1.0)
    simulation.command(Twist(0.2, 0.0, 0.0))  # without board commands, other sources can drive
    simulation.run(0.4)
    assert simulation.base.twist().x > 0.05


def test_commands_in_another_mode_and_invalid_commands_are_rejected(simulation: Simulation, board: WheelBoard) -> None:
    for method, arguments in (
        ("positionMoveOneRPC", [0, 10.0]),
        ("setRefDutyCycleOneRPC", [0, 10.0]),
        ("velocityMoveOneRPC", [2, 10.0]),
        ("velocityMoveOneRPC", [0, math.nan]),
        ("velocityMoveAllRPC", [[1.0]]),
        ("setControlModeOneRPC", [0, modes.VOCAB_CM_MIXED]),
    ):
        with pytest.raises(CallFailed):
            answer(board, method, arguments)
    with pytest.raises(NotImplementedError):
        answer(board, "setRefTorqueOneRPC", [0, 1.0])
    assert simulation.wheels.board.next_velocities(0.01) is None


def test_the_emergency_stop_and_a_mode_change_cancel_commands(simulation: Simulation, board: WheelBoard) -> None:
    answer(board, "setControlModeAllRPC", [[modes.VOCAB_CM_POSITION] * 2])
    answer(board, "positionMoveAllRPC", [[900.0, 900.0]])
    simulation.run(0.5)
    simulation.stop(on=True)
    simulation.stop(on=False)
    assert simulation.wheels.board.next_velocities(0.01) is None
    answer(board, "setControlModeAllRPC", [[modes.VOCAB_CM_PWM] * 2])
    answer(board, "setRefDutyCycleAllRPC", [[10.0, 10.0]])
    wanted = simulation.wheels.board.next_velocities(0.01)
    assert wanted is not None
    assert math.degrees(wanted[0]) == pytest.approx(simulation.wheels.board.greatest / 10.0)
    assert list(simulation.wheels.board.duties()) == pytest.approx([10.0, 10.0])
    answer(board, "setControlModeAllRPC", [[modes.VOCAB_CM_IDLE] * 2])
    assert simulation.wheels.board.next_velocities(0.01) is None


def test_duty_cycles_expire(simulation: Simulation, board: WheelBoard) -> None:
    answer(board, "setControlModeAllRPC", [[modes.VOCAB_CM_PWM] * 2])
    answer(board, "setRefDutyCycleAllRPC", [[10.0, 10.0]])
    simulation.run(2.0)
    assert list(board.state().values["pwmDutycycle"]) == [0.0, 0.0]


def test_a_script_moves_the_wheels_until_a_halt(tmp_path: Path) -> None:
    with Place(tmp_path) as place, NameServer(port=place.port, gc_seconds=0):
        names = NameClient(Address("127.0.0.1", place.port), namespace="/root")
        place.worker.start(place.config(plan="hall", start=(0.0, 0.0, 0.0), yarp="/cer", speed="max"))
        until(lambda: connections.exists(names, "/cer/mobile_base/state:o"), "the board's ports are open")
        with network_of(names):
            driver = yarp.PolyDriver(
                yarp.Property("(device remote_controlboard) (remote /cer/mobile_base) (local /script)")
            )
            assert driver.isValid()
            encoders, position = driver.viewIEncoders(), driver.viewIPositionControl()
            assert driver.viewIAxisInfo().getAxisName(0) == "mobile_base_l_wheel_joint"
            assert driver.viewIControlMode().setControlModes(yarp.IVector(2, yarp.VOCAB_CM_POSITION))
            assert encoders.resetEncoders()
            assert position.positionMove(yarp.DVector([90.0, 90.0]))
            until(position.checkMotionDone, "the wheels reach the target")
            until(lambda: abs(encoders.getEncoder(1) - 90.0) < 1.0, "the encoders report the target")
            assert position.positionMove(yarp.DVector([1e6, 1e6]))
            (answer,) = until(lambda: place.far.hub.ask("halt", {}, worker="sim"), "the simulator replies")
            assert answer.value == {"halted": True}
            assert position.isMotionDone()
            driver.close()
        place.worker.stop()
