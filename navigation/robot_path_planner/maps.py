"""The maps that are planned on: of the store with its areas and links, or of a topic."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence

from bridge.stores.errors import StoreError
from bridge.stores.kinds import AREA, LINK, LOCATION, MAP
from bridge.stores.store import Store
from navigation.goals import Place
from navigation.pose import Pose
from navigation.robot_path_planner.ground import Ground, Zone
from navigation.robot_path_planner.itinerary import Link
from navigation.robot_path_planner.settings import Settings
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapGrid2D

_log = logging.getLogger(__name__)


class StoreAtlas:
    """The store's maps for a robot; see `navigation.robot_path_planner.itinerary.Atlas`. On the module's thread.

    Args:
        store: where maps, areas and links are.
        settings: what the robot needs of room.
    """

    def __init__(self, store: Store, settings: Settings) -> None:
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

    def links(self) -> Sequence[Link]:
        """The store's links whose two locations are there."""
        made = []
        for name, link in self._store.all(LINK).items():
            first, second = self._store.get(LOCATION, link.first), self._store.get(LOCATION, link.second)
            if first is None or second is None:
                _log.warning("link %s: there is no location %s", name, link.second if first else link.first)
                continue
            made.append(Link(_place(link.first, first), _place(link.second, second), link.cost, name))
        return made

    def _zones(self) -> list[Zone]:
        made = []
        for name, area in self._store.all(AREA).items():
            try:
                made.append(Zone(area, self._store.behaviour(name)))
            except StoreError as err:
                _log.warning("%s", err)
        return made


def _place(name: str, location: Map2DLocation) -> Place:
    return Place(location.map_id, Pose(location.x, location.y, math.radians(location.theta)), name)
