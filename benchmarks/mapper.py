"""Mapper2D: scans per second compared with an octomap, and the agreement of its maps with the simulator's plans.

The scans are from a tour of the simulated R1 with open doors: with true poses, and with the odometry of the shipped
configuration, which drifts by meters. For each map the rows give the share of occupied cells within two cells of a
surface, and the share of the surface in the laser's sight that the map has as occupied. With drift they also give the
error of the final pose, and the processor time. `make bench-peers` installs the peer.
"""

from __future__ import annotations

import argparse
import importlib
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.rows import Row, add_json_option, need_peers, report
from bridge.messages.scan import LaserScan
from navigation.algorithms.astar import astar
from navigation.algorithms.distance_transform import distance_transform
from navigation.algorithms.shortcut import shortcut
from navigation.algorithms.submaps import Scan
from navigation.mapper2d.drawn import DrawnMap
from navigation.mapper2d.mapper import Mapper
from navigation.mapper2d.section import Mapper2DSection
from navigation.pose import Pose, wrapped
from sim.base import Twist
from sim.export import grid as true_grid
from sim.laser_kernel import cast
from sim.plan import Plan, load_plan
from sim.section import EncodersSection, LaserSection, SimSection
from sim.simulation import Simulation
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D

Floats = NDArray[np.float64]

PLANS = ("apartment", "lab")
APART = 2.0
"""Meters between the points of a tour."""

CLEARANCE = 0.4
"""Meters between a tour and walls."""

FARTHEST = 10.0

DRIFT = EncodersSection(scale=(0.006, -0.004), noise=0.01)
"""The setting in `configs/navigation.yaml`."""

_STILL = 2.0  # seconds for which the robot stands before a tour with drift
_DENSE = 14_400  # beams with which the surface in sight is computed
_FINE = 0.01  # meters between the points of this surface


class Seen(NamedTuple):
    """A scan, its true pose, and its pose by odometry."""

    pose: Pose
    scan: LaserScan
    odometry: Pose


def empty(name: str) -> Plan:
    """Return a plan without people and without boxes that can be pushed, with open doors."""
    plan = load_plan(name)
    floors = {
        key: floor.model_copy(
            update={
                "people": (),
                "boxes": tuple(box for box in floor.boxes if box.mass is None),
                "doors": tuple(door.model_copy(update={"open": True}) for door in floor.doors),
            }
        )
        for key, floor in plan.floors.items()
    }
    return plan.model_copy(update={"floors": floors})


def tour(simulation: Simulation, seconds: float = math.inf) -> Iterator[Seen]:
    """Drive through the whole floor in lock-step, for at most ``seconds``, and yield the scans."""
    grid = true_grid(simulation.plan, simulation.floor)
    walls = grid.flags != MapFlag.FREE
    open_ = (distance_transform(walls) * grid.resolution > CLEARANCE).astype(np.uint8)
    end = simulation.time_ns + min(seconds, 1e6) * 1e9
    for place in _points(open_, round(APART / grid.resolution)):
        x, y, _ = simulation.base.pose()
        start = grid.cells_at((x, y))
        path = astar(open_, (int(start[1]), int(start[0])), place)
        if path is None:
            continue  # an unreachable corner
        for target in grid.centers_of(shortcut(open_, path.cells)[1:, ::-1]):
            for seen in _driven(simulation, *target):
                yield seen
                if simulation.time_ns >= end:
                    return


