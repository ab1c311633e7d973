"""A deployment for the examples: the daemon with its gateway, a fast planner, and locations on a map."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import yaml
import zenoh

from tests.peers.daemon.deployment import Deployment
from tests.peers.navigation.hub_planner import HubPlanner
from tests.peers.ros1.network import ROS1_PYTHON
from tests.peers.ros2.network import ros2_environment, ros2_python
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until
from yarp_compat.dev.localization2d import Localization2DServer
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.map2d_client import Map2DClient
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.server import ServiceServer
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address

EXAMPLES = Path(__file__).parents[3] / "examples"
PLACES = {"kitchen": 1.0, "hall": 3.0, "bedroom": 0.0}
PLANNER = "robot_path_planner"


class Examples:
    """The servers that the examples connect to."""

    def __init__(self, deployment: Deployment) -> None:
        self.deployment = deployment
        self.address = Address("127.0.0.1", free_port())
        (deployment.folder / "yarp.conf").write_text(f"{self.address.host} {self.address.port} yarp\n")
        self.names = NameClient(self.address, namespace="/root")
        deployment.start(**self.sections(PLANNER))
        self.planner = deployment.keep(HubPlanner(deployment.settings(PLANNER), PLANNER))
        until(
            lambda: all(connections.exists(self.names, port) for port in _SERVER_PORTS),
            "YARP's server ports are open",
            40,
        )
        self._until_zenoh_is_served()
        self._store_places()
        answers = Localization2DServer(self)
        self._localizer = ServiceServer("/localization2D_nws_yarp/rpc", answers, naming=self.names).open()

    def sections(self, planner: str) -> dict[str, Any]:
        """Return the sections of the configuration."""
        return {
            "yarp": {"nameserver": "embedded", "address": f"127.0.0.1:{self.address.port}", "poll": 0.1},
            "navigation": {"planner": planner, "patience": 60.0},
            "modules": {"map2d_server": {"enabled": True, "current": "flat"}},
            "store": {"enabled": True},
            **yaml.safe_load((EXAMPLES / "zenoh.yaml").read_text()),
        }

    def _until_zenoh_is_served(self) -> None:
        config = zenoh.Config()
        for key, value in (("mode", "client"), ("connect/endpoints", [f"tcp/127.0.0.1:{self.deployment.port}"])):
            config.insert_json5(key, json.dumps(value))
        with zenoh.open(config) as session:
            querier = session.declare_querier("robot/go_to")
            until(lambda: querier.matching_status.matching, "the go_to service is served on zenoh", 40)  # type: ignore[attr-defined]
        until(
            lambda: self.deployment.route("zenoh_json", "/navigation/status", "out"),
            "the status is published on zenoh",
            40,
        )

    def _store_places(self) -> None:
        with Map2DClient(naming=self.names) as maps:
            maps.maps["flat"] = MapGrid2D.of(np.zeros((40, 40), np.uint8), name="flat", resolution=0.1)
            for name, x in PLACES.items():
                maps.locations[name] = Map2DLocation("flat", x, 0.0, 0.0)

    def getCurrentPosition(self) -> tuple[Map2DLocation, None]:  # noqa: N802 - YARP's name
        """Return the position of the planner's robot, as a localizer would."""
        return Map2DLocation("flat", self.robot_x(), 0.0, 0.0), None

    def robot_x(self) -> float:
        """Return the robot's position along x, in meters."""
        return float(self.planner.x)

    def start(self, side: str, example: str, *arguments: str) -> Process:
        """Start an example in its side's interpreter."""
        env = {**os.environ, "YARP_CONFIG_HOME": str(self.deployment.folder), "PYTHONUNBUFFERED": "1"}
        python: Any = sys.executable
        if side == "rospy":
            python, env = ROS1_PYTHON, self.deployment.master.env
        elif side == "ros1":
            env |= {"ROS_MASTER_URI": self.deployment.master.uri, "PYTHONPATH": str(EXAMPLES.parent)}
        elif side == "rclpy":
            python, env = ros2_python(), ros2_environment()
        return Process([python, EXAMPLES / example, *arguments], env)

    def stop(self) -> None:
        """Close the ports of this process."""
        self._localizer.close()


_SERVER_PORTS = ("/navigation2D_nws_yarp/rpc", "/map2D_nws_yarp/rpc")


def run(program: Process, seconds: float = 60.0) -> tuple[int, list[str]]:
    """Wait until a program exits; return its exit code and the lines that it printed."""
    try:
        code = program.popen.wait(seconds)
    except subprocess.TimeoutExpired:
        raise AssertionError(f"the program did not exit: {program.output()}") from None
    return code, program.output().splitlines()
