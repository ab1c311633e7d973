"""The module Mapper3D: builds an octree from clouds and depth images, and a layer for planners."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from bridge.config.sections.section import Section
from bridge.hub.errors import HubError
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.status import Part
from bridge.stores.entry import StoreError
from bridge.worker import Health
from navigation.algorithms.voxel_layer import EDGE, FLOOR, LayerColumns
from navigation.frames import FramesError
from navigation.map2d_server.files import MapsFolder
from navigation.mapper3d.commands import SpaceCommands
from navigation.mapper3d.layer import LayerPublisher, grid_of
from navigation.mapper3d.octomaps import OctomapServer
from navigation.mapper3d.section import Mapper3DSection
from navigation.mapper3d.sources import SensorPoses, SensorReading, Sources
from navigation.mapper3d.space import SensorPose, Space
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.octomap import Octomap
from yarp_compat.wire.errors import WireError

_BEAT = 0.05  # seconds between two attempts to use waiting clouds
_SAVE_PERIOD = 60.0  # seconds; a module has one second to stop, and saving a large map may take longer
_SILENT_NS = 2_000_000_000  # time without a message, after which the sensors count as silent
_DROPS = 4  # this many times more drops than floor columns mean that the floor's height is wrong


class Mapper3D(Module):
    """Builds a 3D map while the robot drives."""

    name = "mapper3d"

    @override
    def start(self, host: Host, section: Section) -> None:
        assert isinstance(section, Mapper3DSection)
        self._host, self._section = host, section
        self.space = Space(section)
        self._began = host.clock.elapsed_ns()
        self._state_file, self._refused = host.folder / "map.ot", False
        folder = MapsFolder(section.folder or host.folder / "maps")
        self._commands = SpaceCommands(
            self.space, self._grid, lambda: host.store, folder, section.map_name, mapping=section.mapping
        )
        self._trouble, self._unsaved = self._load(), ""
        # the changes of the map that are saved and published; -1 for none
        self._saved, self._layer_shown, self._map_shown = self.space.changes, -1, -1
        self._floorless = ""
        self._poses = SensorPoses(host, section)
        self._layer = LayerPublisher(host, section) if section.layer.topic else None
        self._octomaps = OctomapServer(host, section, self.space) if section.octomap else None
        self._queue = Sources(host, section, self._poses, self._add).queue
        host.yarp.respond(f"{section.prefix}/rpc", lambda values: host.loop.call(lambda: self._commands.answer(values)))
        self._commands.serve(host, self.name)
        host.on_jump(self._queue.clear)
        host.every(_BEAT, self._queue.work)
        host.every(section.layer.period, self._publish_layer)
        host.every(section.period, self._publish_map)
        host.every(_SAVE_PERIOD, self._save_state)

    def _add(self, reading: SensorReading, pose: SensorPose) -> None:
        if self._commands.mapping:
            now = (self._host.clock.elapsed_ns() - self._began) / 1e9
            self.space.add(reading.points, pose, reading.view, now)

    def _load(self) -> str:
        """Continue the saved map, or else the map of the store; return why that failed, or ""."""
        section, source = self._section, "modules.mapper3d.load"
        try:
            if section.keep and self._state_file.is_file():
                source = str(self._state_file)
                self.space.load(Octomap.load(self._state_file).tree())
            elif section.load:
                self._commands.load(section.load)
        except (OSError, WireError, StoreError, HubError, ValueError) as err:
            self._refused = source == str(self._state_file)
            trouble = f"cannot continue the map: {source}: {err}"
            self._host.log.warning("%s", trouble)
            return trouble
        return ""

    def _grid(self) -> MapGrid2D:
        """Return the layer around the robot; raises `ValueError` if its pose is unknown."""
        return grid_of(self._columns(), self._section.layer.name, self._section.resolution)

    def _columns(self) -> LayerColumns:
        """Return the columns around the robot; raises `ValueError` if its pose is unknown."""
        try:
            base = self._poses.base()
        except FramesError as err:
            raise ValueError(str(err)) from None
        section, layer = self._section, self.space.layer(base)
        edges, floors = (np.count_nonzero(layer.kinds == kind) for kind in (EDGE, FLOOR))
        self._floorless = (
            f"drops all around instead of a floor at the height of {section.base_frame}: set modules.mapper3d.floor"
            if edges > _DROPS * floors
            else ""
        )
        return layer

    def _publish_layer(self) -> None:
        changes = self.space.changes
        if self._layer is None or self._layer_shown == changes:
            return
        try:
            self._layer.publish(self._columns())
        except ValueError:  # try again: clouds are only used while the pose is known
            return
        self._layer_shown = changes

    def _publish_map(self) -> None:
        shown, self._map_shown = self._map_shown, self.space.changes
        if self._octomaps is not None:
            self._octomaps.publish(changed=shown != self._map_shown)

    @override
    def health(self) -> Health:
        if not self._commands.mapping:
            return Health("running", "stopped; 'start' continues mapping")
        received, section = self._queue.received_ns, self._section
        if received is None or not 0 <= self._host.clock.now_ns() - received <= _SILENT_NS:
            topics = [*section.clouds, *(source.image for source in section.depth)]
            reason = f"no messages on {', '.join(topics)}" if topics else "no source: set clouds or depth"
            return Health("waiting", reason)
        trouble = self._queue.trouble or self._unsaved or self._trouble or self._floorless
        if trouble:
            return Health("waiting", trouble)
        voxels = self.space.voxels
        full = (
            "; the map is full (modules.mapper3d.memory) and adds nothing new"
            if voxels.full and section.when_full == "stop"
            else ""
        )
        return Health("running", f"map {section.map_name}: {voxels.megabytes:.0f} MB{full}")

    @override
    def status(self) -> Part:
        space, queue = self.space, self._queue
        return Part(
            map=self._section.map_name, mapping=self._commands.mapping, clouds=space.clouds,
            blocks=space.voxels.count, megabytes=space.voxels.megabytes, full=space.voxels.full,
            forgotten=space.forgotten, given_up=space.given_up, dropped=queue.dropped,
            trouble=queue.trouble or self._unsaved or self._trouble,
        )  # fmt: skip

    @override
    def stop(self) -> None:
        self._save_state()

    def _save_state(self) -> None:
        """Save the map in the state folder, atomically, if the section asks for it and it has changed.

        A file that could not be loaded is kept as ``map.refused.ot``, unless there is such a file already.
        """
        changes = self.space.changes
        if not self._section.keep or changes == self._saved:
            return
        part, refused = (self._state_file.with_name(name) for name in ("part.ot", "map.refused.ot"))
        try:
            Octomap.of(self.space.tree()).save(part)
            if self._refused and not refused.exists():
                self._state_file.replace(refused)
            part.replace(self._state_file)
        except (OSError, WireError) as err:
            trouble = f"cannot save the map: {err}"
            if trouble != self._unsaved:
                self._host.log.warning("%s", trouble)
            self._unsaved = trouble
        else:
            self._saved, self._refused, self._unsaved = changes, False, ""
