"""Midspan's clients of INavigation2D and ILocalization2D with its servers, through ports, in three generations."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from tests.peers.yarp.map_server import KeptMaps
from tests.support.wait import until
from tests.yarp_compat.dev.test_imap2d import KITCHEN, PATH, small_map
from tests.yarp_compat.dev.test_inavigation2d import COVARIANCE, FAILED, LOCALIZED, Planner
from tests.yarp_compat.ports.conftest import MakePort, make_port, naming
from yarp_compat.dev.basecontrol import OdometryData
from yarp_compat.dev.client import Stream
from yarp_compat.dev.inavigation2d import (
    Navigation2DServer,
    NavigationMapTypeEnum,
    NavigationStatusEnum,
    TrajectoryTypeEnum,
)
from yarp_compat.dev.localization2d import ILocalization2DMsgs, Localization2DClient, Localization2DServer
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.navigation2d_client import Navigation2DClient
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.server import Server
from yarp_compat.naming import connections
from yarp_compat.os.data.stdvector import BVector, SVector
from yarp_compat.os.data.vocab import Vocab32
from yarp_compat.ports.naming import LocalNaming, PortError
from yarp_compat.pythonic import Client, Writer
from yarp_compat.sig.matrix import Matrix
from yarp_compat.sig.vec2d import Vec2D
from yarp_compat.wire.generation import Generation, Generations

__all__ = ["make_port", "naming"]

ROOM = Map2DArea("m1", [Vec2D(0, 0), Vec2D(2, 0), Vec2D(2, 3), Vec2D(0, 3)], "a room")


class Robot(Planner):
    """A planner and localizer that records its commands."""

    def __init__(self) -> None:
        super().__init__()
        self.status, self.next_states = "moving", list[str]()
        self.placed: list[Any] = []
        self.located: Any = (Map2DLocation("m1", 1.0, 2.1, 100.0), COVARIANCE)

    def getNavigationStatus(self) -> str:
        return self.next_states.pop(0) if self.next_states else self.status

    def resumeNavigation(self) -> None:
        self.commands.append("resume")

    def recomputeCurrentNavigationPath(self) -> None:
        self.commands.append("recompute")

    def getCurrentNavigationWaypoint(self) -> Map2DLocation:
        return KITCHEN

    def getLastVelocityCommand(self) -> tuple[float, float, float]:
        return 0.1, 0.0, 5.0

    def getCurrentPosition(self) -> tuple[Map2DLocation, Any] | None:
        return self.located

    def getLocalizationStatus(self) -> str:
        return "localized_ok"

    def getEstimatedPoses(self) -> list[Map2DLocation]:
        return [KITCHEN]

    def getEstimatedOdometry(self) -> OdometryData:
        return OdometryData(odom_x=1.5)

    def setInitialPose(self, *arguments: Any) -> None:
        self.placed.append(arguments)

    def startLocalizationService(self) -> None:
        self.commands.append("start")

    def stopLocalizationService(self) -> None:
        self.commands.append("stop")


@pytest.fixture
def robot() -> Robot:
    return Robot()


@pytest.fixture
def kept() -> KeptMaps:
    kept = KeptMaps()
    kept.kept["location"]["kitchen"] = KITCHEN
    kept.kept["area"].update(room=ROOM, far=Map2DArea("m1", [Vec2D(8, 8), Vec2D(9, 8), Vec2D(9, 9)]))
    kept.kept["path"]["tour"] = PATH
    return kept


@pytest.fixture(params=[Generation.YARP_3_6, Generation.YARP_3_12, Generation.YARP_4])
def client(
    request: pytest.FixtureRequest, robot: Robot, kept: KeptMaps, make_port: MakePort, naming: LocalNaming
) -> Iterator[Navigation2DClient]:
    generation: Generation = request.param
    for name, service in (("/nav", Navigation2DServer(robot)), ("/loc", Localization2DServer(robot)), ("/maps", kept)):
        server = Server(service, Generations(generation))
        make_port(f"{name}/rpc", server, rpc=True, on_event=server.on_event, profile=generation.profile)
    with Navigation2DClient("/nav", "/maps", "/loc", "/me", naming=naming) as connected:
        yield connected


def test_targets_are_sent_and_controlled(client: Navigation2DClient, robot: Robot) -> None:
    assert client.gotoTargetByAbsoluteLocation(KITCHEN)
    place, path, grid, status = Map2DLocation(), Map2DPath(), MapGrid2D(), [None]
    assert client.getAbsoluteLocationOfCurrentTarget(place)
    assert place == client.getAbsoluteLocationOfCurrentTarget() == KITCHEN
    assert client.getRelativeLocationOfCurrentTarget() == (OK, 1.0, 2.0, 3.0)
    assert client.getNavigationStatus(status)
    assert status == [client.getNavigationStatus()] == [NavigationStatusEnum.navigation_status_moving]
    assert status[0] == Vocab32.encode("movg")  # a number, as in the bindings
    assert client.getAllNavigationWaypoints(TrajectoryTypeEnum.global_trajectory, path)
    assert path == client.getAllNavigationWaypoints(TrajectoryTypeEnum.global_trajectory) == PATH
    assert client.getCurrentNavigationWaypoint() == KITCHEN
    assert client.getCurrentNavigationMap(NavigationMapTypeEnum.local_map, grid)
    assert grid == small_map()
    assert not client.getCurrentNavigationMap(NavigationMapTypeEnum.global_map, grid)
    assert grid == small_map()
    calls = [client.suspendNavigation(), client.suspendNavigation(2.0), client.resumeNavigation(),
             client.recomputeCurrentNavigationPath(), client.followPath(PATH),
             client.gotoTargetByRelativeLocation(1, 2, 90), client.applyVelocityCommand(0.1, 0, 5)]  # fmt: skip
    assert all(calls)
    assert robot.commands == [math.inf, 2.0, "resume", "recompute", PATH, (1.0, 2.0, 90.0), (0.1, 0.0, 5.0, 0.1)]
    assert client.gotoTargetByRelativeLocation(1, 2)
    assert client.getLastVelocityCommand() == (OK, 0.1, 0.0, 5.0)
    assert client.stopNavigation()
    assert client.getRelativeLocationOfCurrentTarget()[0].code is ReturnCode.METHOD_FAILED
    assert client.getAbsoluteLocationOfCurrentTarget() == Map2DLocation()


def test_targets_are_found_by_name(client: Navigation2DClient, robot: Robot) -> None:
    name = SVector()
    assert client.gotoTargetByLocationName("kitchen")
    assert (robot.target, client.getNameOfCurrentTarget()) == (KITCHEN, "kitchen")
    assert client.gotoTargetByLocationName("room")
    assert robot.target is not None
    assert ROOM.checkLocationInsideArea(robot.target)
    assert client.getNameOfCurrentTarget(name)
    assert name == ["room"]
    assert client.gotoTargetByLocationName("tour")
    assert robot.commands == [PATH]
    assert client.gotoTargetByLocationName("nowhere") == FAILED
    assert robot.target is None  # the client stops the robot, as YARP's client does


def test_places_are_compared_with_the_position_of_the_robot(
    client: Navigation2DClient, robot: Robot, kept: KeptMaps
) -> None:
    truth, name, area = BVector(), SVector(), Map2DArea()
    assert client.checkInsideArea("room", truth)
    assert truth == [True]
    assert client.checkInsideArea(kept.kept["area"]["far"]) is False
    assert client.checkInsideArea("nowhere", truth) == FAILED
    assert client.checkNearToLocation("kitchen", truth, 0.2)
    assert truth == [True]
    assert client.checkNearToLocation(KITCHEN, None, 0.2, 5) is False
    assert client.checkNearToLocation("kitchen", None, 0.2, 15) is True
    assert client.findCurrentArea(name, area)
    assert (name, area) == (["room"], ROOM)
    assert client.storeCurrentPosition("here")
    assert kept.kept["location"]["here"] == robot.located[0]
    robot.located = (Map2DLocation("m2", 1, 2), None)
    assert client.findCurrentArea(name, area)
    assert (name, area) == ([""], Map2DArea())
    robot.located = None
    for call in (lambda: client.checkInsideArea("room", truth), lambda: client.checkNearToLocation(KITCHEN, truth, 1),
                 lambda: client.findCurrentArea(name, area), lambda: client.storeCurrentPosition("here")):  # fmt: skip
        assert call() == FAILED


def test_the_position_of_the_robot_is_read_and_set(client: Navigation2DClient, robot: Robot) -> None:
    place, covariance, poses, odometry = Map2DLocation(), Matrix(), [], OdometryData()
    assert client.getCurrentPosition(place, covariance)
    assert (place, covariance) == (robot.located[0], COVARIANCE)
    assert client.getCurrentPosition() == client.position == place
    assert client.getLocalizationStatus() is LOCALIZED
    assert client.getEstimatedPoses(poses)
    assert poses == [KITCHEN]
    assert client.getEstimatedOdometry(odometry)
    assert odometry.odom_x == 1.5
    assert client.startLocalizationService()
    assert client.stopLocalizationService()
    assert robot.commands == ["start", "stop"]
    assert client.setInitialPose(KITCHEN)
    assert client.setInitialPose(KITCHEN, COVARIANCE)
    assert client.setInitialPose(KITCHEN, Matrix(2, 2)) == FAILED
    assert [arguments[0] for arguments in robot.placed] == [KITCHEN, KITCHEN]
    robot.located = None
    assert client.getCurrentPosition(place, covariance) == FAILED
    with pytest.raises(CallFailed):
        _ = client.position


def test_the_methods_of_the_map_server_are_inherited(client: Navigation2DClient) -> None:
    names = SVector()
    assert client.getLocationsList(names)
    assert client.getLocationsList() == tuple(names)
    assert names == ["kitchen"]
    assert client.deleteLocation("kitchen")


def test_the_python_interface_raises_exceptions(client: Navigation2DClient, robot: Robot) -> None:
    client.go("kitchen")
    client.go(KITCHEN)
    with pytest.raises(CallFailed):
        client.go("nowhere")
    with pytest.raises(TimeoutError, match="moving"):
        client.wait(0)
    robot.status, robot.next_states = "aborted", ["moving", "paused"]
    assert client.wait() is client.status is NavigationStatusEnum.navigation_status_aborted


def test_text_commands_are_executed(client: Navigation2DClient, robot: Robot, naming: LocalNaming) -> None:
    with Client("/me/user_commands/rpc", "/user", naming=naming) as user:
        assert user.ask(["listLocations"]) == ["many", "kitchen"]
        assert user.ask(["gotoLocation", "kitchen"]) == ["ok"]
        assert user.ask(["gotoLocation", "nowhere"]) == ["fail"]
        assert user.ask(["help"])[0] == "many"
        assert user.ask(["nonsense"]) == ["err"]
    assert robot.target is None


def test_calls_to_a_missing_server_fail(make_port: MakePort, naming: LocalNaming, robot: Robot) -> None:
    port = make_port("/nav/rpc", Server(Navigation2DServer(robot)), rpc=True)
    unreached = ReturnValue(ReturnCode.COMMUNICATION)
    with Navigation2DClient("/nav", "", "", naming=naming) as client:
        assert client.gotoTargetByAbsoluteLocation(KITCHEN)
        assert client.getCurrentPosition(Map2DLocation()) == unreached
        assert client.getLocationsList([]) == unreached
        assert client.getLocationsList() == client.getEstimatedPoses() == ()
        port.close()
        assert client.stopNavigation() == unreached
        assert client.getNavigationStatus() is NavigationStatusEnum.navigation_status_error


@pytest.mark.parametrize("restarts", [True, False])
def test_a_stream_continues_after_its_connection_has_ended(naming: LocalNaming, restarts: bool) -> None:
    source = "/loc/streaming:o"
    with ExitStack() as writers:
        writer = writers.enter_context(Writer(source, naming=naming))
        with Stream(source, Map2DLocation, "/me", naming=naming) as positions:
            if restarts:
                writer.close()
                writer = writers.enter_context(Writer(source, naming=naming))
            else:
                assert writer.core.remove_output("/me")
            until(lambda: writer.write(KITCHEN) and positions.read_now(), "the stream continues")


def test_a_stream_reconnects_after_an_unexpected_error(
    naming: LocalNaming, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    source, connect, errors = "/loc/streaming:o", connections.connect, [RuntimeError("can't start new thread")]

    def failing(*args: Any) -> str:
        if errors:
            raise errors.pop()
        return connect(*args)

    with Writer(source, naming=naming) as writer, Stream(source, Map2DLocation, "/me", naming=naming) as positions:
        monkeypatch.setattr(connections, "connect", failing)
        assert writer.core.remove_output("/me")
        until(lambda: writer.write(KITCHEN) and positions.read_now(), "the stream continues")
    assert "can't start new thread" in caplog.text


def test_a_stream_yields_messages_until_it_is_closed(make_port: MakePort, naming: LocalNaming) -> None:
    with (
        Writer("/loc/streaming:o", naming=naming) as writer,
        Stream("/loc/streaming:o", Map2DLocation, strict=True, naming=naming) as positions,
    ):
        assert positions.read_now() is None
        for place, envelope in ((KITCHEN, "7 12.5"), (Map2DLocation("", math.nan, math.nan, math.nan), "")):
            assert writer.write(place, envelope, strict=True)
        messages = iter(positions)
        assert next(messages) == (KITCHEN, 12.5)
        place, stamp = next(messages)
        assert math.isnan(place.x)
        assert stamp == 0
        positions.close()
        assert list(messages) == []
    with pytest.raises(PortError, match="nowhere"), Stream("/nowhere", Map2DLocation, naming=naming):
        pass


class Forgetful(ILocalization2DMsgs):
    """A server like those of 4.0, which replies "ok" without setting the results."""

    def get_current_position2_RPC(self) -> Any:
        return OK, Map2DLocation(), Matrix(3, 3)


def test_a_position_without_covariance_is_a_failure(
    make_port: MakePort, naming: LocalNaming, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_port("/loc/rpc", Server(Forgetful()), rpc=True)
    with Localization2DClient("/loc", "/me", naming=naming) as client:
        assert client.getCurrentPosition(Map2DLocation(), Matrix())
        empty = lambda: (OK, Map2DLocation(), Matrix())  # noqa: E731
        monkeypatch.setattr(client.remote, "get_current_position2_RPC", empty)
        place = Map2DLocation("m1", 1, 2)
        assert client.getCurrentPosition(place, Matrix()) == FAILED
        assert place == Map2DLocation("m1", 1, 2)
