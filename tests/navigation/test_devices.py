"""YARP devices of a script with Midspan's servers: planner, maps, localizer and transforms, over real ports."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest

import yarp_compat as yarp
from bridge.hub.wire.qos import Qos
from bridge.stores.kinds import MAP
from navigation.status import State
from tests.peers.navigation.gateway import Rig, patient
from tests.peers.yarp.network import network_of
from tests.support.wait import until
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.naming import connections

SERVERS = (
    "(navigation_server /navigationServer) (map_locations_server /mapServer) (localization_server /localizationServer)"
)
TURNED = {"z": math.sin(math.pi / 4), "w": math.cos(math.pi / 4)}
AT = {"translation": {"x": 1.0, "y": 2.0}, "rotation": TURNED}


class Served(Rig):
    """All modules that serve a script, and a robot at (1, 2) on the map ``house``, heading along y."""

    def configured(self, **changed: Any) -> Any:
        modules = {
            "map2d_server": {"enabled": True},
            "localization_server": {"enabled": True, "source": "tf", "period": 0.05},
            "transform_server": {"enabled": True},
        }
        return self.config(navigation={**self.section, **changed}, modules=modules)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with patient(), Served(tmp_path_factory.mktemp("devices")) as rig, network_of(rig.names):
        store = rig.worker.store
        store.put(MAP, "house", MapGrid2D.of([[0] * 4] * 3, name="house"))
        store.use_map("house")
        frames = rig.client.node.publisher("/tf", "tf2_msgs/msg/TFMessage", Qos(depth=10))

        def publish() -> None:
            head = {"stamp": rig.client.node.clock.stamp(), "frame_id": "map"}
            frames.publish({"transforms": [{"header": head, "child_frame_id": "base_link", "transform": AT}]})

        rig.client.loop.every(0.05, publish)
        for port in (
            "/mapServer/rpc",
            "/localizationServer/rpc",
            "/frameTransformServer/frameTransformGet_nws_yarp/tf:o",
        ):
            until(lambda name=port: connections.exists(rig.names, name), f"{port} is registered", 30)
        until(rig.gateway.robot, "the robot's pose is known", 20)
        yield rig


@pytest.fixture
def rig(running: Served) -> Served:
    running.fresh()
    return running


def opened(options: str) -> yarp.PolyDriver:
    driver = yarp.PolyDriver(yarp.Property(options))
    assert driver.isValid()
    return driver


@pytest.mark.parametrize("device", ["navigation2D_nwc_yarp", "navigation2DClient"])
def test_a_script_sends_the_robot_to_a_place(rig: Served, device: str) -> None:
    driver = opened(f"(device {device}) (local /script) {SERVERS}")
    robot, maps, where = driver.viewINavigation2D(), driver.viewIMap2D(), driver.viewILocalization2D()

    def localized() -> Map2DLocation | None:
        """Return the robot's position, which is unknown while its transform is late."""
        position: Map2DLocation = where.getCurrentPosition()
        return position if position.map_id == "house" else None

    position = until(localized, "the robot is localized")
    assert (position.x, position.y, position.theta) == pytest.approx((1.0, 2.0, 90.0))
    ok = yarp.localization_status_localized_ok
    until(lambda: where.getLocalizationStatus() is ok, "the status is localized_ok")
    assert maps.storeLocation("kitchen", Map2DLocation("house", 3.0, 1.0, 0.0))
    until(lambda: robot.storeCurrentPosition("here"), "the robot's position is stored")
    names = yarp.SVector()
    assert maps.getLocationsList(names)
    assert {"here", "kitchen"} <= {*names}
    assert robot.gotoTargetByLocationName("kitchen")
    goal = rig.planner.until(1)
    rig.state(State.MOVING)
    assert robot.getNavigationStatus() is yarp.navigation_status_moving
    assert robot.getAbsoluteLocationOfCurrentTarget().x == 3.0
    near = yarp.BVector(1)
    until(lambda: robot.checkNearToLocation("here", near, 0.1), "the robot's position is known")
    assert near == [True]
    assert maps.deleteLocation("here")
    rig.planner.reach(goal)
    rig.state(State.REACHED)
    assert robot.getNavigationStatus() is yarp.navigation_status_goal_reached
    assert robot.stopNavigation()
    assert driver.close()


@pytest.mark.usefixtures("running")
@pytest.mark.parametrize("device", ["map2D_nwc_yarp", "map2DClient"])
def test_a_script_reads_the_map(device: str) -> None:
    driver = opened(f"(device {device}) (local /script) (remote /mapServer) (carrier tcp)")
    grid = MapGrid2D()
    assert driver.viewIMap2D().get_map("house", grid)
    assert (grid.name, grid.width(), grid.height()) == ("house", 4, 3)
    assert not driver.viewIMap2D().get_map("cellar", grid)
    driver.close()


@pytest.mark.usefixtures("running")
@pytest.mark.parametrize("device", ["localization2D_nwc_yarp", "localization2DClient"])
def test_a_script_reads_the_robots_pose(device: str) -> None:
    driver = opened(f"(device {device}) (local /script) (remote /localizationServer)")
    position = Map2DLocation()
    until(lambda: driver.viewILocalization2D().getCurrentPosition(position), "the robot is localized")
    assert (position.map_id, position.x, position.y) == ("house", pytest.approx(1.0), pytest.approx(2.0))
    driver.close()


@pytest.mark.usefixtures("running")
@pytest.mark.parametrize(
    "options",
    [
        "(device frameTransformClient) (config_name ftc_yarp_only.xml) (ft_client_prefix /script)",
        "(device frameTransformClient) (filexml_option ftc_sub_yarp_only.xml)",
        "(device frameTransform_nwc_yarp) (ftGet_client_enable_stream false)",
        "(device transformClient) (local /script) (remote /transformServer) (period 10)",
    ],
)
def test_a_script_reads_and_sets_transforms(options: str) -> None:
    driver = opened(options)
    frames, transform = driver.viewIFrameTransform(), yarp.Matrix()
    until(lambda: frames.getTransform("base_link", "map", transform), "the robot's transform is known")
    assert (transform[0, 3], transform[1, 3]) == pytest.approx((1.0, 2.0))
    # the client drops transforms that have not been repeated for 0.2 s
    until(lambda: frames.canTransform("base_link", "map"), "the transform is repeated")
    corner = yarp.Matrix(4, 4)
    corner.eye()
    assert bool(frames.setTransformStatic("corner", "map", corner)) is ("ftc_sub_yarp_only" not in options)
    if "ftc_sub" not in options:
        until(lambda: frames.frameExists("corner"), "the server has the transform")
        assert frames.deleteTransform("corner", "map")
    driver.close()
