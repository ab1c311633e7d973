"""Maps from drifting odometry: scans matched to submaps, and a graph that moves the submaps into place.

Each scan is matched to the current submap, which overlaps the next one by half, so that the drift within a submap is a
few millimeters. Near older submaps, the scan is matched to them too, and each match becomes an edge of the graph (Hess
et al., "Real-Time Loop Closure in 2D LIDAR SLAM", ICRA 2016).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.loops import LoopResult, LoopSearch
from navigation.algorithms.submaps import Scan, Submaps, View
from navigation.algorithms.surfels import Surface
from navigation.pose import Pose

Floats = NDArray[np.float64]

MOST_SUBMAPS = 800
"""Maximum number of submaps, about 2 km of driving; the graph's cost grows with their number."""

ANYWHERE = math.inf, math.pi
"""Meters and radians by which a pose may be wrong if it is unknown."""

Search = Callable[[], "LoopResult | None"]
RunSearch = Callable[[Callable[[], Search], "Callable[[LoopResult | None], object]"], object]
"""Runs a search for loops: calls the first function to prepare the search, and the second one with its result.

Both are called on the thread that adds the scans, but the search may run on another one. If searches are slower than
scans, some searches are skipped.
"""


def at_once(prepare: Callable[[], Search], deliver: Callable[[LoopResult | None], object]) -> None:
    """Run a search on the calling thread."""
    deliver(prepare()())


_ORIGIN = Pose(0.0, 0.0, 0.0)
_MOVED, _TURNED = 0.03, math.radians(1.5)  # least motion since the last matched scan
_VIEW_MOVED, _VIEW_TURNED = 0.15, math.radians(8.0)  # least motion since the last view
_WAY, _VIEWS = 5.0, 80  # size of a submap: meters of the robot's path, and the largest number of views
_LOOP_EVERY = 0.5  # meters between two searches for loops
_POINTS = 240  # points of a scan that are matched
# standard deviations of a step of odometry: meters, radians, and the share of the step that is added to each. The
# errors are biased, and a small standard deviation of the heading would let the bias turn the map
_METERS, _RADIANS, _DRIFT = 0.004, math.radians(2.0), 0.05
_LEAST_SHARE = 0.3  # least share of a scan's points on the submap's lines; below it, only the odometry counts
_MOST_OFF = 0.15, math.radians(6.0)  # largest distance of a match from the odometry
_JUMP = 1.0, math.radians(60.0)  # if odometry moves farther between two scans, it counts as reset
# information of the edge between two consecutive submaps
_STEADY = np.diag((0.005**-2.0, 0.005**-2.0, math.radians(0.1) ** -2.0))


@dataclass
class Track:
    """The laser in the current submap.

    Attributes:
        odometry: the laser's pose in the odometry frame at the last scan.
        current: index of the submap to which scans are matched.
        pose: the laser's pose in the current submap at the last scan.
        matched: the same at the last match.
        viewed: the same at the last view.
        following: index of the next submap; -1 for none.
        begun: the next submap's pose in the current submap.
        way: meters driven in the current submap.
        since_loop: meters driven since the last search for loops.
        lost: number of scans since the last one that matched.
    """

    odometry: Pose
    current: int
    pose: Pose = _ORIGIN
    matched: Pose = _ORIGIN
    viewed: Pose = _ORIGIN
    following: int = -1
    begun: Pose = _ORIGIN
    way: float = 0.0
    since_loop: float = 0.0
    lost: int = 0


