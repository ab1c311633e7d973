"""A daemon with the demo's robot and the console, on the test's own ports, without ROS 1 and ROS 2."""

from __future__ import annotations

import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import yaml

from bridge.hub.session import Hub, HubSettings
from bridge.messages.registry import Registry
from tests.contract.hubside import HubSide
from tests.peers.browser.page import TestPage
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until
from yarp_compat.dev.map2d_client import Map2DClient
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address

ROOT = Path(__file__).parents[3]
CONFIG = ROOT / "configs" / "navigation.yaml"
PORTER = {"name": "porter", "base_frame": "odom", "path": "/planner/robot_path_planner/path"}
"""Another robot: it stands at the start of the odometry, and has the same goal as the first one."""


class WebRobot:
    """The robot can drive once `ready` has returned."""

    def __init__(self, folder: Path) -> None:
        self.port, self.router, self.names = free_port(), free_port(), free_port()
        self.file = folder / "midspan.yaml"
        config: dict[str, Any] = yaml.safe_load(CONFIG.read_text())
        store = {key: str(CONFIG.parent / file) for key, file in config["store"].items()}
        sections = {
            "name": "web-test",
            "state": str(folder / "state"),
            "hub": {"listen": f"tcp/127.0.0.1:{self.router}"},
            "ros1": {"enabled": False},
            "ros2": {"enabled": False},
            "store": store,
            "sim": {**config["sim"], "people": False},
            "yarp": {**config["yarp"], "address": f"127.0.0.1:{self.names}", "ip": "127.0.0.1"},
            "web": {"enabled": True, "listen": f"127.0.0.1:{self.port}", "robots": [PORTER]},
        }
        self.file.write_text(yaml.safe_dump({**config, **sections}))
        self.daemon = self._start()

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    def _start(self) -> Process:
        return Process([sys.executable, "-m", "bridge.cli.main", "run", "--config", self.file])

    def ready(self) -> None:
        """Wait until the page is served and the robot can drive."""
        until(self._answers, f"the page is served; {self.daemon.output()[-2000:]}", 60)
        with TestPage(self.port) as page:
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
        settings = HubSettings(node="far", worker="test", daemon="test", router=f"tcp/127.0.0.1:{self.router}")
        return HubSide(Hub.open(settings), Registry())

    def yarp_maps(self) -> Map2DClient:
        """Return a YARP client of Map2DServer."""
        names = NameClient(Address("127.0.0.1", self.names), namespace="/root")
        return Map2DClient(naming=names, timeout=30)

    def command(self, *words: str) -> str:
        """Return the output of a command."""
        done = subprocess.run(
            [sys.executable, "-m", "bridge.cli.main", *words, "--config", str(self.file)],
            capture_output=True, text=True, timeout=60, check=True,
        )  # fmt: skip
        return done.stdout.strip()

    def kill_daemon_and_start_again(self) -> None:
        """Kill the daemon and every worker, and restart it."""
        self.daemon.signal(9)
        self.daemon.stop()
        self.daemon = self._start()

    def close(self) -> None:
        self.daemon.stop()
