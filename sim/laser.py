"""The laser: one ideal scanner, or the robot's own scanners blended into one."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bridge.messages.scan import LaserScan
from sim.laser_kernel import blend, cast
from sim.robot import Mount, Scanner
from sim.section import LaserSection

Floats = NDArray[np.float64]


class Laser:
    """Scans a world's segments and circles.

    Args:
        mount: the positions of the robot's own scanners.
        rng: the random generator for noise and dropouts.
    """

    def __init__(self, section: LaserSection, mount: Mount, rng: np.random.Generator) -> None:
        self.section, self._rng = section, rng
        self.height = mount.height
        self.step = 2.0 * math.pi / section.beams
        self._own = section.kind == "robot"
        self.scanners = mount.scanners if self._own else (Scanner(),)
        # YARP's first beam points to the robot's front, the first beam of most ROS drivers to its back
        self.first = 0.0 if self._own else -math.pi
        angles = self.first + np.arange(section.beams) * self.step
        self._beams = np.ascontiguousarray(np.stack([np.cos(angles), np.sin(angles)], axis=1))
        self._blind = [_blind(scanner, np.degrees(angles)) for scanner in self.scanners]

    def scan(self, time_ns: int, pose: tuple[float, float, float], segments: Floats, circles: Floats) -> LaserScan:
        """Return one scan from the base's pose (x, y, yaw: meters, radians)."""
        turns = [
            self._turn(s, blind, pose, segments, circles) for s, blind in zip(self.scanners, self._blind, strict=True)
        ]
        ranges = turns[0]
        if self._own:
            ranges = np.full(self.section.beams, math.nan)
            for scanner, turn in zip(self.scanners, turns, strict=True):
                x, y, yaw = scanner.at
                blend(turn, self.first, self.step, x, y, math.radians(yaw), ranges, self.step)
        return LaserScan(time_ns, self.first, self.step, self.section.nearest, self.section.farthest, ranges)

    def _turn(
        self,
        scanner: Scanner,
        blind: NDArray[np.bool_],
        pose: tuple[float, float, float],
        segments: Floats,
        circles: Floats,
    ) -> Floats:
        section, (x, y, yaw), (dx, dy, turned) = self.section, pose, scanner.at
        c, s = math.cos(yaw), math.sin(yaw)
        out = np.empty(section.beams)
        at = (x + c * dx - s * dy, y + s * dx + c * dy, yaw + math.radians(turned))
        cast(segments, circles, *at, self._beams, self.first, self.step, section.farthest, out)
        if section.noise:
            out += self._rng.normal(0.0, section.noise, section.beams)
        if section.resolution:
            np.round(out / section.resolution, out=out)
            out *= section.resolution
        out[out > section.farthest] = math.inf
        out[out < section.nearest] = math.nan
        if section.dropouts:
            out[self._rng.random(section.beams) < section.dropouts] = math.nan
        out[blind] = math.nan
        return out


def _blind(scanner: Scanner, degrees: Floats) -> NDArray[np.bool_]:
    """Return which beams are blind; YARP's SKIP sectors are open intervals of 0 to 360 degrees (Lidar2DDeviceBase)."""
    around = degrees % 360.0
    blind = np.zeros(degrees.shape, np.bool_)
    for begin, end in scanner.blind:
        blind |= (around > begin) & (around < end)
    return blind


def reference(
    segments: Floats, circles: Floats, pose: tuple[float, float, float], angles: Floats, farthest: float
) -> Floats:
    """Compute the distances by brute force, for tests: all beams with all segments and circles.

    Args:
        segments: (n, 4) x1, y1, x2, y2, meters.
        circles: (m, 3) x, y, radius, meters.
        pose: the laser's x and y (meters) and yaw (radians).
        angles: the beams' angles in the laser's frame, radians.
        farthest: meters.
    """
    x, y, yaw = pose
    c, s = np.cos(angles + yaw)[:, None], np.sin(angles + yaw)[:, None]
    nearest = np.full(angles.shape, math.inf)
    with np.errstate(all="ignore"):
        if len(segments):
            ax, ay = segments[:, 0] - x, segments[:, 1] - y
            dx, dy = segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]
            den = c * dy - s * dx
            r, u = (ax * dy - ay * dx) / den, (ax * s - ay * c) / den
            hit = (r > 0) & (u >= -1e-12) & (u <= 1 + 1e-12)
            nearest = np.minimum(nearest, np.where(hit, r, math.inf).min(axis=1))
        if len(circles):
            ax, ay, radius = circles[:, 0] - x, circles[:, 1] - y, circles[:, 2]
            inside = radius**2 - (c * ay - s * ax) ** 2
            r = (c * ax + s * ay) - np.sqrt(inside)
            hit = (r > 0) & (inside >= 0) & (np.hypot(ax, ay) > radius)
            nearest = np.minimum(nearest, np.where(hit, r, math.inf).min(axis=1))
    return np.where(nearest > farthest, math.inf, nearest)