def _points(open_: NDArray[np.uint8], step: int) -> Iterator[tuple[int, int]]:
    """Yield the cells (row, column) of a lattice, back and forth; the nearest open cells replace blocked ones."""
    near = step // 3
    for turn, row in enumerate(range(step // 2, len(open_), step)):
        columns = range(step // 2, open_.shape[1], step)
        for column in columns if turn % 2 == 0 else reversed(columns):
            low_row, low_column = max(0, row - near), max(0, column - near)
            open_cells = np.argwhere(open_[low_row : row + near + 1, low_column : column + near + 1])
            if len(open_cells):
                distances = np.add(open_cells, (low_row, low_column))
                best = distances[np.abs(distances - (row, column)).sum(axis=1).argmin()]
                yield int(best[0]), int(best[1])


def _driven(simulation: Simulation, x: float, y: float) -> Iterator[Seen]:
    """Drive straight to a place, unless that takes too long, and yield each new scan."""
    last = None
    start = simulation.base.pose()
    patience = simulation.time_ns + (10.0 + math.hypot(x - start.x, y - start.y) / 0.1) * 1e9
    while simulation.time_ns < patience:
        pose = Pose(*simulation.base.pose())
        distance = math.hypot(x - pose.x, y - pose.y)
        if distance < 0.1:
            return
        off = wrapped(math.atan2(y - pose.y, x - pose.x) - pose.theta)
        ahead = 0.0 if abs(off) > 0.3 else min(0.5, distance)
        simulation.command(Twist(ahead, 0.0, max(-1.0, min(1.0, 2.0 * off))))
        simulation.tick()
        if simulation.scan is not last:
            last = simulation.scan
            if last.time_ns == simulation.time_ns:
                time_ns = simulation.time_ns
                yield Seen(Pose(*simulation.base.pose(), time_ns), last, Pose(*simulation.estimate.pose[:3], time_ns))


def mapped(scans: list[Seen], resolution: float = 0.05) -> Mapper:
    """Return the map of a tour, from the true poses."""
    mapper = Mapper(Mapper2DSection(resolution=resolution, farthest=FARTHEST))
    for pose, scan, _ in scans:
        mapper.scan(pose, scan.ranges, scan.first, scan.step, scan.farthest)
    return mapper


class Match(NamedTuple):
    """The agreement of a map with the surfaces of a floor.

    ``near``: share of the occupied cells whose middle is within two cells of a surface. ``covered``: share of the
    surface in sight that is within one cell of an occupied cell.
    """

    near: float
    covered: float


def match(grid: MapGrid2D, simulation: Simulation, poses: list[Pose]) -> Match:
    """Compare a map with the surfaces of a static floor."""
    segments, circles = simulation.world.seen()
    rows, columns = np.nonzero(grid.flags == MapFlag.WALL)
    centers = grid.centers_of(np.stack((columns, rows), -1))
    near = float((_distance(centers, segments, circles) <= 2.0 * grid.resolution).mean())
    surface = _in_sight(segments, circles, poses)
    apart = distance_transform(grid.flags == MapFlag.WALL)
    cells = grid.cells_at(surface)
    inside = (cells >= 0).all(axis=1) & (cells < (grid.width(), grid.height())).all(axis=1)
    hit = np.zeros(len(surface), np.bool_)
    hit[inside] = apart[cells[inside, 1], cells[inside, 0]] < 1.5
    return Match(near, float(hit.mean()))


def _distance(points: Floats, segments: Floats, circles: Floats) -> Floats:
    """Return each point's distance to the nearest surface, in meters."""
    best = np.full(len(points), math.inf)
    for x, y, to_x, to_y in segments:
        vector = np.array((to_x - x, to_y - y))
        along = np.clip((points - (x, y)) @ vector / max(vector @ vector, 1e-12), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - (x, y) - along[:, None] * vector, axis=1))
    for x, y, radius in circles:
        best = np.minimum(best, np.abs(np.linalg.norm(points - (x, y), axis=1) - radius))
    return best


def _in_sight(segments: Floats, circles: Floats, poses: list[Pose]) -> Floats:
    """Return the points of surface at centimeter resolution in a laser's sight from these poses, (n, 2) meters."""
    step = math.tau / _DENSE
    angles = np.arange(_DENSE) * step
    beams = np.ascontiguousarray(np.stack((np.cos(angles), np.sin(angles)), axis=1))
    left, bottom = np.array([(pose.x, pose.y) for pose in poses]).min(axis=0) - FARTHEST
    right, top = np.array([(pose.x, pose.y) for pose in poses]).max(axis=0) + FARTHEST
    out = np.empty(_DENSE)
    visible = np.zeros((round((right - left) / _FINE) + 2, round((top - bottom) / _FINE) + 2), np.bool_)
    for pose in poses:
        cast(segments, circles, pose.x, pose.y, 0.0, beams, 0.0, step, FARTHEST, out)
        hit = out <= FARTHEST
        ends = (np.array((pose.x - left, pose.y - bottom)) + out[hit, None] * beams[hit]) / _FINE
        visible[tuple(np.round(ends).astype(np.int64).T)] = True
    surface: Floats = np.argwhere(visible) * _FINE + (left, bottom)
    return surface


def quality(name: str, seconds: float = math.inf) -> tuple[Match, list[Seen]]:
    """Drive a tour, and compare its map with the plan."""
    simulation = Simulation(SimSection.model_validate({"laser": {"farthest": FARTHEST}}), empty(name))
    scans = list(tour(simulation, seconds))
    return match(mapped(scans).grid(), simulation, [seen.pose for seen in scans]), scans


class Drifted(NamedTuple):
    """A map from drifting odometry.

    ``off``, ``turned``: error of the final pose, meters and degrees. ``odometry``: the same error of the odometry,
    meters.
    ``load``: processor time as a share of the tour's time.
    """

    match: Match
    off: float
    turned: float
    odometry: float
    load: float


def drifted(name: str, seconds: float = math.inf) -> Drifted:
    """Drive a tour with the drift of the shipped encoders and a noise of 1 cm, and compare its map with the plan."""
    laser = LaserSection(farthest=FARTHEST, noise=0.01)
    simulation = Simulation(SimSection(laser=laser, encoders=DRIFT), empty(name))
    for _ in range(round(_STILL * 100)):
        simulation.tick()
    scans = list(tour(simulation, seconds))
    drawn = DrawnMap(Mapper(Mapper2DSection(farthest=FARTHEST)))
    drawn.locate(scans[0].pose)
    begin = time.process_time()
    for _, scan, odometry in scans:
        drawn.scan(odometry, Scan(scan.ranges, scan.first, scan.step, FARTHEST))
        drawn.work()
    drawn.finish()
    load = (time.process_time() - begin) / (1e-9 * (scans[-1].pose.stamp_ns - scans[0].pose.stamp_ns))
    truth, pose = scans[-1].pose, drawn.slam.pose
    by_odometry = scans[0].pose @ (scans[0].odometry.inverse @ scans[-1].odometry)
    result = match(drawn.mapper.grid(), simulation, [seen.pose for seen in scans])
    turned = abs(math.degrees(wrapped(pose.theta - truth.theta)))
    return Drifted(result, pose.distance(truth), turned, by_odometry.distance(truth), load)


def ours(scans: list[Seen]) -> float:
    """Return Mapper2D's scans per second."""
    mapped(scans[:2])  # warm up
    begin = time.perf_counter()
    mapped(scans)
    return len(scans) / (time.perf_counter() - begin)


def octomap(scans: list[Seen], seconds: float) -> float:
    """Return the peer's scans per second with the same beams, measured for about ``seconds``."""
    tree: Any = importlib.import_module("pyoctomap").OcTree(0.05)
    begin, count = time.perf_counter(), 0
    for pose, scan, _ in scans:
        angles = pose.theta + scan.first + scan.step * np.arange(scan.ranges.size)
        hit = np.isfinite(scan.ranges)
        ends = np.zeros((int(hit.sum()), 3))
        ends[:, 0] = pose.x + scan.ranges[hit] * np.cos(angles[hit])
        ends[:, 1] = pose.y + scan.ranges[hit] * np.sin(angles[hit])
        tree.insertPointCloud(ends, np.array((pose.x, pose.y, 0.0)), max_range=FARTHEST)
        count += 1
        if time.perf_counter() - begin > seconds:
            break
    return count / (time.perf_counter() - begin)


def drift_rows(name: str, seconds: float) -> list[Row]:
    """Return the rows of a tour with drift; the limits are the aims of Mapper2D."""
    result = drifted(name, seconds)
    case = f"{name}, odometry off by {result.odometry:.1f} m"
    return [
        Row(f"{case}, occupied cells within 2 cells", 100.0 * result.match.near, 99.0, "%", "more"),
        Row(f"{case}, surface in sight that is mapped", 100.0 * result.match.covered, 97.0, "%", "more"),
        Row(f"{case}, final position", 100.0 * result.off, 3.0, "cm", "less"),
        Row(f"{case}, final heading", result.turned, 0.5, "degrees", "less"),
        Row(f"{case}, processor time", 100.0 * result.load, 4.6, "% of a core", "less"),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", nargs="+", default=list(PLANS), metavar="PLAN")
    parser.add_argument(
        "--seconds", type=float, default=math.inf, help="simulated seconds of a tour (default: the whole tour)"
    )
    add_json_option(parser)
    args = parser.parse_args()
    need_peers("pyoctomap")
    rows = []
    for name in args.plans:
        match_, scans = quality(name, args.seconds)
        driven = f"{name}, {len(scans) * 0.1:.0f} s"
        rows.append(
            Row(f"{driven}, occupied cells within 2 cells of a surface", 100.0 * match_.near, 100.0, "%", "more")
        )
        rows.append(Row(f"{driven}, surface in sight that is mapped", 100.0 * match_.covered, 95.0, "%", "more"))
        rows += drift_rows(name, args.seconds)
        rows.append(Row(f"{name}, 720 beams, octomap", ours(scans), octomap(scans, 10.0), "scans/s", "more"))
    report(rows, args.json)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
