"""Every call of INavigation2D and ILocalization2D: its bytes, and the servers of devices."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.yarp_compat.dev.test_imap2d import KITCHEN, PATH, small_map
from tests.yarp_compat.dev.test_service import Wire
from tests.yarp_compat.dev.written import Bytes, Returning, listed, text, vocab
from yarp_compat.dev.basecontrol import OdometryData
from yarp_compat.dev.inavigation2d import (
    INavigation2DMsgs,
    Navigation2DServer,
    NavigationMapTypeEnum,
    NavigationStatusEnum,
    TrajectoryTypeEnum,
    statusToString,
    stringToStatus,
)
from yarp_compat.dev.localization2d import ILocalization2DMsgs, Localization2DServer, LocalizationStatusEnum
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.server import Server
from yarp_compat.dev.service import Service
from yarp_compat.sig.matrix import Matrix
from yarp_compat.wire.generation import Generation, Generations

MOVING = NavigationStatusEnum.navigation_status_moving
LOCALIZED = LocalizationStatusEnum.localization_status_localized_ok
FAILED = ReturnValue(ReturnCode.METHOD_FAILED)
COVARIANCE = Matrix([[1, 2, 3], [4, 5, 6], [7, 8, 9]])
NAVIGATION: dict[str, tuple[tuple[Any, ...], tuple[Any, ...]]] = {
    "stop_navigation": ((), ()),
    "resume_navigation": ((), ()),
    "suspend_navigation": ((math.inf,), ()),
    "recompute_current_navigation_path": ((), ()),
    "get_navigation_status": ((), (MOVING,)),
    "get_current_nav_waypoint": ((), (KITCHEN,)),
    "get_all_navigation_waypoints": ((TrajectoryTypeEnum.local_trajectory,), (PATH,)),
    "get_current_navigation_map": ((NavigationMapTypeEnum.global_map,), (small_map(),)),
    "goto_target_by_absolute_location": ((KITCHEN,), ()),
    "follow_path": ((PATH,), ()),
    "goto_target_by_relative_location1": ((1.0, 2.0), ()),
    "goto_target_by_relative_location2": ((1.0, 2.0, 90.0), ()),
    "get_absolute_location_of_current_target": ((), (KITCHEN,)),
    "get_relative_location_of_current_target": ((), (1.0, 2.0, 90.0)),
    "goto_target_by_absolute_location_and_set_name": ((KITCHEN, "kitchen"), ()),
    "apply_velocity_command": ((0.1, 0.2, 3.0, 0.5), ()),
    "get_last_velocity_command": ((), (0.1, 0.2, 3.0)),
    "get_name_of_current_target": ((), ("kitchen",)),
}
LOCALIZATION: dict[str, tuple[tuple[Any, ...], tuple[Any, ...]]] = {
    "start_localization_service": ((), ()),
    "stop_localization_service": ((), ()),
    "get_localization_status": ((), (LOCALIZED,)),
    "get_estimated_poses": ((), ([KITCHEN, KITCHEN],)),
    "get_current_position1": ((), (KITCHEN,)),
    "get_current_position2": ((), (KITCHEN, COVARIANCE)),
    "get_estimated_odometry": ((), (OdometryData(1, 2, 3, 4, 5, 6, 7, 8, 9),)),
    "set_initial_pose1": ((KITCHEN,), ()),
    "set_initial_pose2": ((KITCHEN, COVARIANCE), ()),
}
CALLS = [(INavigation2DMsgs, f"{name}_RPC", *data) for name, data in NAVIGATION.items()]
CALLS += [(ILocalization2DMsgs, f"{name}_RPC", *data) for name, data in LOCALIZATION.items()]
NAMES = [call[1] for call in CALLS]
UNSET: dict[type[Any], Any] = {
    NavigationStatusEnum: NavigationStatusEnum.navigation_status_idle,
    LocalizationStatusEnum: LocalizationStatusEnum.localization_status_not_yet_localized,
    Matrix: Matrix(3, 3),
}


def test_the_list_of_calls_is_complete() -> None:
    assert {name for kind, name, *_ in CALLS if kind is INavigation2DMsgs} == set(INavigation2DMsgs.calls())
    assert {name for kind, name, *_ in CALLS if kind is ILocalization2DMsgs} == set(ILocalization2DMsgs.calls())


@pytest.mark.parametrize("generation", Generation)
@pytest.mark.parametrize(("kind", "name", "arguments", "results"), CALLS, ids=NAMES)
def test_a_call_has_the_bytes_of_generated_code(
    kind: type[Service], name: str, arguments: Any, results: Any, generation: Generation
) -> None:
    call, rules = kind.calls()[name], Bytes(generation)
    request = rules.request(name, *arguments)
    assert call.request(arguments, generation.profile) == request
    server = Returning.of(kind, (OK, *results) if results else OK)
    reply = Server(server, Generations(generation)).answer(request, "/peer", generation.profile)
    assert list(server.arguments) == list(arguments)
    assert reply == rules.reply(OK, *results)
    assert call.read_reply(reply, generation).results == [OK, *results]


@pytest.mark.parametrize("generation", Generation)
@pytest.mark.parametrize(("kind", "name", "arguments", "results"), CALLS, ids=NAMES)
def test_a_failed_call_returns_defaults_after_its_outcome(
    kind: type[Any], name: str, arguments: Any, results: Any, generation: Generation
) -> None:
    server = Server(Returning.of(kind, CallFailed()), Generations(generation))
    reply = server.answer(Bytes(generation).request(name, *arguments), "/peer", generation.profile)
    defaults = (UNSET[type(it)] if type(it) in UNSET else type(it)() for it in results)
    assert kind.calls()[name].read_reply(reply, generation).results == [FAILED, *defaults]


@pytest.mark.parametrize("generation", Generation)
def test_an_unset_status_of_a_real_server_is_read(generation: Generation) -> None:
    """After an outcome other than ok, YARP's server writes the vocab 0 as the status."""
    rules = Bytes(generation)
    reply = listed(rules.outcome(ReturnCode.METHOD_FAILED), vocab(""))
    parsed = INavigation2DMsgs.calls()["get_navigation_status_RPC"].read_reply(reply, generation)
    assert parsed.results == [FAILED, NavigationStatusEnum.navigation_status_idle]


