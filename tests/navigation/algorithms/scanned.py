"""A simulated laser with drifting odometry in a corridor around a block, for the tests of scan matching."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.submaps import Scan
from navigation.pose import Pose
from sim.laser_kernel import cast

BEAMS = 360
FARTHEST = 8.0
WIDTH, HEIGHT = 8.0, 5.0
"""Width and height of the laser's path around the block, along the middle of the corridor, meters."""

_STEP = math.tau / BEAMS
_ANGLES = np.arange(BEAMS) * _STEP
_DIRECTIONS = np.ascontiguousarray(np.stack((np.cos(_ANGLES), np.sin(_ANGLES)), axis=1))


def _wall(
    start: NDArray[np.float64], end: NDArray[np.float64], niches: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Return the corners of a wall that has niches to its right at the given distances from its start."""
    along = (end - start) / np.linalg.norm(end - start)
    aside = np.array((along[1], -along[0])) * 0.35
    corners = [start]
    for at in niches:
        low, high = start + along * at, start + along * (at + 0.9)
        corners += [low, low + aside, high + aside, high]
    return corners


def corridor() -> NDArray[np.float64]:
    """Return the walls of a closed corridor, 2 m wide with different niches on each side: segments (n, 4), meters."""
    rng = np.random.default_rng(7)
    segments = []
    for margin, side in ((1.0, 1.0), (-1.0, -1.0)):
        x, y = WIDTH / 2 + margin, HEIGHT / 2 + margin
        corners = np.array([(-x, -y), (x, -y), (x, y), (-x, y)][:: round(side)])
        points: list[NDArray[np.float64]] = []
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            free = np.linalg.norm(end - start) - 1.2
            points += _wall(start, end, np.arange(0.3, free, 2.2) + rng.uniform(0.0, 0.6))
        ring = np.array(points)
        segments.append(np.hstack((ring, np.roll(ring, -1, axis=0))))
    return np.vstack(segments)


class Seen(NamedTuple):
    """The true and the drifted pose of a laser, and its scan."""

    truth: Pose
    odometry: Pose
    scan: Scan


class Laser:
    """A laser that scans segments with one centimeter of noise."""

    def __init__(self, segments: NDArray[np.float64]) -> None:
        self._segments, self._rng = segments, np.random.default_rng(1)

    def scan(self, pose: Pose) -> Scan:
        out = np.empty(BEAMS)
        cast(self._segments, np.empty((0, 3)), *pose[:3], _DIRECTIONS, 0.0, _STEP, FARTHEST, out)
        return Scan(np.where(out <= FARTHEST, out + self._rng.normal(0.0, 0.01, BEAMS), math.inf), 0.0, _STEP, FARTHEST)


def drive(laser: Laser, meters: float, *, scale: float = 1.01, bend: float = 0.02) -> Iterator[Seen]:
    """Drive around the block; odometry scales distances (``scale``) and drifts in yaw (``bend``, radians per meter)."""
    pose, odometry = Pose(-WIDTH / 2 + 1.0, -HEIGHT / 2, 0.0), Pose(0.0, 0.0, 0.0)
    corners = [(WIDTH / 2, -HEIGHT / 2), (WIDTH / 2, HEIGHT / 2), (-WIDTH / 2, HEIGHT / 2), (-WIDTH / 2, -HEIGHT / 2)]
    way, target = 0.0, 0
    while way < meters:
        x, y = corners[target % 4]
        if math.hypot(x - pose.x, y - pose.y) < 0.15:
            target += 1
            continue
        off = math.remainder(math.atan2(y - pose.y, x - pose.x) - pose.theta, math.tau)
        ahead = 0.1 if abs(off) < 0.3 else 0.0
        turn = max(-0.15, min(0.15, off))
        pose, odometry = pose @ Pose(ahead, 0.0, turn), odometry @ Pose(ahead * scale, 0.0, turn + bend * ahead)
        way += ahead
        yield Seen(pose, odometry, laser.scan(pose))
