"""Unchanged scripts (`import yarp`) that open devices, as separate programs, with servers at real ports."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from tests.peers.yarp.map_server import KeptMaps
from tests.peers.yarp.script import output_lines, start
from tests.support.ports import free_port
from tests.yarp_compat.dev.drivers.test_cameras_and_models import Camera
from tests.yarp_compat.dev.drivers.test_sensors import SCAN, Battery, Laser
from yarp_compat.dev.battery import BatteryData
from yarp_compat.dev.inavigation2d import Navigation2DServer
from yarp_compat.dev.localization2d import Localization2DServer
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.server import ServiceServer
from yarp_compat.dev.service import Service
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer
from yarp_compat.pythonic import Writer
from yarp_compat.sig.image import ImageRgb
from yarp_compat.wire.generation import Generation, Generations

KITCHEN = Map2DLocation("flat", 3.0, 1.0, 90.0)


class Network:
    """A name server, its folder, and its servers."""

    def __init__(self, folder: Path, server: NameServer, open_ports: ExitStack) -> None:
        self.folder, self._open = folder, open_ports
        self._naming = NameClient(Address(server.address.host, server.address.port))

    def serve(self, name: str, service: Service, generation: Generation) -> None:
        """Serve an interface as a release of YARP does."""
        server = ServiceServer(
            name, service, generations=Generations(generation), profile=generation.profile, naming=self._naming
        )
        self._open.enter_context(server)

    def publish(self, name: str, content: Any) -> None:
        """Publish the same message repeatedly until the test ends."""
        out, ended = self._open.enter_context(Writer(name, naming=self._naming)), threading.Event()

        def write() -> None:
            while not ended.wait(0.02):
                out.write(content, "1 1795143618.5")

        thread = threading.Thread(target=write)
        thread.start()
        self._open.callback(thread.join)
        self._open.callback(ended.set)


@pytest.fixture
def network(tmp_path: Path) -> Iterator[Network]:
    with NameServer(port=free_port()) as server, ExitStack() as ports:
        (tmp_path / "yarp.conf").write_text(f"{server.address.host} {server.address.port} yarp\n")
        yield Network(tmp_path, server, ports)


class Robot:
    """A robot that moves during the first three requests of its status, and then has reached its goal."""

    def __init__(self) -> None:
        self.goals = list[Map2DLocation]()
        self.steps = ["moving", "moving", "moving"]

    def gotoTargetByAbsoluteLocation(self, loc: Map2DLocation) -> None:
        self.goals.append(loc)

    def getNavigationStatus(self) -> str:
        return self.steps.pop() if self.steps else "goal_reached"

    def stopNavigation(self) -> None:
        """Do nothing."""

    def getCurrentPosition(self) -> tuple[Map2DLocation, None]:
        return Map2DLocation("flat", 1.0, 2.0, 0.0), None


@pytest.mark.parametrize(
    ("version", "device"),
    [("3.6", "navigation2DClient"), ("3.12", "navigation2D_nwc_yarp"), ("4", "navigation2D_nwc_yarp")],
)
def test_a_script_drives_a_robot_of_any_release(network: Network, version: str, device: str) -> None:
    robot, maps, generation = Robot(), KeptMaps(), Generation.of(version)
    maps.kept["location"]["kitchen"] = KITCHEN
    network.serve("/nav/rpc", Navigation2DServer(robot), generation)
    network.serve("/loc/rpc", Localization2DServer(robot), generation)
    network.serve("/maps/rpc", maps, generation)
    assert output_lines(start("navigate", network.folder, device)) == [
        "at 1.0 2.0 of flat, knows kitchen",
        "reached",
        "closed True False",
    ]
    assert robot.goals == [KITCHEN]


def test_a_script_without_its_robot_reports_an_error_and_exits(network: Network) -> None:
    assert output_lines(start("navigate", network.folder, "navigation2D_nwc_yarp")) == ["Cannot open the device!"]


@pytest.mark.parametrize("version", ["3.12", "4"])
def test_a_script_uses_the_available_devices_of_a_robot(network: Network, version: str) -> None:
    generation, camera = Generation.of(version), Camera()
    image = ImageRgb()
    image.resize(8, 6)
    network.serve("/robot/battery/rpc:i", Battery(), generation)
    network.serve("/robot/laser:o/rpc:i", Laser(), generation)
    network.serve("/robot/camera/rpc", camera, Generation.YARP_4)
    network.publish("/robot/battery/data:o", BatteryData(80.0, 48.0, -2.5, 31.0, 2))
    network.publish("/robot/laser:o", SCAN)
    network.publish("/robot/camera", image)
    assert output_lines(start("robot_parts", network.folder)) == [
        "gaze is missing: gazecontrollerclient",
        "arm is missing: batteryClient",
        "battery laser camera",
        "80 % 48.0 V lead",
        "True",
        "nearest 1.0",
        "True 8 6",
        "zoom 2.5",
        "None",
    ]
    assert camera.values[0] == 2.5
