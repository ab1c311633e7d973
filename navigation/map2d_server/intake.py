"""Imports into the store: maps of other map servers and mappers, and points clicked in rviz."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

import numpy as np

from bridge.hub.graph import HubEndpoint
from bridge.hub.wire.qos import LATCHED
from bridge.modules.endpoints import Subscription
from bridge.modules.host import Host
from bridge.stores.entry import StoreError
from bridge.stores.kinds import LOCATION, MAP
from bridge.stores.store import Store
from navigation.map2d_server.section import TakenMap
from navigation.maps.grid import from_grid
from navigation.messages import GRID, Message
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D

_log = logging.getLogger(__name__)

_UNKNOWN_SECONDS = 5.0  # a map waits this long for the graph to show its sender, whose token it may overtake
_MOST_UNKNOWN = 8
_MOST_POINTS = 10_000


class MapIntake:
    """Imports the maps of one topic, except maps of another Map2DServer, which are in the store already.

    Whether a Map2DServer sent a map is decided as soon as the graph shows the sender, which may leave at any time.
    """

    def __init__(self, host: Host, rule: TakenMap, store: Store, on_refusal: Callable[[str], None]) -> None:
        self._host, self._rule, self._store, self._on_refusal = host, rule, store, on_refusal
        self._unknown: dict[bytes, Message] = {}
        """The newest map of each sender that the graph does not show yet, by GID."""
        self._waiting: Message | None = None
        self._due = False
        self._next = 0.0
        self.topic, self.taken = rule.topic, 0
        self._end: Subscription = host.node.subscription(rule.topic, GRID, self._on_map, LATCHED)

    def _on_map(self, message: Message) -> None:
        sender = self._end.sender
        if len(self._unknown) >= _MOST_UNKNOWN:
            self._unknown.pop(next(iter(self._unknown)))
        self._unknown[sender] = message
        self.follow_graph()
        if sender in self._unknown:
            self._host.loop.after(_UNKNOWN_SECONDS, lambda: self._give_up(sender, message))

    def follow_graph(self) -> None:
        """Import the maps whose senders the graph shows; called when it changes."""
        if not self._unknown:
            return
        for end in self._host.node.hub.graph.publishers(self.topic):
            message = self._unknown.pop(end.gid, None)
            if message is not None and not is_ours(end):
                self._schedule(message)

    def _give_up(self, sender: bytes, message: Message) -> None:
        if self._unknown.get(sender) is message:
            del self._unknown[sender]
            self._on_refusal(
                f"{self.topic}: a map was not imported, as its publisher has left, or is not in the hub's graph;"
                " keep its publisher running"
            )

    def _schedule(self, message: Message) -> None:
        self._waiting = message
        if not self._due:
            self._due = True
            self._host.loop.after(max(0.0, self._next - time.monotonic()), self._import_map)

    def _import_map(self) -> None:
        self._due = False
        waiting, self._waiting = self._waiting, None
        if waiting is None:
            return
        self._next = time.monotonic() + self._rule.period
        try:
            grid = from_grid(waiting, self._rule.name)
            with self._store.replica.locked():  # so that flags painted meanwhile are not lost
                self._store_map(grid)
        except (StoreError, ValueError) as error:
            self._on_refusal(f"{self.topic}: {error}")

    def _store_map(self, grid: MapGrid2D) -> None:
        name, before = self._rule.name, self._store.get(MAP, self._rule.name)
        if before is not None:
            keep_flags(grid, before)
        if before is None or grid != before:
            self._store.put(MAP, name, grid)
            self.taken += 1
            _log.info("%s: imported into the store as map %r", self.topic, name)
        if self._rule.use and self._store.current_map() != name:
            self._store.use_map(name)


class ClickedPoints:
    """Stores points of ``/clicked_point`` as locations on the current map."""

    def __init__(
        self,
        host: Host,
        prefix: str,
        frame: str,
        store: Store,
        current: Callable[[], str],
        on_refusal: Callable[[str], None],
    ) -> None:
        self._prefix, self._frame, self._store = prefix, frame, store
        self._current, self._on_refusal = current, on_refusal
        host.node.subscription("/clicked_point", "geometry_msgs/msg/PointStamped", self._on_point)

    def _on_point(self, message: Message) -> None:
        try:
            self._store_point(message)
        except (StoreError, ValueError) as error:
            self._on_refusal(f"/clicked_point: {error}")

    def _store_point(self, message: Message) -> None:
        frame, point, current = str(message["header"]["frame_id"]).lstrip("/"), message["point"], self._current()
        if frame != self._frame:
            raise ValueError(
                f"the point is in the frame {frame!r}; maps are in {self._frame!r}: set rviz's fixed frame"
            )
        if not current:
            raise ValueError("the point is on no map: no current map is set")
        x, y = float(point["x"]), float(point["y"])
        if not (np.isfinite(x) and np.isfinite(y)):
            raise ValueError("the point is not finite")
        used = set(self._store.names(LOCATION))
        name = next((f"{self._prefix}{n}" for n in range(1, _MOST_POINTS) if f"{self._prefix}{n}" not in used), None)
        if name is None:
            raise ValueError(f"the store already has {_MOST_POINTS - 1} points")
        self._store.put(LOCATION, name, Map2DLocation(current, x, y, 0.0, "clicked"))


def is_ours(endpoint: HubEndpoint) -> bool:
    """Whether an endpoint belongs to a Map2DServer, of this or another daemon."""
    return endpoint.node == "map2d_server"


def keep_flags(grid: MapGrid2D, before: MapGrid2D) -> None:
    """Copy the keep-out cells that people have painted to a new version of a map with the same geometry."""
    geometry = (grid.flags.shape, grid.resolution, *grid.origin)
    if geometry == (before.flags.shape, before.resolution, *before.origin):
        drawn = before.flags == MapFlag.KEEP_OUT
        grid.flags[drawn] = MapFlag.KEEP_OUT
