"""Closes loops: matches the current scan to submaps that the robot visited before.

Near the last closure, the scan is matched directly. After a long drive without a closure, or on a loaded map, all poses
within the expected drift are searched by correlation; a closure found by a search counts only after a second scan has
confirmed it.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.likelihood_field import LikelihoodField
from navigation.algorithms.pose_graph import Edge, PoseGraph
from navigation.algorithms.pose_search import PoseSearch, SearchWindow
from navigation.algorithms.submaps import Submaps
from navigation.algorithms.surfels import Match, Surface, Surfels
from navigation.pose import Pose

Floats = NDArray[np.float64]

NEAR = 5.0
"""A scan is matched to a submap whose middle is less than this many meters away."""

DRIFT = 0.02
"""Expected drift, in meters per meter of the robot's path."""

_TURN_DRIFT = math.radians(0.4)  # expected drift of the heading, radians per meter
_MOST_DRIFT = 6.0, math.radians(40.0)  # the largest expected drift
_DIRECT = 0.25  # meters of drift up to which a scan is matched without a search
_MOST_DIRECT, _MOST_SEARCHED = 2, 2  # submaps that are matched directly, and search_surfels, for each scan
_POINTS, _SEARCH_POINTS = 300, 180  # points of a scan that a direct match and a search use
_SHARE, _SURE_SHARE = 0.5, 0.7  # least share of a scan's points on a submap's lines, after a direct match and a search
_CLEARLY = 0.85  # the best pose is ambiguous if the second one has more than this part of its share
_OFF = 0.3, math.radians(6.0)  # largest distance of a direct match from its guess
_AGREED = 0.3, math.radians(2.0)  # largest difference between two closures that confirm each other
_PATIENCE = 4  # scans within which a closure must be confirmed
_STEP = 0.3  # meters that each edge adds to a path's length; a closure adds nothing else
_GRID = 0.1  # side of a cell of the search, meters
_SHARPNESS, _HIT = 0.1, 0.9  # of the search's likelihood field: meters, and share of points on a submap's lines
_FLOOR = np.diag((0.004**2, 0.004**2, math.radians(0.08) ** 2))  # least covariance of a match
_SMALL = 0.7  # a closure whose error is smaller (standard deviations) does not move the submaps
_WRONG = 5.0  # a closure with a larger error after optimization (standard deviations) contradicts the others


class Closure(NamedTuple):
    """A match of the current scan with an older submap.

    Attributes:
        submap: index of the older submap.
        match: the laser's pose in that submap.
        before: the laser's pose on the map without the closure.
        correction: the movement of the map's frame that the closure implies.
    """

    submap: int
    match: Match
    before: Pose
    correction: Pose


class LoopResult(NamedTuple):
    """The result of a search that closes loops.

    Attributes:
        edges: the graph's new edges.
        poses: new poses of all nodes that the graph had when the search began; None if they do not move.
    """

    edges: list[Edge]
    poses: list[Pose] | None


class Candidate(NamedTuple):
    """A submap to search, with the expected drift in meters and radians."""

    submap: int
    drift: float
    turn: float


class LaserPose(NamedTuple):
    """The laser's pose in the current submap."""

    submaps: Submaps
    current: int
    pose: Pose

    @property
    def on_map(self) -> Pose:
        """The laser's pose on the map."""
        return self.submaps.graph.poses[self.current] @ self.pose

    def guess(self, index: int) -> Pose:
        """Return the laser's pose in another submap, according to the graph."""
        return self.submaps.graph.poses[index].inverse @ self.on_map

    def closure(self, index: int, match: Match) -> Closure:
        """Return the closure that a match with a submap implies."""
        before = self.on_map
        return Closure(index, match, before, self.submaps.graph.poses[index] @ match.pose @ before.inverse)


@dataclass
class Suspicion:
    """A closure that a second scan has to confirm."""

    closure: Closure
    age: int = 0


