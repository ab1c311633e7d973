"""A grid that goes with a robot: what its laser saw last of each cell, and when.

The grid is a torus: a cell of the world has the place (row modulo side, column modulo side), so that nothing is copied
when the window moves on. Rows go along y, columns along x. Each cell has three times, in seconds: when a beam last
passed through it, when one last ended in it, and since when beams have ended there without a longer break.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from bridge.messages.cache import compiled

Floats = NDArray[np.float64]
F = TypeVar("F", bound=Callable[..., Any])
_njit: Any = numba.njit


def _part(function: F) -> F:
    """Compile a function that is called by compiled ones alone."""
    made: F = _njit(function)
    return made


FREE, OCCUPIED, UNKNOWN = 0, 1, 2
NEVER = -1e9
"""The time at which nothing was seen."""

SETTLED = 0.5
"""Seconds after its last echo in which a cell counts as left: an echo after it is something that came."""

_BLIND_BEAMS = 5
_WEDGE = 0.4

HOLD = 0.35
"""Seconds for which an echo holds against beams that pass: with noise, a wall's cells are passed now and then."""

MOVING_SECONDS = 1.0
"""How long what came counts as moving."""


@_part
def _pass(
    passed: Floats,
    ended: Floats,
    resolution: float,
    row0: int,
    column0: int,
    now: float,
    x: float,
    y: float,
    c: float,
    s: float,
    length: float,
) -> None:
    """Mark the cells of one beam as passed, up to the one before its end (Amanatides and Woo 1987)."""
    side = passed.shape[0]
    row, column = math.floor(y / resolution), math.floor(x / resolution)
    down, right = (1 if s > 0.0 else -1), (1 if c > 0.0 else -1)
    each_x = resolution / abs(c) if c != 0.0 else math.inf
    each_y = resolution / abs(s) if s != 0.0 else math.inf
    next_x = ((column + (1 if right > 0 else 0)) * resolution - x) / c if c != 0.0 else math.inf
    next_y = ((row + (1 if down > 0 else 0)) * resolution - y) / s if s != 0.0 else math.inf
    r, k = row % side, column % side
    while row0 <= row < row0 + side and column0 <= column < column0 + side:
        if ended[r, k] < now - HOLD:
            passed[r, k] = now
        if next_x < next_y:
            if next_x >= length:
                return
            column += right
            k += right
            k = 0 if k == side else side - 1 if k < 0 else k
            next_x += each_x
        else:
            if next_y >= length:
                return
            row += down
            r += down
            r = 0 if r == side else side - 1 if r < 0 else r
            next_y += each_y


@_part
def _shorten(ranges: Floats, believed: Floats, step: float, nearest: float, reach: float, aside: float) -> None:
    """Let no beam be believed farther than to what it passes nearer than ``aside``."""
    beams = ranges.shape[0]
    around = abs(beams * abs(step) - 2.0 * math.pi) < 2.0 * abs(step)
    for beam in range(beams):
        distance = ranges[beam]
        if not nearest <= distance < reach:
            continue
        for other in range(1, int(min(aside / distance, 0.8) / abs(step)) + 1):
            for place in (beam - other, beam + other):
                if around:
                    place %= beams
                if 0 <= place < beams and believed[place] > distance:
                    believed[place] = distance


@_part
def _leave_out(ranges: Floats, begins: Floats, step: float, aside: float) -> None:
    """From which distance on beams are believed: those beside a blind sector seem to pass through it at first."""
    beams = ranges.shape[0]
    around = abs(beams * abs(step) - 2.0 * math.pi) < 2.0 * abs(step)
    for way in (1, -1):
        blind, rim = 0, beams if around else 0
        for turn in range(2 * beams if around else beams):
            beam = (turn if way > 0 else -1 - turn) % beams
            if math.isnan(ranges[beam]):
                blind += 1
                rim = 0 if blind >= _BLIND_BEAMS else rim
                continue
            blind, rim = 0, rim + 1
            if rim * abs(step) < _WEDGE:
                begins[beam] = max(begins[beam], aside / (rim * abs(step)))


@_part
def _came(ended: Floats, since: Floats, row: int, column: int, row0: int, column0: int, now: float) -> float:
    """1 where something came to a cell lately, and stands not beside what has been there for longer."""
    side = ended.shape[0]
    if since[row % side, column % side] < now - MOVING_SECONDS:
        return 0.0
    for i in range(max(row - 2, row0), min(row + 3, row0 + side)):
        for k in range(max(column - 2, column0), min(column + 3, column0 + side)):
            r, c = i % side, k % side
            if ended[r, c] > now - 3.0 * SETTLED and since[r, c] < now - MOVING_SECONDS:
                return 0.0
    return 1.0


@_part
def _state(passed: float, ended: float, now: float, memory: float) -> int:
    if passed < now - memory and ended < now - memory:
        return UNKNOWN
    return OCCUPIED if ended >= passed else FREE


