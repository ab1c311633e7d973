"""Results of each kernel for fixed inputs, for comparison between two processors.

``python -m tests.arm64.results FILE`` writes them into a file. Inputs are exact on every processor: they are integers
divided by a power of two, without NumPy's own functions, whose last bits differ by processor. Each result's name begins
with the name of its kernel.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import random
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bridge import kernels
from bridge.messages.registry import Registry
from bridge.messages.transcode import vm
from navigation.algorithms import potential_field, stopping
from navigation.algorithms.astar import astar
from navigation.algorithms.distance_transform import distance_transform
from navigation.algorithms.likelihood_field import LikelihoodField
from navigation.algorithms.occupancy import OccupancyMap
from navigation.algorithms.pose_search import PoseSearch, SearchWindow
from navigation.algorithms.shortcut import shortcut
from navigation.algorithms.voxel_leaves import leaves
from navigation.algorithms.voxel_map import VoxelMap
from navigation.maps.kernels import join
from sim import depth_kernel, laser_kernel
from tests.bags.test_split import MCAP, ROS1_TEXT, rows_, split
from tests.messages.transcode.programs import TYPES, damaged, programs
from tests.navigation.algorithms.test_rolling_grid import Window, rolling_grid
from tests.navigation.algorithms.test_voxel_layer import FAR, Room
from tests.peers.ros1 import trees
from tests.sim.test_depth_kernel import render
from tests.tf.test_kernels import run

Named = Iterator[tuple[str, Any]]
CELL = 0.0625


def exact(rng: np.random.Generator, low: float, high: float, shape: Any) -> np.ndarray:
    """Return random numbers that are equal on every processor."""
    return low + rng.integers(0, 2**20, shape) * ((high - low) / 2**20)


def grids() -> Named:
    """Plan, search and score on a grid."""
    rng = np.random.default_rng(1)
    walls = rng.integers(0, 10, (90, 120)) < 2
    distances = distance_transform(walls)
    yield "distance_transform", distances
    weights = np.where(walls, 0, 1 + rng.integers(0, 40, walls.shape)).astype(np.uint8)
    path = astar(weights, (2, 3), (85, 110))
    assert path is not None
    yield "astar.cells", path.cells
    yield "astar.length", path.length
    yield "shortcut", shortcut(weights, path.cells)
    descent = potential_field.descend(
        np.minimum(distances, 40.0).astype(np.float32), walls, (40, 60), (80.5, 100.25), None, 2.0, 8.0, 1.0
    )
    yield "potential_field.cells", descent.cells
    yield "potential_field", (descent.aim, descent.cost, descent.blocked)
    field = LikelihoodField(walls, ~walls, CELL)
    table = field.table(0.125, 0.9)
    poses, points = exact(rng, -1.0, 7.0, (40, 3)), exact(rng, -2.0, 2.0, (60, 2))
    yield "likelihood_field.distances", field.distances
    yield "likelihood_field.table", table
    yield "likelihood_field.score", field.score(table, float(table.min()), poses, points)
    for n, pose in enumerate(poses.tolist()):
        yield f"likelihood_field.agreement {n}", field.agreement(tuple(pose), points, 0.125)
    values = np.zeros(walls.shape, np.uint8)
    join(weights, walls.astype(np.uint8) * 4, values)
    yield "kernels.join", values
    yield "pose_search", PoseSearch(field, table).best(points, SearchWindow(3.0, 2.5, 0.25, 0.5, 0.5))


def scans() -> Named:
    """Map lasers and depth images, and stop before obstacles."""
    rng = np.random.default_rng(2)
    occupancy, voxels, window = OccupancyMap(80, 90, CELL, (-1.0, -1.0)), VoxelMap(CELL, 5_000), Window(rolling_grid)
    for n in range(6):
        ranges = exact(rng, 0.1, 4.0, 300)
        ranges[:: 17 + n] = (math.nan, math.inf, -math.inf, 1e300)[n % 4]
        with np.errstate(all="ignore"):
            yield f"occupancy.insert {n}", occupancy.insert((0.5, 0.25, 0.3 * n), ranges, -1.5, 0.01, 10.0)
        yield f"rolling_grid.mark {n}", window.mark(ranges, 10.0 + n)
        points = exact(rng, -2.0, 2.0, (2_000, 3)).astype(np.float32)
        x, y, z = exact(rng, -0.25, 0.25, 3).tolist()
        yield f"voxel_map.insert {n}", voxels.insert(points, (x, y, z), 3.0, 5.0)
    yield "occupancy.odds", occupancy.odds
    yield "rolling_grid.states", window.states()
    yield "voxel_map.blocks", voxels.blocks
    yield "voxel_map.values", voxels.values
    for n, leaf in enumerate(leaves(voxels.blocks, voxels.values)):
        yield f"voxel_leaves {n}", leaf
    room = Room().box(FAR, slice(10, 30), 0.7, 0.75).box(slice(10, 14), FAR, 0.0, 0.3)
    for n, column in enumerate(room.columns()):
        yield f"voxel_layer {n}", column
    yield from stops(np.ascontiguousarray(exact(rng, -3.0, 3.0, (40, 3))))


def stops(points: np.ndarray) -> Named:
    """Slow down before obstacles around a robot."""
    surroundings, blocker = np.zeros(6), np.zeros(3)
    for n in range(16):
        theta, velocity = n * 0.375, np.array((0.0625 * n, -0.03125 * n, 0.125))
        stopping.ahead(points, 40, 0.0, 0.0, theta, 0.25, 1.2, 0.8, 0.3, 0.3, 0.4, surroundings)
        share = stopping.slowed(
            points, 40, 0.0, 0.0, theta, velocity, velocity, 0.2, 0.5, 1.0, 0.25, 0.05, 0.25, 0.75, blocker
        )
        yield f"stopping.ahead {n}", surroundings
        yield f"stopping.slowed {n}", (share, *blocker.tolist())


def simulated() -> Named:
    """Render a laser and a depth camera."""
    rng = np.random.default_rng(3)
    angles = [k * math.tau / 64 - math.pi for k in range(64)]
    beams, out = np.array([(math.cos(angle), math.sin(angle)) for angle in angles]).round(9), np.zeros(64)
    segments, circles = exact(rng, -9.0, 9.0, (25, 4)), exact(rng, 0.125, 9.0, (5, 3))
    laser_kernel.cast(segments, circles, -3.0, 0.5, 0.75, beams, -math.pi, math.tau / 64, 20.0, out)
    merged = np.full(64, math.nan)
    laser_kernel.blend(out, -math.pi, math.tau / 64, 0.25, -0.125, 0.75, merged, math.tau / 64)
    yield "laser_kernel.cast", out
    yield "laser_kernel.blend", merged
    solids = [[x, y, 0.6, 0.8, 0.5, width, 0.0, 1.5] for x, y, width in exact(rng, 1.0, 4.0, (8, 3)).tolist()]
    yield "depth_kernel", render(depth_kernel, solids)
    yield "depth_kernel with drops", render(depth_kernel, solids, solids[:2], (0.5, 0.25, 1.25))


def messages() -> Named:
    """Convert whole and damaged messages, and split chunks of bags."""
    registry, dice = Registry(), random.Random(7)
    for name in TYPES:
        for which, (program, good) in enumerate(programs(registry, name)):
            machine = vm.VirtualMachine(*program.assemble(), ValueError)
            method = machine.check if program.source_cdr and program.target_cdr else machine.convert
            for n, message in enumerate((good, *(damaged(good, dice) for _ in range(60)))):
                try:
                    result = method(message)
                except ValueError as err:
                    result = err.args
                yield f"vm {name} {which} {n}", result
    for name, record in (("split_mcap", MCAP), ("split_ros1", ROS1_TEXT)):
        yield f"split.{name}", rows_(split, name, 3 * record)


def transforms() -> Named:
    """Store and look up frames, without a log line for each kind of refusal."""
    log = logging.getLogger("bridge.tf.intake")
    log.addFilter(_drop)
    try:
        for n, steps in enumerate(trees.cases(11, 60)):
            yield f"history+message {n}", run(steps, random.Random(n))
    finally:
        log.removeFilter(_drop)


def _drop(_record: logging.LogRecord) -> bool:
    return False


CASES: tuple[Callable[[], Named], ...] = (grids, scans, simulated, messages, transforms)


def results() -> dict[str, Any]:
    """Return the digest of each result, and the result's numbers or text."""
    got: dict[str, Any] = {}
    for case in CASES:
        for name, value in case():
            assert name not in got, name
            if isinstance(value, np.ndarray):
                data, values = value.tobytes(), value.ravel().tolist()
            else:
                data, values = repr(value).encode(), [repr(value)]
            got[name] = [hashlib.sha256(data).hexdigest(), values]
    return got


def differences(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> list[str]:
    """Describe each result that differs, with its first different value."""
    lines = [f"{name}: missing" for name in ours if name not in theirs]
    for name, (digest, values) in theirs.items():
        own_digest, own = ours.get(name, ("", []))
        if digest == own_digest:
            continue
        pairs = [(n, a, b) for n, (a, b) in enumerate(zip(own, values, strict=False)) if repr(a) != repr(b)]
        if len(own) != len(values):
            lines.append(f"{name}: {len(own)} values here, {len(values)} there")
        elif not pairs:
            lines.append(f"{name}: values are equal, but not their bytes (NaN)")
        else:
            n, a, b = pairs[0]
            lines.append(f"{name}: {len(pairs)} of {len(own)} values differ; value {n} is {a!r} here, {b!r} there")
    return lines


def main() -> None:
    """Write the results into a file."""
    if not kernels.state().ok:
        sys.exit(f"cannot compare kernels: {kernels.state()}")
    Path(sys.argv[1]).write_text(json.dumps(results()), encoding="utf-8")


if __name__ == "__main__":
    main()
