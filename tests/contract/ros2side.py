"""The ROS 2 side of the contract suite: real rclpy programs of Jazzy and Kilted on a separate domain."""

from __future__ import annotations

import functools
import os
from pathlib import Path
from typing import Any

from typing_extensions import override

from bridge.adapters.ros2.environment import worker_environment
from bridge.config.model import Config
from bridge.interfaces.builder import build
from bridge.interfaces.cache import environment
from bridge.interfaces.folders import read_folders
from tests.contract.side import PEER_FOLDERS, Side, WorkerProcess
from tests.peers.hub.network import HubNetwork
from tests.peers.peer import Peer
from tests.peers.ros2 import kilted
from tests.peers.ros2.network import (
    ROS2_PEER,
    SHORT_CYCLONE_LEASE,
    SHORT_LEASE,
    ros2_domain,
    ros2_environment,
    ros2_python,
)
from tests.support.missing import ROS2, need


class Ros2Side(Side):
    """A DDS domain. It has no central process that could crash; only its programs start and exit."""

    name = "ros2"
    has_services = True
    tells_errors = False
    reports_death = False  # not before a program's lease of 20 s expires

    def __init__(self, _hubs: HubNetwork) -> None:
        super().__init__()
        need(ROS2)

    def peer(self, **more: str) -> Peer:
        peer = Peer(ROS2_PEER, ros2_python(), self._environment() | more, f"peer{next(self._names)}")
        self._open.append(peer)
        return peer

    def _environment(self) -> dict[str, str]:
        """Return the environment of programs."""
        return _custom_environment()

    def mortal(self) -> Peer:
        return self.peer(**SHORT_LEASE)

    def bridge(self, config: Config) -> WorkerProcess:
        worker = WorkerProcess("ros2", config, worker_environment(config, os.environ))
        self._open.append(worker)
        return worker

    def restart_network(self) -> None:
        pass

    def config(self) -> dict[str, Any]:
        return {"ros2": {"domain": ros2_domain()}}


class KiltedSide(Ros2Side):
    """The same with programs on ROS 2 Kilted (Fast DDS 3), while Midspan uses Jazzy."""

    @override
    def mortal(self) -> Peer:
        return self.peer(FASTDDS_DEFAULT_PROFILES_FILE=SHORT_LEASE["FASTRTPS_DEFAULT_PROFILES_FILE"])

    @override
    def _environment(self) -> dict[str, str]:
        return _kilted_environment()


class CycloneSide(Ros2Side):
    """Midspan and the programs on Cyclone DDS (``ros2.rmw``)."""

    @override
    def mortal(self) -> Peer:
        return self.peer(**SHORT_CYCLONE_LEASE)

    @override
    def _environment(self) -> dict[str, str]:
        return {**ros2_environment(on_cyclone=True), **environment([_custom_prefix()])}

    @override
    def config(self) -> dict[str, Any]:
        return {"ros2": {"domain": ros2_domain(), "rmw": "rmw_cyclonedds_cpp"}}


@functools.cache
def _custom_prefix() -> Path:
    """Build the suite's message packages as a user would."""
    return build(read_folders(PEER_FOLDERS))


@functools.cache
def _kilted_environment() -> dict[str, str]:
    return kilted.program_environment(read_folders(PEER_FOLDERS))


def _custom_environment() -> dict[str, str]:
    return {**ros2_environment(), **environment([_custom_prefix()])}
