"""Latched publishers of maps: the current map, every map, and masks for Nav2's filters."""

from __future__ import annotations

import hashlib
import logging
import re
from collections.abc import Callable
from collections.abc import Set as AbstractSet

import numpy as np
from numpy.typing import NDArray

from bridge.hub.wire.qos import LATCHED
from bridge.modules.endpoints import ModulePublisher
from bridge.modules.host import ModuleNode
from bridge.stores.kinds import AREA, BEHAVIOR, CURRENT, MAP
from bridge.stores.store import MapAreas, Store
from navigation.maps.grid import data_of, info_of, message_of, to_cdr, to_grid, turned
from navigation.maps.masks import KEEP_OUT as KEPT
from navigation.maps.masks import binary_mask, keepout_mask, speed_mask
from navigation.messages import GRID, Message
from yarp_compat.dev.mapgrid import MapGrid2D


class Head:
    """The content of headers: the frame of all maps, and the time in nanoseconds."""

    def __init__(self, frame: str, now_ns: Callable[[], int]) -> None:
        self.frame, self.now_ns = frame, now_ns

    def header(self) -> Message:
        """Return a ``std_msgs/msg/Header`` with the current time."""
        seconds, nanoseconds = divmod(self.now_ns(), 1_000_000_000)
        return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": self.frame}


_log = logging.getLogger(__name__)

KEEP_OUT, KEEP_OUT_INFO = "/keepout_filter_mask", "/keepout_costmap_filter_info"
SPEED, SPEED_INFO = "/speed_filter_mask", "/speed_costmap_filter_info"
BINARY, BINARY_INFO = "/binary_filter_mask", "/binary_costmap_filter_info"
INFO = "nav2_msgs/msg/CostmapFilterInfo"

_KEEP_OUT_FILTER, _BINARY_FILTER = 0, 3
"""``CostmapFilterInfo.type`` of KeepoutFilter and BinaryFilter (nav2_costmap_2d, costmap_filters/filter_values.hpp).

1 and 2 are SpeedFilter's, in percent and m/s.
"""


def masks_of(grid: MapGrid2D, areas: MapAreas, head: Head) -> dict[str, tuple[str, Message]]:
    """Return the type and message of each mask by topic. The grid is the current map, aligned to yaw 0."""
    mask = keepout_mask(grid, areas.keep_out)
    if areas.closed:
        mask[:] = KEPT  # without a mask, Nav2's filters would let robots drive everywhere
    limits = [
        (area, behavior.max_speed)
        for area, behavior in areas.named.values()
        if behavior.max_speed is not None and area.points
    ]
    speed = speed_mask(grid, limits)

    def on_cells(values: NDArray[np.int8]) -> tuple[str, Message]:
        return GRID, message_of(data_of(values), grid, head.frame, head.now_ns())

    def info(kind: int, mask_topic: str, base: float, multiplier: float) -> tuple[str, Message]:
        return INFO, {
            "header": head.header(),
            "type": kind,
            "filter_mask_topic": mask_topic,
            "base": base,
            "multiplier": multiplier,
        }

    return {
        KEEP_OUT: on_cells(mask),
        KEEP_OUT_INFO: info(_KEEP_OUT_FILTER, KEEP_OUT, 0.0, 1.0),
        BINARY: on_cells(binary_mask(mask)),
        BINARY_INFO: info(_BINARY_FILTER, BINARY, 0.0, 1.0),
        SPEED: on_cells(speed.values),
        SPEED_INFO: info(speed.type, SPEED, speed.base, speed.multiplier),
    }


Keys = AbstractSet[tuple[str, str]]  # kinds and names of changed values
MAP_TOPIC, METADATA_TOPIC = "/map", "/map_metadata"
_FORBIDDEN = re.compile(r"[^A-Za-z0-9_]")


