"""ROS 2 for the tests: a domain for each test process, and the environment of real rclpy programs on it."""

from __future__ import annotations

import functools
import os
import socket
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from bridge.adapters.ros2.environment import available, worker_environment
from bridge.config.model import Config
from bridge.demo.sandbox import hold_domain
from tests.support.missing import ROS2, need

ROS2_PEER = Path(__file__).with_name("peer.py")
"""The program that `tests.peers.peer.Peer` drives on the ROS 2 side; run it with `sys.executable`."""

SERVER = Path(sys.prefix) / "bin/fast-discovery-server"
"""Fast DDS's discovery server, which needs `ros2_environment`."""

SHORT_LEASE = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(Path(__file__).with_name("short_lease.xml"))}
"""Environment of a program whose death is detected after 2 s; Fast DDS's default is 20 s."""

SHORT_CYCLONE_LEASE = {"CYCLONEDDS_URI": "<CycloneDDS><Domain><Discovery><LeaseDuration>2s</></></></CycloneDDS>"}
"""The same for a program on Cyclone DDS, whose default is 10 s."""

_held: list[socket.socket] = []


@functools.cache
def ros2_domain() -> int:
    """Return this test process's ROS domain."""
    return new_domain()


def new_domain() -> int:
    """Return a ROS domain that no other test process or demo uses, reserved until this process exits."""
    hold, domain = hold_domain()
    _held.append(hold)
    return domain


def ros2_environment(*, on_cyclone: bool = False, **extra: str) -> dict[str, str]:
    """Return an environment for native ROS 2 programs on this process's domain: default settings, this machine only.

    With ``on_cyclone``, the programs use rmw_cyclonedds_cpp, which must be installed (`has_rmw_cyclonedds`).
    """
    environment: Mapping[str, str] = os.environ
    rmw = {"rmw": "rmw_cyclonedds_cpp"} if on_cyclone else {}
    env = worker_environment(Config.model_validate({"ros2": {"domain": ros2_domain(), **rmw}}), environment)
    for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "PYTHONPATH", "ROS_SUPER_CLIENT"):
        env.pop(name, None)
    logs = Path(tempfile.gettempdir()) / f"midspan-test-ros2-log-{os.getuid()}"
    env |= {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(logs),
        "PYTHONUNBUFFERED": "1",
        **extra,
    }
    return env


def has_rmw_cyclonedds() -> bool:
    """Return whether the tests' ROS 2 has rmw_cyclonedds_cpp, which the wheels lack."""
    return not available(Config.model_validate({"ros2": {"rmw": "rmw_cyclonedds_cpp"}}))


def ros2_python() -> Path:
    """Return the interpreter that has rclpy; skip the test if ROS 2 is missing."""
    need(ROS2)
    return Path(sys.executable)
