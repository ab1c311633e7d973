"""The module Mapper3D: clouds and depth images of the hub become an octree, and a layer for planners."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bridge.config.sections.mapper3d import Mapper3DSection
from bridge.config.sections.section import Section
from bridge.hub.errors import HubError
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.modules.services import Answer
from bridge.stores.entry import StoreError
from bridge.worker import Health
from navigation.algorithms.voxel_layer import EDGE, FLOOR, LayerColumns
from navigation.frames import FramesError
from navigation.map2d_server.files import MapsFolder
from navigation.mapper3d.commands import SpaceCommands
from navigation.mapper3d.layer import LayerPublisher, grid_of
from navigation.mapper3d.octomaps import OctomapServer
from navigation.mapper3d.sources import Seats, Seen, Sources
from navigation.mapper3d.space import Seat, Space
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.octomap import Octomap
from yarp_compat.wire.errors import WireError

TRIGGER = "std_srvs/srv/Trigger"
_BEAT = 0.05
_KEEP = 60.0  # seconds: who stops has a second, and a large map needs more
_SILENT_NS = 2_000_000_000
_DROPS = 4  # times as many columns that drop as there are with a floor: it is looked for at a wrong height


class Mapper3D(Module):
    """Maps space while the robot is driven about."""

    name = "mapper3d"

    def start(self, host: Host, section: Section) -> None:
        """Open what the section names, and begin to map."""
        assert isinstance(section, Mapper3DSection)
        self._host, self._section = host, section
        self.space = Space(section)
        self._began = host.clock.elapsed_ns()
        self._kept, self._kept_clouds = host.folder / "map.ot", 0
        folder = MapsFolder(section.folder or host.folder / "maps")
        self._words = SpaceCommands(
            self.space, self._grid, lambda: host.store, folder, section.map_name, mapping=section.mapping
        )
        self._trouble = self._take_up()
        self._layer_changed = self._map_changed = True
        self._floorless = ""
        self._seats = Seats(host, section)
        self._layer = LayerPublisher(host, section) if section.layer.topic else None
        self._octomaps = OctomapServer(host, section, self.space) if section.octomap else None
        self._sources = Sources(host, section, self._seats, self._take)
        host.yarp.respond(f"{section.prefix}/rpc", lambda values: host.loop.call(lambda: self._asked(values)))
        for word, done in (("start", "mapping"), ("stop", "not mapping")):
            host.node.server(f"/{self.name}/{word}", TRIGGER, self._trigger(word, done))
        host.node.server(f"/{self.name}/save", TRIGGER, self._save)
        host.on_jump(self._sources.forget)
        host.every(_BEAT, self._sources.work)
        host.every(section.layer.period, self._tell_layer)
        host.every(section.period, self._tell_map)
        host.every(_KEEP, self._keep)

    def _take(self, seen: Seen, seat: Seat) -> None:
        if self._words.mapping:
            self.space.take(seen.points, seat, seen.view, (self._host.clock.elapsed_ns() - self._began) / 1e9)
            self._layer_changed = self._map_changed = True

    def _take_up(self) -> str:
        """Continue with the saved map, else with that of the store; return why that failed, else ""."""
        section, where = self._section, "modules.mapper3d.load"
        try:
            if section.keep and self._kept.is_file():
                where = str(self._kept)
                self.space.load(Octomap.load(self._kept).tree())
            elif section.load:
                self._words.load(section.load)
        except (OSError, WireError, StoreError, HubError, ValueError) as err:
            trouble = f"the map is not gone on with: {where}: {err}"
            self._host.log.warning("%s", trouble)
            return trouble
        return ""

    def _grid(self) -> MapGrid2D:
        """The layer about the robot; raises as `_columns`."""
        return grid_of(self._columns(), self._section.layer.name, self._section.resolution)

    def _columns(self) -> LayerColumns:
        """The columns around the robot; raises `ValueError` if its pose is unknown."""
        try:
            base = self._seats.base()
        except FramesError as err:
            raise ValueError(str(err)) from None
        section, found = self._section, self.space.layer(base)
        edges, floors = (np.count_nonzero(found.kinds == kind) for kind in (EDGE, FLOOR))
        self._floorless = (
            f"no floor at the height of {section.base_frame}, but drops all around: set modules.mapper3d.floor"
            if edges > _DROPS * floors
            else ""
        )
        return found

    def _tell_layer(self) -> None:
        if self._layer is None or not self._layer_changed:
            return
        try:
            self._layer.tell(self._columns())
        except ValueError:  # it is known again as soon as clouds are taken
            return
        self._layer_changed = False

    def _tell_map(self) -> None:
        if self._octomaps is not None:
            self._octomaps.tell(changed=self._map_changed)
        self._map_changed = False

    def _asked(self, values: list[Any]) -> list[Any]:
        answer = self._words.answer(values)
        self._layer_changed = self._map_changed = True
        return answer

    def _trigger(self, word: str, done: str) -> Callable[[dict[str, Any], Answer], None]:
        def serve(_request: dict[str, Any], answer: Answer) -> None:
            self._words.answer([word])
            answer({"success": True, "message": done})

        return serve

    def _save(self, _request: dict[str, Any], answer: Answer) -> None:
        try:
            answer({"success": True, "message": self._words.save()})
        except (StoreError, ValueError) as err:
            answer({"success": False, "message": str(err)})

    def health(self) -> Health:
        """Whether it maps, and what of."""
        if not self._words.mapping:
            return Health("running", "stopped: it takes no clouds until 'start'")
        heard, section = self._sources.heard, self._section
        if heard is None or not 0 <= self._host.clock.now_ns() - heard <= _SILENT_NS:
            topics = [*section.clouds, *(source.image for source in section.depth)]
            return Health("waiting", f"no message on {', '.join(topics)}" if topics else "no clouds, no depth: set one")
        trouble = self._sources.trouble or self._trouble or self._floorless
        if trouble:
            return Health("waiting", trouble)
        voxels = self.space.voxels
        full = "; it is full (memory), and takes nothing new" if voxels.full and section.when_full == "stop" else ""
        return Health("running", f"map {section.map_name}: {voxels.megabytes:.0f} MB{full}")

    def status(self) -> dict[str, Any]:
        """The map, and what was left out."""
        space, sources = self.space, self._sources
        return {
            "map": self._section.map_name, "mapping": self._words.mapping, "clouds": space.clouds,
            "blocks": space.voxels.count, "megabytes": space.voxels.megabytes, "full": space.voxels.full,
            "forgotten": space.forgotten, "given_up": space.given_up, "dropped": sources.dropped,
            "trouble": sources.trouble or self._trouble,
        }  # fmt: skip

    def stop(self) -> None:
        """Keep the map, if it is to be."""
        self._keep()

    def _keep(self) -> None:
        """Write the map into the state folder, if it is to be and it changed since; whole or not at all."""
        if self._section.keep and self.space.clouds != self._kept_clouds:
            self._kept_clouds = self.space.clouds
            part = self._kept.with_name("part.ot")
            try:
                Octomap.of(self.space.tree()).save(part)
                part.replace(self._kept)
            except (OSError, WireError) as err:
                self._trouble = f"the map is not kept: {err}"
                self._host.log.warning("%s", self._trouble)
