"""Control boards as scripts use them, in the protocols of YARP 3 and 4: Midspan's board, driven through `PolyDriver`.

The patterns are those of public scripts: position moves until they are done, loops of velocities, encoders in a loop,
modes of one joint, of some, and of all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

import yarp_compat as yarp
from tests.peers.yarp.joints import AXES, Joints
from tests.support.wait import until
from tests.yarp_compat.os.conftest import name_server
from yarp_compat.dev.controlboard.server import ControlBoardServer
from yarp_compat.naming.client import NameClient

__all__ = ["name_server"]


def wait_until(condition: Callable[[], object]) -> None:
    until(condition, "the board has executed the command", 10.0, 0.005)


@pytest.fixture
def joints(name_server: object) -> Iterator[Joints]:
    """Serve a board at /robot/arm."""
    board = Joints()
    with ControlBoardServer("/robot/arm", board, period=0.005):
        yield board


@pytest.fixture(params=["4.0", "3.x"])
def driver(request: pytest.FixtureRequest, joints: Joints) -> Iterator[yarp.PolyDriver]:
    """Open a device for the board, in the protocol of a release."""
    if request.param == "3.x":
        NameClient().unregister("/robot/arm/nws/rpc:i")
    yarp.Network.init()
    options = yarp.Property()
    options.put("device", "remote_controlboard")
    options.put("remote", "/robot/arm")
    options.put("local", "/script/arm")
    options.put("timeout", 60.0)  # a busy machine may delay the states
    device = yarp.PolyDriver(options)
    assert device.isValid()
    yield device
    yarp.Network.fini()


def test_position_moves_run_until_done(driver: yarp.PolyDriver, joints: Joints) -> None:
    encoders, position = driver.viewIEncoders(), driver.viewIPositionControl()
    axes = position.getAxes()
    assert axes == encoders.getAxes() == AXES
    assert position.setRefSpeeds(yarp.DVector(axes, 20.0))
    assert position.setRefAccelerations(yarp.DVector([10.0, 20.0, 30.0]))
    assert position.positionMove(0, 25.0)
    assert position.positionMove(yarp.DVector([1.0, 2.0, 3.0]))
    wait_until(position.checkMotionDone)
    assert position.isMotionDone(1)
    assert position.relativeMove(2, yarp.IVector([0, 2]), yarp.DVector([10.0, 10.0]))
    target, positions = yarp.DVector(1), yarp.DVector(axes)
    assert position.getTargetPosition(2, target)
    assert list(target) == [13.0]
    wait_until(lambda: encoders.getEncoders(positions) and list(positions) == [11.0, 2.0, 13.0])
    assert encoders.getEncoder(2) == 13.0
    done = yarp.BVector(1)
    assert position.checkMotionDone(2, yarp.IVector([0, 1]), done)
    assert done[0]
    assert position.stop()
    assert position.stop(1)
    assert position.stop(2, yarp.IVector([0, 1]))
    speeds = yarp.DVector(axes)
    assert position.getRefSpeeds(speeds)
    assert list(speeds) == [20.0] * 3
    assert position.getRefAccelerations(2, yarp.IVector([2, 0]), speeds)
    assert list(speeds)[:2] == [30.0, 10.0]


def test_streamed_velocities_reach_the_joints(driver: yarp.PolyDriver, joints: Joints) -> None:
    modes, velocity, encoders = driver.viewIControlMode(), driver.viewIVelocityControl(), driver.viewIEncoders()
    assert modes.setControlModes(yarp.IVector(AXES, yarp.VOCAB_CM_VELOCITY))
    for speed in (5.0, 10.0, 15.0):
        assert velocity.velocityMove(0, speed)
    assert velocity.velocityMove(1, -1.0)
    wait_until(lambda: joints.of("velocity") == [15.0, -1.0, 0.0])
    assert velocity.velocityMove(yarp.DVector([1.0, 2.0, 3.0]))
    wait_until(lambda: joints.of("velocity") == [1.0, 2.0, 3.0])
    assert velocity.velocityMove(2, yarp.IVector([2, 0]), yarp.DVector([7.0, 8.0]))
    wait_until(lambda: joints.of("velocity") == [8.0, 2.0, 7.0])
    velocities = yarp.DVector(AXES)
    assert velocity.getRefVelocities(velocities)
    assert list(velocities) == [8.0, 2.0, 7.0]
    wait_until(lambda: encoders.getEncoderSpeeds(velocities) and velocities[2] == 7.0)
    assert velocity.stop()
    assert joints.of("velocity") == [0.0] * AXES


def test_timed_encoders_fill_every_kind_of_vector(driver: yarp.PolyDriver, joints: Joints) -> None:
    joints.of("position")[:] = [1.0, 2.0, 3.0]
    timed = driver.viewIEncodersTimed()
    values, times = yarp.DVector(AXES), yarp.DVector(AXES)
    wait_until(lambda: timed.getEncodersTimed(values, times) and list(values) == [1.0, 2.0, 3.0])
    assert abs(times[0] - yarp.now()) < 40.0
    assert driver.viewIPreciselyTimed().getLastInputStamp().getTime() >= times[0]
    vector, array = yarp.Vector(AXES), np.zeros(AXES)
    assert timed.getEncoders(vector.data())
    assert timed.getEncoders(array)
    assert list(vector) == list(array) == [1.0, 2.0, 3.0]
    value, time = yarp.DVector(1), yarp.DVector(1)
    assert timed.getEncoderTimed(2, value, time)
    assert value[0] == 3.0
    assert timed.resetEncoders()
    wait_until(lambda: timed.getEncoder(2) == 0.0)
    assert timed.setEncoder(1, 4.0)
    wait_until(lambda: timed.getEncoder(1) == 4.0)


def test_modes_are_set_for_one_joint_some_and_all(driver: yarp.PolyDriver, joints: Joints) -> None:
    modes, interaction = driver.viewIControlMode(), driver.viewIInteractionMode()
    assert modes.setControlMode(1, yarp.VOCAB_CM_TORQUE)
    wait_until(lambda: modes.getControlMode(1) == yarp.VOCAB_CM_TORQUE)
    assert modes.setControlModes(2, yarp.IVector([0, 2]), yarp.IVector(2, yarp.VOCAB_CM_POSITION_DIRECT))
    values = yarp.IVector(AXES)
    direct = yarp.VOCAB_CM_POSITION_DIRECT
    wait_until(lambda: modes.getControlModes(values) and list(values) == [direct, yarp.VOCAB_CM_TORQUE, direct])
    assert interaction.setInteractionMode(0, yarp.VOCAB_IM_COMPLIANT)
    wait_until(lambda: interaction.getInteractionMode(0) == yarp.VOCAB_IM_COMPLIANT)
    assert interaction.setInteractionModes(yarp.IVector(AXES, yarp.VOCAB_IM_STIFF))
    wait_until(lambda: interaction.getInteractionModes(values) and list(values) == [yarp.VOCAB_IM_STIFF] * AXES)


def test_references_are_set_and_read_back(driver: yarp.PolyDriver, joints: Joints) -> None:
    direct, torque = driver.viewIPositionDirect(), driver.viewITorqueControl()
    pwm, current = driver.viewIPWMControl(), driver.viewICurrentControl()
    assert direct.setPositions(yarp.DVector([1.0, 2.0, 3.0]))
    assert direct.setPosition(0, 9.0)
    wait_until(lambda: joints.of("position") == [9.0, 2.0, 3.0])
    assert torque.setRefTorques(2, yarp.IVector([0, 1]), yarp.DVector([0.5, 0.25]))
    assert pwm.setRefDutyCycles(yarp.DVector([10.0, 20.0, 30.0]))
    assert current.setRefCurrent(2, 1.5)
    wait_until(
        lambda: joints.of("torque")[1] == 0.25 and joints.of("pwm")[2] == 30.0 and joints.of("current")[2] == 1.5
    )
    torques, least, greatest = yarp.DVector(AXES), yarp.DVector(1), yarp.DVector(1)
    assert torque.getRefTorques(torques)
    assert list(torques) == [0.5, 0.25, 0.0]
    assert torque.getTorqueRange(0, least, greatest)
    assert (least[0], greatest[0]) == (-1.0, 1.0)
    wait_until(lambda: pwm.getDutyCycles(torques) and list(torques) == [10.0, 20.0, 30.0])
    wait_until(lambda: current.getCurrent(2, greatest) and greatest[0] == 1.5)


def test_limits_names_and_variables_are_read_back(driver: yarp.PolyDriver, joints: Joints) -> None:
    limits, info, variables = driver.viewIControlLimits(), driver.viewIAxisInfo(), driver.viewIRemoteVariables()
    least, greatest = yarp.DVector(1), yarp.DVector(1)
    assert limits.setLimits(1, -30.0, 45.5)
    assert limits.getLimits(1, least, greatest)
    assert (least[0], greatest[0]) == (-30.0, 45.5)
    assert limits.getVelLimits(1, least, greatest)
    assert greatest[0] == 100.0
    assert [info.getAxisName(joint) for joint in range(AXES)] == ["joint0", "joint1", "joint2"]
    assert info.getJointType(0) == yarp.VOCAB_JOINTTYPE_REVOLUTE
    assert info.getAxisName(7) == "unknown"
    value = yarp.Bottle('12 (1.5 2.5) "two words"')
    assert variables.setRemoteVariable("gains", value)
    bottle = yarp.Bottle()
    assert variables.getRemoteVariable("gains", bottle)
    assert bottle.toString() == value.toString()
    assert variables.getRemoteVariablesList(bottle)
    assert bottle.toString() == "gains"
    assert not variables.getRemoteVariable("nothing", bottle)


def test_invalid_commands_return_false(driver: yarp.PolyDriver, joints: Joints) -> None:
    position = driver.viewIPositionControl()
    assert not position.positionMove(AXES, 1.0)
    assert not position.positionMove(yarp.DVector(AXES - 1))
    assert not driver.viewIMotor().getTemperatures(yarp.DVector(AXES))
    joints.modes[0] = yarp.VOCAB_CM_IDLE
    assert not position.positionMove(yarp.DVector([1.0, 1.0, 1.0]))
    with pytest.raises(TypeError):
        position.positionMove("far")
    with pytest.raises(TypeError):
        driver.viewIEncoders().getEncoders(1.0)


def test_a_state_expires_after_its_timeout(name_server: object) -> None:
    yarp.Network.init()
    board = Joints()
    server = ControlBoardServer("/robot/leg", board, period=0.005).open()
    options = {"device": "controlBoard_nwc_yarp", "remote": "/robot/leg", "local": "/script/leg", "timeout": 0.05}
    driver = yarp.PolyDriver(yarp.Property(options))
    encoders = driver.viewIEncoders()
    positions = yarp.DVector(AXES)
    wait_until(lambda: encoders.getEncoders(positions))
    server.close()
    wait_until(lambda: not encoders.getEncoders(positions))
    yarp.Network.fini()


def test_a_missing_board_is_reported_with_both_port_names(
    name_server: object, caplog: pytest.LogCaptureFixture
) -> None:
    yarp.Network.init()
    options = yarp.Property("(device remote_controlboard) (remote /robot/wing) (local /script/wing)")
    assert not yarp.PolyDriver(options).isValid()
    assert "/robot/wing/nws/rpc:i (YARP 4) nor /robot/wing/rpc:i (YARP 3)" in caplog.text
    yarp.Network.fini()
