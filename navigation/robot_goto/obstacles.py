"""What is in the robot's way beside what its laser sees: clouds of points at any height, and layers of the map."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bridge.config.sections.planners import RobotGotoSection
from navigation.clouds import Points
from navigation.layers import Places, on
from navigation.pose import Pose
from navigation.robot_goto.local_grid import RESOLUTION, SIDE

LEAST = 2  # points of a cloud by which a voxel is occupied: one may be noise
MOST, RAYS = 50_000, 10_000  # points of a cloud that are taken for obstacles, and for rays: evenly ones of more
_BIN = math.radians(2.0)  # rays that are so near to one another look the same way
_BEYOND = 0.15  # metres that rays go on behind a voxel that is free, which is more than the noise of most cameras
_NEVER = -math.inf
_AGAIN = 0.2  # seconds after which it is looked what is too old, where no cloud comes


class CloudWindow:
    """Voxels of 5 cm around the robot, from the floor up to its height, and when a cloud had points in each last.

    A voxel is free again once all rays of a cloud that look its way go on behind it, or after ``memory`` seconds. The
    lowest level is the floor: it is occupied where a cloud has points that are lower than it, seen through it.

    Args:
        memory: seconds.
        height: metres; what is higher is not touched.
        step: metres above and below the floor that the wheels take.
        radius: metres; nothing within it of the robot's middle is an obstacle, but the robot itself.
    """

    def __init__(self, memory: float, height: float, step: float, radius: float) -> None:
        self._memory, self._height, self._step, self._radius = memory, height, step, radius
        self._seen = np.full((math.ceil(height / RESOLUTION) + 1, SIDE, SIDE), _NEVER)
        self._row0 = self._column0 = 0
        self._looked, self._places = _NEVER, np.empty((0, 2))

    def take(self, now: float, points: Points, eye: NDArray[np.float64], at: Pose) -> None:
        """Take up a cloud (n, 3) of an eye (3), metres in the grid's frame with z above the floor.

        The robot was at a pose in that frame.
        """
        self._move(math.floor(at.y / RESOLUTION) - SIDE // 2, math.floor(at.x / RESOLUTION) - SIDE // 2)
        points = thinned(points, MOST)
        own = np.hypot(points[:, 0] - at.x, points[:, 1] - at.y) < self._radius
        z = points[:, 2]
        hit = np.zeros(self._seen.shape, np.bool_)
        hit[1:] = self._counted(points[(z >= self._step) & (z < self._height) & ~own], len(hit) - 1) >= LEAST
        hit[:1] = self._counted(_through_floor(points[(z < -self._step) & ~own], eye)) >= LEAST
        floor = self._counted(points[np.abs(z) < self._step])[0] >= LEAST
        self._seen[0][floor] = _NEVER
        self._clear(thinned(points, RAYS), eye, hit)
        self._seen[hit] = now
        self._looked = _NEVER

    def places(self, now: float) -> Places:
        """(n, 2) the middles of the columns with anything in them, metres."""
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
                gone = slice(SIDE - moved, SIDE) if moved > 0 else slice(0, -moved)
                self._seen[(slice(None), gone) if axis == 1 else (slice(None), slice(None), gone)] = _NEVER
        self._row0, self._column0 = row0, column0

    def _counted(self, points: Points, levels: int = 0) -> NDArray[np.int64]:
        """How many points lie in each voxel of so many levels, or with none in each column, whatever their height."""
        x, y, z = np.floor(points.T / RESOLUTION).astype(np.int64)
        x, y, z = x - self._column0, y - self._row0, z if levels else z * 0
        count = max(levels, 1)
        within = (x >= 0) & (x < SIDE) & (y >= 0) & (y < SIDE) & (z >= 0) & (z < count)
        flat = ((z * SIDE + y) * SIDE + x)[within]
        return np.bincount(flat, minlength=count * SIDE * SIDE).reshape(count, SIDE, SIDE)

    def _clear(self, rays: Points, eye: NDArray[np.float64], hit: NDArray[np.bool_]) -> None:
        """Forget voxels behind which all rays of their direction go on."""
        levels, rows, columns = np.nonzero(np.isfinite(self._seen[1:]) & ~hit[1:])
        if not len(levels) or not len(rays):
            return
        middles = (np.stack((columns + self._column0, rows + self._row0, levels), axis=1) + 0.5) * RESOLUTION
        away, ways = _polar(middles - eye)
        far, seen = _polar(rays - eye)
        nearest = np.full((round(math.tau / _BIN) + 2, round(math.pi / _BIN) + 2), math.inf)
        np.minimum.at(nearest, tuple(seen.T), far)
        # a voxel is wider than a ray: what is seen beside it counts, too
        around = np.min([np.roll(nearest, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)
        free = np.isfinite(nearest[tuple(ways.T)]) & (around[tuple(ways.T)] > away + _BEYOND)
        self._seen[1:][levels[free], rows[free], columns[free]] = _NEVER


def thinned(points: Points, most: int) -> Points:
    """So many of the points at most, evenly; by an odd step, so that a picture's rows give not the same columns all."""
    return points[:: math.ceil(len(points) / most) | 1] if len(points) > most else points


