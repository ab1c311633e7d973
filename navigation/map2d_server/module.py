"""Map2DServer: the maps and places of the store for every side.

YARP clients read and change them through IMap2D. ROS 1 and ROS 2 get the current map, the planners' masks and every
map as latched topics, and the services of their usual map servers. Each change reaches all clients.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable

from typing_extensions import override

from bridge.config.sections.section import Section
from bridge.hub.graph.owners import owner
from bridge.module_keys import MapServerKeys
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.stores.entry import StoreError
from bridge.stores.kinds import AREA, BEHAVIOR, CURRENT, LOCATION, MAP, MAP3D, OBJECT, PATH
from bridge.stores.store import Change
from bridge.worker import Health
from navigation.map2d_server.files import MapFiles, MapsFolder
from navigation.map2d_server.intake import ClickedPoints, MapIntake, is_ours
from navigation.map2d_server.maps3d import Maps3D
from navigation.map2d_server.markers import Markers
from navigation.map2d_server.publishers import MAP_TOPIC, AllMaps, CurrentMap, Head, Keys, Masks
from navigation.map2d_server.section import Map2DServerSection
from navigation.map2d_server.services import MapAnswers, MapCommands, MapServices

_log = logging.getLogger(__name__)

_SHOWN = (MAP, MAP3D, CURRENT, LOCATION, OBJECT, AREA, PATH, BEHAVIOR)


class Map2DServer(Module):
    """Serves the store's maps."""

    name = "map2d_server"

    @override
    def start(self, host: Host, section: Section) -> None:
        assert isinstance(section, Map2DServerSection)
        self._host, self._store = host, host.store
        self._changed: set[tuple[str, str]] = set()
        self._lock = threading.Lock()
        self._refused, self._last_refused = 0, ""
        imported = host.config.store
        files = MapFiles(
            MapsFolder(section.folder or host.folder / "maps"), self._store, imported.maps, imported.locations
        )
        node, head = host.node, Head(section.frame, host.clock.now_ns)
        self._current = CurrentMap(node, self._store, head, section.current)
        self._maps = AllMaps(node, self._store, head)
        self._maps3d = Maps3D(node, self._store, head)
        self._masks = Masks(node, self._store, head)
        self._markers = Markers(node, self._store, section.frame)
        self._intakes = [MapIntake(host, rule, self._store, self._refuse) for rule in section.take]
        self._others: list[str] = []
        self._closing = [self._store.watch(self._on_change, *_SHOWN), node.hub.graph.watch(self._graph_changed)]
        self._graph_due = False
        self._check_publishers()
        every = {(kind.name, name) for kind in (MAP, MAP3D) for name in self._store.names(kind)}
        self._refresh(every | {(CURRENT.name, "map")})
        MapServices(node, self._store, files, self._current, self._maps, self._refuse)
        if section.clicked_point:
            ClickedPoints(
                host, section.clicked_point, section.frame, self._store, lambda: self._current.name, self._refuse
            )
        answers = MapAnswers(self._store, files, self._refuse)
        for port in section.ports:
            host.yarp.serve(port, answers)
        if section.command_port:
            host.yarp.respond(section.command_port, MapCommands(self._store, self._current).answer)

    @override
    def health(self) -> Health:
        state = f"map {self._current.name}" if self._current.name else "no current map"
        if self._others:
            state += f"; {MAP_TOPIC} is published by {', '.join(self._others)}, not by this module"
        return Health("running", state)

    @override
    def status(self) -> MapServerKeys:
        return MapServerKeys(
            current=self._current.name,
            maps=self._maps.topics,
            maps3d=self._maps3d.topics,
            taken={intake.topic: intake.taken for intake in self._intakes},
            refusals=self._refused,
            last_refusal=self._last_refused,
        )

    @override
    def warnings(self) -> Iterable[str]:
        return self._masks.areas.troubles

    @override
    def stop(self) -> None:
        for close in self._closing:
            close()

    def _on_change(self, change: Change) -> None:
        """Schedule an update after a change here or elsewhere; runs on the store's thread."""
        with self._lock:
            first = not self._changed
            self._changed.add((change.kind, change.name))
        if first:
            self._host.loop.post(self._settle)

    def _settle(self) -> None:
        """Publish all changes since the last update."""
        with self._lock:
            changed, self._changed = self._changed, set()
        self._refresh(changed)

    def _refresh(self, changed: Keys) -> None:
        self._try(self._show_current, changed)
        for key in sorted(changed):  # one by one, so that a map that cannot be published does not keep others back
            self._try(self._maps.update, {key})
            self._try(self._maps3d.update, {key})

    def _try(self, show: Callable[[Keys], object], changed: Keys) -> None:
        try:
            show(changed)
        except (StoreError, ValueError) as error:
            self._refuse(str(error))

    def _show_current(self, changed: Keys) -> None:
        map_changed = self._current.update(changed)
        self._masks.update(self._current, changed, map_changed=map_changed)
        self._markers.update(self._current, self._masks.areas, changed, map_changed=map_changed)

    def _graph_changed(self) -> None:
        """Schedule a check of the map's publishers; runs on a zenoh thread."""
        if not self._graph_due:
            self._graph_due = True
            self._host.loop.post(self._check_publishers)

    def _check_publishers(self) -> None:
        """Stop publishing the current map if another program publishes one."""
        self._graph_due = False
        others = [end for end in self._host.node.hub.graph.publishers(MAP_TOPIC) if not is_ours(end)]
        self._others = sorted({owner(end) for end in others})
        self._current.mute(bool(others))
        for intake in self._intakes:
            intake.follow_graph()

    def _refuse(self, reason: str) -> None:
        """Count and log a refused call, file or message."""
        with self._lock:
            self._refused, again = self._refused + 1, reason == self._last_refused
            self._last_refused = reason
        _log.log(logging.DEBUG if again else logging.WARNING, "refused: %s", reason)
