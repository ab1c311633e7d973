"""Grid paths: Midspan's A* compared with scipy, w9-pathfinding and pyastar2d.

The peer's time is given twice: without and with the time in which it builds its graph of the grid.

w9-pathfinding and scipy find the optimum without cutting corners; pyastar2d counts a diagonal as one and cuts corners,
so its path differs. `make bench-peers` installs the peers.
"""

from __future__ import annotations

import argparse
import math
import random
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
from navigation.algorithms.astar import astar
from navigation.algorithms.shortcut import shortcut

Grid = NDArray[np.uint8]
Cell = tuple[int, int]
SIZES = (500, 1000, 4000)
MAPS = ("rooms", "maze", "random20", "random30")


class Found(NamedTuple):
    """A planner's result: seconds for its graph and for the path, the path's length in cells, number of cut corners."""

    build: float
    search: float
    length: float
    cut: int = 0


def rooms(size: int) -> Grid:
    """Return ten by ten rooms, each with a door to each neighbor."""
    dice = random.Random(1)
    grid = np.ones((size, size), np.uint8)
    step = size // 10
    walls = range(step, size - 1, step)
    for wall in walls:
        grid[wall, :] = grid[:, wall] = 0
    for wall in walls:
        for begin in range(0, size, step):
            for line in (grid[wall], grid[:, wall]):
                door = begin + dice.randrange(2, step - 4)
                line[door : door + 3] = 1
    return grid


def maze(size: int) -> Grid:
    """Return a perfect maze with corridors of three cells, carved depth first."""
    dice = random.Random(2)
    count = (size - 1) // 4
    grid = np.zeros((size, size), np.uint8)
    seen = np.zeros((count, count), bool)
    stack = [(0, 0)]
    seen[0, 0] = True
    while stack:
        row, column = stack[-1]
        grid[4 * row + 1 : 4 * row + 4, 4 * column + 1 : 4 * column + 4] = 1
        candidates = [
            (row + down, column + right)
            for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0))
            if 0 <= row + down < count and 0 <= column + right < count and not seen[row + down, column + right]
        ]
        if not candidates:
            stack.pop()
            continue
        following = dice.choice(candidates)
        seen[following] = True
        top, left = 4 * min(row, following[0]) + 1, 4 * min(column, following[1]) + 1
        bottom, right = 4 * max(row, following[0]) + 4, 4 * max(column, following[1]) + 4
        grid[top:bottom, left:right] = 1
        stack.append(following)
    return grid


def scattered(size: int, share: float) -> Grid:
    """Return random obstacles, none near the two ends."""
    grid = (np.random.default_rng(3).random((size, size)) >= share).astype(np.uint8)
    grid[:4, :4] = grid[-6:, -6:] = 1
    return grid


