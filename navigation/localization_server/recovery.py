"""The search for a better pose, if the map explains too little of a scan."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.likelihood_field import LikelihoodField
from navigation.algorithms.pose_search import PoseSearch, SearchWindow
from navigation.localization_server.judge import Judge
from navigation.localization_server.section import LocalizerSection
from navigation.pose import Pose

Floats = NDArray[np.float64]

_EXPLAINED_WITHIN = 0.15  # meters from a wall within which the map explains a beam's end
_SURE, _BETTER = 0.9, 0.1
"""No search runs from this explained share on. Another pose must explain this much more, or twice as much unless the
robot is lost."""

_SEARCH_EVERY, _LOST_SEARCH_EVERY = 3.0, 1.0
"""Minimum seconds between searches, normally and if the robot is lost; both grow if searches find nothing."""

_SEARCH_TURN, _LOST_REACH = 0.79, 12.0
"""The search range around the estimate: radians to each side; if the robot is lost, meters, and any heading."""

_PATIENCE = 4  # after this many fruitless searches the minimum time grows, by at most this factor
_NEVER = -(1 << 62)


def explained_shares(field: LikelihoodField, pose: tuple[float, float, float], points: Floats) -> tuple[float, float]:
    """Return how well the map explains a scan, and how much of the scan contradicts the pose."""
    agreeing, against = field.agreement(pose, points, _EXPLAINED_WITHIN)
    return max(0.0, agreeing - against), against


class PoseRecovery:
    """Searches for better poses on one map.

    Attributes:
        searches: number of searches so far.
    """

    def __init__(self, field: LikelihoodField, search: PoseSearch, settings: LocalizerSection, judge: Judge) -> None:
        self._field, self._search, self._settings, self._judge = field, search, settings, judge
        self._searched_ns = _NEVER
        self._fruitless = 0
        self.searches = 0

    def begin(self) -> None:
        """Start again after an initial pose."""
        self._searched_ns, self._fruitless = _NEVER, 0

    def forget_stamps(self) -> None:
        """Allow a search at once, because the clock was set."""
        self._searched_ns = _NEVER

    def better(self, stamp_ns: int, pose: Pose, share: float, points: Floats) -> tuple[Floats, Floats] | None:
        """Search around a pose if it is time; return poses that explain the scan better, with their scores, or None.

        ``share`` is the share of the scan that the map explains at the pose.
        """
        settings, judge, quality = self._settings, self._judge, self._judge.quality
        alarmed = quality < settings.poor or judge.refuted or judge.startled or judge.doubtful
        every = _LOST_SEARCH_EVERY if alarmed else _SEARCH_EVERY
        pause = every * min(_PATIENCE, 1 + self._fruitless // _PATIENCE)
        if max(share, quality) >= _SURE or (stamp_ns - self._searched_ns) / 1e9 < pause:
            return None
        self._searched_ns = stamp_ns
        self.searches += 1
        lost = quality < settings.good or judge.refuted or judge.doubtful
        wanted = max(share + _BETTER * (1.0 if lost else 2.0), settings.good)
        windows = [SearchWindow(pose.x, pose.y, pose.theta, settings.recovery, _SEARCH_TURN)]
        lost = judge.was_localized and (judge.refuted or judge.doubtful)
        if lost or (quality < settings.poor and self._fruitless >= 2):
            windows.append(SearchWindow(pose.x, pose.y, pose.theta, _LOST_REACH, math.pi))
        for window in windows:
            poses, scores = self._search.best(points, window)
            shares = np.array([explained_shares(self._field, (row[0], row[1], row[2]), points)[0] for row in poses])
            better = shares >= wanted
            if better.any():
                self._fruitless = 0
                return poses[better], scores[better]
        self._fruitless += 1
        return None
