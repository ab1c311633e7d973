"""The unchanged deployments of configs/ with external planners; stand-ins replace the ROS programs.

In the second scenario of the paper that Midspan continues (see the README), a YARP client sends a robot on YARP to a
place, and ROS 1's move_base drives it there, with amcl and map_server. The other deployment is Nav2 with a YARP client.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.peers.daemon.deployment import Deployment
from tests.peers.ros1.network import ROS1_PYTHON
from tests.peers.ros2.network import SHORT_LEASE, ros2_domain, ros2_environment, ros2_python
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until
from yarp_compat.dev.inavigation2d import NavigationStatusEnum
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.navigation2d_client import Navigation2DClient
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer
from yarp_compat.ports.naming import NoNameServerError, PortError
from yarp_compat.pythonic import Reader
from yarp_compat.sig.matrix import Matrix

pytestmark = pytest.mark.thorough

ROOT = Path(__file__).parents[2]
CONFIGS, PEERS = ROOT / "configs", ROOT / "tests" / "peers"
APARTMENT = str(CONFIGS / "apartment" / "apartment.yaml")
SPEED, PATIENCE = "2.0", "5.0"
SECONDS = 40.0


class Site:
    """A deployment of a file on its own ports and networks, with a robot's name server if the file needs one."""

    def __init__(self, deployment: Deployment, file: str) -> None:
        self.deployment, self._stack = deployment, ExitStack()
        self.address = Address("127.0.0.1", free_port())
        config: dict[str, Any] = yaml.safe_load((CONFIGS / file).read_text())
        namespace = "/root"
        if config["yarp"]["nameserver"] == "site":
            self._stack.enter_context(NameServer(port=self.address.port, namespace=namespace, gc_seconds=0))
        config["yarp"] |= {"address": f"127.0.0.1:{self.address.port}", "namespace": namespace, "poll": 0.1}
        config["store"]["locations"] = str(CONFIGS / config["store"]["locations"])
        config.pop("ros1", None)
        config["ros2"] = {"domain": ros2_domain()}
        self.names = NameClient(self.address, namespace=namespace)
        deployment.start(**config)

    def program(self, python: Any, script: str, *words: str, **env: str) -> None:
        self.deployment.keep(Process([python, PEERS / script, *words], env))

    def client(self) -> Navigation2DClient:
        """Return a YARP program that knows only names of places."""

        def opened() -> Navigation2DClient | None:
            # the yarp worker may run the name server, and starts after the ROS workers; a port is registered shortly
            # before it is open, and may have to use another number
            try:
                return self._stack.enter_context(Navigation2DClient(naming=self.names, timeout=SECONDS))
            except (NoNameServerError, PortError):
                return None

        result = until(opened, "all of YARP's entry points are open", SECONDS, every=0.2)
        assert result is not None
        return result

    def reader(self, port: str) -> Reader:
        return self._stack.enter_context(Reader(port, naming=self.names))

    def reaches(self, port: str) -> bool:
        """Return whether the bridge is connected to a port of the robot."""
        ports = self.deployment.worker("yarp").get("ports", [])
        return any(peer["port"] == port for item in ports for peer in item["peers"])

    def close(self) -> None:
        self._stack.close()


@pytest.fixture
def site(deployment: Deployment, request: pytest.FixtureRequest) -> Iterator[Site]:
    with contextlib.closing(Site(deployment, request.param)) as site:
        yield site


def until_the_map_is_known(client: Navigation2DClient) -> None:
    """Wait until the map of the stand-in for map_server is in the store."""
    names: list[str] = []
    until(lambda: client.get_map_names(names) and "apartment" in names, "the map is known", SECONDS, every=0.2)


def assert_goes(client: Navigation2DClient, place: str) -> None:
    """Send the robot to a place. The gateway's entry point may exist shortly before the planner is discovered."""
    until(lambda: bool(client.gotoTargetByLocationName(place)), f"{place} is accepted as a goal", SECONDS, every=0.5)
    reached = NavigationStatusEnum.navigation_status_goal_reached
    until(lambda: client.status == reached, f"{place} is reached", SECONDS, every=0.1)


@pytest.mark.parametrize("site", ["yarp_robot_move_base.yaml"], indirect=True)
def test_a_yarp_robot_is_driven_by_move_base_and_localized_by_amcl(site: Site) -> None:
    environment = site.deployment.master.env
    wheels = site.reader("/baseControl/control:i")
    site.program(ROS1_PYTHON, "ros1/map_server.py", APARTMENT, **environment)
    site.program(ROS1_PYTHON, "ros1/amcl.py", **environment)
    site.program(ROS1_PYTHON, "ros1/move_base.py", SPEED, PATIENCE, **environment)
    client = site.client()
    until_the_map_is_known(client)
    until(lambda: site.reaches("/baseControl/control:i"), "velocities cross", SECONDS, every=0.2)
    assert_goes(client, "kitchen")
    local, covariance = Map2DLocation(), Matrix()

    def arrived() -> bool:
        return bool(client.getCurrentPosition(local, covariance)) and (local.x, local.y) == pytest.approx(
            (1.6, 2.4), abs=0.1
        )

    until(arrived, "the frames report the robot's arrival", SECONDS, every=0.2)
    assert local.map_id == "apartment"  # the map of the locations, although /map has no name
    assert covariance.numpy().shape == (3, 3)
    assert covariance.numpy()[0, 0] == pytest.approx(0.04)
    commands = []
    while (message := wheels.read_now()) is not None:
        commands.append(message.values)
    assert commands, "the wheels receive nothing"
    assert commands[-1][0] == 3


@pytest.mark.parametrize("site", ["nav2.yaml"], indirect=True)
def test_nav2_drives_for_a_client_of_yarp(site: Site) -> None:
    environment = {**ros2_environment(), **SHORT_LEASE}
    site.program(ROS1_PYTHON, "ros1/map_server.py", APARTMENT, **site.deployment.master.env)
    site.program(ros2_python(), "ros2/nav2.py", SPEED, PATIENCE, **environment)
    client = site.client()
    until_the_map_is_known(client)
    assert_goes(client, "bedroom")
