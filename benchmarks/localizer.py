"""The accuracy of the localizer while the simulated R1 drives for minutes with drifting odometry.

The drive runs in lock-step, so that the figures hold on any machine. The encoders have errors of 2 and 3 percent and
noise; the laser is the R1's own, blind to the sides, with noise and lost echoes; people walk, and there are crates that
the map lacks. The peer of each figure is its limit: 0.15 m and 5 degrees over 10 minutes; the same errors after at most
60 s of driving, from starts that are wrong by 3 m and 30 degrees; and 100 ms for a scan.

    python benchmarks/localizer.py [--json FILE] [--minutes 10] [--seeds 3] [--starts 10]
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.rows import Row, add_json_option, report
from navigation.algorithms.astar import astar
from navigation.algorithms.distance_transform import distance_transform
from navigation.localization_server.localizer import Localizer
from navigation.localization_server.section import LocalizerSection
from navigation.pose import Pose, wrapped
from navigation.scan import scan_points
from sim import export
from sim.base import Twist
from sim.section import EncodersSection, LaserSection, SimSection
from sim.simulation import Simulation
from yarp_compat.dev.mapgrid import MapFlag

WORLDS = ("apartment", "lab")
DRIFT = EncodersSection(scale=(0.02, 0.03), noise=0.02)
LASER = LaserSection(kind="robot", beams=720, noise=0.01, dropouts=0.02)
METERS, DEGREES, RECOVERY = 0.15, 5.0, 60.0
_FOR_GOOD = 30.0  # seconds for which the errors must be within the limits after a recovery
_CLEAR = 0.35  # meters between the path and obstacles
_AHEAD = 0.3  # meters from a point of the path at which the robot heads for the next point
_FAR = 2.0  # minimum length of a path, meters
_PERSON = 0.8  # meters from a person ahead at which the robot stops
_STUCK = 6.0  # seconds without progress after which the robot backs up and drives to another place
_TURN_FIRST = 0.8  # radians off the path from which the robot turns in place
_CONTROL = 10
"""Ticks of 10 ms between two commands."""


class Tour:
    """Drives a simulated robot between random places by its true pose, so that the localizer has no influence.

    Args:
        there: the simulation.
        seed: seed of the places.

    Attributes:
        grid: the floor's map.
        ahead: the remaining path, meters.
    """

    def __init__(self, there: Simulation, seed: int) -> None:
        self.there = there
        self.grid = export.grid(there.plan, there.floor)
        self._rng = np.random.default_rng(seed)
        self.ahead: list[tuple[float, float]] = []
        self._moved, self._at, self._backs = 0.0, (0.0, 0.0), 0.0

    def steer(self) -> None:
        """Command the velocity along the path."""
        x, y, yaw = self.there.base.pose()
        now = self.there.time_ns / 1e9
        if math.hypot(x - self._at[0], y - self._at[1]) > 0.1:
            self._at, self._moved = (x, y), now
        if now - self._moved > _STUCK:
            self.ahead, self._moved, self._backs = [], now, now + 1.0
        while self.ahead and math.hypot(self.ahead[0][0] - x, self.ahead[0][1] - y) < _AHEAD:
            self.ahead.pop(0)
        if not self.ahead:
            self.ahead = self._next(x, y)
        to_x, to_y = self.ahead[0]
        error = wrapped(math.atan2(to_y - y, to_x - x) - yaw)
        speed = 0.3 * math.cos(error) if abs(error) < _TURN_FIRST and not self._blocked(x, y, yaw) else 0.0
        speed = -0.1 if now < self._backs else speed
        self.there.command(Twist(speed, 0.0, max(-0.5, min(0.5, 1.5 * error))))

    def _blocked(self, x: float, y: float, yaw: float) -> bool:
        """Return whether a person stands ahead."""
        return any(
            math.hypot(person.x - x, person.y - y) < _PERSON
            and abs(wrapped(math.atan2(person.y - y, person.x - x) - yaw)) < 2 * _TURN_FIRST
            for person in self.there.world.people.values()
        )

    def _next(self, x: float, y: float) -> list[tuple[float, float]]:
        """Return a path to a random distant place."""
        weights = self._weights()
        places = np.argwhere(weights > 0)
        column, row = (int(v) for v in self.grid.cells_at((x, y)))
        while True:
            goal = places[self._rng.integers(len(places))]
            path = astar(weights, (row, column), (int(goal[0]), int(goal[1])))
            if path is not None and path.length > _FAR / self.grid.resolution:
                centers = self.grid.centers_of(path.cells[::4, ::-1])
                return [(float(px), float(py)) for px, py in centers[2:]]

    def _weights(self) -> NDArray[np.uint8]:
        """Return the cost of each cell, with all obstacles, including those that the map lacks."""
        solid = self.grid.flags == MapFlag.WALL
        rows, columns = np.indices(solid.shape)
        middles = self.grid.centers_of(np.stack((columns, rows), axis=-1))
        world = self.there.world
        for piece in (*(crate.now() for crate in world.crates.values()), *world.leaves(is_open=False)):
            solid |= np.hypot(middles[..., 0] - piece.x, middles[..., 1] - piece.y) < piece.reach
        clear = distance_transform(solid) * self.grid.resolution
        free = (self.grid.flags == MapFlag.FREE) & (clear > _CLEAR)
        return np.where(free, np.where(clear > 2 * _CLEAR, 1, 4), 0).astype(np.uint8)


def simulated(world: str, seed: int) -> Simulation:
    """Return a simulation with all disturbances."""
    return Simulation(SimSection(plan=world, seed=seed, laser=LASER, encoders=DRIFT))


def drive(tour: Tour, localizer: Localizer, seconds: float, costs: list[float]) -> Iterator[tuple[float, float, float]]:
    """Drive, and yield ten times per second the time and the localizer's error (m, degrees)."""
    simulation = tour.there
    begun = simulation.time_ns
    last = -1
    for n in range(round(seconds * 100)):
        if n % _CONTROL == 0:
            tour.steer()
        simulation.tick()
        estimate = simulation.estimate
        localizer.odometry(Pose(*estimate.pose, stamp_ns=estimate.time_ns))
        if simulation.scan.time_ns == last:
            continue
        last = simulation.scan.time_ns
        points = scan_points(simulation.scan)
        clock = time.perf_counter()
        localizer.scan(last, points)
        costs.append(time.perf_counter() - clock)
        pose, truth = localizer.pose, simulation.base.pose()
        assert pose is not None
        meters = math.hypot(pose.x - truth.x, pose.y - truth.y)
        yield (simulation.time_ns - begun) / 1e9, meters, abs(math.degrees(wrapped(pose.theta - truth.yaw)))


