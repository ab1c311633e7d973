"""The simulated R1 and BaseControl, driven by programs of all sides through the whole daemon, in lock-step."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable
from typing import Any

import pytest

from tests.contract.hubside import HubSide
from tests.peers.daemon.deployment import Deployment
from tests.peers.navigation.square import Pose, Program, driven, pose_of
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.dev.basecontrol import MobileBaseVelocity, OdometryData
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer
from yarp_compat.pythonic import Reader, Writer

ODOMETRY, TWIST = "nav_msgs/Odometry", "geometry_msgs/Twist"
SIDE = 0.4
TICK = 0.08
SCALE = 0.03
NO_LASER = {"beams": 4, "rate": 1.0}
"""The laser with the least load, because these tests do not use it."""


class RosLike:
    """A program whose topics carry ROS messages."""

    def __init__(self, peer: Any) -> None:
        self._peer = peer
        self._out = peer.advertise("/cmd_vel", TWIST)
        self._in = peer.subscribe("/odom", ODOMETRY)
        self._heard = 0
        self._last: tuple[int, Pose] = (-1, Pose(0.0, 0.0, 0.0))

    def command(self, x: float, turn: float) -> None:
        # the unused axes have distinct values, which reveal swapped axes
        linear, angular = {"x": x, "y": 0.5, "z": 0.25}, {"x": 0.125, "y": 0.75, "z": turn}
        self._peer.publish(self._out, {"linear": linear, "angular": angular})

    def pose(self, after_ns: int) -> Pose:
        while self._last[0] < after_ns:
            new = self._listen()
            assert new, f"no odometry after {after_ns / 1e9:.2f} s, the last is of {self._last[0] / 1e9:.2f} s"
            self._heard += len(new)
            self._last = pose_of(new[-1])
        return self._last[1]

    def _listen(self) -> list[dict[str, Any]]:
        if isinstance(self._peer, HubSide):
            return self._peer.wait(self._in, self._heard + 1, 20.0)[self._heard :]
        result: list[dict[str, Any]] = self._peer.wait(self._in, self._heard + 1, 20.0, self._heard)
        return result


class YarpProgram:
    """A program that writes to BaseControl's port and reads the odometry, only through YARP."""

    def __init__(self, names: NameClient) -> None:
        self._writer = Writer("/square/command:o", naming=names).open()
        self._reader = Reader("/square/odometry:i", naming=names).open()
        connect = connections.connect
        until(lambda: connections.exists(names, "/baseControl/odometry/odometry:o"), "BaseControl's ports exist", 20)
        self._writer.connect("/baseControl/input/command/data:i")
        connect(names, "/baseControl/odometry/odometry:o", "/square/odometry:i")
        self._last = (-1, Pose(0.0, 0.0, 0.0))

    def command(self, x: float, turn: float) -> None:
        self._writer.write(MobileBaseVelocity(x, 0.5, math.degrees(turn)))

    def pose(self, after_ns: int) -> Pose:
        while self._last[0] < after_ns:
            received = self._reader.read()
            assert received is not None
            data = received.to(OdometryData)
            stamp = round(float(received.envelope.split()[1]) * 1e9)
            self._last = (stamp, Pose(data.odom_x, data.odom_y, math.radians(data.odom_theta)))
        return self._last[1]

    def stop(self) -> None:
        self._writer.close()
        self._reader.close()


class Robot:
    """The deployment with the simulator and BaseControl."""

    def __init__(self, deployment: Deployment, **sim: Any) -> None:
        self.deployment, port = deployment, free_port()
        server = deployment.keep(_Stopped(NameServer(port=port, gc_seconds=0)))
        assert server
        self.names = NameClient(Address("127.0.0.1", port), namespace="/root")
        deployment.start(
            sim={"enabled": True, "speed": "step", "drive": "wheels", "plan": "hall", "laser": NO_LASER, **sim},
            clock={"source": "sim"},
            modules={"base_control": {"enabled": True}},
            yarp={"address": f"127.0.0.1:{port}", "namespace": "/root", "ip": "127.0.0.1"},
        )
        self.far = deployment.zenoh()
        self._truth = self.far.subscribe("/ground_truth", ODOMETRY, depth=1)
        self.now = 0
        until(self._ready, "the robot steps", 40)

    def _ready(self) -> bool:
        return bool(self.call(TICK, "base_control", patience=1.0)["success"])

    def call(self, seconds: float, *wait_for: str, patience: float = 20.0) -> dict[str, Any]:
        request = {"seconds": seconds, "wait_for": list(wait_for), "patience": patience}
        reply: dict[str, Any] = self.far.call("/sim/step", "midspan_msgs/Step", **request).result(40)["reply"]
        return reply

    def step(self) -> int:
        """Advance the simulation; return its time in nanoseconds."""
        reply = self.call(TICK, "base_control")
        assert reply["success"], reply
        self.now = reply["stamp"]["sec"] * 1_000_000_000 + reply["stamp"]["nanosec"]
        return self.now

    def commands(self) -> int:
        """Return how many commands BaseControl has accepted."""
        (reply,) = self.far.hub.ask("status", {}, worker="base_control", timeout=20.0)
        return sum(source["commands"] for source in reply.value["inputs"].values())

    def truth(self) -> Pose:
        """Return the robot's current true pose."""
        result: tuple[int, Pose] = (-1, Pose(0.0, 0.0, 0.0))

        def current() -> bool:
            nonlocal result
            result = pose_of(self.far.wait(self._truth, 1)[-1])
            return result[0] > self.now - 30_000_000  # the true pose is published at 50 Hz

        until(current, "the true pose is published", 20)
        return result[1]


