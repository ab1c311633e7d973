"""``midspan map explore`` with the real gateway; the test acts as the planner, and publishes the map."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.cli.graph.goal import FollowedGoal
from bridge.cli.maps import explore
from navigation.maps.grid import to_grid
from tests.cli.conftest import Midspan, Outcome, alongside
from tests.peers.navigation.floors import floor, paint
from tests.peers.navigation.gateway import ClientGoal, Rig, pose
from tests.support.wait import until
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D

_TOPICS = itertools.count()


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with Rig(tmp_path_factory.mktemp("explore")) as rig:
        frames = rig.far.advertise("/tf_static", "tf2_msgs/TFMessage", latched=True)
        robot = {"translation": {"x": 0.8, "y": 2.5}, "rotation": {"w": 1.0}}
        header = {"frame_id": "map"}
        rig.far.publish(frames, {"transforms": [{"header": header, "child_frame_id": "base_link", "transform": robot}]})
        yield rig


@dataclass
class Exploring:
    """The command, and the topic of a growing map."""

    rig: Rig
    midspan: Midspan
    topic: str
    out: Any

    def publish(self, grid: MapGrid2D) -> None:
        message = to_grid(grid)
        self.rig.far.publish(self.out, message | {"data": message["data"].tolist()})

    def run(self, script: Callable[[], object], *words: str) -> Outcome:
        """Explore while a function acts as the planner and as other users."""
        command = ("map", "explore", "--topic", self.topic, "--radius", "0.25", "--seconds", "60")
        with alongside(script):
            return self.midspan(*command, *words)

    def stop(self) -> None:
        assert self.rig.ask("stop")


@pytest.fixture
def exploring(
    running: Rig, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Exploring:
    running.fresh()
    monkeypatch.setattr(explore, "_NEWER_SECONDS", 0.5)
    monkeypatch.setattr(explore, "_SETTLE_SECONDS", 0.2)
    file = tmp_path / "midspan.yaml"
    config = {"name": "here", "hub": {"listen": running.hubs.endpoint}, "navigation": running.section}
    file.write_text(json.dumps(config))
    topic = f"/growing_{next(_TOPICS)}"
    out = running.far.advertise(topic, "nav_msgs/OccupancyGrid", latched=True)
    return Exploring(running, Midspan(file, capsys), topic, out)


def rooms(known: float) -> MapGrid2D:
    """Return a floor with a wall and three doors; the floor beyond x = ``known`` is unknown."""
    grid = floor((2.4, 0.0, 2.6, 0.4), (2.4, 1.2, 2.6, 2.0), (2.4, 2.8, 2.6, 3.8), (2.4, 4.6, 2.6, 5.0))
    if known < 5.0:
        paint(grid, (known, 0.0, 5.0, 5.0), MapFlag.UNKNOWN)
    return grid


def test_exploration_drives_to_frontiers_until_none_is_left(
    exploring: Exploring, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(explore, "_NEWER_SECONDS", 40.0)  # the newer map is sure to come, but late on a busy machine
    exploring.publish(rooms(2.5))
    planner = exploring.rig.planner

    def play() -> None:
        first = planner.until(1)
        x, y = (first.goal["pose"]["pose"]["position"][axis] for axis in "xy")
        assert 1.7 < x < 2.4
        assert abs(y - 2.4) < 0.3, "the first goal is at the nearest door"
        planner.reach(first)
        exploring.publish(rooms(5.0))

    outcome = exploring.run(play, "--json")
    assert outcome.code == 0
    goal, end = outcome.lines()
    assert (goal["event"], goal["number"], goal["frontier"]) == ("goal", 1, pytest.approx(0.8, abs=0.11))
    assert (end["status"], end["goals"], end["reached"]) == ("complete", 1, 1)
    assert end["area"] == pytest.approx(24.0, abs=2.0)
    assert len(planner.goals) == 1


def test_a_robot_in_an_unknown_part_of_the_map_has_not_explored_all(exploring: Exploring) -> None:
    grid = rooms(5.0)
    paint(grid, (0.0, 0.0, 2.4, 5.0), MapFlag.UNKNOWN)
    exploring.publish(grid)
    outcome = exploring.run(lambda: None)
    assert outcome.code == 1
    assert outcome.out.startswith("failing: no path can begin at the robot's position: "), outcome
    assert not exploring.rig.planner.goals


def test_a_stop_during_a_goal_ends_the_exploration(exploring: Exploring) -> None:
    exploring.publish(rooms(2.5))
    planner = exploring.rig.planner
    outcome = exploring.run(lambda: planner.until(1) and exploring.stop())
    assert (outcome.code, outcome.out.splitlines()[-1].partition(";")[0]) == (1, "stopped: it was stopped")
    assert len(planner.goals) == 1


def test_a_stop_between_two_goals_ends_the_exploration(exploring: Exploring, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(explore, "_NEWER_SECONDS", 40.0)  # the next goal waits for a map that does not arrive
    exploring.publish(rooms(2.5))
    planner, rig = exploring.rig.planner, exploring.rig

    def play() -> None:
        planner.reach(planner.until(1))
        until(lambda: rig.statuses[-1]["state"] == "goal_reached", "the gateway has no goal", 20, every=0.01)
        exploring.stop()

    outcome = exploring.run(play)
    assert (outcome.code, outcome.out.splitlines()[-1].partition(";")[0]) == (1, "stopped: the robot was stopped")
    assert len(planner.goals) == 1


def test_a_stop_before_the_first_goal_ends_the_exploration(exploring: Exploring) -> None:
    def play() -> None:
        graph = exploring.rig.client.node.hub.graph
        until(lambda: graph.subscriptions(exploring.topic), "the verb waits for the map", 30)
        exploring.stop()
        exploring.publish(rooms(2.5))

    outcome = exploring.run(play)
    assert (outcome.code, outcome.out.splitlines()[-1].partition(";")[0]) == (1, "stopped: it was stopped")
    assert not exploring.rig.planner.goals


def test_no_goal_is_sent_after_a_stop_that_came_while_it_was_prepared(
    exploring: Exploring, monkeypatch: pytest.MonkeyPatch
) -> None:
    watches = list[explore._Watch]()

    class Watch(explore._Watch):
        def __init__(self) -> None:
            super().__init__()
            watches.append(self)

    def prepare_and_stop(*args: Any) -> Any:
        sent = FollowedGoal(*args)
        exploring.stop()
        until(lambda: watches[0].why, "the command has received the stop", 20)
        return sent

    monkeypatch.setattr(explore, "_Watch", Watch)
    monkeypatch.setattr(explore, "FollowedGoal", prepare_and_stop)
    exploring.publish(rooms(2.5))
    outcome = exploring.run(lambda: None)
    assert (outcome.code, outcome.out.splitlines()[-1].partition(";")[0]) == (1, "stopped: it was stopped")
    assert not exploring.rig.planner.goals


def test_another_clients_goal_ends_the_exploration(exploring: Exploring) -> None:
    exploring.publish(rooms(2.5))
    planner = exploring.rig.planner
    others: list[ClientGoal] = []

    def play() -> None:
        planner.until(1)
        others.append(ClientGoal(exploring.rig.client, pose(1.0, 1.0)))

    outcome = exploring.run(play)
    assert outcome.code == 1
    assert outcome.out.splitlines()[-1].startswith("stopped: "), outcome
    planner.reach(planner.until(2))
    assert others[0].end()[0] == "SUCCEEDED", "the other client's goal is not disturbed"
    assert len(planner.goals) == 2


def test_failed_goals_are_remembered_and_end_the_exploration(exploring: Exploring) -> None:
    exploring.publish(rooms(2.5))
    planner = exploring.rig.planner

    def play() -> None:
        for number in range(1, 4):
            planner.give_up(planner.until(number), f"no path {number}")

    outcome = exploring.run(play)
    assert outcome.code == 1
    assert "failing: 3 goals in a row failed; the last reason: no path 3" in outcome.out
    heights = [round(goal.goal["pose"]["pose"]["position"]["y"], 1) for goal in planner.goals]
    assert len({*heights}) == 3, heights
    assert np.ptp(heights) > 2.5


def test_a_limit_ends_the_exploration(exploring: Exploring) -> None:
    exploring.publish(rooms(2.5))
    planner = exploring.rig.planner
    outcome = exploring.run(lambda: planner.reach(planner.until(1)), "--goals", "1")
    assert (outcome.code, outcome.out.splitlines()[-1].partition(";")[0]) == (1, "limit: 1 goals were sent")
