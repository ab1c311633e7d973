"""Submaps: each has the scans of a few meters of the robot's path, to which later scans are matched.

A submap's frame is the pose of its first scan. The pose graph has one node for each submap.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from threading import Lock
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.pose_graph import PoseGraph
from navigation.algorithms.surfels import Surface, Surfels, surface
from navigation.pose import Pose

Floats = NDArray[np.float64]

NO_ECHO = 65535
"""A view's value for a beam without an echo."""

MOST_RANGE = 65.0
"""Meters beyond which a view stores no echo."""

_REACH = 12.0  # meters around a submap's first scan
_CACHED = 16  # submaps whose surfels are in memory


class View(NamedTuple):
    """A scan that is part of the map.

    Attributes:
        submap: index of the submap.
        pose: the laser's pose in the submap's frame.
        millimeters: each beam's range; 0 if unknown, `NO_ECHO` without an echo.
        first, step: the first beam's angle from the laser's direction, and the step to the next, radians.
        farthest: the maximum range, meters.
    """

    submap: int
    pose: Pose
    millimeters: NDArray[np.uint16]
    first: float
    step: float
    farthest: float

    @property
    def ranges(self) -> Floats:
        """The ranges in meters; NaN unknown, infinite without an echo."""
        ranges: Floats = self.millimeters / 1000.0
        ranges[self.millimeters == 0] = math.nan
        ranges[self.millimeters == NO_ECHO] = math.inf
        return ranges

    def surface(self) -> Surface:
        """Return the scan's points on surfaces, in the laser's frame."""
        return surface(self.ranges, self.first, self.step, self.farthest)


class Scan(NamedTuple):
    """A scan as in `OccupancyMap.insert`: ranges and maximum range in meters, angles in radians."""

    ranges: Floats
    first: float
    step: float
    farthest: float

    def surface(self) -> Surface:
        """Return the scan's points on surfaces, in the laser's frame."""
        return surface(self.ranges, self.first, self.step, self.farthest)

    def view(self, submap: int, pose: Pose) -> View:
        """Return the scan as a view of a submap, with the laser's pose in that submap."""
        millimeters = np.zeros(len(self.ranges), np.uint16)
        echo = (self.ranges > 0.0) & (self.ranges <= min(self.farthest, MOST_RANGE))
        millimeters[echo] = np.maximum(np.round(self.ranges[echo] * 1000.0), 1.0)
        millimeters[self.ranges > self.farthest] = NO_ECHO
        return View(submap, pose, millimeters, self.first, self.step, self.farthest)


class Submaps:
    """All submaps, and the graph with their poses on the map.

    Attributes:
        graph: has a node for each submap, with the same index.
        views: all views, in the order of time.
        views_of: the indices of each submap's views.
    """

    def __init__(self) -> None:
        self.graph, self.views = PoseGraph(), list[View]()
        self.views_of: list[list[int]] = []
        self._surfels: OrderedDict[int, Surfels] = OrderedDict()
        self._lock = Lock()  # protects the surfels' cache

    def snapshot(self) -> Submaps:
        """Return the submaps with a copy of the graph, for another thread; views and surfels are shared.

        That thread may use all submaps to which no views are added meanwhile.
        """
        copy = Submaps()
        copy.graph.poses, copy.graph.edges = list(self.graph.poses), list(self.graph.edges)
        copy.views, copy.views_of = self.views, self.views_of
        copy._surfels, copy._lock = self._surfels, self._lock
        return copy

    def first(self, count: int) -> Submaps:
        """Return the first submaps, with their views and the edges between them."""
        part = Submaps()
        part.graph.poses = self.graph.poses[:count]
        part.graph.edges = [edge for edge in self.graph.edges if max(edge.first, edge.second) < count]
        part.views_of = [[] for _ in part.graph.poses]
        for view in self.views:
            if view.submap < count:
                part.add(view)
        return part

    def begin(self, pose: Pose) -> int:
        """Add an empty submap at a pose on the map; return its index."""
        self.views_of.append([])
        return self.graph.add(pose)

    def add(self, view: View) -> None:
        """Add a view, but not its points, which `Surfels.add` adds."""
        self.views_of[view.submap].append(len(self.views))
        self.views.append(view)

    def on_map(self, view: View) -> Pose:
        """Return the laser's pose of a view on the map."""
        return self.graph.poses[view.submap] @ view.pose

    def middle(self, submap: int) -> Pose | None:
        """Return the laser's pose on the map in the middle of a submap; None without views."""
        views = self.views_of[submap]
        return self.on_map(self.views[views[len(views) // 2]]) if views else None

    def surfels(self, submap: int) -> Surfels:
        """Return a submap's surfels, computed from its views if they are no longer cached."""
        with self._lock:
            cached = self._surfels.get(submap)
        if cached is None:
            cached = Surfels(_REACH)
            for index in self.views_of[submap]:
                view = self.views[index]
                cached.add(view.surface().moved(view.pose))
        with self._lock:
            self._surfels[submap] = cached
            self._surfels.move_to_end(submap)
            while len(self._surfels) > _CACHED:
                self._surfels.popitem(last=False)
        return cached
