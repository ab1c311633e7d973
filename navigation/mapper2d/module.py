"""The module Mapper2D: builds a map from scans, for every side and for the store."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from typing_extensions import override

from bridge.config.sections.section import Section
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.scan import LaserScan
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.modules.services import Answer
from bridge.status import Part
from bridge.worker import Health
from navigation.frames import FramesError
from navigation.ini import laid_under
from navigation.map2d_server.files import MapsFolder
from navigation.mapper2d.commands import Canvas, MapperCommands
from navigation.mapper2d.mapper import Mapper
from navigation.mapper2d.poses import COVARIANT, Poses, of_message, sent_ns
from navigation.mapper2d.section import Mapper2DSection
from navigation.mapper2d.settings import read_file
from navigation.mapper2d.source import make_source
from navigation.maps.grid import to_cdr, to_grid
from navigation.messages import GRID, stamp_ns
from navigation.pose import Pose, check_rotation
from navigation.scan import SCAN, ScanError, of_ros, of_yarp
from navigation.sensor_queue import SensorQueue
from navigation.yarp import PortConnection
from yarp_compat.dev.rangefinder import LaserScan2D
from yarp_compat.pythonic import Received
from yarp_compat.wire.errors import WireError

GET_MAP = "nav_msgs/srv/GetMap"
SAVE_MAP = "slam_toolbox/srv/SaveMap"

_SAVED, _NO_MAP, _NOT_SAVED = 0, 1, 255  # RESULT_SUCCESS, RESULT_NO_MAP_RECEIEVD, RESULT_UNDEFINED_FAILURE

_WAITING = 20  # scans that may wait for their poses
_BEAT = 0.05  # seconds between two calls of `Mapper2D._work`
_SILENT_NS = 2_000_000_000  # time without a scan, after which the laser counts as silent


class _Scan(NamedTuple):
    """A scan, with the frame of its laser."""

    frame: str
    laser_scan: LaserScan


class Mapper2D(Module):
    """Builds a map while the robot is driven."""

    name = "mapper2d"

    @override
    def start(self, host: Host, section: Section) -> None:
        assert isinstance(section, Mapper2DSection)
        self._section, self._notes = laid_under(section, section.ini, read_file)
        section = self._section
        for note in self._notes:
            host.log.warning("%s", note)
        self._host = host
        self.mapper = Mapper(section)
        self.mapper.mapping = section.mapping
        self._scans: SensorQueue[_Scan] = SensorQueue(
            self._map_scan, limit=_WAITING, what="scan", clock=host.clock, log=host.log
        )
        self._changed = True
        self._poses = Poses(host, section)
        self.source = make_source(host, section, self.mapper, self._poses)
        self._canvas = Canvas(self.mapper)
        folder = MapsFolder(section.folder or host.folder / "maps")
        self._commands = MapperCommands(self.mapper, self._canvas, self.source, lambda: host.store, folder)
        if section.scan:
            host.node.subscription(section.scan, SCAN, self._on_scan, Qos(depth=5))
        self._map = host.node.publisher(section.topic, GRID, LATCHED, priority="state") if section.topic else None
        if section.initial_pose:
            host.node.subscription(section.initial_pose, COVARIANT, self._on_initial_pose)
        self._offer(host, section.prefix)
        host.on_jump(self._scans.clear)
        host.every(_BEAT, self._work)
        host.every(section.period, self._publish)

    def _offer(self, host: Host, prefix: str) -> None:
        host.yarp.respond(f"{prefix}/rpc", lambda values: host.loop.call(lambda: self._answer(values)))
        self._picture = host.yarp.output(f"{prefix}/map:o", "yarp/image")
        host.yarp.input(f"{prefix}/yarpviewTarget:i", self._click)
        port = f"{prefix}/laser:i"
        host.yarp.input(port, self._on_yarp_scan)
        pairs = [(self._section.laser_port, port)]
        if self._section.pose == "port":
            pairs.append((self._section.pose_port, f"{prefix}/odometry:i"))
        self._connected = [PortConnection(host.yarp.naming, source, target) for source, target in pairs if source]
        self._commands.serve(host, self.name)
        host.node.server("/dynamic_map", GET_MAP, self._answer_map)
        host.node.server("/slam_toolbox/save_map", SAVE_MAP, self._save_map)

    def _on_initial_pose(self, message: dict[str, Any]) -> None:
        """Accept the robot's pose from a topic."""
        frame, place = message["header"]["frame_id"].lstrip("/"), Pose(*of_message(message))
        if frame not in ("", self._section.map_frame.lstrip("/")) or not all(map(math.isfinite, place[:3])):
            self._host.log.warning("%s: ignored pose %s in the frame %r", self._section.initial_pose, place[:3], frame)
            return
        try:
            check_rotation(message["pose"]["pose"]["orientation"], "the pose's")
        except ValueError as err:
            self._host.log.warning("%s: ignored: %s", self._section.initial_pose, err)
        else:
            self.source.locate(place)

    def _on_scan(self, message: dict[str, Any]) -> None:
        header = message["header"]
        self._scans.received_ns = now = self._host.clock.now_ns()
        try:
            scan = _Scan(header["frame_id"], of_ros(message, stamp_ns(header) or now))
        except ScanError as err:
            self._scans.drop(str(err))
        else:
            self._add(scan)

    def _on_yarp_scan(self, received: Received) -> None:
        """Handle a scan; runs on the connection's thread."""
        try:
            laser_scan = of_yarp(received.to(LaserScan2D), sent_ns(received.envelope) or self._host.clock.now_ns())
        except ScanError as err:
            raise WireError(str(err)) from None
        self._host.loop.call(lambda: self._add(_Scan("", laser_scan)))

    def _add(self, scan: _Scan) -> None:
        self._scans.received_ns = self._host.clock.now_ns()
        if self.mapper.mapping or self._section.slam:
            self._scans.add(scan)

    def _map_scan(self, scan: _Scan) -> None:
        """Add a scan to the map; raises `FramesError` while its pose is not known."""
        laser_scan = scan.laser_scan
        if self._poses.is_upside_down(scan.frame):
            laser_scan = laser_scan.turned_over()
        self._changed |= self.source.add(scan.frame, laser_scan)

    def _work(self) -> None:
        self._scans.work()
        self._changed |= self.source.work()

    def _publish(self) -> None:
        """Publish the map if it has changed, and send its picture."""
        if self._changed and self._map is not None:
            self._map.publish_cdr(bytes(to_cdr(self.mapper.grid(), self._section.map_frame, self._host.clock.now_ns())))
        self._changed = False
        if self._picture.has_readers:
            try:
                robot: Pose | None = self.source.robot()
            except FramesError:
                robot = None
            self._picture.write(self._canvas.picture(robot))

    def _answer_map(self, _request: dict[str, Any], answer: Answer) -> None:
        """Respond with the current map, as slam_toolbox and gmapping do."""
        grid = to_grid(self.mapper.grid(), self._section.map_frame, self._host.clock.now_ns())
        answer({"map": grid})

    def _save_map(self, request: dict[str, Any], answer: Answer) -> None:
        """Save the map in ROS's format in the maps folder; slam_toolbox saves in its working directory."""
        if self.mapper.empty:
            answer({"result": _NO_MAP})
            return
        try:
            self._commands.save_file(str(request["name"]["data"]) or self.mapper.name, ".yaml", ".yml")
        except (OSError, ValueError) as err:
            self._host.log.warning("/slam_toolbox/save_map: the map is not saved: %s", err)
            answer({"result": _NOT_SAVED})
        else:
            answer({"result": _SAVED})

    def _answer(self, values: list[Any]) -> list[Any]:
        answer = self._commands.answer(values)
        self._changed = True
        return answer

    def _click(self, received: Received) -> None:
        """Paint at a click on the picture; runs on the connection's thread."""
        values = received.values

        def paint() -> None:
            self._canvas.click(values)
            self._changed = True

        try:
            self._host.loop.call(paint)
        except ValueError as err:
            raise WireError(str(err)) from None  # the port counts and logs it

    @override
    def health(self) -> Health:
        if not self.mapper.mapping:
            return Health("running", "stopped; 'start' continues mapping")
        received = self._scans.received_ns
        if received is None or not 0 <= self._host.clock.now_ns() - received <= _SILENT_NS:
            troubles = [connection.trouble for connection in self._connected if connection.trouble]
            sources = [self._section.scan, f"{self._section.prefix}/laser:i"]
            names = " or ".join(sources[not sources[0] :])
            return Health("waiting", "; ".join((f"no scans on {names}", *troubles)))
        if self._scans.trouble:
            return Health("waiting", self._scans.trouble)
        if self.source.trouble:
            return Health("running", self.source.trouble)
        width, height = self.mapper.size
        full = "; the map has reached its largest size (modules.mapper2d.largest)" if self.mapper.full else ""
        return Health("running", f"map {self.mapper.name}: {width:g} x {height:g} m{full}")

    @override
    def status(self) -> Part:
        return Part(
            map=self.mapper.name,
            mapping=self.mapper.mapping,
            size=list(self.mapper.size),
            scans=self.mapper.scans,
            dropped=self._scans.dropped,
            trouble=self._scans.trouble,
            connections=[connection.trouble for connection in self._connected if connection.trouble],
            notes=list(self._notes),
            **self.source.status().document(),
        )

    @override
    def stop(self) -> None:
        for connection in self._connected:
            connection.close()