class CurrentMap:
    """The current map on ``/map`` and ``/map_metadata``."""

    def __init__(self, node: ModuleNode, store: Store, head: Head, default: str) -> None:
        self._node, self._store, self._head, self._default = node, store, head, default
        self._ends: tuple[ModulePublisher, ModulePublisher] | None = None
        self._muted = False
        self.name = ""  # "" without a current map
        self.grid: MapGrid2D | None = None  # the current map, aligned to yaw 0

    def choose(self) -> str:
        """Return the name of the current map: the selected one, or the section's default if the store has it, or ""."""
        return self._store.current_map() or (self._default if self._default in self._store.names(MAP) else "")

    def update(self, changed: Keys) -> bool:
        """Publish the map if it has changed; return whether it has."""
        name = self.choose()
        if name == self.name and not changed & {(MAP.name, name), (CURRENT.name, "map")}:
            return False
        self.name = name
        stored = self._store.get(MAP, name) if name else None
        self.grid = None if stored is None else turned(stored)
        self._publish()
        return True

    def mute(self, muted: bool) -> None:
        """Stop publishing while another program publishes the map, or publish again."""
        if muted != self._muted:
            self._muted = muted
            self._publish()

    def message(self) -> Message | None:
        """Return the map as ``OccupancyGrid``, or None."""
        return None if self.grid is None else self.message_of(self.grid)

    def message_of(self, grid: MapGrid2D) -> Message:
        """Return any map as ``OccupancyGrid``."""
        return to_grid(grid, self._head.frame, self._head.now_ns())

    def _publish(self) -> None:
        if self.grid is None or self._muted:
            for end in self._ends or ():
                self._node.release(end)
            self._ends = None
            return
        if self._ends is None:
            self._ends = (
                self._node.publisher(MAP_TOPIC, GRID, LATCHED, priority="state"),
                self._node.publisher(METADATA_TOPIC, "nav_msgs/msg/MapMetaData", LATCHED, priority="state"),
            )
        now = self._head.now_ns()
        self._ends[0].publish_cdr(bytes(to_cdr(self.grid, self._head.frame, now)))
        self._ends[1].publish(info_of(self.grid, now))


class AllMaps:
    """Publishes every map of the store on ``/maps/<name>``."""

    def __init__(self, node: ModuleNode, store: Store, head: Head) -> None:
        self._node, self._store, self._head = node, store, head
        self._ends: dict[str, ModulePublisher] = {}

    def update(self, changed: Keys) -> None:
        """Publish the changed maps, and close the topics of deleted ones."""
        for kind, name in sorted(changed):
            if kind == MAP.name:
                self._show(name)

    @property
    def topics(self) -> dict[str, str]:
        """The topic of each map."""
        return {name: end.topic for name, end in self._ends.copy().items()}  # another thread reads the topics

    def _show(self, name: str) -> None:
        stored = self._store.get(MAP, name)
        end = self._ends.get(name)
        if stored is None:
            if end is not None:
                self._node.release(self._ends.pop(name))
            return
        if end is None:
            topic = topic_of(name, set(self.topics.values()))
            end = self._ends[name] = self._node.publisher(topic, GRID, LATCHED, priority="state")
        end.publish_cdr(bytes(to_cdr(turned(stored), self._head.frame, self._head.now_ns())))


class Masks:
    """Publishes the masks of keep-out cells, areas and speed limits for the filters in Nav2's costmaps."""

    def __init__(self, node: ModuleNode, store: Store, head: Head) -> None:
        self._node, self._store, self._head = node, store, head
        self._ends: dict[str, ModulePublisher] = {}
        self.areas = MapAreas()

    def update(self, current: CurrentMap, changed: Keys, *, map_changed: bool) -> None:
        """Publish the masks of the current map if the map, an area or a behavior has changed."""
        if not (map_changed or any(kind in (AREA.name, BEHAVIOR.name) for kind, _ in changed)):
            return
        self.areas = self._store.areas(current.name) if current.name else MapAreas()
        for text in self.areas.troubles:
            _log.warning("%s", text)
        messages = {} if current.grid is None else masks_of(current.grid, self.areas, self._head)
        for topic in self._ends.keys() - messages.keys():
            self._node.release(self._ends.pop(topic))
        for topic, (type_name, message) in messages.items():
            if topic not in self._ends:
                self._ends[topic] = self._node.publisher(topic, type_name, LATCHED, priority="state")
            self._ends[topic].publish(message)


def topic_of(name: str, taken: AbstractSet[str] = frozenset(), *, under: str = "/maps") -> str:
    """Return the topic ``<under>/<name>``, with ``_`` for invalid characters, and with a hash if that topic is taken.

    A name that begins with a digit gets the prefix ``n``; names are cut to 200 characters. The hash is the first 8
    digits of the name's SHA-256.
    """
    part = _FORBIDDEN.sub("_", name)[:200]
    topic = f"{under}/{'n' if part[0].isdigit() else ''}{part}"
    return f"{topic}_{hashlib.sha256(name.encode()).hexdigest()[:8]}" if topic in taken else topic
