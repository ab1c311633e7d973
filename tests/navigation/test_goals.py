"""Goals of clients on other machines end when the link is cut; goals of this machine's clients continue."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from navigation.constraints import Constraints
from navigation.goals import FarClients, goal_of
from navigation.pose import check_rotation
from navigation.status import Fault, PlanError


class World:
    """A hub whose sessions appear and disappear, and a goal of the client ``client``."""

    def __init__(self) -> None:
        self.seen = {b"client": "other"}
        self.near = {"this"}
        self.goal = SimpleNamespace(id=b"goal", client=b"client")
        self.goals = [self.goal]
        self.unreachable: list[Any] = []
        self.mesh = SimpleNamespace(ended=0)
        graph = SimpleNamespace(zid_of=lambda gid: self.seen.get(gid, ""))
        hub = SimpleNamespace(zid="own", neighbors=lambda: self.near, graph=graph, mesh=self.mesh)
        timers: list[Any] = []
        loop = SimpleNamespace(every=lambda _seconds, check: timers.append(check))
        self.server: Any = type("Server", (), {"active": property(lambda _: self.goals)})()
        host: Any = SimpleNamespace(node=SimpleNamespace(hub=hub), loop=loop)
        FarClients(host, self.server, lambda goal, reason: self.unreachable.append((goal, reason)))
        (self._check,) = timers

    def check(self, times: int = 5) -> list[Any]:
        for _ in range(times):
            self._check()
        return [goal for goal, _ in self.unreachable]


def test_the_goal_of_a_client_that_is_cut_off_ends() -> None:
    world = World()
    assert world.check() == []
    world.seen.clear()
    assert world.check(2) == [], "a link may be reopened"
    assert world.check(1) == [world.goal]


def test_the_goal_of_a_client_cut_off_before_the_first_check_ends() -> None:
    world = World()
    world.server.met(world.goal)
    world.seen.clear()
    assert world.check(3) == [world.goal]
    world = World()
    world.near.add("other")
    world.server.met(world.goal)
    world.seen.clear()
    assert world.check() == [], "the client is on this machine"


@pytest.mark.parametrize(
    "client", ["of this machine", "of this worker", "never seen", "unnamed", "back in time", "ended"]
)
def test_all_other_goals_continue(client: str) -> None:
    world = World()
    if client == "of this machine":
        world.near = {"this", "other"}
    elif client == "of this worker":
        world.seen[b"client"] = "own"
    elif client == "never seen":
        world.seen.clear()
    elif client == "unnamed":
        world.goal.client = b""
    world.check()
    world.seen.clear()
    if client == "back in time":
        world.check(2)
        world.seen = {b"client": "other"}
    elif client == "ended":
        world.goals = []
    assert world.check(5) == []


@pytest.mark.parametrize(
    ("session", "seconds", "computed", "ends"),
    [
        ("other", 2.9, 0.1, True),
        ("", 9.0, 0.0, True),
        ("own", 9.0, 0.0, False),
        ("other", 1.9, 0.0, False),
        ("other", 9.0, 8.9, False),
    ],
)
@pytest.mark.parametrize("late", [False, True])
def test_the_goals_of_other_processes_end_if_a_suspension_has_ended_a_link(
    monkeypatch: pytest.MonkeyPatch, session: str, seconds: float, computed: float, ends: bool, late: bool
) -> None:
    """Whether the session notices the end of the link before the first check, or after it."""
    clock = [100.0, 5.0]
    monkeypatch.setattr("navigation.goals._now", lambda: tuple(clock))
    world = World()
    world.near.add("other")
    world.check(1)
    world.seen[b"client"] = session
    clock[:] = 100.0 + seconds, 5.0 + computed
    if late:
        assert world.check(1) == []
        clock[0] += 0.25
    world.mesh.ended += 1
    assert bool(world.check(1)) is ends
    assert all(f"for {seconds} s" in reason for _, reason in world.unreachable)


def test_a_suspension_that_ended_no_link_ends_no_goal(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0, 5.0]
    monkeypatch.setattr("navigation.goals._now", lambda: tuple(clock))
    world = World()
    world.check(1)
    clock[0] += 9.0
    for _ in range(20):
        assert world.check(1) == []
        clock[0] += 0.25
    world.mesh.ended += 1  # for another reason
    assert world.check(1) == []


def goal(turn: dict[str, float], tree: str = "") -> Any:
    """Return the result of `goal_of` for a ``NavigateToPose`` goal with this orientation."""
    pose = {"position": {"x": 1.0, "y": 2.0, "z": 0.0}, "orientation": {**dict.fromkeys("xyzw", 0.0), **turn}}
    frames: Any = SimpleNamespace(map_frame="map")
    return goal_of({"pose": {"header": {"frame_id": "map"}, "pose": pose}, "behavior_tree": tree}, frames, list)


@pytest.mark.parametrize("turn", [{}, {"w": 3.0}, {"z": 1e-9}, {"x": 0.5, "w": 0.5}])
def test_a_goal_whose_quaternion_is_not_a_rotation_is_rejected(turn: dict[str, float]) -> None:
    with pytest.raises(PlanError, match="the goal's quaternion is not a rotation: its length is") as caught:
        goal(turn)
    assert caught.value.fault is Fault.BAD_GOAL
    any_heading, _ = goal(turn, Constraints(heading=False).to_text())
    assert any_heading.pose[:2] == (1.0, 2.0)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.707, 0.707), (0.0, 0.0, -1.0, 0.0)])
def test_rounded_quaternions_are_rotations(turn: tuple[float, ...]) -> None:
    check_rotation(dict(zip("xyzw", turn, strict=True)), "its")