def held(
    world: str, seed: int, minutes: float, settings: LocalizerSection
) -> tuple[np.ndarray, list[float], Localizer]:
    """Drive from the correct pose; return the errors, (n, 3): time in s, m, degrees."""
    tour = Tour(simulated(world, seed), seed)
    localizer = Localizer(tour.grid, settings, seed)
    localizer.initial(Pose(*tour.there.base.pose()))
    costs: list[float] = []
    return np.array(list(drive(tour, localizer, minutes * 60.0, costs))), costs, localizer


def recovered(world: str, seed: int, settings: LocalizerSection) -> float:
    """Return the seconds from a start wrong by 3 m and 30 degrees until the limits hold for 30 s; infinite if never."""
    rng = np.random.default_rng(1000 + seed)
    tour = Tour(simulated(world, seed), seed)
    for _ in range(round(10.0 * float(rng.random())) * 10):  # drive to a random place on the path first
        tour.steer()
        tour.there.run(0.1)
    truth = tour.there.base.pose()
    away, turned = float(rng.uniform(0.0, math.tau)), math.radians(float(rng.choice([-30.0, 30.0])))
    localizer = Localizer(tour.grid, settings, seed)
    localizer.initial(Pose(truth.x + 3.0 * math.cos(away), truth.y + 3.0 * math.sin(away), truth.yaw + turned))
    since = 0.0
    for seconds, meters, degrees in drive(tour, localizer, RECOVERY + _FOR_GOOD, []):
        if meters > METERS or degrees > DEGREES:
            since = seconds
        elif seconds - since >= _FOR_GOOD:
            return since
    return math.inf


def rows(minutes: float, seeds: int, starts: int, settings: LocalizerSection) -> Iterator[Row]:
    """Yield all rows."""
    for world in WORLDS:
        if seeds:
            yield from _held_rows(world, minutes, seeds, settings)
        if starts:
            late = [recovered(world, seed, settings) for seed in range(starts)]
            for share in (50, 90, 100):
                value = float(np.percentile(late, share, method="higher"))
                yield Row(f"{world}, {starts} wrong starts: recovered after, {share} %", value, RECOVERY, "s")


def _held_rows(world: str, minutes: float, seeds: int, settings: LocalizerSection) -> Iterator[Row]:
    runs = [held(world, seed, minutes, settings) for seed in range(seeds)]
    errors = np.concatenate([run[0] for run in runs])
    costs = np.concatenate([run[1] for run in runs]) * 1e3
    name = f"{world}, {seeds} x {minutes:g} min"
    for column, limit, unit in ((1, METERS, "m"), (2, DEGREES, "deg")):
        for share in (50, 99, 100):
            value = float(np.percentile(errors[:, column], share))
            yield Row(f"{name}: error, {f'{share} %' if share < 100 else 'maximum'}", value, limit, unit)
    for share in (50, 99, 100):
        yield Row(f"{name}: a scan, {share} %", float(np.percentile(costs, share)), 100.0, "ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_json_option(parser)
    parser.add_argument("--minutes", type=float, default=10.0, help="duration of each drive, minutes")
    parser.add_argument("--seeds", type=int, default=3, help="drives in each world")
    parser.add_argument("--starts", type=int, default=10, help="wrong starts in each world")
    options = parser.parse_args()
    report(list(rows(options.minutes, options.seeds, options.starts, LocalizerSection())), options.json)


if __name__ == "__main__":
    main()
