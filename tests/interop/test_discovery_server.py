"""A real Fast DDS discovery server (``ROS_DISCOVERY_SERVER``), real ROS programs on both sides, and the real daemon."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.peers.daemon.deployment import Deployment
from tests.peers.ros2.network import ros2_environment
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until

KIND = "std_msgs/String"


@pytest.fixture
def _server(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Run a discovery server, which all programs of the test use."""
    port = free_port()
    monkeypatch.setenv("ROS_DISCOVERY_SERVER", f"127.0.0.1:{port}")
    command = [str(Path(sys.prefix) / "bin/fast-discovery-server"), "-i", "0", "-l", "127.0.0.1", "-p", str(port)]
    with Process(command, ros2_environment()):
        yield


@pytest.mark.usefixtures("_server")
def test_programs_of_a_discovery_server_are_bridged(deployment: Deployment) -> None:
    """Programs that start later, or that were bridged before the worker was killed, are included."""
    deployment.start()
    ros1, ros2 = deployment.ros1(), deployment.ros2()
    ends = {
        ros2: (ros2.advertise("/to_ros1", KIND), ros1, ros1.subscribe("/to_ros1", KIND)),
        ros1: (ros1.advertise("/to_ros2", KIND), ros2, ros2.subscribe("/to_ros2", KIND)),
    }

    def crosses(word: str) -> None:
        def received() -> bool:
            for source, (publisher, _, _) in ends.items():
                source.publish(publisher, {"data": word})
            return all({"data": word} in sink.wait(number, 1, 0.2) for _, sink, number in ends.values())

        until(received, f"messages cross {word}", 40)

    crosses("at first")
    pid = deployment.worker("ros2")["pid"]
    os.kill(pid, signal.SIGKILL)
    until(lambda: deployment.worker("ros2").get("pid") not in (None, pid), "another worker runs", 40, every=0.1)
    crosses("after the kill")
    late = deployment.ros2("late")
    published, received = late.advertise("/late", KIND), ros1.subscribe("/late", KIND)

    def heard() -> bool:
        late.publish(published, {"data": "late"})
        return bool(ros1.wait(received, 1, 0.2))

    until(heard, "a program that starts later is bridged", 40)
