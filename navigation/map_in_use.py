"""The map that a module uses: the store's current map, or the map from a topic."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bridge.hub.wire.qos import LATCHED
from bridge.modules.host import Host
from bridge.stores.entry import StoreError
from bridge.stores.kinds import CURRENT, MAP, ValueKind
from navigation.map2d_server.section import Map2DServerSection
from navigation.maps.grid import from_grid
from navigation.messages import GRID, Message
from yarp_compat.dev.mapgrid import MapGrid2D


class MapInUse:
    """Follows the map that a section configures: ``store`` (or None), or a topic. Used on the module's thread.

    ``use`` is called with each new map, with None if the store has no current map, and with the same map again when a
    value of ``kinds`` changes in the store.
    """

    def __init__(
        self, host: Host, source: str | None, use: Callable[[MapGrid2D | None], object], *kinds: ValueKind[Any]
    ) -> None:
        self._host, self._topic, self._use = host, source or "store", use
        self.of_store = self._topic == "store"
        self.grid: MapGrid2D | None = None
        # why the map is missing, or not the newest
        self.trouble = "" if self.of_store else f"waiting for a map on {self._topic}"
        # whether the map's keep-out cells are unknown: the store cannot be read, or no map has arrived on the topic
        self.unknown = not self.of_store
        self._due = self._closed = False
        watched = {*kinds, MAP, CURRENT} if self.of_store else {*kinds}
        self._closing: list[Callable[[], object]] = [host.store.watch(self._on_change, *watched)] if watched else []
        if not self.of_store:
            subscription = host.node.subscription(self._topic, GRID, self._on_map, LATCHED)
            self._closing.append(lambda: host.node.release(subscription))

    def update(self) -> None:
        """Use the store's current map, or the topic's newest map again."""
        self._due = False
        if self._closed:
            return
        if self.of_store:
            try:
                name = self._host.store.current_map()
                self.grid = self._host.store.get(MAP, name) if name else None
            except StoreError as err:
                self.trouble, self.unknown = str(err), True
                return
            self.unknown = False
            self.trouble = "the store has no current map" if self.grid is None else ""
        self._use(self.grid)

    def close(self) -> None:
        self._closed = True
        for close in self._closing:
            close()

    def _on_change(self, _change: object) -> None:
        """Schedule one update for any number of changes; runs on the store's thread."""
        if not self._due:
            self._due = True
            self._host.loop.post(self.update)

    def _on_map(self, message: Message) -> None:
        if self._closed:
            return  # received just before closing
        try:
            name = self._host.config.section(Map2DServerSection).taken_as(self._topic)
            grid = from_grid(message, name or self._host.store.current_map() or self._topic.strip("/"))
        except (ValueError, StoreError) as err:
            self.trouble = f"{self._topic}: {err}"
            return
        self.grid, self.trouble, self.unknown = grid, "", False
        self._use(grid)
