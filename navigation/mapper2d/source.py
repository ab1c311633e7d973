"""The sources of the scans' poses: a pose from elsewhere, or scan matching."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from typing_extensions import override

from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.scan import LaserScan
from bridge.modules.host import Host
from bridge.status import Part
from bridge.tf.stamped import TF, TF_TYPE, Stamped, write
from navigation.algorithms.submaps import Scan
from navigation.frames import STATUS, FramesError
from navigation.mapper2d import graph_file
from navigation.mapper2d.drawn import DrawnMap
from navigation.mapper2d.mapper import Mapper
from navigation.mapper2d.poses import Poses
from navigation.mapper2d.section import Mapper2DSection
from navigation.messages import STRING
from navigation.pose import Pose
from navigation.scan import clean_ranges
from yarp_compat.dev.mapgrid import MapGrid2D

_LOST = 10  # after this many scans in a row without a match, the pose counts as lost


class PoseSource(ABC):
    """Adds scans to the map at their poses. Used only on the module's thread."""

    def __init__(self, mapper: Mapper, poses: Poses) -> None:
        self._mapper, self._poses = mapper, poses

    @abstractmethod
    def add(self, frame: str, laser_scan: LaserScan) -> bool:
        """Add a scan of the laser in a frame; return whether the map changed.

        Raises `FramesError` while the pose is not known, `ValueError` for an invalid pose.
        """

    @abstractmethod
    def robot(self) -> Pose:
        """Return the robot's current pose on the map; raises `FramesError`."""

    @abstractmethod
    def locate(self, pose: Pose) -> None:
        """Set the robot's current pose on the map."""

    @abstractmethod
    def clear(self) -> None:
        """Start a new map."""

    @abstractmethod
    def load(self, grid: MapGrid2D, graph: Path) -> None:
        """Continue a map, whose graph is in a file; raises `ValueError` or `OSError` if this is not possible."""

    @abstractmethod
    def saving(self, graph: Path) -> AbstractContextManager[None]:
        """Save the scans and the graph of a map, which the body saves; see `graph_file.replacing`."""

    def grid(self) -> MapGrid2D:
        """Return the map for saving, completely drawn."""
        return self._mapper.grid()

    def work(self) -> bool:
        """Do periodic work; return whether the map changed."""
        return False

    @property
    def trouble(self) -> str:
        """Why poses are missing or wrong; "" if they are not."""
        return ""

    def status(self) -> Part:
        """Return entries for the module's status."""
        return Part()


class GivenPoses(PoseSource):
    """Adds scans at poses from ``/tf``, a topic or a port."""

    @override
    def add(self, frame: str, laser_scan: LaserScan) -> bool:
        pose = self._poses.laser(frame, laser_scan.time_ns)
        return self._mapper.scan(pose, clean_ranges(laser_scan), laser_scan.first, laser_scan.step, laser_scan.farthest)

    @override
    def robot(self) -> Pose:
        return self._poses.robot()

    @override
    def locate(self, pose: Pose) -> None:
        self._poses.set(pose)

    @override
    def clear(self) -> None:
        self._mapper.clear()

    @override
    def load(self, grid: MapGrid2D, graph: Path) -> None:
        self._mapper.load(grid)

    @override
    def saving(self, graph: Path) -> AbstractContextManager[None]:
        return graph_file.replacing(graph, None)  # removes the graph of an earlier map with this name


