"""Surfaces in a plane: points of laser scans with their normals, gathered in cells as short lines.

Each cell holds one line for each of eight directions that its surface may face, so that the two sides of a thin wall,
or the walls of a corner, stay apart (normal distributions transform: Biber and Strasser, "The Normal Distributions
Transform", IROS 2003; with lines, which unlike ellipses do not hold a scan back along a wall).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navigation.pose import Pose

Floats = NDArray[np.float64]

CELL = 0.3
"""Side of a cell, meters."""

_FACES = 8
_BASELINE = 0.08  # meters from a point to each of the two points that give its normal
_BEND = 0.03  # meters by which a point may lie off the line between these two
_LEAST_POINTS = 5  # points that a line needs
_MARGIN = 1.0  # meters around the lines on a raster
_FLAT = 0.1  # largest ratio of the variance across a line to that along it
_THIN = 0.05  # largest standard deviation across a line, meters


class Surface(NamedTuple):
    """The points of a scan that lie on surfaces, in the laser's frame.

    Attributes:
        points: (m, 2) meters.
        normals: (m, 2) unit vectors that face the laser.
    """

    points: Floats
    normals: Floats

    def thinned(self, most: int) -> Surface:
        """Return at most ``most`` points, spread over all beams."""
        if len(self.points) <= most:
            return self
        chosen = np.linspace(0, len(self.points) - 1, most).astype(np.intp)
        return Surface(self.points[chosen], self.normals[chosen])

    def moved(self, pose: Pose) -> Surface:
        """Return the surface in the frame in which the laser has a pose."""
        turn = rotation(pose.theta)
        return Surface(self.points @ turn.T + (pose.x, pose.y), self.normals @ turn.T)


def surface(ranges: NDArray[np.floating], first: float, step: float, farthest: float) -> Surface:
    """Return the points of a scan whose neighbors lie on the same surface.

    Args:
        ranges: meters, one per beam; a value that is not between 0 and ``farthest`` is no echo.
        first: the first beam's angle from the laser's direction, radians.
        step: the angle from a beam to the next, radians.
        farthest: meters.
    """
    beams = np.asarray(ranges, np.float64)
    count = beams.size
    valid = (beams > 0.0) & (beams <= farthest)
    if not valid.any() or not step:
        return Surface(np.empty((0, 2)), np.empty((0, 2)))
    angles = first + step * np.arange(count)
    lengths = np.where(valid, beams, 0.0)
    points = np.stack((lengths * np.cos(angles), lengths * np.sin(angles)), axis=1)
    full = abs(abs(step) * count - math.tau) < 1.5 * abs(step)
    at = np.flatnonzero(valid)
    stride = np.clip(np.ceil(_BASELINE / (lengths[at] * abs(step))), 1, max(1, count // 12)).astype(np.intp)
    before, after = at - stride, at + stride
    if full:
        before, after = before % count, after % count
    inside = (before >= 0) & (after < count)
    at, stride, before, after = at[inside], stride[inside], before[inside], after[inside]
    left, right = points[before] - points[at], points[after] - points[at]
    along = right - left
    length = np.hypot(along[:, 0], along[:, 1])
    bend = np.abs(left[:, 0] * right[:, 1] - left[:, 1] * right[:, 0]) / np.maximum(length, 1e-9)
    most = np.maximum(4.0 * stride * abs(step) * lengths[at], 4.0 * _BASELINE)
    good = valid[before] & valid[after] & (length > 1e-3) & (length < most) & (bend < _BEND)
    at, along, length = at[good], along[good], length[good]
    normals = np.stack((-along[:, 1], along[:, 0]), axis=1) / length[:, None]
    away = (normals * points[at]).sum(axis=1) > 0.0
    normals[away] *= -1.0
    return Surface(points[at], normals)


class Match(NamedTuple):
    """The best pose of a scan on surfels.

    Attributes:
        pose: the laser's pose in the surfels' frame.
        information: (3, 3) inverse covariance of x, y (meters) and theta (radians), without the prior.
        share: the share of the scan's points that lie on a line of the surfels.
        error: median distance of these points from their lines, meters.
    """

    pose: Pose
    information: Floats
    share: float
    error: float


class Surfels:
    """Lines that approximate the surfaces around a place, in its frame.

    Args:
        reach: meters from the place to each side; points beyond are ignored.
    """

    def __init__(self, reach: float) -> None:
        self._half = math.ceil(reach / CELL)
        self._side = 2 * self._half
        count = self._side * self._side * _FACES
        self._sums = np.zeros((count, 6))  # number of points, x, y, xx, xy, yy
        self._lines = np.full((count, 4), np.nan)  # a point of the line, and its normal; NaN for none

    def add(self, scan: Surface) -> None:
        """Add the points of a scan, in the surfels' frame."""
        keys = self._keys(scan.points, scan.normals)
        inside = keys >= 0
        keys, (x, y) = keys[inside], scan.points[inside].T
        np.add.at(self._sums, keys, np.stack((np.ones(len(x)), x, y, x * x, x * y, y * y), axis=1))
        self._update(np.unique(keys))

    def _update(self, keys: NDArray[np.intp]) -> None:
        count, x, y, xx, xy, yy = self._sums[keys].T
        x, y = x / count, y / count
        xx, xy, yy = xx / count - x * x, xy / count - x * y, yy / count - y * y
        middle, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
        least, most = np.maximum(middle - apart, 0.0), middle + apart
        flat = (count >= _LEAST_POINTS) & (least < _FLAT * most) & (least < _THIN * _THIN)
        along = 0.5 * np.arctan2(2.0 * xy, xx - yy)
        lines = np.stack((x, y, -np.sin(along), np.cos(along)), axis=1)
        lines[~flat] = np.nan
        self._lines[keys] = lines

    def _keys(self, points: Floats, normals: Floats) -> NDArray[np.intp]:
        """Return the index of each point's line; -1 outside."""
        cells = np.floor(points / CELL).astype(np.intp) + self._half
        inside = ((cells >= 0) & (cells < self._side)).all(axis=1)
        face = np.round(np.arctan2(normals[:, 1], normals[:, 0]) * (_FACES / math.tau)).astype(np.intp) % _FACES
        keys = (cells[:, 1] * self._side + cells[:, 0]) * _FACES + face
        keys[~inside] = -1
        return keys

    def raster(self, resolution: float) -> tuple[NDArray[np.bool_], tuple[float, float]]:
        """Return the cells (rows, columns) that the lines cross, and the lower left corner in the surfels' frame."""
        lines = self._lines[np.isfinite(self._lines[:, 0])]
        if not len(lines):
            return np.zeros((1, 1), np.bool_), (0.0, 0.0)
        along = np.linspace(-0.5 * CELL, 0.5 * CELL, 2 * math.ceil(CELL / resolution) + 1)
        x = (lines[:, :1] - lines[:, 3:] * along).ravel()
        y = (lines[:, 1:2] + lines[:, 2:3] * along).ravel()
        left, bottom = float(x.min()) - _MARGIN, float(y.min()) - _MARGIN
        columns, rows = (
            math.ceil((high + _MARGIN - low) / resolution) for high, low in ((x.max(), left), (y.max(), bottom))
        )
        cells = np.zeros((rows, columns), np.bool_)
        cells[((y - bottom) / resolution).astype(np.intp), ((x - left) / resolution).astype(np.intp)] = True
        return cells, (left, bottom)

    def match(
        self,
        scan: Surface,
        guess: Pose,
        prior: Floats | None = None,
        *,
        noise: float = 0.02,
        within: float = 0.05,
        steps: int = 8,
    ) -> Match:
        """Return the pose near a guess at which a scan fits the lines best (Gauss-Newton, robust weights).

        Args:
            scan: the scan, in the laser's frame.
            guess: the laser's pose in the surfels' frame.
            prior: (3, 3) inverse covariance of the guess; without it, only the scan counts.
            noise: standard deviation of a point from its line, meters.
            within: distance up to which a point lies on its line, meters.
            steps: maximum number of iterations.
        """
        start = np.array(guess[:3])
        pose = start.copy()
        added = np.zeros((3, 3)) if prior is None else prior
        information = np.zeros((3, 3))
        distance = np.empty(0)
        for _ in range(steps):
            c, s = math.cos(pose[2]), math.sin(pose[2])
            turn = np.array(((c, -s), (s, c)))
            turned = scan.points @ turn.T
            keys = self._keys(turned + pose[:2], scan.normals @ turn.T)
            lines = self._lines[keys]
            normal_x, normal_y = lines[:, 2], lines[:, 3]
            distance = normal_x * (turned[:, 0] + pose[0] - lines[:, 0]) + normal_y * (
                turned[:, 1] + pose[1] - lines[:, 1]
            )
            on = (keys >= 0) & np.isfinite(distance)
            distance = distance[on]
            jacobian = np.stack(
                (normal_x[on], normal_y[on], normal_y[on] * turned[on, 0] - normal_x[on] * turned[on, 1]), axis=1
            )
            weight = 1.0 / (noise * noise + np.square(distance))
            weighted = jacobian * weight[:, None]
            information = weighted.T @ jacobian
            off = pose - start
            gradient = weighted.T @ distance + added @ off
            try:
                change = np.linalg.solve(information + added + 1e-6 * np.eye(3), -gradient)
            except np.linalg.LinAlgError:
                break
            pose = pose + change
            if abs(change[0]) < 2e-4 and abs(change[1]) < 2e-4 and abs(change[2]) < 1e-4:
                break
        apart = np.abs(distance)
        near = apart[apart < within]
        share = len(near) / max(1, len(scan.points))
        error = float(np.median(near)) if len(near) else math.inf
        return Match(
            Pose(float(pose[0]), float(pose[1]), math.remainder(float(pose[2]), math.tau)), information, share, error
        )


def rotation(theta: float) -> Floats:
    """Return the matrix of a rotation, radians."""
    c, s = math.cos(theta), math.sin(theta)
    return np.array(((c, -s), (s, c)))
