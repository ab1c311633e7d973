"""The map in use, as modules follow it: the store's current one, or a topic's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bridge.hub.wire.qos import LATCHED
from bridge.modules.host import Host
from bridge.stores.entry import StoreError
from bridge.stores.kinds import CURRENT, MAP, ValueKind
from navigation.maps.grid import from_grid
from navigation.messages import GRID, Message
from yarp_compat.dev.mapgrid import MapGrid2D


class MapInUse:
    """Follows the map that a section names: ``store`` (or None), or a topic. On the module's thread.

    ``use`` is called with each map, None where the store has no current one; with the same one again where a value of
    these kinds changes in the store.
    """

    def __init__(
        self, host: Host, source: str | None, use: Callable[[MapGrid2D | None], object], *kinds: ValueKind[Any]
    ) -> None:
        self._host, self._topic, self._use = host, source or "store", use
        self.of_store = self._topic == "store"
        self.grid: MapGrid2D | None = None
        # why none is used, or not the newest
        self.trouble = "" if self.of_store else f"no map has come from {self._topic}"
        self._due = self._closed = False
        watched = {*kinds, MAP, CURRENT} if self.of_store else {*kinds}
        self._closing: list[Callable[[], object]] = [host.store.watch(self._changed, *watched)] if watched else []
        if not self.of_store:
            heard = host.node.subscription(self._topic, GRID, self._told, LATCHED)
            self._closing.append(lambda: host.node.release(heard))

    def take(self) -> None:
        """Use the store's current map, or once more the topic's."""
        self._due = False
        if self._closed:
            return
        if self.of_store:
            try:
                name = self._host.store.current_map()
                self.grid = self._host.store.get(MAP, name) if name else None
            except StoreError as err:
                self.trouble = str(err)
                return
            self.trouble = "the store has no current map" if self.grid is None else ""
        self._use(self.grid)

    def close(self) -> None:
        """Follow no more."""
        self._closed = True
        for close in self._closing:
            close()

    def _changed(self, _change: object) -> None:
        """On the store's thread; many changes at once are taken up once."""
        if not self._due:
            self._due = True
            self._host.loop.post(self.take)

    def _told(self, message: Message) -> None:
        if self._closed:
            return  # it came just before
        try:
            name = self._host.config.modules.map2d_server.taken_as(self._topic)
            grid = from_grid(message, name or self._host.store.current_map() or self._topic.strip("/"))
        except (ValueError, StoreError) as err:
            self.trouble = f"{self._topic}: {err}"
            return
        self.grid, self.trouble = grid, ""
        self._use(grid)