class MatchedPoses(PoseSource):
    """Adds scans at the poses at which they match earlier scans; publishes the odometry frame's pose on the map."""

    def __init__(self, host: Host, section: Mapper2DSection, mapper: Mapper, poses: Poses) -> None:
        super().__init__(mapper, poses)
        self._host, self._section = host, section
        self.drawn = DrawnMap(mapper, host.background.submit)
        self._mount = Pose(0.0, 0.0, 0.0)
        self._start: Pose | None = None  # the robot's pose that was set, until the next scan
        self._begun: Pose | None = None  # the odometry frame's pose on a map that has no scans yet, if known
        self._localizer = ""  # the status of a localizer
        self._stamp_ns = 0  # the stamp of the last transform
        self._tf = host.node.publisher(TF, TF_TYPE, Qos(depth=100)) if section.publish_tf else None
        if self._tf is not None:
            host.node.subscription(STATUS, STRING, self._on_localizer, LATCHED)

    def _on_localizer(self, message: dict[str, Any]) -> None:
        self._localizer = message["data"]

    @override
    def add(self, frame: str, laser_scan: LaserScan) -> bool:
        self._mount = self._poses.mount(frame)
        odometry = self._poses.odometry(laser_scan.time_ns) @ self._mount
        if not all(map(math.isfinite, odometry[:3])):
            raise ValueError(f"the odometry must be finite, not {odometry[:3]}")
        if self.drawn.slam.track is None:
            self._begin(odometry)
        farthest = min(laser_scan.farthest, self._section.farthest)
        scan = Scan(clean_ranges(laser_scan), laser_scan.first, laser_scan.step, farthest)
        return self.drawn.scan(odometry._replace(stamp_ns=laser_scan.time_ns), scan)

    def _begin(self, odometry: Pose) -> None:
        """Set the laser's pose before the first scan of a map: from the pose that was set, else from the odometry.

        On a loaded map, the odometry alone does not show the pose. While mapping is stopped, the robot may drive on.
        """
        start, self._start = self._start, None
        if start is not None:
            self._begun = start @ self._mount @ odometry.inverse
        if self._begun is not None:
            self.drawn.locate(self._begun @ odometry)
        elif self.drawn.slam.unsure is None:
            self.drawn.locate(odometry)

    @override
    def robot(self) -> Pose:
        return self._correction() @ self._poses.odometry()

    def _correction(self) -> Pose:
        correction = self.drawn.slam.correction
        if correction is None:
            raise FramesError("the robot's pose on the map is not known yet")
        return correction

    @override
    def locate(self, pose: Pose) -> None:
        if self.drawn.slam.track is None:
            self._start = pose
        else:
            self.drawn.locate(pose @ self._mount)

    @override
    def clear(self) -> None:
        self._begun = self.drawn.slam.correction or self._begun
        self.drawn.clear()

    @override
    def load(self, grid: MapGrid2D, graph: Path) -> None:
        if not graph.is_file():
            raise ValueError(
                f"the map {grid.name} was saved without its scans, so that mapping by scans cannot continue it:"
                " set modules.mapper2d.pose to tf, topic or port, and provide the pose, for example from a localizer"
            )
        self.drawn.load(grid, graph)
        self._begun = None

    @override
    def saving(self, graph: Path) -> AbstractContextManager[None]:
        return graph_file.replacing(graph, self.drawn.saved())

    @override
    def grid(self) -> MapGrid2D:
        self.drawn.finish()
        return super().grid()

    @override
    def work(self) -> bool:
        if self._tf is not None and not self._localized:
            self._publish_correction()
        return self.drawn.work()

    def _publish_correction(self) -> None:
        correction = self.drawn.slam.correction
        if correction is None or self._tf is None:
            return
        section, half = self._section, 0.5 * correction.theta
        stamp = self._host.clock.now_ns() + round(section.tf_tolerance * 1e9)
        if stamp == self._stamp_ns:
            return  # two beats at the same simulated time
        self._stamp_ns = stamp
        names = section.map_frame.lstrip("/"), section.odom_frame.lstrip("/")
        place, turned = (correction.x, correction.y, 0.0), (0.0, 0.0, math.sin(half), math.cos(half))
        self._tf.publish_cdr(write([Stamped(*names, stamp, place, turned)]))

    @property
    def _localized(self) -> bool:
        """Whether another program localizes the robot, so that a second transform would contradict it."""
        return self._localizer == "localized_ok" or self._poses.corrected

    @property
    @override
    def trouble(self) -> str:
        slam, failed = self.drawn.slam, self._host.background.trouble
        if failed:
            return f"the search for loops failed ({failed}): the map may be bent; see the log of Mapper2D"
        if self._tf is not None and self._localized:
            return (
                "a localizer publishes the transform from map to odometry, on its own map: stop it, or set"
                " modules.mapper2d.pose to tf to map with its poses"
            )
        if slam.unsure is not None:
            return "searching for the robot's place on the loaded map: drive, or set the pose with initLoc"
        if slam.track is not None and slam.track.lost >= _LOST:
            return "the scans do not match the map: the pose follows the odometry"
        if slam.full:
            return "the map has reached its largest number of scans: save it, and start another with clear"
        return ""

    @override
    def status(self) -> Part:
        submaps, loops = self.drawn.slam.submaps, self.drawn.slam.loops
        return Part(
            submaps=len(submaps.graph.poses),
            views=len(submaps.views),
            closures=loops.closed,
            refused_closures=loops.refused,
        )


def make_source(host: Host, section: Mapper2DSection, mapper: Mapper, poses: Poses) -> PoseSource:
    """Return the source that a section selects."""
    return MatchedPoses(host, section, mapper, poses) if section.slam else GivenPoses(mapper, poses)
