"""The feeds of the store: the current map with its images, the other maps, the places."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from typing_extensions import override

from bridge.client.store import StoreClient
from bridge.concurrency import SerialExecutor
from bridge.config.model import Config
from bridge.hub.endpoints.keyspace import KeySpace
from bridge.hub.errors import HubError
from bridge.hub.wire.qos import LATCHED
from bridge.modules.host import Host
from bridge.stores.entry import StoreError
from bridge.stores.kinds import AREA, LOCATION, MAP, PATH
from bridge.stores.wire import prefix
from bridge.web.feeds.feed import Feed
from bridge.web.feeds.map_pictures import Pictures, flags_picture, occupancy_picture
from bridge.web.feeds.robot import TopicsFeed, pose_json
from navigation.maps.grid import from_grid
from navigation.messages import GRID
from navigation.pose import Pose
from yarp_compat.dev.mapgrid import MapGrid2D

_log = logging.getLogger("midspan.web")

POLL_SECONDS = 1.0
"""Interval at which the store is polled for changes."""


@dataclass(frozen=True)
class StoreView:
    """The content of the store that pages see.

    ``name`` and ``grid``: the current map; ``grid`` is None if the store does not have it.
    """

    maps: dict[str, Any]
    places: dict[str, Any]
    grid: MapGrid2D | None
    name: str


class StoreFollower:
    """Polls the store for changes while one of its feeds is watched.

    Queries run on a separate thread; results are passed to the feeds on the module's thread.
    """

    def __init__(self, host: Host, config: Config) -> None:
        self._host, self._config = host, config
        self._executor = SerialExecutor("midspan-web-store")
        self._space: KeySpace | None = None
        self._client: StoreClient | None = None
        self._lock = threading.Lock()
        self._feeds: dict[Feed, Callable[[StoreView], None]] = {}
        self._timer: Any = None
        self._asking = False
        self._digest: Any = None
        self._view: StoreView | None = None
        self._map: tuple[Any, MapGrid2D | None] | None = None

    def begin(self, feed: Feed, take: Callable[[StoreView], None]) -> None:
        """Pass the current content and later changes to a feed."""
        self._feeds[feed] = take
        if self._timer is None:
            self._timer = self._host.loop.every(POLL_SECONDS, self.refresh)
        if self._view is not None:
            take(self._view)
        self.refresh()

    def end(self, feed: Feed) -> None:
        """Stop passing changes to a feed."""
        self._feeds.pop(feed, None)
        if not self._feeds and self._timer is not None:
            self._timer.close()
            self._timer = self._view = self._digest = self._map = None

    def client(self) -> StoreClient:
        """Return the store on the hub; raises `StoreError` if it is missing.

        Do not call it on the module's thread, because it blocks.
        """
        with self._lock:
            if self._client is None or not self._client.present:
                self._space = self._space or self._host.node.hub.keyspace(prefix(self._config.hub.domain))
                self._client = StoreClient(self._space, self._config.name)
            return self._client

    @property
    def writing(self) -> tuple[Callable[[], StoreClient], Callable[[], None]]:
        """Return what verbs need to change the store: `client`, and a function to call after each change."""
        return self.client, lambda: self._host.loop.post(self.refresh)

    def refresh(self) -> None:
        """Poll now, unless a query is running or no feed is watched."""
        if not self._asking and self._feeds:
            self._asking = True
            self._executor.submit(self._ask)

    def close(self) -> None:
        self._executor.close()

    def _ask(self) -> None:
        try:
            view, reason = self._read(), ""
        except (StoreError, HubError) as err:
            view, reason, self._client, self._digest, self._map = None, str(err), None, None, None
        except Exception as err:
            _log.exception("cannot read the store")
            view, reason, self._digest, self._map = None, f"{type(err).__name__}: {err}", None, None
        self._host.loop.post(partial(self._on_view, view, reason))

    def _read(self) -> StoreView | None:
        """Return the store's content; None if it has not changed."""
        client = self.client()
        digest = client.digest()
        if digest == self._digest:
            return None
        name = client.current_map()
        stamp = next((entry for entry in digest if entry[:2] == [MAP.name, name]), None)
        cached = self._map
        if cached is None or cached[0] != stamp:
            cached = self._map = stamp, client.get(MAP, name) if stamp else None
        grid = cached[1]
        view = StoreView({"names": client.names(MAP), "current": name}, _places(client), grid, name)
        self._digest = digest
        return view

    def _on_view(self, view: StoreView | None, reason: str) -> None:
        self._asking = False
        if reason:
            for feed in tuple(self._feeds):
                feed.put(None, reason)
        elif view is not None:
            self._view = view
            for take in tuple(self._feeds.values()):
                take(view)


