"""A map from drifting odometry: the poses of `Slam`, drawn by `Mapper`, without a thread or a clock."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from navigation.algorithms.slam import RunSearch, Slam, at_once
from navigation.algorithms.submaps import Scan
from navigation.mapper2d import graph_file
from navigation.mapper2d.graph_file import SavedGraph
from navigation.mapper2d.mapper import Mapper
from navigation.pose import Pose
from yarp_compat.dev.mapgrid import MapGrid2D

ROUGHLY = 1.0, math.radians(30.0)
"""Meters and radians by which a pose that a person gives may be wrong."""

_MOVED, _TURNED = 0.02, math.radians(0.1)  # motion of a submap after which the map is drawn again
_PATIENCE = 20  # the map is drawn again after at least one scan for this many views on it
_SLICE = 100  # views that are drawn at a time
_EVERY_NS = 500_000_000  # time between scans that are drawn without becoming part of the map


@dataclass
class Drawing:
    """A drawing of the whole map in progress.

    Attributes:
        mapper: the mapper that has drawn the views so far.
        poses: the submaps' poses when the drawing began.
        count: the number of views drawn.
    """

    mapper: Mapper
    poses: list[Pose]
    count: int = 0


@dataclass
class DrawnMap:
    """Keeps the drawn map up to date with the poses of its scans.

    Attributes:
        mapper: draws the map.
        run: runs the searches for loops.
        slam: the poses.
    """

    mapper: Mapper
    run: RunSearch = at_once
    slam: Slam = field(init=False)
    _poses: list[Pose] = field(default_factory=list)  # the submaps' poses as drawn
    _drawing: Drawing | None = None
    _scans: int = 0  # scans since the last drawing
    _drawn_ns: int = 0  # the time of the last scan that was drawn

    def __post_init__(self) -> None:
        self.slam = Slam(run=self.run)

    def scan(self, odometry: Pose, scan: Scan) -> bool:
        """Add a scan at the laser's pose in the odometry frame; return whether the map changed."""
        slam, mapper = self.slam, self.mapper
        view = slam.add(odometry, scan, mapping=mapper.mapping)
        self._scans += 1
        if slam.correction is None or not mapper.mapping:
            return False
        if view is None and not 0 <= self._drawn_ns <= odometry.stamp_ns - _EVERY_NS:
            return False
        self._drawn_ns = odometry.stamp_ns
        poses = slam.submaps.graph.poses
        if not self._poses and len(poses) > 2:
            self.draw_again()  # the trajectory has just been joined to a loaded map
        self._poses += poses[len(self._poses) :]
        mapper.scan(slam.pose, scan.ranges, scan.first, scan.step, scan.farthest)
        mapper.full = mapper.full or slam.full
        if self._drawing is None and self._scans * _PATIENCE > len(slam.submaps.views) and self._is_outdated():
            self.draw_again()
        return True

    def _is_outdated(self) -> bool:
        return any(
            drawn.distance(pose) > _MOVED or abs(math.remainder(drawn.theta - pose.theta, math.tau)) > _TURNED
            for drawn, pose in zip(self._poses, self.slam.submaps.graph.poses, strict=False)
        )

    def draw_again(self) -> None:
        """Start drawing the whole map again; `work` continues that."""
        self._drawing = Drawing(self.mapper.blank(), list(self.slam.submaps.graph.poses))

    def work(self) -> bool:
        """Continue the drawing; return whether the map changed."""
        drawing = self._drawing
        if drawing is None:
            return False
        submaps = self.slam.submaps
        for view in submaps.views[drawing.count : drawing.count + _SLICE]:
            drawing.mapper.scan(submaps.on_map(view), view.ranges, view.first, view.step, view.farthest)
        drawing.count += _SLICE
        if drawing.count < len(submaps.views):
            return False
        self.mapper.adopt(drawing.mapper)
        self._poses, self._drawing, self._scans = drawing.poses, None, 0
        return True

    def finish(self) -> None:
        """Finish drawing the map with the current poses."""
        while self._drawing is not None or self._is_outdated():
            if self._drawing is None:  # a drawing in progress may have begun with earlier poses
                self.draw_again()
            self.work()

    def clear(self) -> None:
        """Start a new map at the current pose."""
        start = self.slam.pose
        self.mapper.clear()
        self._reset(Slam(start, self.run))

    def locate(self, laser: Pose) -> None:
        """Set the laser's current pose. On a loaded map it is approximate; else it is exact, and moves the map."""
        self.slam.move(laser, ROUGHLY)
        if self.slam.track is not None and self.slam.unsure is None:
            self.draw_again()

    def saved(self) -> SavedGraph:
        """Return the graph for `load`, without scans whose place on a loaded map is unknown."""
        return SavedGraph(self.slam.placed, *self.mapper.painted)

    def load(self, grid: MapGrid2D, path: Path) -> None:
        """Continue a map with its graph if both are valid; raises `OSError`, or `ValueError` with the reason."""
        saved = graph_file.read(path)
        self.mapper.load(grid)
        self._reset(Slam.resume(saved.submaps, Pose(0.0, 0.0, 0.0), run=self.run))
        x, y = self.mapper.painted[1]
        self.mapper.overlay(saved.paint, (saved.corner[0] - x, saved.corner[1] - y))

    def _reset(self, slam: Slam) -> None:
        self.slam, self._poses, self._drawing, self._scans, self._drawn_ns = slam, [], None, 0, 0