def ends(name: str, size: int) -> tuple[Cell, Cell]:
    """Return opposite corners."""
    last = 4 * ((size - 1) // 4) - 2 if name == "maze" else size - 3
    return (2, 2), (last, last)


def make_map(name: str, size: int) -> Grid:
    """Return a map by its name."""
    if name.startswith("random"):
        return scattered(size, int(name.removeprefix("random")) / 100.0)
    return rooms(size) if name == "rooms" else maze(size)


def ours(grid: Grid, start: Cell, goal: Cell) -> Found:
    """Plan with Midspan's A*, which builds no graph."""
    begin = time.perf_counter()
    path = astar(grid, start, goal)
    seconds = time.perf_counter() - begin
    return Found(0.0, seconds, math.nan if path is None else path.length)


def by_scipy(grid: Grid, start: Cell, goal: Cell) -> Found:
    """Plan with Dijkstra on a sparse matrix, without cutting corners."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import dijkstra

    begin = time.perf_counter()
    rows, columns = grid.shape
    number = np.arange(grid.size).reshape(grid.shape)
    free = grid > 0
    sources, targets, costs = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        tails = (slice(0, rows - down), slice(max(0, -right), columns - max(0, right)))
        heads = (slice(down, rows), slice(max(0, right), columns + min(0, right)))
        open_ = free[tails] & free[heads]
        if down and right:
            open_ &= free[tails[0], heads[1]] & free[heads[0], tails[1]]
        sources.append(number[tails][open_])
        targets.append(number[heads][open_])
        costs.append(np.full(int(open_.sum()), math.hypot(down, right)))
    graph = csr_matrix(
        (np.concatenate(costs), (np.concatenate(sources), np.concatenate(targets))), shape=(grid.size, grid.size)
    )
    built = time.perf_counter()
    distances = dijkstra(graph, directed=False, indices=number[start])
    return Found(built - begin, time.perf_counter() - built, float(distances[number[goal]]))


def by_w9(grid: Grid, start: Cell, goal: Cell) -> Found:
    """Plan with A* in C++, without cutting corners."""
    from w9_pathfinding.envs import DiagonalMovement
    from w9_pathfinding.envs import Grid as Environment
    from w9_pathfinding.pf import AStar

    begin = time.perf_counter()
    env: Any = Environment(
        np.where(grid > 0, grid.astype(float), -1.0).tolist(),
        diagonal_movement=DiagonalMovement.only_when_no_obstacle,
        diagonal_movement_cost_multiplier=math.sqrt(2.0),
    )
    finder = AStar(env)
    built = time.perf_counter()
    path = finder.find_path(start[::-1], goal[::-1])
    return Found(built - begin, time.perf_counter() - built, length(path))


def by_pyastar2d(grid: Grid, start: Cell, goal: Cell) -> Found:
    """Plan with A* in C++, where a diagonal counts as one, and corners are cut."""
    import pyastar2d

    begin = time.perf_counter()
    weights = np.where(grid > 0, grid, np.inf).astype(np.float32)
    built = time.perf_counter()
    path = pyastar2d.astar_path(weights, start, goal, allow_diagonal=True)
    return Found(built - begin, time.perf_counter() - built, length(path), corners_cut(grid, path))


def length(path: Any) -> float:
    """Return the length of a path in cells, with a diagonal as the square root of two."""
    steps = np.abs(np.diff(np.asarray(path), axis=0)).sum(axis=1)
    return float((steps == 1).sum() + math.sqrt(2.0) * (steps == 2).sum())


def corners_cut(grid: Grid, path: Any) -> int:
    """Return the number of diagonal steps of a path past an occupied cell."""
    steps_from, steps_to = np.asarray(path)[:-1], np.asarray(path)[1:]
    diagonal = (steps_from != steps_to).all(axis=1)
    beside = (grid[steps_from[:, 0], steps_to[:, 1]] > 0) & (grid[steps_to[:, 0], steps_from[:, 1]] > 0)
    return int((diagonal & ~beside).sum())


def smoothed(grid: Grid, start: Cell, goal: Cell) -> float:
    """Return the seconds for a path and its waypoints."""
    begin = time.perf_counter()
    path = astar(grid, start, goal)
    assert path is not None
    shortcut(grid, path.cells)
    return time.perf_counter() - begin


PEERS = {"scipy": by_scipy, "w9-pathfinding": by_w9, "pyastar2d": by_pyastar2d}


def measured(sizes: list[int], maps: list[str], rounds: int) -> Iterator[Row]:
    """Yield all rows: the best of several rounds of each, in turns."""
    for size in sizes:
        for name in maps:
            grid, (start, goal) = make_map(name, size), ends(name, size)
            ours(grid, start, goal)  # allocates the memory
            smoothed(grid, start, goal)
            peer_results: dict[str, list[Found]] = {peer: [] for peer in PEERS}
            own_results: list[Found] = []
            whole: list[float] = []
            for _ in range(rounds):
                own_results.append(ours(grid, start, goal))
                whole.append(smoothed(grid, start, goal))
                for peer, plan in PEERS.items():
                    peer_results[peer].append(plan(grid, start, goal))
            mine = min(result.search for result in own_results)
            for peer, all_ in peer_results.items():
                search = min(result.search for result in all_)
                built = min(result.build + result.search for result in all_)
                yield Row(f"{name} {size}, {peer}", 1e3 * mine, 1e3 * search, "ms")
                yield Row(f"{name} {size}, {peer} with its graph", 1e3 * mine, 1e3 * built, "ms")
                yield Row(f"{name} {size}, length to {peer}", own_results[0].length, all_[0].length, "cells")
                if all_[0].cut:
                    yield Row(f"{name} {size}, corners cut to {peer}", 0, all_[0].cut, "steps")
            yield Row(f"{name} {size}, with waypoints to without", 1e3 * min(whole), 1e3 * mine, "ms")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES), metavar="CELLS")
    parser.add_argument("--maps", choices=MAPS, nargs="+", default=list(MAPS))
    parser.add_argument("--rounds", type=int, default=3)
    add_json_option(parser)
    args = parser.parse_args()
    need_peers("scipy", "w9_pathfinding", "pyastar2d")
    report(list(measured(args.sizes, args.maps, max(1, args.rounds))), args.json)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
