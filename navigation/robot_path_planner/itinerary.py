"""The way from one map to another, over links such as lifts."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from navigation.algorithms.astar import astar
from navigation.goals import Place
from navigation.plan_error import PlanError
from navigation.pose import Pose
from navigation.robot_path_planner.ground import Ground
from navigation.status import Fault


@dataclass(frozen=True)
class Link:
    """Two places between which robots change maps, either way.

    Attributes:
        first: one of them.
        second: the other, on another map.
        cost: as so many metres of way.
        name: as it is kept.
    """

    first: Place
    second: Place
    cost: float = 0.0
    name: str = ""


@dataclass(frozen=True)
class Leg:
    """The part of a way to drive on the map at hand.

    Attributes:
        end: where it ends.
        onto: where the robot goes on, on another map; None where the end is the goal.
    """

    end: Place
    onto: Place | None = None


class Atlas(Protocol):
    """All maps, and the links between them."""

    def ground(self, name: str) -> Ground | None:
        """A map; None where there is none of the name."""

    def links(self) -> Sequence[Link]:
        """All links."""


class NoAtlas:
    """One that knows of no other map."""

    def ground(self, name: str) -> Ground | None:
        """None."""
        del name
        return None

    def links(self) -> Sequence[Link]:
        """None."""
        return ()


def leg(atlas: Atlas, ground: Ground, start: Pose, goal: Place) -> Leg:
    """What to drive on the map at hand to come to a goal on any map, the shortest way.

    Args:
        atlas: the other maps.
        ground: the map at hand.
        start: where the robot is on it.
        goal: where it is to go.

    Raises:
        PlanError: no links lead there; the text says why.
    """
    if goal.map_name == ground.name:
        return Leg(goal)
    if atlas.ground(goal.map_name) is None:
        raise PlanError(Fault.NO_MAP, f"the goal is on the map '{goal.map_name}', and there is no map of this name")
    links = [way for each in atlas.links() for way in (each, Link(each.second, each.first, each.cost, each.name))]
    numbers = itertools.count()
    waiting: list[tuple[float, int, Place, Leg | None]] = [(0.0, next(numbers), Place(ground.name, start), None)]
    done: set[Place] = set()
    while waiting:
        cost, _, here, first = heapq.heappop(waiting)
        if here == goal and first is not None:
            return first
        if here in done:
            continue
        done.add(here)
        there = ground if here.map_name == ground.name else atlas.ground(here.map_name)
        if there is None:
            continue
        ends = [(each.first, each.second, each.cost) for each in links if each.first.map_name == here.map_name]
        if here.map_name == goal.map_name:
            ends.append((goal, goal, 0.0))
        for end, onto, price in ends:
            length = _length(there, here.pose, end.pose)
            if math.isfinite(length):
                began = first or Leg(end, onto)
                heapq.heappush(waiting, (cost + length + price, next(numbers), onto, began))
    raise PlanError(Fault.NO_PATH, f"no link leads from the map {ground.name} to the goal on the map {goal.map_name}")


def _length(ground: Ground, one: Pose, other: Pose) -> float:
    """Metres of the way between two places of a map; infinite where there is none."""
    here, there = ground.cell(one.x, one.y), ground.cell(other.x, other.y)
    if here is None or there is None or not ground.fits(there):
        return math.inf
    if here == there:
        return one.distance(other)
    found = astar(ground.weights, here, there)
    return math.inf if found is None else found.length * ground.grid.resolution