def _through_floor(points: Points, eye: NDArray[np.float64]) -> Points:
    """Where the rays from an eye above the floor to points below it come through."""
    if eye[2] <= 0.0:
        return points[:0]
    share = (eye[2] / (eye[2] - points[:, 2]))[:, None]
    found: Points = (eye + (points - eye) * share).astype(np.float32)
    return found


def _polar(ways: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.intp]]:
    """Ways (n, 3) as their lengths, and numbers of their directions (n, 2)."""
    flat = np.hypot(ways[:, 0], ways[:, 1])
    azimuth, elevation = np.arctan2(ways[:, 1], ways[:, 0]), np.arctan2(ways[:, 2], flat)
    numbers = np.stack(((azimuth + math.pi) / _BIN, (elevation + math.pi / 2) / _BIN), axis=1)
    return np.hypot(flat, ways[:, 2]), numbers.astype(np.intp)


class Obstacles:
    """All that was said by the sources of a configuration; how old a cloud may be is theirs. On one thread.

    Attributes:
        trouble: by topic, why what it says cannot be used.
        silent: which layer says nothing any more, "" where none does; whoever gives layers sets it.
    """

    def __init__(self, settings: RobotGotoSection) -> None:
        self._settings, self._sources = settings, settings.obstacles
        self._layers: dict[str, Places] = {}
        self.trouble: dict[str, str] = {}
        self.silent = ""
        self.clear()

    def clear(self) -> None:
        """Forget what clouds showed; layers stand on the map, and a latched one is not said again."""
        settings = self._settings
        self._heard: dict[str, float] = {}
        self._window = CloudWindow(settings.memory, settings.height, settings.max_step, 0.7 * settings.robot_radius)

    def forget_places(self) -> None:
        """The odometry has jumped: what clouds showed stands somewhere else."""
        heard = self._heard
        self.clear()
        self._heard = heard

    def cloud(self, topic: str, now: float, points: Points, eye: NDArray[np.float64], at: Pose) -> None:
        """Take up a cloud that was made at seconds; see `CloudWindow.take`. One without points says nothing."""
        if len(points):
            self._heard[topic] = max(now, self._heard.get(topic, -math.inf))
            self.trouble.pop(topic, None)
            self._window.take(now, points, eye, at)
        else:
            self.trouble[topic] = "none of its points says anything"

    def layer(self, topic: str, places: Places) -> None:
        """Take up a layer's occupied places, (n, 2) on the map."""
        self._layers[topic] = places

    def places(self, now: float, pose: Pose | None, moved: Pose) -> Places:
        """(n, 2) what stands in the way, in the grid's frame, in which the robot is at ``moved``; on the map at a pose.

        Layers do not matter while it is not known where the robot is on the map: it does not drive then.
        """
        found = [self._window.places(now)] if any(one.type == "cloud" for one in self._sources) else []
        if pose is not None:
            reach = SIDE / 2 * RESOLUTION
            for places in self._layers.values():
                near = (np.abs(places - (pose.x, pose.y)) < reach * math.sqrt(2.0)).all(axis=1)
                found.append(on(places[near], moved @ pose.inverse))
        return np.concatenate(found) if found else np.empty((0, 2))

    def unheard(self, now: float) -> str:
        """Which source is silent and since when; "" where none is."""
        for source in self._sources:
            if source.type == "layer":
                silent = "" if source.topic in self._layers else source.silent(None, now)
            else:
                silent = source.silent(self._heard.get(source.topic), now)
            if silent:
                why = self.trouble.get(source.topic)
                return silent + (f" ({why})" if why else "")
        return self.silent
