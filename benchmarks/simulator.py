"""The cost of the simulator: the base with a laser among many walls compared with the bare base; scans and pictures.

The peer of the real-time factor is the bare loop of `World.step` of the same base on an empty floor, with the same
commands. The peers of laser and depth camera are DART's own ray casts (with Bullet) on the same walls. The peer of the
camera's share of a core is its picture without noise and points.

    python benchmarks/simulator.py [--json FILE] [--quick]
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.rows import Row, add_json_option, report
from sim import bodies
from sim.base import STEP_NS, Twist
from sim.depth import DepthCamera
from sim.environment import dartpy
from sim.laser_kernel import cast
from sim.plan import Box, Floor, Plan
from sim.section import CameraSection, LaserSection, SimSection
from sim.simulation import Simulation

BEAMS = 1600
WALLS = (50, 500, 2000)
_TURN = 0.4  # rad/s
_RAYS = 100  # DART casts one ray for this many pixels


def plan(count: int) -> Plan:
    """Return a plan whose size grows with the number of its walls, with space for a circle in the middle."""
    rng = np.random.default_rng(count)
    half = 10.0 * math.sqrt(count / 50)
    boxes: list[Box] = []
    while len(boxes) < count:
        x, y = rng.uniform(-half, half, 2)
        if math.hypot(x, y) > 1.8:
            degrees = float(rng.choice([0.0, 90.0]))
            boxes.append(Box(at=(float(x), float(y), degrees), size=(float(rng.uniform(0.5, 2)), 0.1, 2.0)))
    return Plan(name="walls", floors={"walls": Floor(boxes=tuple(boxes))})


def simulation(count: int) -> Simulation:
    """Return the base with a laser of 1,600 beams at 10 Hz among a number of walls."""
    laser = LaserSection(beams=BEAMS, rate=10.0, noise=0.005)
    return Simulation(SimSection(laser=laser), plan(count))


def drive(sim: Simulation, seconds: float) -> None:
    """Drive in circles."""
    for _ in range(round(seconds * 10)):
        sim.command(Twist(0.25, 0.0, _TURN))
        sim.run(0.1)


def bare(sim: Simulation, seconds: float) -> None:
    """Drive the same base in the same circles, with only DART steps and constant wheel commands."""
    step, base = sim.world.step, sim.base
    base.turn((base.matrix(0.16416, 0.338) @ (0.25, 0.0, _TURN)).tolist())
    step(round(seconds * 1e9 / STEP_NS))


def factor(run: Callable[[Simulation, float], None], sim: Simulation, seconds: float) -> tuple[float, float]:
    """Return simulated seconds per second of processor time, and of real time; the best of three."""
    run(sim, 1.0)
    best = (0.0, 0.0)
    for _ in range(3):
        cpu, wall = time.process_time(), time.perf_counter()
        run(sim, seconds)
        best = max(best, (seconds / (time.process_time() - cpu), seconds / (time.perf_counter() - wall)))
    return best


def scans(count: int, seconds: float) -> tuple[float, float]:
    """Return scans per second, by Midspan and by DART's rays."""
    sim = simulation(count)
    segments, circles = sim.world.seen()
    step = 2 * math.pi / BEAMS
    angles = -math.pi + np.arange(BEAMS) * step
    beams = np.ascontiguousarray(np.stack([np.cos(angles), np.sin(angles)], axis=1))
    out = np.empty(BEAMS)
    ours = rate(lambda: cast(segments, circles, 0.1, 0.2, 0.3, beams, -math.pi, step, 20.0, out), seconds)
    dart = dartpy()
    skeleton, nodes = bodies.fixed(sim.world.pieces)
    group = dart.collision.BulletCollisionDetector().createCollisionGroup()
    group.addShapeFrames(nodes)
    start = [0.1, 0.2, 0.5]
    ends = [[0.1 + 20 * math.cos(a + 0.3), 0.2 + 20 * math.sin(a + 0.3), 0.5] for a in angles]

    def rays() -> None:
        for end in ends:
            group.raycast(start, end, dart.collision.RaycastOption(), dart.collision.RaycastResult())

    theirs = rate(rays, seconds)
    assert skeleton.getNumBodyNodes() == 1
    return ours, theirs


def pictures(count: int, seconds: float) -> tuple[float, float]:
    """Return depth pictures without noise per second, by Midspan and by DART's rays (only every hundredth is cast)."""
    sim = simulation(count)
    camera = DepthCamera(CameraSection(rate=5.0, noise=0.0), 0)
    solids, drops, at = sim.world.solids(), sim.world.drops, sim.base.pose()
    ours = rate(lambda: camera.picture(0, at, solids, drops), seconds)
    dart = dartpy()
    skeleton, nodes = bodies.fixed(sim.world.pieces)
    group = dart.collision.BulletCollisionDetector().createCollisionGroup()
    group.addShapeFrames(nodes)
    turned, eye = camera.optical_frame(at)
    some = np.ones((camera.size[1], camera.size[0]), np.float32)
    ends = eye + 10.0 * camera.points(some).reshape(-1, 3)[::_RAYS] @ turned.T

    def rays() -> None:
        for end in ends:
            group.raycast(eye, end, dart.collision.RaycastOption(), dart.collision.RaycastResult())

    theirs = rate(rays, seconds) / _RAYS
    assert skeleton.getNumBodyNodes() == 1
    return ours, theirs


def shares(name: str, seconds: float) -> list[Row]:
    """Return the load of pictures at 5 Hz with noise and points, compared with only the pictures."""
    sim = Simulation(SimSection(plan=name))
    solids, drops, at = sim.world.solids(), sim.world.drops, sim.base.pose()
    bare, whole = (DepthCamera(CameraSection(rate=5.0, noise=noise), 0) for noise in (0.0, 0.08))
    ours = rate(lambda: whole.points(whole.picture(0, at, solids, drops)), seconds)
    peer = rate(lambda: bare.picture(0, at, solids, drops), seconds)
    return [Row(f"share of a core, depth with noise and points at 5 Hz, {name}", 500 / ours, 500 / peer, "%", "less")]


def rate(do: Callable[[], Any], seconds: float) -> float:
    """Return how often per second a function can be called."""
    do()
    count, began = 0, time.perf_counter()
    while time.perf_counter() - began < seconds:
        do()
        count += 1
    return count / (time.perf_counter() - began)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="measure for a tenth of the time")
    add_json_option(parser)
    args = parser.parse_args()
    seconds = 4.0 if args.quick else 30.0
    empty = Simulation(SimSection(), Plan(name="empty", floors={"empty": Floor()}))
    peer, _ = factor(bare, empty, seconds)
    rows = []
    for count in WALLS:
        ours, _ = factor(drive, simulation(count), seconds)
        rows.append(Row(f"real-time factor, {count} walls, {BEAMS} beams at 10 Hz", ours, peer, "x", "more"))
        rows.append(Row(f"share of a core at real time, {count} walls", 100 / ours, 100 / peer, "%", "less"))
    for count in WALLS:
        mine, theirs = scans(count, seconds / 15)
        rows.append(Row(f"laser scans, {count} walls, {BEAMS} beams", mine, theirs, "1/s", "more"))
    for count in WALLS:
        mine, theirs = pictures(count, seconds / 15)
        rows.append(Row(f"depth pictures, {count} walls, 640 x 480", mine, theirs, "1/s", "more"))
    for name in ("apartment", "tables"):
        rows += shares(name, seconds / 15)
    report(rows, args.json)


if __name__ == "__main__":
    main()
