"""All maps for planning, and the path from one to another over links such as elevators."""

from __future__ import annotations

import heapq
import itertools
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

from typing_extensions import override

from bridge.stores.kinds import LINK, LOCATION, MAP
from bridge.stores.store import MapAreas, Store
from navigation.algorithms.astar import astar
from navigation.goals import MapPlace
from navigation.pose import Pose
from navigation.robot_path_planner.ground import Ground, Zone
from navigation.robot_path_planner.section import RobotPathPlannerSection
from navigation.status import Fault, PlanError
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapGrid2D


@dataclass(frozen=True)
class LinkedPlaces:
    """Two places at which robots change from one map to the other, in both directions."""

    first: MapPlace
    second: MapPlace  #: on another map
    cost: float = 0.0  #: equivalent meters of path
    name: str = ""  #: the link's name in the store


@dataclass(frozen=True)
class Leg:
    """The part of a path on one map."""

    end: MapPlace
    onto: MapPlace | None = None  #: the link's place on the next map; None if the end is the goal


class Atlas:
    """All maps and the links between them; this base class has none."""

    def ground(self, name: str) -> Ground | None:  # noqa: ARG002 - for subclasses
        """Return the map of this name, or None."""
        return None

    def links(self) -> Sequence[LinkedPlaces]:
        """Return the links between all maps."""
        return ()


def leg(atlas: Atlas, ground: Ground, start: Pose, goal: MapPlace) -> Leg:
    """Return this map's part of the shortest path to a goal on any map.

    Raises `PlanError` if the goal's map is not stored, robots must keep out of one of the two maps, or no links lead to
    the goal.
    """
    there = ground if goal.map_name == ground.name else atlas.ground(goal.map_name)
    if there is None:
        raise PlanError(Fault.NO_MAP, f"the goal is on the map '{goal.map_name}', which is not in the store")
    if ground.closed or there.closed:
        raise PlanError(Fault.NO_MAP, ground.closed or there.closed)
    if there is ground:
        return Leg(goal)
    links = [
        directed
        for link in atlas.links()
        for directed in (link, LinkedPlaces(link.second, link.first, link.cost, link.name))
    ]
    numbers = itertools.count()
    waiting: list[tuple[float, int, MapPlace, Leg | None]] = [(0.0, next(numbers), MapPlace(ground.name, start), None)]
    done: set[MapPlace] = set()
    while waiting:
        cost, _, place, first = heapq.heappop(waiting)
        if place == goal and first is not None:
            return first
        if place in done:
            continue
        done.add(place)
        here_ground = ground if place.map_name == ground.name else atlas.ground(place.map_name)
        if here_ground is None or here_ground.closed:
            continue
        ends = [(link.first, link.second, link.cost) for link in links if link.first.map_name == place.map_name]
        if place.map_name == goal.map_name:
            ends.append((goal, goal, 0.0))
        for end, onto, price in ends:
            length = _length(here_ground, place.pose, end.pose)
            if math.isfinite(length):
                began = first or Leg(end, onto)
                heapq.heappush(waiting, (cost + length + price, next(numbers), onto, began))
    raise PlanError(Fault.NO_PATH, f"no links from the map {ground.name} to the goal on the map {goal.map_name}")


def _length(ground: Ground, start: Pose, end: Pose) -> float:
    """Return the meters of the path between two poses on a map; infinite without a path."""
    start_cell, end_cell = ground.cell(start.x, start.y), ground.cell(end.x, end.y)
    if start_cell is None or end_cell is None or not ground.fits(end_cell):
        return math.inf
    if start_cell == end_cell:
        return start.distance(end)
    path = astar(ground.weights, start_cell, end_cell)
    return math.inf if path is None else path.length * ground.grid.resolution


_log = logging.getLogger(__name__)


class StoreAtlas(Atlas):
    """The store's maps for a robot with these settings. Used only on the module's thread."""

    def __init__(self, store: Store, settings: RobotPathPlannerSection) -> None:
        self._store, self.settings = store, settings
        self._grounds: dict[str, Ground] = {}

    def clear(self) -> None:
        """Drop cached maps, because maps, areas or the robot have changed."""
        self._grounds.clear()

    @override
    def ground(self, name: str) -> Ground | None:
        ground = self._grounds.get(name)
        if ground is None:
            grid = self._store.get(MAP, name) if name else None
            if grid is None:
                return None
            ground = self._grounds[name] = self.ground_of(grid, self.areas(name))
        return ground

    def ground_of(self, grid: MapGrid2D, areas: MapAreas) -> Ground:
        """Return any map with its areas."""
        zones = [Zone(*pair) for pair in areas.named.values()]
        return Ground(grid, self.settings.robot_radius, self.settings.clearance, zones, areas.closed)

    def areas(self, name: str) -> MapAreas:
        """Return the areas on a map; log those that cannot be read."""
        areas = self._store.areas(name)
        for text in areas.troubles:
            _log.warning("%s", text)
        return areas

    @override
    def links(self) -> Sequence[LinkedPlaces]:
        links = []
        for name, link in self._store.all(LINK).items():
            first, second = self._store.get(LOCATION, link.first), self._store.get(LOCATION, link.second)
            if first is None or second is None:
                _log.warning("link %s: location %s not found", name, link.second if first else link.first)
                continue
            links.append(LinkedPlaces(_place(link.first, first), _place(link.second, second), link.cost, name))
        return links


def _place(name: str, location: Map2DLocation) -> MapPlace:
    return MapPlace(location.map_id, Pose(location.x, location.y, math.radians(location.theta)), name)
