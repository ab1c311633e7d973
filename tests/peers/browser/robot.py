"""A daemon with the demo's robot and the console, on the test's own ports, without ROS 1 and ROS 2."""

from __future__ import annotations

import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import yaml

from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from tests.contract.hubside import HubSide
from tests.peers.browser.page import TestPage
from tests.peers.daemon.midspan import MidspanDaemon
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.dev.map2d_client import Map2DClient
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address

ROOT = Path(__file__).parents[3]
CONFIG = ROOT / "configs" / "navigation.yaml"
PORTER = {"name": "porter", "base_frame": "odom", "path": "/planner/robot_path_planner/path"}
"""Another robot, which stands at the start of the odometry and has the same goal as the first one."""


class WebRobot(MidspanDaemon):
    """The robot can drive once `ready` has returned."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, "web-test")
        self.web, self.names = free_port(), free_port()
        config: dict[str, Any] = yaml.safe_load(CONFIG.read_text())
        store = {key: str(CONFIG.parent / file) for key, file in config["store"].items()}
        sections = {
            "hub": {"listen": self.endpoint},
            "ros1": {"enabled": False},
            "ros2": {"enabled": False},
            "store": store,
            "sim": {**config["sim"], "people": False},
            "yarp": {**config["yarp"], "address": f"127.0.0.1:{self.names}", "ip": "127.0.0.1"},
            "web": {"enabled": True, "listen": f"127.0.0.1:{self.web}", "robots": [PORTER]},
        }
        self.configure(**{**config, "name": self.name, "state": str(folder / "state"), **sections})
        self.run()

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.web}/"

    def ready(self) -> None:
        """Wait until the page is served and the robot can drive."""
        assert self.daemon is not None
        until(self._answers, f"the page is served; {self.daemon.output()[-2000:]}", 60)
        with TestPage(self.web) as page:
            page.watch("robot", "driving", "places")
            page.value("robot", what="the robot's pose is known")
            page.value("driving", lambda value: value and value["state"] == "idle")
            page.value("places", lambda value: value and "kitchen" in value["locations"])

    def _answers(self) -> bool:
        try:
            with urllib.request.urlopen(self.address, timeout=5) as answer:
                return bool(answer.status == 200)
        except (urllib.error.URLError, OSError):
            return False

    def hub_program(self) -> HubSide:
        """Return a program on the robot's hub."""
        return HubSide(Hub.open(self.settings("far")), Registry())

    def yarp_maps(self) -> Map2DClient:
        """Return a YARP client of Map2DServer."""
        names = NameClient(Address("127.0.0.1", self.names), namespace="/root")
        return Map2DClient(naming=names, timeout=30)

    def kill_daemon(self) -> None:
        """Kill the daemon and every worker; `run` starts it again."""
        assert self.daemon is not None
        self.daemon.signal(9)
        self.daemon.stop()

    def close(self) -> None:
        self.stop_daemon()
