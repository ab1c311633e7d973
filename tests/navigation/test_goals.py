"""Goals of another machine's clients end once those are cut off; those of this machine's do not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from navigation.constraints import Constraints
from navigation.goals import FarClients, goal_of
from navigation.pose import check_rotation
from navigation.status import Fault, PlanError


class World:
    """A hub on which sessions come and go, and a goal of the client ``client``."""

    def __init__(self) -> None:
        self.seen = {b"client": "there"}
        self.near = {"here"}
        self.goal = SimpleNamespace(id=b"goal", client=b"client")
        self.goals = [self.goal]
        self.gone: list[Any] = []
        hub = SimpleNamespace(
            zid="own", neighbours=lambda: self.near, graph=SimpleNamespace(zid_of=lambda gid: self.seen.get(gid, ""))
        )
        looks: list[Any] = []
        loop = SimpleNamespace(every=lambda _seconds, look: looks.append(look))
        self.server: Any = type("Server", (), {"active": property(lambda _: self.goals)})()
        host: Any = SimpleNamespace(node=SimpleNamespace(hub=hub), loop=loop)
        FarClients(host, self.server, self.gone.append)
        (self._look,) = looks

    def look(self, times: int = 5) -> list[Any]:
        for _ in range(times):
            self._look()
        return self.gone


def test_who_is_cut_off_loses_its_goal() -> None:
    world = World()
    assert world.look() == []
    world.seen.clear()
    assert world.look(2) == [], "a link may be made again"
    assert world.look(1) == [world.goal]


def test_who_is_cut_off_before_the_first_look_loses_its_goal_too() -> None:
    world = World()
    world.server.met(world.goal)
    world.seen.clear()
    assert world.look(3) == [world.goal]
    world = World()
    world.near.add("there")
    world.server.met(world.goal)
    world.seen.clear()
    assert world.look() == [], "it is of this machine"


@pytest.mark.parametrize("why", ["of this machine", "of this worker", "never seen", "unnamed", "back in time", "ended"])
def test_all_others_goals_go_on(why: str) -> None:
    world = World()
    if why == "of this machine":
        world.near = {"here", "there"}
    elif why == "of this worker":
        world.seen[b"client"] = "own"
    elif why == "never seen":
        world.seen.clear()
    elif why == "unnamed":
        world.goal.client = b""
    world.look()
    world.seen.clear()
    if why == "back in time":
        world.look(2)
        world.seen = {b"client": "there"}
    elif why == "ended":
        world.goals = []
    assert world.look(5) == []


def goal(turn: dict[str, float], tree: str = "") -> Any:
    """What `goal_of` returns for a ``NavigateToPose`` goal with this orientation."""
    pose = {"position": {"x": 1.0, "y": 2.0, "z": 0.0}, "orientation": {**dict.fromkeys("xyzw", 0.0), **turn}}
    frames: Any = SimpleNamespace(map_frame="map")
    return goal_of({"pose": {"header": {"frame_id": "map"}, "pose": pose}, "behavior_tree": tree}, frames, list)


@pytest.mark.parametrize("turn", [{}, {"w": 3.0}, {"z": 1e-9}, {"x": 0.5, "w": 0.5}])
def test_a_planner_refuses_a_goal_whose_quaternion_is_not_a_rotation(turn: dict[str, float]) -> None:
    with pytest.raises(PlanError, match="the goal's quaternion is not a rotation: its length is") as caught:
        goal(turn)
    assert caught.value.fault is Fault.BAD_GOAL
    any_heading, _ = goal(turn, Constraints(heading=False).to_text())
    assert any_heading.pose[:2] == (1.0, 2.0)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.707, 0.707), (0.0, 0.0, -1.0, 0.0)])
def test_rounded_quaternions_are_rotations(turn: tuple[float, ...]) -> None:
    check_rotation(dict(zip("xyzw", turn, strict=True)), "its")