@pytest.mark.parametrize("given", [None, Matrix(), np.zeros((0, 0)), Matrix(3, 3), np.zeros((3, 3)), [[0.0] * 3] * 3])
def test_an_empty_covariance_is_written_as_zeros(given: Any) -> None:
    rules = Bytes(Generation.YARP_4)
    server = Server(Returning.of(ILocalization2DMsgs, (OK, KITCHEN, given)), Generations(Generation.YARP_4))
    reply = server.answer(rules.request("get_current_position2_RPC"), "/peer")
    assert reply == rules.reply(OK, KITCHEN, Matrix(3, 3))


def test_a_covariance_of_another_size_is_rejected_in_both_directions() -> None:
    rules = Bytes(Generation.YARP_4)
    server = Server(Returning.of(ILocalization2DMsgs, (OK, KITCHEN, Matrix(2, 2))), Generations(Generation.YARP_4))
    places = ILocalization2DMsgs(Wire(server, Generation.YARP_4))
    assert places.get_current_position2_RPC()[0].code is ReturnCode.GENERIC
    reply = server.answer(rules.request("set_initial_pose2_RPC", KITCHEN, Matrix(2, 2)), "/peer")
    assert reply.endswith(b"fail")
    assert server.refused == 1


def test_the_empty_covariance_of_a_real_server_is_read() -> None:
    """The real server confuses two cases: it sends "ok" with all results unset (measured with 3.12.3 and 4.0)."""
    rules = Bytes(Generation.YARP_4)
    empty = listed(*[bytes.fromhex("0100000000000000")] * 2, bytes.fromhex("1401000000000000"))
    reply = listed(rules.of(OK), rules.of(Map2DLocation()), empty)
    parsed = ILocalization2DMsgs.calls()["get_current_position2_RPC"].read_reply(reply, Generation.YARP_4)
    assert parsed.results == [OK, Map2DLocation(), Matrix()]


def test_a_status_is_converted_from_and_to_text() -> None:
    assert statusToString(MOVING) == "navigation_status_moving"
    assert stringToStatus("navigation_status_goal_reached") is NavigationStatusEnum.navigation_status_goal_reached
    assert stringToStatus("goal_reached") is NavigationStatusEnum.navigation_status_goal_reached
    assert stringToStatus("nonsense") is NavigationStatusEnum.navigation_status_error


# -- servers ----------------------------------------------------------------------------------------------------------