class LoopSearch:
    """Searches for loops on one map.

    Attributes:
        closed: the number of accepted closures.
        refused: the number of closures that contradicted the graph.
    """

    def __init__(self) -> None:
        self.closed, self.refused = 0, 0
        self._suspicion: Suspicion | None = None
        self._turn = 0

    def search(
        self,
        submaps: Submaps,
        current: int,
        pose: Pose,
        scan: Surface,
        end: int,
        unsure: tuple[float, float] | None,
    ) -> LoopResult | None:
        """Match a scan to older submaps, and optimize the graph; return None if no closure is accepted.

        Args:
            submaps: a `Submaps.snapshot`, whose graph is changed.
            current: index of the current submap.
            pose: the laser's pose in the current submap.
            scan: the scan's points, in the laser's frame.
            end: index of the first submap that is too new to be matched.
            unsure: meters and radians by which the pose on the map may be wrong if the current submap is not joined to
                older submaps yet; None if it is joined.
        """
        laser = LaserPose(submaps, current, pose)
        direct, far = self._candidates(laser, end, unsure)
        points = scan.thinned(_POINTS)
        closures = [closure for index in direct if (closure := _match_submap(laser, index, points)) is not None]
        trusted = [] if closures else self._search(laser, far, points)
        if not closures and not trusted:
            return None
        graph = submaps.graph
        edges = len(graph.edges)
        for closure in (*closures, *trusted):
            information = np.linalg.inv(np.linalg.inv(closure.match.information + 1e-3 * np.eye(3)) * 4.0 + _FLOOR)
            graph.join(closure.submap, current, closure.match.pose, information, offset=pose, loop=True)
        if not trusted and graph.errors()[edges:].max() < _SMALL:
            self.closed += len(closures)
            return LoopResult(graph.edges[edges:], None)
        graph.optimize(12 if trusted else 4, trusting=4 if trusted else 0)
        if trusted and graph.errors()[edges:].max() > _WRONG:
            self.refused += 1
            return None
        self.closed += len(closures) + len(trusted)
        return LoopResult(graph.edges[edges:], graph.poses)

    def _candidates(
        self, laser: LaserPose, end: int, unsure: tuple[float, float] | None
    ) -> tuple[list[int], list[Candidate]]:
        """Return the submaps to match directly, and those to search."""
        here = laser.on_map
        lengths = _path_lengths(laser.submaps.graph, laser.current) if unsure is None else {}
        near: list[tuple[float, int]] = []
        far: list[tuple[float, Candidate]] = []
        for index in range(end):
            middle = laser.submaps.middle(index)
            if middle is None:
                continue
            if unsure is None:
                way = lengths.get(index, math.inf)
                drift, turn = min(0.05 + DRIFT * way, _MOST_DRIFT[0]), min(0.03 + _TURN_DRIFT * way, _MOST_DRIFT[1])
            else:
                drift, turn = unsure
            gap = middle.distance(here)
            if drift < _DIRECT and gap < NEAR:
                near.append((gap, index))
            elif drift >= _DIRECT and gap < NEAR + drift:
                far.append((gap, Candidate(index, drift, turn)))
        near.sort()
        far.sort()
        return [index for _, index in near[:_MOST_DIRECT]], self._choose([candidate for _, candidate in far])

    def _choose(self, far: list[Candidate]) -> list[Candidate]:
        """Return the candidates that may confirm the suspected closure; or, if none may, the next few in turn."""
        suspicion = self._suspicion
        if suspicion is not None:
            again = [candidate for candidate in far if candidate.submap == suspicion.closure.submap]
            if again:
                return again
        self._turn += _MOST_SEARCHED
        return [far[(self._turn + n) % len(far)] for n in range(min(_MOST_SEARCHED, len(far)))]

    def _search(self, laser: LaserPose, far: list[Candidate], points: Surface) -> list[Closure]:
        """Return the closure that a search finds if it confirms an earlier one."""
        suspicion = self._suspicion
        if suspicion is not None:
            suspicion.age += 1
            if suspicion.age > _PATIENCE:
                suspicion = self._suspicion = None
        for candidate in far:
            closure = _search_submap(laser, candidate, points)
            if closure is None:
                continue
            if suspicion is not None and _agree(suspicion.closure, closure):
                self._suspicion = None
                return [closure]
            self._suspicion = Suspicion(closure)
            break
        return []


