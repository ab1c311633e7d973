"""The example planner and the example localizer with errors in their own code, and the planner with keep-out areas."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.messages.actions import GoalState
from bridge.stores.kinds import AREA, MAP
from navigation.localization_server.estimate import LocalizationStatus, PoseEstimate
from navigation.pose import Pose
from tests.examples.test_own_navigation import FOLDERS
from tests.peers.hub.modules import Place
from tests.peers.navigation.floors import floor
from tests.peers.navigation.planning import Robot
from tests.peers.navigation.served import Program
from tests.support.wait import until
from yarp_compat.dev.locations import Map2DArea
from yarp_compat.sig.vec2d import Vec2D

ACROSS = [Vec2D(2.0, -1.0), Vec2D(2.2, -1.0), Vec2D(2.2, 30.0), Vec2D(2.0, 30.0)]


class Client(Robot):
    """A driver on the hub, and a client of the example planner."""

    def connect(self) -> None:
        self._action = "/planner/wavefront/navigate_to_pose"
        Program.connect(self)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Place]:
    for folder in FOLDERS:
        monkeypatch.syspath_prepend(folder)
    with Place(tmp_path) as place:
        yield place
    for name in ("wavefront", "wave_search", "odometer"):
        sys.modules.pop(name, None)


@pytest.fixture
def client(place: Place) -> Iterator[Client]:
    own = {"name": "wavefront", "factory": "wavefront:Wavefront"}
    client = Client(place.far.hub, place.far.registry)
    place.worker.start(place.config(own, store={"enabled": True}, navigation={"map": "store"}))
    store = place.worker.store
    store.put(MAP, "floor", floor())
    store.use_map("floor")
    module: Any = place.worker.running("wavefront").module
    until(lambda: module._ground is not None, "the planner has the map", 20)
    try:
        yield client
    finally:
        client.close()


def test_the_error_of_a_timer_ends_the_goal_and_is_in_the_status(place: Place, client: Client) -> None:
    host = place.worker.running("wavefront").host
    client.speed = 0.1
    sent = client.send(4.0, 1.0)
    until(lambda: client.goal is not None and client.goal.active, "the robot drives", 20)

    def tick() -> None:
        if sent.goal.active:
            raise ZeroDivisionError("of the test")

    timer = host.loop.every(0.02, tick)
    status, result = sent.end()
    assert status is GoalState.ABORTED
    assert result["error_msg"].startswith("wavefront failed: ZeroDivisionError: of the test (test_own_failures.py, ")
    goal = client.goal
    assert goal is not None
    until(lambda: goal.status is GoalState.CANCELED, "the driver's goal is canceled", 20)
    (warning,) = place.answer("wavefront")["warnings"]
    assert warning.startswith("one step failed: ZeroDivisionError: of the test")
    timer.close()
    client.speed = 3.0
    assert client.send(2.0, 1.0).end()[0] is GoalState.SUCCEEDED


def test_the_error_of_a_background_job_ends_the_goal(place: Place, client: Client) -> None:
    host = place.worker.running("wavefront").host
    client.speed = 0.1
    sent = client.send(4.0, 1.0)
    until(lambda: client.goal is not None and client.goal.active, "the robot drives", 20)
    host.loop.call(lambda: host.background.submit(lambda: lambda: [][1], lambda _path: None))
    assert "IndexError" in sent.end()[1]["error_msg"]
    assert place.answer("wavefront")["warnings"][0].startswith("a background job failed: IndexError")


def test_the_example_planner_keeps_out_of_areas(place: Place, client: Client) -> None:
    module: Any = place.worker.running("wavefront").module
    place.worker.store.put(AREA, "across", Map2DArea("floor", ACROSS, "keep_out"))
    # the planner may still read the map again, without the area
    until(lambda: module._ground.kept.any(), "the planner has the area", 20)
    assert client.send(4.0, 1.0).end()[1]["error_msg"] == "no path to the goal"
    assert client.send(2.1, 1.0).end()[1]["error_msg"] == "the goal is in a keep-out area"
    assert client.send(1.5, 1.0).end()[0] is GoalState.SUCCEEDED


def test_a_failing_status_hides_nothing_else(place: Place, client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(place.worker.running("wavefront").module, "status", lambda: int("7.0"))
    status = place.answer("wavefront")
    assert status["state"] == "running"
    assert "the module's status failed: ValueError: invalid literal" in status["warnings"][0]


def test_the_pose_is_unknown_after_an_error_in_a_localizers_callback(place: Place) -> None:
    section = {"enabled": True, "source": "odometer:Odometer", "initial_pose": [0, 0, 0]}
    place.worker.start(place.config(modules={"localization_server": section}, store={"enabled": True}))
    running = place.worker.running("localization_server")
    module: Any = running.module

    def fail() -> None:
        raise ValueError("no marker")

    timer = running.host.loop.every(0.05, fail)

    def failed() -> PoseEstimate | None:
        estimate: PoseEstimate = module._estimate
        return estimate if "ValueError: no marker" in estimate.reason else None

    assert until(failed, "the pose is unknown", 20).status is LocalizationStatus.ERROR
    assert "ValueError: no marker" in place.answer("localization_server")["warnings"][0]
    timer.close()
    until(lambda: "no marker" not in module._estimate.reason, "the localizer is used again", 20)


def test_a_localizer_that_cannot_use_a_map_has_no_pose_until_it_can(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    section = {"enabled": True, "source": "odometer:Odometer", "initial_pose": [0, 0, 0]}
    place.worker.start(place.config(modules={"localization_server": section}, store={"enabled": True}))
    module: Any = place.worker.running("localization_server").module
    store = place.worker.store
    with monkeypatch.context() as patch:
        patch.setattr(module.source, "use_map", lambda *_: [][2])
        store.put(MAP, "floor", floor())
        store.use_map("floor")
        until(lambda: "use_map() of odometer:Odometer: IndexError" in module._estimate.reason, "no pose", 20)
    loop = place.worker.running("localization_server").host.loop
    with monkeypatch.context() as patch:
        patch.setattr(module.source, "initial", lambda *_: [][3])
        with pytest.raises(RuntimeError, match=r"initial\(\) of odometer:Odometer: IndexError"):
            loop.call(lambda: module.begin(Pose(0.0, 0.0, 0.0), None, ""))
    store.put(MAP, "floor", floor())
    until(lambda: "use_map" not in module._estimate.reason, "the map is used", 20)