class Planner:
    """A device that records its commands."""

    def __init__(self) -> None:
        self.commands: list[Any] = []
        self.target: Map2DLocation | None = None
        self.refuses: CallFailed | ReturnValue | None = None

    def gotoTargetByAbsoluteLocation(self, loc: Map2DLocation) -> ReturnValue | None:
        if isinstance(self.refuses, CallFailed):
            raise self.refuses
        if self.refuses is None:
            self.target = loc
        return self.refuses

    def gotoTargetByRelativeLocation(self, *pose: float) -> None:
        self.commands.append(pose)

    def followPath(self, path: Map2DPath) -> ReturnValue:
        self.commands.append(path)
        return OK

    def stopNavigation(self) -> None:
        self.target = None

    def suspendNavigation(self, seconds: float) -> None:
        self.commands.append(seconds)

    def getNavigationStatus(self) -> str:
        return "waiting_obstacle"

    def getAbsoluteLocationOfCurrentTarget(self) -> Map2DLocation | None:
        return self.target

    def getRelativeLocationOfCurrentTarget(self) -> tuple[float, float, float] | None:
        return None if self.target is None else (1.0, 2.0, 3.0)

    def getAllNavigationWaypoints(self, kind: TrajectoryTypeEnum) -> Map2DPath:
        return PATH if kind is TrajectoryTypeEnum.global_trajectory else Map2DPath()

    def getCurrentNavigationMap(self, kind: NavigationMapTypeEnum) -> MapGrid2D | None:
        return small_map() if kind is NavigationMapTypeEnum.local_map else None

    def applyVelocityCommand(self, *command: float) -> None:
        self.commands.append(command)


@pytest.fixture
def planner() -> Planner:
    return Planner()


@pytest.fixture(params=[Generation.YARP_3_6, Generation.YARP_3_12, Generation.YARP_4])
def release(request: pytest.FixtureRequest) -> Generation:
    """The client's release."""
    generation: Generation = request.param
    return generation


@pytest.fixture
def remote(release: Generation, planner: Planner) -> INavigation2DMsgs:
    return INavigation2DMsgs(Wire(Server(Navigation2DServer(planner), Generations(release)), release))


def test_calls_reach_the_planner(remote: INavigation2DMsgs, planner: Planner) -> None:
    assert remote.get_absolute_location_of_current_target_RPC() == (FAILED, Map2DLocation())
    assert remote.get_relative_location_of_current_target_RPC() == (FAILED, 0.0, 0.0, 0.0)
    assert remote.goto_target_by_absolute_location_RPC(KITCHEN)
    assert remote.get_absolute_location_of_current_target_RPC() == (OK, KITCHEN)
    assert remote.get_relative_location_of_current_target_RPC() == (OK, 1.0, 2.0, 3.0)
    assert remote.get_navigation_status_RPC() == (OK, NavigationStatusEnum.navigation_status_waiting_obstacle)
    assert remote.get_all_navigation_waypoints_RPC(TrajectoryTypeEnum.global_trajectory) == (OK, PATH)
    assert remote.get_all_navigation_waypoints_RPC(TrajectoryTypeEnum.local_trajectory) == (OK, Map2DPath())
    assert remote.get_current_navigation_map_RPC(NavigationMapTypeEnum.local_map) == (OK, small_map())
    assert remote.get_current_navigation_map_RPC(NavigationMapTypeEnum.global_map)[0] == FAILED
    assert remote.goto_target_by_relative_location1_RPC(1, 2)
    assert remote.goto_target_by_relative_location2_RPC(1, 2, 3)
    for seconds in (2.5, 0.0, math.inf):
        assert remote.suspend_navigation_RPC(seconds)
    assert remote.apply_velocity_command_RPC(0.1, 0.0, 5.0, 0.2)
    assert math.isnan(planner.commands[0][2])
    assert planner.commands[0][:2] == (1.0, 2.0)
    assert planner.commands[1:] == [(1.0, 2.0, 3.0), 2.5, math.inf, math.inf, (0.1, 0.0, 5.0, 0.2)]
    assert remote.stop_navigation_RPC()
    assert planner.target is None


def test_missing_methods_of_a_device_are_not_implemented(remote: INavigation2DMsgs, release: Generation) -> None:
    lacking = ReturnValue(ReturnCode.NOT_IMPLEMENTED)
    outcomes = [remote.resume_navigation_RPC(), remote.get_current_nav_waypoint_RPC()[0],
                remote.recompute_current_navigation_path_RPC(), remote.get_last_velocity_command_RPC()[0]]  # fmt: skip
    assert not any(outcomes)
    if release is not Generation.YARP_3_6:  # replies in YARP 3.6 contain only ok or fail
        assert outcomes == [lacking] * 4