class Slam:
    """A map that grows along the robot's path.

    Args:
        start: the laser's pose on the map at the first scan.
        run: runs the searches for loops.

    Attributes:
        submaps: the submaps, with their graph.
        track: None before the first scan.
        loops: the search for loops.
        unsure: meters and radians by which the pose may be wrong until the trajectory joins a loaded map; else None.
    """

    def __init__(self, start: Pose = _ORIGIN, run: RunSearch = at_once) -> None:
        self.submaps, self.loops = Submaps(), LoopSearch()
        self.track: Track | None = None
        self.unsure: tuple[float, float] | None = None
        self._start, self._joined_from = start, 0
        self._run, self._moved = run, False  # whether the map was moved since the search began

    @classmethod
    def resume(
        cls, submaps: Submaps, guess: Pose, unsure: tuple[float, float] = ANYWHERE, run: RunSearch = at_once
    ) -> Slam:
        """Continue a map from a pose of the laser that may be wrong by ``unsure`` (meters, radians)."""
        slam = cls(guess, run)
        slam.submaps, slam.unsure, slam._joined_from = submaps, unsure, len(submaps.graph.poses)
        return slam

    @property
    def pose(self) -> Pose:
        """The laser's pose on the map at the last scan."""
        track = self.track
        return self._start if track is None else self.submaps.graph.poses[track.current] @ track.pose

    @property
    def correction(self) -> Pose | None:
        """The odometry frame's pose on the map; None before the first scan, and while the pose is unsure."""
        track = self.track
        return None if track is None or self.unsure is not None else self.pose @ track.odometry.inverse

    @property
    def placed(self) -> Submaps:
        """The submaps whose poses on the map are known: all, unless the trajectory has not joined a loaded map yet."""
        return self.submaps if self.unsure is None else self.submaps.first(self._joined_from)

    @property
    def full(self) -> bool:
        """Whether no further scans become part of the map."""
        return len(self.submaps.graph.poses) >= MOST_SUBMAPS

    def move(self, pose: Pose, unsure: tuple[float, float]) -> None:
        """Set the laser's pose on the map; moves the trajectory if it has not joined a loaded map yet, else the map."""
        change = pose @ self.pose.inverse
        self._start = pose
        poses = self.submaps.graph.poses
        first = self._joined_from if self.unsure is not None else 0
        poses[first:] = [change @ old for old in poses[first:]]
        self.unsure = self.unsure and unsure
        self._moved = True

    def add(self, odometry: Pose, scan: Scan, *, mapping: bool = True) -> View | None:
        """Add a scan at the laser's pose in the odometry frame; return its view if it becomes part of the map.

        Without ``mapping``, the scan only updates the laser's pose.
        """
        track = self.track
        if track is None:
            if not mapping:
                return None
            self.track = Track(odometry, self.submaps.begin(self._start))
            view = self._view(self.track, scan, scan.surface())
            self._close_loops(self.track, scan.surface())
            return view
        moved = track.odometry.inverse @ odometry
        track.odometry = odometry
        if _is_apart(_ORIGIN, moved, *_JUMP):
            return None
        track.pose = guess = track.pose @ moved
        if not _is_apart(track.matched, guess, _MOVED, _TURNED):
            return None
        surface = scan.surface()
        track.pose = track.matched = self._match(track, surface, guess)
        if not mapping or self.full or not _is_apart(track.viewed, track.pose, _VIEW_MOVED, _VIEW_TURNED):
            return None
        way = track.viewed.distance(track.pose)
        track.viewed, track.way, track.since_loop = track.pose, track.way + way, track.since_loop + way
        view = self._view(track, scan, surface)
        self._close_loops(track, surface)
        self._advance(track)
        return view

    def _match(self, track: Track, surface: Surface, guess: Pose) -> Pose:
        """Return the scan's pose in the current submap, or the guess if it does not match."""
        moved = track.matched.inverse @ guess
        meters, radians = _METERS + _DRIFT * math.hypot(moved.x, moved.y), _RADIANS + _DRIFT * abs(moved.theta)
        prior = np.diag((meters**-2.0, meters**-2.0, radians**-2.0))
        match = self.submaps.surfels(track.current).match(surface.thinned(_POINTS), guess, prior)
        if match.share < _LEAST_SHARE or _is_apart(guess, match.pose, *_MOST_OFF):
            track.lost += 1
            return guess
        track.lost = 0
        return match.pose

    def _view(self, track: Track, scan: Scan, surface: Surface) -> View:
        view = scan.view(track.current, track.pose)
        surfels = self.submaps.surfels(track.current)  # before `add`: surfels may be computed from the views
        self.submaps.add(view)
        surfels.add(surface.moved(track.pose))
        if track.following >= 0:
            self._add_following(track, view, surface)
        return view

    def _add_following(self, track: Track, view: View, surface: Surface) -> None:
        """Add a view to the next submap too."""
        pose = track.begun.inverse @ view.pose
        self.submaps.surfels(track.following).add(surface.moved(pose))

    def _close_loops(self, track: Track, surface: Surface) -> None:
        if track.since_loop < _LOOP_EVERY and self.unsure is None:
            return
        track.since_loop = 0.0
        self._run(partial(self._search, track.current, track.pose, surface), self._adopt)

    def _search(self, current: int, pose: Pose, surface: Surface) -> Search:
        """Return a search for loops at the laser's pose in a submap, which may run on another thread."""
        self._moved = False
        end = max(0, current - 1) if self.unsure is None else self._joined_from
        return partial(self.loops.search, self.submaps.snapshot(), current, pose, surface, end, self.unsure)

    def _adopt(self, closed: LoopResult | None) -> None:
        """Apply the result of a search; submaps added since it began move with the last submap that it knew."""
        if closed is None or self._moved:
            return
        graph, poses = self.submaps.graph, closed.poses
        graph.edges += closed.edges
        if poses is not None:
            known = len(poses)
            change = poses[-1] @ graph.poses[known - 1].inverse
            graph.poses = [*poses, *(change @ pose for pose in graph.poses[known:])]
            self.unsure = None

    def _advance(self, track: Track) -> None:
        """Begin the next submap in the middle of the current one, and switch to it at the current one's end."""
        graph, views = self.submaps.graph, len(self.submaps.views_of[track.current])
        if track.following < 0 and (track.way > 0.5 * _WAY or views > _VIEWS // 2):
            track.begun = track.pose
            track.following = self.submaps.begin(graph.poses[track.current] @ track.pose)
            graph.join(track.current, track.following, track.pose, _STEADY)
            view = self.submaps.views[-1]
            self._add_following(track, view, view.surface())
        elif track.following >= 0 and (track.way > _WAY or views > _VIEWS):
            back = track.begun.inverse
            track.current, track.following, track.way = track.following, -1, 0.0
            track.pose, track.matched, track.viewed = (
                back @ pose for pose in (track.pose, track.matched, track.viewed)
            )


def _is_apart(a: Pose, b: Pose, meters: float, radians: float) -> bool:
    return a.distance(b) > meters or abs(math.remainder(a.theta - b.theta, math.tau)) > radians
