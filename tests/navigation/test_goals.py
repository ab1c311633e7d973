"""Goals of another machine's clients end once those are cut off; those of this machine's do not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from navigation.goals import FarClients


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