class Paced:
    """A program that continues when BaseControl has received its command.

    The simulation does not wait for commands, which could arrive some ticks late on a busy machine.
    """

    def __init__(self, robot: Robot, program: Program) -> None:
        self._robot, self._program = robot, program
        self._received = robot.commands()
        self.pose = program.pose

    def command(self, x: float, turn: float) -> None:
        """Send a command every 2 s until BaseControl receives one; it drops commands that a stalled process delays."""
        accepted, again = self._received, -math.inf

        def received() -> bool:
            nonlocal again
            if time.monotonic() > again:
                again = time.monotonic() + 2.0
                self._program.command(x, turn)
            self._received = self._robot.commands()
            return self._received != accepted

        until(received, "BaseControl receives the command", 40)


class _Stopped:
    def __init__(self, server: NameServer) -> None:
        server.open()
        self.stop = server.close


def moved(start: Pose, pose: Pose) -> Pose:
    """Return a pose relative to ``start``."""
    dx, dy = pose.x - start.x, pose.y - start.y
    cos, sin = math.cos(start.theta), math.sin(start.theta)
    theta = math.remainder(pose.theta - start.theta, 2 * math.pi)
    return Pose(cos * dx + sin * dy, cos * dy - sin * dx, theta)


CORNERS = ((SIDE, 0.0), (SIDE, SIDE), (0.0, SIDE), (0.0, 0.0))


@pytest.mark.thorough
@pytest.mark.timeout(300)  # several hundred steps, each of which waits for four processes
def test_programs_of_every_side_drive_a_square(deployment: Deployment) -> None:
    """The first program drives a square, the others two sides, which shows both axes of the command."""
    robot = Robot(deployment)
    yarp = deployment.keep(YarpProgram(robot.names))
    programs: dict[str, Callable[[], Program]] = {
        "rospy": lambda: RosLike(deployment.ros1()),
        "rclpy": lambda: RosLike(deployment.ros2()),
        "zenoh": lambda: RosLike(deployment.sdk()),
        "YARP": lambda: yarp,
    }
    for name, created in programs.items():
        program = created()
        connected(robot, program)
        start, reported = robot.truth(), program.pose(robot.now)
        corners = CORNERS if name == "rospy" else CORNERS[:2]
        poses = driven(Paced(robot, program), SIDE, robot.step, len(corners))
        for corner, pose in zip(corners, poses, strict=True):
            true, by_odometry = moved(start, robot.truth()), moved(reported, pose)
            assert math.dist(true[:2], corner) < 0.05, (name, corner, true)
            assert math.dist(true[:2], by_odometry[:2]) < 0.01 * 4 * SIDE, (name, true, by_odometry)
            assert abs(math.remainder(true.theta - by_odometry.theta, 2 * math.pi)) < 0.01 * 2 * math.pi


def connected(robot: Robot, program: Program) -> None:
    """Wait until the program's commands move the robot and odometry arrives; then stop the robot."""
    begin = robot.truth()

    def moves() -> bool:
        program.command(0.05, 0.0)
        robot.step()
        return math.dist(robot.truth()[:2], begin[:2]) > 0.01

    until(moves, "the program's commands move the robot", 40)
    while True:
        before = robot.truth()
        robot.step()
        robot.step()
        if math.dist(before[:2], robot.truth()[:2]) < 1e-5:
            break
    program.pose(robot.now)


@pytest.mark.thorough
def test_odometry_has_the_error_of_the_encoders(deployment: Deployment) -> None:
    robot = Robot(deployment, encoders={"scale": [SCALE, SCALE]})
    program = RosLike(robot.far)
    connected(robot, program)
    start, reported = robot.truth(), program.pose(robot.now)
    for _ in range(60):
        program.command(0.25, 0.0)
        robot.step()
    true, by_odometry = moved(start, robot.truth()), moved(reported, program.pose(robot.now))
    assert true.x > 0.4
    assert by_odometry.x / true.x == pytest.approx(1.0 + SCALE, abs=0.01)


@pytest.mark.thorough
def test_the_base_stops_when_its_commanders_worker_is_killed_and_resumes_with_the_next(
    deployment: Deployment,
) -> None:
    robot = Robot(deployment)
    program = RosLike(deployment.ros1())
    connected(robot, program)

    def turns() -> float:
        """Command for some ticks, and return the angle that the robot turned in the last one, in radians."""
        before = robot.truth()
        for _ in range(3):
            before = robot.truth()
            program.command(0.0, 0.5)
            robot.step()
        return abs(math.remainder(robot.truth()[2] - before[2], math.tau))

    def stands() -> bool:
        """Kill the worker, and return whether the robot stands before the next worker takes over."""
        os.kill(deployment.answer("ros1")["pid"], signal.SIGKILL)
        end = time.monotonic() + 2.0
        while time.monotonic() < end:
            if turns() < 1e-5:
                return True
        return False

    until(lambda: turns() > 0.2 * TICK, "the robot turns", 20)
    until(stands, "the robot stands despite the program's commands", 20)
    until(lambda: turns() > 0.2 * TICK, "the robot turns through the next worker", 40)
