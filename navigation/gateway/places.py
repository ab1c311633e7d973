"""Places by name, and places as YARP has them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bridge.modules.host import Host
from bridge.stores.errors import StoreError
from bridge.stores.kinds import AREA, LOCATION, MAP
from bridge.stores.store import Store
from navigation.gateway.drive import Target
from navigation.maps.grid import from_grid, yaw_of
from navigation.pose import Pose
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapGrid2D

_ANY = math.nan


class Places:
    """The store's maps and locations, for goals.

    Args:
        host: the module's.
        frame: of the map that is in use.
    """

    def __init__(self, host: Host, frame: str) -> None:
        self._host, self._frame = host, frame

    @property
    def store(self) -> Store | None:
        """The store, where there is one."""
        try:
            return self._host.store
        except StoreError:
            return None

    @property
    def current(self) -> str:
        """The map that is in use, "" where none is."""
        return "" if self.store is None else self.store.current_map()

    def find(self, name: str) -> Target:
        """A location's pose, or a point in an area, in any heading.

        Raises:
            LookupError: there is none of the name; the text says what there is.
        """
        store = self.store
        if store is None:
            raise LookupError("there is no store of locations here; switch on `store`")
        found = store.get(LOCATION, name)
        if found is not None:
            return self.target(found)
        area = store.get(AREA, name)
        middle = None if area is None else area.getCentroid()
        if area is None or middle is None:
            known = ", ".join([*store.names(LOCATION), *store.names(AREA)][:20]) or "none"
            raise LookupError(f"there is no location or area {name!r}; there are: {known}")
        inside = middle if area.contains(middle.x, middle.y) else area.getRandomLocation() or middle
        inside.theta = _ANY
        return self.target(inside)

    def target(self, place: Map2DLocation) -> Target:
        """A goal at a place; where that is on another map, its frame is that map's name."""
        elsewhere = place.map_id and self.current and place.map_id not in (self.current, self._frame)
        frame = place.map_id if elsewhere else self._frame
        return Target(Pose(place.x, place.y, math.radians(place.theta)), frame)

    def known(self, place: Map2DLocation) -> Target:
        """A goal at a place.

        Raises:
            LookupError: the store has maps, and not the place's.
        """
        target, store = self.target(place), self.store
        if target.frame != self._frame and store is not None and target.frame not in (maps := store.names(MAP)):
            raise LookupError(f"it is on the map {target.frame}, which is not here; there are: {', '.join(maps[:20])}")
        return target

    def location(self, message: Mapping[str, Any] | Target) -> Map2DLocation:
        """A ``geometry_msgs/PoseStamped``, or a target, as a place on a map."""
        if isinstance(message, Target):
            frame, pose = message.frame, message.pose
        else:
            position, frame = message["pose"]["position"], str(message["header"]["frame_id"])
            pose = Pose(position["x"], position["y"], yaw_of(message["pose"]["orientation"]))
        map_id = self.current or frame if frame in ("", self._frame) else frame
        return Map2DLocation(map_id, float(pose.x), float(pose.y), math.degrees(pose.theta))

    def map(self) -> MapGrid2D | None:
        """The map that is in use."""
        store = self.store
        return None if store is None or not self.current else store.get(MAP, self.current)

    def grid(self, message: Mapping[str, Any] | None) -> MapGrid2D | None:
        """A ``nav_msgs/OccupancyGrid`` as YARP has it."""
        return None if message is None else from_grid(message, self.current or "map")
