"""All maps that are planned on, and the way from one to another over links such as lifts."""

from __future__ import annotations

import heapq
import itertools
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

from bridge.config.sections.planners import RobotPathPlannerSection
from bridge.stores.entry import StoreError
from bridge.stores.kinds import AREA, LINK, LOCATION, MAP
from bridge.stores.store import Store
from navigation.algorithms.astar import astar
from navigation.goals import MapPlace
from navigation.pose import Pose
from navigation.robot_path_planner.ground import Ground, Zone
from navigation.status import Fault, PlanError
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapGrid2D


@dataclass(frozen=True)
class LinkedPlaces:
    """Two places between which robots change maps, either way."""

    first: MapPlace  #: one of them
    second: MapPlace  #: the other, on another map
    cost: float = 0.0  #: as so many metres of way
    name: str = ""  #: as it is kept


@dataclass(frozen=True)
class Leg:
    """The part of a way to drive on the map at hand."""

    end: MapPlace  #: where it ends
    onto: MapPlace | None = None  #: where the robot goes on, on another map; None where the end is the goal


class Atlas:
    """All maps, and the links between them; this one knows of none."""

    def ground(self, name: str) -> Ground | None:  # noqa: ARG002 - for those that know some
        """The map of a name, if any."""
        return None

    def links(self) -> Sequence[LinkedPlaces]:
        """All links."""
        return ()


def leg(atlas: Atlas, ground: Ground, start: Pose, goal: MapPlace) -> Leg:
    """What to drive on this map to come to a goal on any map, the shortest way; raises `PlanError` without links."""
    if goal.map_name == ground.name:
        return Leg(goal)
    if atlas.ground(goal.map_name) is None:
        raise PlanError(Fault.NO_MAP, f"the goal is on the map '{goal.map_name}', and there is no map of this name")
    links = [
        way for each in atlas.links() for way in (each, LinkedPlaces(each.second, each.first, each.cost, each.name))
    ]
    numbers = itertools.count()
    waiting: list[tuple[float, int, MapPlace, Leg | None]] = [(0.0, next(numbers), MapPlace(ground.name, start), None)]
    done: set[MapPlace] = set()
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
    """Metres of the way between two places of a map; infinite without a way."""
    here, there = ground.cell(one.x, one.y), ground.cell(other.x, other.y)
    if here is None or there is None or not ground.fits(there):
        return math.inf
    if here == there:
        return one.distance(other)
    found = astar(ground.weights, here, there)
    return math.inf if found is None else found.length * ground.grid.resolution


_log = logging.getLogger(__name__)


class StoreAtlas(Atlas):
    """The store's maps for a robot with these settings. On the module's thread."""

    def __init__(self, store: Store, settings: RobotPathPlannerSection) -> None:
        self._store, self.settings = store, settings
        self._grounds: dict[str, Ground] = {}

    def forget(self) -> None:
        """Maps, areas or the robot have changed."""
        self._grounds.clear()

    def ground(self, name: str) -> Ground | None:
        """A map of the store."""
        found = self._grounds.get(name)
        if found is None:
            grid = self._store.get(MAP, name) if name else None
            if grid is None:
                return None
            found = self._grounds[name] = self.made(grid)
        return found

    def made(self, grid: MapGrid2D) -> Ground:
        """Any map, with the store's areas."""
        return Ground(grid, self.settings.robot_radius, self.settings.clearance, self._zones())

    def links(self) -> Sequence[LinkedPlaces]:
        """The store's links whose two locations are there."""
        made = []
        for name, link in self._store.all(LINK).items():
            first, second = self._store.get(LOCATION, link.first), self._store.get(LOCATION, link.second)
            if first is None or second is None:
                _log.warning("link %s: there is no location %s", name, link.second if first else link.first)
                continue
            made.append(LinkedPlaces(_place(link.first, first), _place(link.second, second), link.cost, name))
        return made

    def _zones(self) -> list[Zone]:
        made = []
        for name, area in self._store.all(AREA).items():
            try:
                made.append(Zone(area, self._store.behaviour(name)))
            except StoreError as err:
                _log.warning("%s", err)
        return made


def _place(name: str, location: Map2DLocation) -> MapPlace:
    return MapPlace(location.map_id, Pose(location.x, location.y, math.radians(location.theta)), name)