def _places(client: StoreClient) -> dict[str, Any]:
    locations = {
        name: {"map": value.map_id, **pose_json(Pose(value.x, value.y, math.radians(value.theta)))}
        for name, value in client.all(LOCATION).items()
    }
    areas = {
        name: {"map": value.map_id, "points": [[point.x, point.y] for point in value.points]}
        for name, value in client.all(AREA).items()
    }
    paths = {
        name: {"map": value.waypoints[0].map_id, "points": [[point.x, point.y] for point in value.waypoints]}
        for name, value in client.all(PATH).items()
        if value.waypoints
    }
    return {"locations": locations, "areas": areas, "paths": paths}


class StoreFeed(Feed):
    """``maps`` or ``places``: a part of the store's content."""

    def __init__(self, name: str, store: StoreFollower, part: Callable[[StoreView], Any]) -> None:
        super().__init__(name)
        self._store, self._part = store, part

    @override
    def open(self) -> None:
        self._store.begin(self, lambda view: self.put(self._part(view)))

    @override
    def close(self) -> None:
        self._store.end(self)


class MapFeed(TopicsFeed):
    """``map``: the current map, from the store or the configured topic."""

    def __init__(self, host: Host, config: Config, store: StoreFollower, pictures: Pictures) -> None:
        super().__init__(host, "map")
        self._source, self._store, self._pictures = config.navigation.map, store, pictures
        self._drawing = SerialExecutor("midspan-web-map")
        self._shown: MapGrid2D | None = None  # None without a map

    @override
    def open(self) -> None:
        if self._source == "store":
            self._store.begin(self, self._on_store_view)
        else:
            self.follow(self._source, GRID, self._on_grid, LATCHED)

    @override
    def close(self) -> None:
        super().close()
        self._store.end(self)
        self._shown = None

    def end(self) -> None:
        """Stop the drawing thread."""
        self._drawing.close()

    def _on_store_view(self, view: StoreView) -> None:
        if view.grid is None:
            self._shown = None
            self.put(None, "no current map; choose one, or import one with 'midspan map import'")
        elif view.grid is not self._shown:
            self._shown = view.grid
            self._drawing.submit(partial(self._draw, view.grid, view.name))

    def _on_grid(self, message: dict[str, Any]) -> None:
        try:
            grid = from_grid(message, self._source)
        except ValueError as err:
            self._shown = None
            self.put(None, f"{self._source}: {err}")
            return
        self._shown = grid
        self._drawing.submit(partial(self._draw, grid, self._source))

    def _draw(self, grid: MapGrid2D, name: str) -> None:
        """Draw the images, on a separate thread because 16 million cells take a quarter of a second."""
        if grid is not self._shown:
            return  # a newer map waits, or the map was removed
        picture = self._pictures.put("occupancy", occupancy_picture(grid))
        tints = flags_picture(grid)
        flags = self._pictures.put("flags", tints) if tints is not None else None
        x, y, theta = grid.origin.to_ros()
        value = {
            "name": name,
            "width": grid.m_width,
            "height": grid.m_height,
            "resolution": grid.resolution,
            "origin": {"x": x, "y": y, "theta": theta},
            "image": picture,
            "flags": flags,
        }
        self._host.loop.post(partial(self._on_drawn, value))

    def _on_drawn(self, value: dict[str, Any]) -> None:
        if self._shown is not None:
            self.put(value)