def _mark(
    passed: Floats,
    ended: Floats,
    since: Floats,
    resolution: float,
    row0: int,
    column0: int,
    now: float,
    x: float,
    y: float,
    theta: float,
    first: float,
    step: float,
    nearest: float,
    farthest: float,
    aside: float,
    ranges: Floats,
    points: Floats,
) -> int:
    """Take up a scan that was made at (x, y, theta); returns how many points it has within the window.

    Scans of several lasers are merged as if one stood in the middle, so that beams seem to pass through corners and
    blind sectors: one that comes nearer than ``aside`` (metres) to where another one ended is believed so far only, and
    beside a blind sector only from where it is farther than that from its rim.

    ``points`` (n, 3) gets where beams ended, x and y, and 1 where something came there lately, else 0. NaN says
    nothing; a distance below ``nearest`` neither, but minus infinity (REP 117) is something right before the laser.
    """
    side = passed.shape[0]
    count = 0
    reach = 0.5 * side * resolution * 1.4143
    for beam in range(ranges.shape[0]):
        distance = ranges[beam]
        if distance == -math.inf:
            distance = nearest
        if math.isnan(distance) or distance < nearest or distance >= farthest or distance > reach:
            continue
        angle = theta + first + beam * step
        hit_x, hit_y = x + distance * math.cos(angle), y + distance * math.sin(angle)
        row, column = math.floor(hit_y / resolution), math.floor(hit_x / resolution)
        if not (row0 <= row < row0 + side and column0 <= column < column0 + side):
            continue
        points[count, 0], points[count, 1] = hit_x, hit_y
        count += 1
        r, c = row % side, column % side
        if ended[r, c] < now - SETTLED:
            # seen free just before: something came; never seen before: it was there
            since[r, c] = now if now - passed[r, c] < MOVING_SECONDS else NEVER
        ended[r, c] = now
    believed = np.minimum(ranges, min(reach, farthest))
    begins = np.zeros(ranges.shape[0])
    _shorten(ranges, believed, step, nearest, reach, aside)
    _leave_out(ranges, begins, step, aside)
    for beam in range(ranges.shape[0]):
        distance = believed[beam]
        begin = begins[beam]
        if math.isnan(distance) or distance < nearest or begin >= distance:
            continue
        angle = theta + first + beam * step
        c, s = math.cos(angle), math.sin(angle)
        _pass(passed, ended, resolution, row0, column0, now, x + c * begin, y + s * begin, c, s, distance - begin)
    for point in range(count):
        row, column = math.floor(points[point, 1] / resolution), math.floor(points[point, 0] / resolution)
        points[point, 2] = _came(ended, since, row, column, row0, column0, now)
    return count


def _near(
    passed: Floats,
    ended: Floats,
    resolution: float,
    row0: int,
    column0: int,
    now: float,
    memory: float,
    x: float,
    y: float,
    reach: float,
    scanned: float,
    out: Floats,
) -> int:
    """The cells around a place that are not free, though no beam of the newest scan ended there.

    ``out`` (n, 3) gets their middles and `OCCUPIED` or `UNKNOWN`; returns how many. ``scanned`` is the time of the
    newest scan.
    """
    side = passed.shape[0]
    count = 0
    first_row, last_row = math.floor((y - reach) / resolution), math.floor((y + reach) / resolution)
    first_column, last_column = math.floor((x - reach) / resolution), math.floor((x + reach) / resolution)
    for row in range(max(first_row, row0), min(last_row + 1, row0 + side)):
        for column in range(max(first_column, column0), min(last_column + 1, column0 + side)):
            r, c = row % side, column % side
            if ended[r, c] == scanned:
                continue
            state = _state(passed[r, c], ended[r, c], now, memory)
            if state != FREE and count < out.shape[0]:
                out[count, 0], out[count, 1] = (column + 0.5) * resolution, (row + 0.5) * resolution
                out[count, 2] = state
                count += 1
    return count


def _states(
    passed: Floats, ended: Floats, row0: int, column0: int, now: float, memory: float, out: NDArray[np.uint8]
) -> None:
    """The whole window, laid out from its corner."""
    side = passed.shape[0]
    for row in range(side):
        r = (row + row0) % side
        for column in range(side):
            c = (column + column0) % side
            out[row, column] = _state(passed[r, c], ended[r, c], now, memory)


def _stand(
    passed: Floats, ended: Floats, resolution: float, now: float, memory: float, x: float, y: float, radius: float
) -> None:
    """Where the robot itself stands is free, unless the laser says otherwise."""
    side = passed.shape[0]
    for row in range(math.floor((y - radius) / resolution), math.floor((y + radius) / resolution) + 1):
        for column in range(math.floor((x - radius) / resolution), math.floor((x + radius) / resolution) + 1):
            dx, dy = (column + 0.5) * resolution - x, (row + 0.5) * resolution - y
            r, c = row % side, column % side
            if dx * dx + dy * dy <= radius * radius and _state(passed[r, c], ended[r, c], now, memory) == UNKNOWN:
                passed[r, c] = now


@cache
def kernels() -> tuple[Any, Any, Any, Any]:
    """The compiled `_mark`, `_near`, `_states` and `_stand`."""
    here, size, real = [Path(__file__)], numba.int64, numba.float64
    grid = numba.types.Array(real, 2, "C")
    row = numba.types.Array(real, 1, "C")
    states = numba.types.Array(numba.uint8, 2, "C")
    mark = compiled(_mark, size(grid, grid, grid, real, size, size, *[real] * 9, row, grid), here, nogil=True)
    near = compiled(_near, size(grid, grid, real, size, size, *[real] * 6, grid), here, nogil=True)
    whole = compiled(_states, numba.void(grid, grid, size, size, real, real, states), here, nogil=True)
    stand = compiled(_stand, numba.void(grid, grid, *[real] * 6), here, nogil=True)
    return mark, near, whole, stand
