"""A robot's driver on another computer than the daemon: commands that its network delays are not executed later.

Each computer is a network namespace. The commander is on the daemon's computer, and on another side than the driver.
"""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.peers.daemon.midspan import MIDSPAN
from tests.peers.hub.network import ROOT
from tests.peers.peer import Peer, on_machine
from tests.peers.ros1.network import ROS1_PEER, ROS1_PYTHON, ros1_environment
from tests.peers.ros2.network import ROS2_PEER, ros2_domain, ros2_environment, ros2_python
from tests.support.missing import ROS1, ROS2, needs
from tests.support.netns import Cable, Machine, need_namespaces
from tests.support.process import DAEMON_SECONDS, Process
from tests.support.wait import until

pytestmark = [needs(ROS1), needs(ROS2), pytest.mark.thorough]

YARP_PEER = ROOT / "tests" / "peers" / "yarp" / "peer.py"
STRING, TWIST = "std_msgs/String", "geometry_msgs/Twist"
CUT = 4.0
"""Seconds without the network: shorter than the 20 s after which DDS forgets a participant."""

COMMANDED = 2.0
"""Seconds of this time during which the commander sends."""

FAST_TOPIC, FAST_PORT = "/cmd_vel_yarpfast_tcp", "/driver/commands:i"
"""A topic that Midspan writes to a YARP port over fast_tcp, the carrier without acknowledgments."""

HEARTBEAT = 3.0
"""Seconds between the times at which Fast DDS offers a reader what it has missed."""


class Robot:
    """A daemon, roscore and commanders on one computer, and the drivers of a base of each side on another."""

    def __init__(self, folder: Path) -> None:
        self.bridge, self.base = Machine("hopbridge"), Machine("hopbase")
        self.cable = Cable(self.bridge, self.base)
        near, far = self.cable.addresses
        for machine in (self.bridge, self.base):
            machine.hosts(**{socket.gethostname(): "127.0.0.1"})
        self.master = f"http://{near}:11311"
        self.folder = folder
        config = {
            "state": str(folder / "state"),
            "hub": {"listen": "tcp/127.0.0.1:7447"},
            "ros1": {"master": self.master, "ip": near, "poll": 0.1},
            "ros2": {"domain": ros2_domain(), "localhost_only": False, "transport": "udp"},
            "yarp": {
                "nameserver": "embedded",
                "address": f"{near}:10000",
                "ip": near,
                "topics": [{"topic": FAST_TOPIC, "port": FAST_PORT, "direction": "out", "carrier": "fast_tcp"}],
            },
        }
        (folder / "midspan.yaml").write_text(yaml.safe_dump(config))
        ros2 = ros2_environment(ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET", FASTDDS_BUILTIN_TRANSPORTS="UDPv4")
        python2 = ros2_python()
        self.processes: list[Process] = []
        self.processes.append(self.bridge.start(ROS1_PYTHON, "/usr/bin/roscore", env=self.ros1(near)))
        daemon = self.bridge.start(*MIDSPAN, "run", "--config", folder / "midspan.yaml", env=dict(os.environ))
        self.processes.append(daemon)
        ros1_commander = self.program(self.bridge, ROS1_PYTHON, ROS1_PEER, self.ros1(near), "commander")
        ros2_commander = self.program(self.bridge, python2, ROS2_PEER, ros2, "commander")
        until(lambda: "yarp: running" in daemon.output(), "the daemon's name server runs")
        yarp = {"PYTHONPATH": str(ROOT)}
        yarp_driver = self.program(self.base, sys.executable, YARP_PEER, yarp, near, "10000", "/driver")
        self.commanders = {
            "ROS 1": ros2_commander,
            "ROS 2": ros1_commander,
            "YARP tcp": ros1_commander,
            "YARP fast_tcp": ros2_commander,
        }
        self.drivers = {
            "ROS 1": self.program(self.base, ROS1_PYTHON, ROS1_PEER, self.ros1(far), "driver"),
            "ROS 2": self.program(self.base, python2, ROS2_PEER, ros2, "driver"),
            "YARP tcp": yarp_driver,
            "YARP fast_tcp": yarp_driver,
        }

    def ros1(self, address: str) -> dict[str, str]:
        home = {"ROS_HOME": str(self.folder / "ros"), "ROS_LOG_DIR": str(self.folder / "ros" / "log")}
        return {**ros1_environment(self.master), "ROS_IP": address, **home}

    def program(self, machine: Machine, python: Path | str, program: Path, env: dict[str, str], *words: str) -> Peer:
        peer = on_machine(machine, env, python, program, *words)
        self.processes.append(peer)
        return peer

    def close(self) -> None:
        for process in reversed(self.processes):
            process.stop(DAEMON_SECONDS)
        for machine in (self.bridge, self.base):
            machine.close()


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    need_namespaces()
    with contextlib.closing(Robot(tmp_path_factory.mktemp("hop"))) as robot:
        yield robot


class Drive:
    """Commands from a program on one side to the driver on another; each contains the time at which it is sent."""

    def __init__(self, robot: Robot, side: str) -> None:
        self._commander, self._driver = robot.commanders[side], robot.drivers[side]
        topic = f"/cmd_vel_{side.replace(' ', '').lower()}"
        port = {"port": FAST_PORT} if topic == FAST_TOPIC else {}
        self._subscriber = self._driver.subscribe(topic, TWIST, depth=1000, **port)
        self._publisher = self._commander.advertise(topic, TWIST)
        self._texts = self._driver.subscribe(f"{topic}/text", STRING)
        self._text = self._commander.advertise(f"{topic}/text", STRING)

    def send(self) -> None:
        self._commander.publish(self._publisher, {"linear": {"x": time.monotonic()}})

    def stream(self, seconds: float) -> None:
        """Send commands 20 times per second."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.send()
            time.sleep(0.05)

    def received(self) -> list[float]:
        messages: list[dict[str, Any]] = self._driver.wait(self._subscriber, 0, 0)
        return [message["linear"]["x"] for message in messages]

    def until_text_crosses(self) -> None:
        """Send texts, which no timeout drops, until one reaches the driver: the network is back."""

        def once() -> bool:
            self._commander.publish(self._text, {"data": "text"})
            return bool(self._driver.wait(self._texts, 1, 0.2))

        until(once, "a text reaches the driver", 60)

    def until_crosses(self, seconds: float) -> None:
        """Send commands until the driver receives another one."""
        before = len(self.received())

        def once() -> bool:
            self.send()
            return len(self._driver.wait(self._subscriber, before + 1, 0.2)) > before

        until(once, "commands reach the driver", seconds)


@pytest.mark.parametrize("side", ["ROS 1", "ROS 2", "YARP tcp", "YARP fast_tcp"])
def test_commands_of_a_silent_commander_do_not_move_the_robot_after_a_cut(robot: Robot, side: str) -> None:
    drive = Drive(robot, side)
    drive.until_crosses(60)
    drive.stream(1.0)
    with robot.cable:
        robot.cable.cut()
        cut = time.monotonic()
        drive.stream(COMMANDED)
        before = len(drive.received())
        time.sleep(CUT - COMMANDED)  # the commander is silent, and the network is still down
    restored = time.monotonic()
    drive.until_text_crosses()
    time.sleep(HEARTBEAT)  # an absent message causes no event to wait for
    drive.until_crosses(60)
    late = [sent for sent in drive.received()[before:] if sent < restored]
    print(f"{side}: {len(late)} of {COMMANDED * 20:.0f} commands arrived after the cut")
    assert not late or late[-1] == 0.0, "the robot stops"
    assert not late or max(late) < cut + 0.8, "later commands are dropped"