def _path_lengths(graph: PoseGraph, current: int) -> dict[int, float]:
    """Return the length in meters of the path along the graph from a submap to each other submap."""
    neighbors: dict[int, list[tuple[int, float]]] = {}
    for edge in graph.edges:
        length = _STEP if edge.loop else math.hypot(edge.measured.x, edge.measured.y) + _STEP
        neighbors.setdefault(edge.first, []).append((edge.second, length))
        neighbors.setdefault(edge.second, []).append((edge.first, length))
    lengths: dict[int, float] = {}
    waiting = [(0.0, current)]
    while waiting:
        way, index = heapq.heappop(waiting)
        if index in lengths:
            continue
        lengths[index] = way
        for other, length in neighbors.get(index, ()):
            if other not in lengths:
                heapq.heappush(waiting, (way + length, other))
    return lengths


def _match_submap(laser: LaserPose, index: int, points: Surface) -> Closure | None:
    """Match a scan to a submap near the pose that the graph implies; return None if it does not fit."""
    guess = laser.guess(index)
    match = laser.submaps.surfels(index).match(points, guess, steps=12)
    if match.share < _SHARE or not _close(guess, match.pose, *_OFF):
        return None
    return laser.closure(index, match)


def _search_submap(laser: LaserPose, candidate: Candidate, points: Surface) -> Closure | None:
    """Search for the pose of a scan on a submap; return None if no pose fits, or more than one."""
    index, drift, turn = candidate
    guess = laser.guess(index)
    middle = laser.submaps.middle(index)
    if math.isinf(drift) and middle is not None:  # the pose is unknown: the robot may be anywhere in the submap
        guess, drift = laser.submaps.graph.poses[index].inverse @ middle, NEAR
    match = search_surfels(laser.submaps.surfels(index), points, guess, drift, turn)
    return None if match is None else laser.closure(index, match)


def search_surfels(surfels: Surfels, points: Surface, guess: Pose, reach: float, turn: float) -> Match | None:
    """Search for the pose of a scan on surfels within a window; return None if no pose fits, or more than one."""
    walls, corner = surfels.raster(_GRID)
    field = LikelihoodField(walls, np.ones(walls.shape, np.bool_), _GRID)
    table = field.table(_SHARPNESS, _HIT)
    few = np.ascontiguousarray(points.thinned(_SEARCH_POINTS).points)
    window = SearchWindow(guess.x - corner[0], guess.y - corner[1], guess.theta, reach, turn)
    poses, _ = PoseSearch(field, table).best(few, window)
    matches: list[Match] = []
    for x, y, theta in poses[:6]:
        match = surfels.match(points, Pose(x + corner[0], y + corner[1], theta), steps=15)
        if all(not _close(match.pose, other.pose, 0.3, 0.2) for other in matches):
            matches.append(match)
    matches.sort(key=lambda match: -match.share)
    if not matches or matches[0].share < _SURE_SHARE or not _close(matches[0].pose, guess, reach + 0.5, turn + 0.2):
        return None
    return None if len(matches) > 1 and matches[1].share > _CLEARLY * matches[0].share else matches[0]


def _agree(a: Closure, b: Closure) -> bool:
    """Whether two closures move the pose before the second one to nearly the same pose."""
    return _close(a.correction @ b.before, b.correction @ b.before, *_AGREED)


def _close(a: Pose, b: Pose, meters: float, radians: float) -> bool:
    return a.distance(b) <= meters and abs(math.remainder(a.theta - b.theta, math.tau)) <= radians