def test_a_target_keeps_its_name_until_it_is_replaced(remote: INavigation2DMsgs, planner: Planner) -> None:
    """A refused goal does not change the name."""
    go = remote.goto_target_by_absolute_location_and_set_name_RPC
    assert remote.get_name_of_current_target_RPC() == (OK, "")
    for replace in (
        remote.stop_navigation_RPC,
        lambda: remote.follow_path_RPC(PATH),
        lambda: remote.goto_target_by_absolute_location_RPC(KITCHEN),
        lambda: remote.goto_target_by_relative_location1_RPC(1, 2),
    ):
        assert go(KITCHEN, "kitchen")
        assert remote.get_name_of_current_target_RPC() == (OK, "kitchen")
        assert replace()
        assert remote.get_name_of_current_target_RPC() == (OK, "")
    assert go(KITCHEN, "kitchen")
    for planner.refuses in (CallFailed(ReturnCode.METHOD_FAILED, "off the map"), FAILED):
        assert not go(KITCHEN, "elsewhere")
        assert remote.get_name_of_current_target_RPC() == (OK, "kitchen")


def test_invalid_goals_do_not_reach_the_device(remote: INavigation2DMsgs, planner: Planner) -> None:
    nowhere = Map2DLocation("m1", math.nan, 0.0)
    assert not remote.goto_target_by_absolute_location_RPC(nowhere)
    assert not remote.goto_target_by_relative_location1_RPC(math.inf, 0)
    assert not remote.goto_target_by_relative_location1_RPC(0, -1.7e308)
    assert not remote.follow_path_RPC(Map2DPath())
    assert not remote.follow_path_RPC(Map2DPath([KITCHEN, nowhere]))
    no_heading = Map2DLocation("m1", 1.0, 2.0, math.inf)  # only NaN means any heading
    assert not remote.goto_target_by_absolute_location_RPC(no_heading)
    assert not remote.goto_target_by_relative_location2_RPC(1.0, 2.0, -math.inf)
    assert not remote.follow_path_RPC(Map2DPath([KITCHEN, no_heading]))
    assert not remote.apply_velocity_command_RPC(math.nan, 0, 0, 0.1)
    assert (planner.commands, planner.target) == ([], None)
    any_heading = Map2DLocation("m1", 1.0, 2.0, math.nan)
    assert remote.goto_target_by_absolute_location_RPC(any_heading)
    assert planner.target is not None
    assert math.isnan(planner.target.theta)


def test_calls_reach_the_localizer() -> None:
    commands: list[Any] = []
    device = SimpleNamespace(
        getLocalizationStatus=lambda: "localized_ok",
        getCurrentPosition=lambda: (KITCHEN, None),
        getEstimatedPoses=lambda: [KITCHEN] * 3,
        getEstimatedOdometry=lambda: OdometryData(odom_x=1),
        startLocalizationService=lambda: commands.append("start"),
        setInitialPose=lambda *arguments: commands.append(arguments),
    )
    remote = ILocalization2DMsgs(Wire(Server(Localization2DServer(device)), Generation.YARP_3_12))
    assert remote.get_localization_status_RPC() == (OK, LOCALIZED)
    assert remote.get_current_position1_RPC() == (OK, KITCHEN)
    assert remote.get_current_position2_RPC() == (OK, KITCHEN, Matrix(3, 3))
    assert remote.get_estimated_poses_RPC() == (OK, [KITCHEN] * 3)
    assert remote.get_estimated_odometry_RPC() == (OK, OdometryData(odom_x=1))
    assert remote.start_localization_service_RPC()
    assert remote.stop_localization_service_RPC().code is ReturnCode.NOT_IMPLEMENTED
    assert remote.set_initial_pose1_RPC(KITCHEN)
    assert remote.set_initial_pose2_RPC(KITCHEN, COVARIANCE)
    assert not remote.set_initial_pose1_RPC(Map2DLocation("m1", 1.0, 2.0, math.nan))
    assert not remote.set_initial_pose2_RPC(KITCHEN, Matrix(np.full((3, 3), math.inf)))
    assert not remote.set_initial_pose2_RPC(KITCHEN, Matrix(-np.eye(3)))
    assert commands[:2] == ["start", (KITCHEN, None)]
    assert commands[2][0] == KITCHEN
    assert np.array_equal(commands[2][1], COVARIANCE.numpy())
    assert len(commands) == 3
    device.getCurrentPosition = lambda: None
    assert remote.get_current_position2_RPC() == (FAILED, Map2DLocation(), Matrix(3, 3))


def test_a_request_with_its_name_in_one_string_is_accepted() -> None:
    """``yarp rpc`` sends such requests; the reply has the format of YARP 3.6 to 3.10."""
    server = Server(Navigation2DServer(Planner()), Generations(Generation.YARP_3_6))
    assert server.answer(listed(text("get_navigation_status_RPC")), "/peer") == listed(vocab("ok"), vocab("wait"))
