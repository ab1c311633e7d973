"""Obstacles that the laser does not see: point clouds at any height, and layers of the map."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from navigation.clouds import Points, thinning
from navigation.layers import Places, on
from navigation.pose import Pose
from navigation.robot_goto.local_grid import RESOLUTION, SIDE
from navigation.robot_goto.section import RobotGotoSection

LEAST = 2  # points of a cloud in an occupied voxel: a single one may be noise
MOST, RAYS = 50_000, 10_000  # points of a cloud that are used as obstacles and as rays
_BIN = math.radians(2.0)  # rays within this angle count as one direction
_BEYOND = 0.15  # meters by which rays pass through a free voxel; more than the noise of most cameras
_NEVER = -math.inf
_AGAIN = 0.2  # seconds between two checks for old voxels if no cloud arrives


class CloudWindow:
    """Voxels of 5 cm around the robot, from the floor to its height, with the time of the last points in each.

    A voxel is free when all rays of a cloud in its direction pass through it, or after ``memory`` seconds. The lowest
    level is the floor: it is occupied if a cloud has points below it, seen through it, as at a stair, and free when a
    cloud has points on it.

    Args:
        memory: seconds.
        height: meters above which the robot touches nothing.
        step: meters above and below the floor that the wheels can drive over.
        radius: meters around the robot's center; points within it are the robot's own.
    """

    def __init__(self, memory: float, height: float, step: float, radius: float) -> None:
        self._memory, self._height, self._step, self._radius = memory, height, step, radius
        self._seen = np.full((math.ceil(height / RESOLUTION) + 1, SIDE, SIDE), _NEVER)
        self._row0 = self._column0 = 0
        self._looked, self._places = _NEVER, np.empty((0, 2))

    def add(self, now: float, points: Points, eye: NDArray[np.float64], at: Pose) -> None:
        """Add a cloud (n, 3), seen from an eye (3), in meters in the grid's frame with z above the floor.

        `at` is the robot's pose in that frame.
        """
        self._move(math.floor(at.y / RESOLUTION) - SIDE // 2, math.floor(at.x / RESOLUTION) - SIDE // 2)
        points = points[:: thinning(len(points), MOST)]
        robot = np.hypot(points[:, 0] - at.x, points[:, 1] - at.y) < self._radius
        z = points[:, 2]
        hit = np.zeros(self._seen.shape, np.bool_)
        hit[1:] = self._count_points(points[(z >= self._step) & (z < self._height) & ~robot], len(hit) - 1) >= LEAST
        hit[:1] = self._count_points(_through_floor(points[(z < -self._step) & ~robot], eye)) >= LEAST
        floor = self._count_points(points[np.abs(z) < self._step])[0] >= LEAST
        self._seen[0][floor] = _NEVER
        self._clear(points[:: thinning(len(points), RAYS)], eye, hit)
        self._seen[hit] = now
        self._looked = _NEVER

    def places(self, now: float) -> Places:
        """Return the centers of occupied columns, (n, 2) meters."""
        if 0.0 <= now - self._looked < _AGAIN:
            return self._places
        rows, columns = np.nonzero(self._seen.max(axis=0) > now - self._memory)
        cells = np.stack((columns + self._column0, rows + self._row0), axis=1).astype(np.float64)
        self._looked, self._places = now, (cells + 0.5) * RESOLUTION
        return self._places

    def _move(self, row0: int, column0: int) -> None:
        for axis, (new, old) in ((1, (row0, self._row0)), (2, (column0, self._column0))):
            moved = min(max(new - old, -SIDE), SIDE)
            if moved:
                self._seen = np.roll(self._seen, -moved, axis)
                entered = slice(SIDE - moved, SIDE) if moved > 0 else slice(0, -moved)
                self._seen[(slice(None), entered) if axis == 1 else (slice(None), slice(None), entered)] = _NEVER
        self._row0, self._column0 = row0, column0

    def _count_points(self, points: Points, levels: int = 0) -> NDArray[np.int64]:
        """Count the points in each voxel of the levels, or in each column at any height without levels."""
        x, y, z = np.floor(points.T / RESOLUTION).astype(np.int64)
        x, y, z = x - self._column0, y - self._row0, z if levels else z * 0
        count = max(levels, 1)
        within = (x >= 0) & (x < SIDE) & (y >= 0) & (y < SIDE) & (z >= 0) & (z < count)
        flat = ((z * SIDE + y) * SIDE + x)[within]
        return np.bincount(flat, minlength=count * SIDE * SIDE).reshape(count, SIDE, SIDE)

    def _clear(self, rays: Points, eye: NDArray[np.float64], hit: NDArray[np.bool_]) -> None:
        """Free the voxels that all rays in their direction pass through."""
        levels, rows, columns = np.nonzero(np.isfinite(self._seen[1:]) & ~hit[1:])
        if not len(levels) or not len(rays):
            return
        middles = (np.stack((columns + self._column0, rows + self._row0, levels), axis=1) + 0.5) * RESOLUTION
        away, directions = _polar(middles - eye)
        far, seen = _polar(rays - eye)
        nearest = np.full((round(math.tau / _BIN) + 2, round(math.pi / _BIN) + 2), math.inf)
        np.minimum.at(nearest, tuple(seen.T), far)
        # a voxel is wider than a ray: neighboring directions count, too
        around = np.min([np.roll(nearest, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)
        free = np.isfinite(nearest[tuple(directions.T)]) & (around[tuple(directions.T)] > away + _BEYOND)
        self._seen[1:][levels[free], rows[free], columns[free]] = _NEVER


def _through_floor(points: Points, eye: NDArray[np.float64]) -> Points:
    """Return where the rays from an eye above the floor to points below it cross the floor."""
    if eye[2] <= 0.0:
        return points[:0]
    share = (eye[2] / (eye[2] - points[:, 2]))[:, None]
    crossings: Points = (eye + (points - eye) * share).astype(np.float32)
    return crossings


def _polar(vectors: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.intp]]:
    """Return the lengths of vectors (n, 3), and the bins of their directions (n, 2)."""
    flat = np.hypot(vectors[:, 0], vectors[:, 1])
    azimuth, elevation = np.arctan2(vectors[:, 1], vectors[:, 0]), np.arctan2(vectors[:, 2], flat)
    numbers = np.stack(((azimuth + math.pi) / _BIN, (elevation + math.pi / 2) / _BIN), axis=1)
    return np.hypot(flat, vectors[:, 2]), numbers.astype(np.intp)


class Obstacles:
    """The obstacles of all configured sources, each with its own time-out. On one thread.

    Attributes:
        trouble: by topic, why its last message is invalid.
        silent: which layer is silent, else ""; set by the source of the layers.
    """

    def __init__(self, settings: RobotGotoSection) -> None:
        self._settings, self._sources = settings, settings.obstacles
        self._layers: dict[str, Places] = {}
        self.trouble: dict[str, str] = {}
        self.silent = ""
        self.clear()

    def clear(self) -> None:
        """Drop the points of clouds; layers stay, as they are on the map and a latched one is not published again."""
        settings = self._settings
        self._received: dict[str, float] = {}
        self._window = CloudWindow(settings.memory, settings.height, settings.max_step, 0.7 * settings.robot_radius)

    def clear_clouds(self) -> None:
        """Drop the points of clouds after the odometry has jumped, but not the clouds' time-outs."""
        received = self._received
        self.clear()
        self._received = received

    def cloud(self, topic: str, now: float, points: Points, eye: NDArray[np.float64], at: Pose) -> None:
        """Add a cloud with a time in seconds; see `CloudWindow.add`. A cloud without points is invalid."""
        if len(points):
            self._received[topic] = max(now, self._received.get(topic, -math.inf))
            self.trouble.pop(topic, None)
            self._window.add(now, points, eye, at)
        else:
            self.trouble[topic] = "the cloud has no valid points"

    def layer(self, topic: str, places: Places) -> None:
        """Replace a layer's occupied points, (n, 2) on the map."""
        self._layers[topic] = places

    def places(self, now: float, pose: Pose | None, moved: Pose) -> Places:
        """Return all obstacles, (n, 2) in the grid's frame. ``moved`` is the robot's pose there, ``pose`` on the map.

        Layers are left out while the robot's pose on the map is unknown, as it does not drive then.
        """
        parts = [self._window.places(now)] if any(source.type == "cloud" for source in self._sources) else []
        if pose is not None:
            reach = SIDE / 2 * RESOLUTION
            for places in self._layers.values():
                near = (np.abs(places - (pose.x, pose.y)) < reach * math.sqrt(2.0)).all(axis=1)
                parts.append(on(places[near], moved @ pose.inverse))
        return np.concatenate(parts) if parts else np.empty((0, 2))

    def silence(self, now: float) -> str:
        """Return which source is silent, and for how long; "" if none is."""
        for source in self._sources:
            if source.type == "layer":
                silent = "" if source.topic in self._layers else source.silent(None, now)
            else:
                silent = source.silent(self._received.get(source.topic), now)
            if silent:
                reason = self.trouble.get(source.topic)
                return silent + (f" ({reason})" if reason else "")
        return self.silent
