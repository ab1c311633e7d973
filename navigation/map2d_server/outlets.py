"""The topics on which maps go out, each latched: the current one, every one, the planners' masks, the places."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Set as AbstractSet

from bridge.modules.node import Node, Publisher
from bridge.stores.kinds import AREA, BEHAVIOUR, CURRENT, LOCATION, MAP, OBJECT, PATH
from bridge.stores.store import Store
from navigation.map2d_server import filters, markers
from navigation.map2d_server.messages import GRID, LATCHED, Head, Message
from navigation.maps.cdr import to_cdr
from navigation.maps.grid import info_of, to_grid
from navigation.maps.turned import turned
from yarp_compat.dev.mapgrid import MapGrid2D

Keys = AbstractSet[tuple[str, str]]
"""Kinds and names of what changed."""

MAP_TOPIC, METADATA_TOPIC = "/map", "/map_metadata"
_FORBIDDEN = re.compile(r"[^A-Za-z0-9_]")


class CurrentMap:
    """The current map on ``/map`` and ``/map_metadata``.

    Attributes:
        name: its name, "" where none was chosen.
        grid: the map itself, turned to yaw 0; None where there is none.
    """

    def __init__(self, node: Node, store: Store, head: Head, default: str) -> None:
        self._node, self._store, self._head, self._default = node, store, head, default
        self._ends: tuple[Publisher, Publisher] | None = None
        self._silent = False
        self.name = ""
        self.grid: MapGrid2D | None = None

    def choose(self) -> str:
        """The name of the map that is current: the one that was chosen, or the rule's where it is there."""
        return self._store.current_map() or (self._default if self._default in self._store.names(MAP) else "")

    def update(self, changed: Keys) -> bool:
        """Publish the map if it is another now; whether it is."""
        name = self.choose()
        if name == self.name and not changed & {(MAP.name, name), (CURRENT.name, "map")}:
            return False
        self.name = name
        found = self._store.get(MAP, name) if name else None
        self.grid = None if found is None else turned(found)
        self._publish()
        return True

    def hush(self, silent: bool) -> None:
        """Publish nothing, since somebody else publishes the map; or publish again."""
        if silent != self._silent:
            self._silent = silent
            self._publish()

    def message(self) -> Message | None:
        """The map as ``OccupancyGrid``; None where there is none."""
        return None if self.grid is None else self.message_of(self.grid)

    def message_of(self, grid: MapGrid2D) -> Message:
        """Any map as ``OccupancyGrid``."""
        return to_grid(grid, self._head.frame, self._head.now_ns())

    def _publish(self) -> None:
        if self.grid is None or self._silent:
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
    """Every map of the store on ``/maps/<name>``."""

    def __init__(self, node: Node, store: Store, head: Head) -> None:
        self._node, self._store, self._head = node, store, head
        self._ends: dict[str, Publisher] = {}

    def update(self, changed: Keys) -> None:
        """Publish the maps that changed; the topics of those that are gone go."""
        for kind, name in sorted(changed):
            if kind == MAP.name:
                self._show(name)

    @property
    def topics(self) -> dict[str, str]:
        """Each map's topic."""
        return {name: end.topic for name, end in self._ends.items()}

    def _show(self, name: str) -> None:
        found = self._store.get(MAP, name)
        end = self._ends.get(name)
        if found is None:
            if end is not None:
                self._node.release(self._ends.pop(name))
            return
        if end is None:
            topic = topic_of(name, set(self.topics.values()))
            end = self._ends[name] = self._node.publisher(topic, GRID, LATCHED, priority="state")
        end.publish_cdr(bytes(to_cdr(turned(found), self._head.frame, self._head.now_ns())))


class Masks:
    """What planners are to keep out of, and where they are to be slow, for the filters of Nav2's costmaps."""

    def __init__(self, node: Node, store: Store, head: Head) -> None:
        self._node, self._store, self._head = node, store, head
        self._ends: dict[str, Publisher] = {}

    def update(self, current: CurrentMap, changed: Keys, *, anew: bool) -> None:
        """Publish the masks of the current map if it, or an area, is another now."""
        if not (anew or any(kind in (AREA.name, BEHAVIOUR.name) for kind, _ in changed)):
            return
        messages = {} if current.grid is None else filters.messages(current.grid, self._store, self._head)
        for topic in self._ends.keys() - messages.keys():
            self._node.release(self._ends.pop(topic))
        for topic, (type_name, message) in messages.items():
            if topic not in self._ends:
                self._ends[topic] = self._node.publisher(topic, type_name, LATCHED, priority="state")
            self._ends[topic].publish(message)


class Markers:
    """Places on the current map, for rviz."""

    _KINDS = frozenset(kind.name for kind in (LOCATION, OBJECT, AREA, PATH))

    def __init__(self, node: Node, store: Store, head: Head) -> None:
        self._store, self._head = store, head
        self._end = node.publisher(markers.TOPIC, markers.TYPE, LATCHED, priority="state")

    def update(self, current: CurrentMap, changed: Keys, *, anew: bool) -> None:
        """Publish them if some changed, or the map did."""
        if anew or any(kind in self._KINDS for kind, _ in changed):
            self._end.publish(markers.markers(self._store, current.name, self._head))


def topic_of(name: str, taken: AbstractSet[str] = frozenset()) -> str:
    """The topic of a map: ``/maps/`` and its name, with ``_`` for what no topic can have.

    Args:
        name: the map's.
        taken: topics of other maps; where one is the same, eight digits of the name's SHA-256 follow.
    """
    part = _FORBIDDEN.sub("_", name)[:200]
    topic = f"/maps/{'n' if part[0].isdigit() else ''}{part}"
    return f"{topic}_{hashlib.sha256(name.encode()).hexdigest()[:8]}" if topic in taken else topic
