"""Whether a robot that moves so can still stop before what is around it; and what lies ahead of it.

The robot is a disc. Its way is followed from the velocity that it has: for as long as it takes until another command
takes hold (reaction), it goes towards what is commanded, then it brakes; linear and angular velocity change as fast as
the base lets them. This is the dynamic window's admissibility (Fox, Burgard, Thrun 1997) with the true braking way
instead of an arc.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from bridge.messages.cache import compiled

Floats = NDArray[np.float64]

SCALES = (1.0, 0.8, 0.6, 0.45, 0.3, 0.2, 0.1, 0.05, 0.0)
_UNKNOWN = 2.0
_STEP = 0.05
_CLOSER = 1e-4
"""Metres that count as no nearer; what is allowed in each step adds up."""


def _slowed(
    points: Floats,
    count: int,
    x: float,
    y: float,
    theta: float,
    has: Floats,
    wanted: Floats,
    reaction: float,
    linear: float,
    angular: float,
    radius: float,
    slow: float,
    fast: float,
    top: float,
    blocker: Floats,
) -> float:
    """The greatest share of the wanted linear velocity with which the robot stops in time; 0 where none does.

    Args:
        points: (n, 3) x, y, and `navigation.algorithms.rolling_grid.UNKNOWN` for the middle of a cell that nobody saw.
        count: how many of them there are.
        x: of the robot, metres, in the points' frame.
        y: the same.
        theta: its heading, radians.
        has: (3) vx, vy (m/s, in the robot's frame), omega (rad/s).
        wanted: (3) the same.
        reaction: seconds for which a command holds at least.
        linear: m/s2, how fast the velocity changes.
        angular: rad/s2, the same of turning.
        radius: the robot's, metres.
        slow: what it keeps beyond its radius when it creeps, metres.
        fast: the same at its top speed.
        top: that speed, m/s.
        blocker: (3) gets the point that did not let it go faster; its third is -1 where nothing did.
    """
    blocker[2] = -1.0
    longest = math.hypot(has[0], has[1]) + math.hypot(wanted[0], wanted[1])
    reach = radius + fast + longest * (reaction + longest / linear) + 0.1
    near = np.empty((count, 4))
    kept = 0
    for i in range(count):
        away = math.hypot(points[i, 0] - x, points[i, 1] - y)
        if away < reach:
            near[kept, 0], near[kept, 1], near[kept, 2], near[kept, 3] = points[i, 0], points[i, 1], points[i, 2], away
            kept += 1
    for scale in SCALES:
        vx, vy, turn = has[0], has[1], has[2]
        to_x, to_y = wanted[0] * scale, wanted[1] * scale
        speed = max(math.hypot(vx, vy), math.hypot(to_x, to_y))
        room = radius + slow + (fast - slow) * min(1.0, speed / top)
        px, py, heading, passed = x, y, theta, 0.0
        hit = -1
        while hit < 0:
            goal_x, goal_y, goal_turn = (to_x, to_y, wanted[2]) if passed < reaction else (0.0, 0.0, 0.0)
            change = math.hypot(goal_x - vx, goal_y - vy)
            share = min(1.0, linear * _STEP / change) if change > 0.0 else 1.0
            vx, vy = vx + (goal_x - vx) * share, vy + (goal_y - vy) * share
            turn += min(angular * _STEP, max(-angular * _STEP, goal_turn - turn))
            heading += turn * _STEP
            c, s = math.cos(heading), math.sin(heading)
            px, py = px + (c * vx - s * vy) * _STEP, py + (s * vx + c * vy) * _STEP
            passed += _STEP
            for i in range(kept):
                least = room if near[i, 2] != _UNKNOWN else radius
                if near[i, 3] > least + 2.0 * reach:
                    continue
                away = math.hypot(near[i, 0] - px, near[i, 1] - py)
                if away < least and away < near[i, 3] - _CLOSER:
                    hit = i
                    break
            if passed >= reaction and abs(vx) + abs(vy) < 1e-6:
                break
        if hit < 0:
            return scale
        blocker[0], blocker[1], blocker[2] = near[hit, 0], near[hit, 1], near[hit, 2]
    return 0.0


def _ahead(
    points: Floats,
    count: int,
    x: float,
    y: float,
    theta: float,
    direction: float,
    length: float,
    half: float,
    radius: float,
    blind: float,
    found: Floats,
) -> None:
    """What is around a robot that goes in a direction (radians, of its own frame).

    ``found`` (6) gets: how many points lie in the rectangle ahead, and how many of them came lately; the nearest point
    that came lately within a half circle ahead (metres); the nearest point that lies not within ``blind`` radians of
    its front (metres), and in which direction (radians); the nearest point of all (metres).
    Points nearer than ``radius`` count as in the rectangle wherever they are ahead.
    """
    inside, came = 0, 0
    moving, aside, angle, nearest = math.inf, math.inf, 0.0, math.inf
    c, s = math.cos(theta + direction), math.sin(theta + direction)
    for i in range(count):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        away = math.hypot(dx, dy)
        along, across = c * dx + s * dy, c * dy - s * dx
        if along > 0.0 and ((along < length and abs(across) < half) or away < radius):
            inside += 1
            came += int(points[i, 2])
        if points[i, 2] and along > -0.17 * away:
            moving = min(moving, away)
        nearest = min(nearest, away)
        if away < aside:
            bearing = math.atan2(dy, dx) - theta
            bearing -= round(bearing / (2.0 * math.pi)) * 2.0 * math.pi
            if abs(bearing) > blind:
                aside, angle = away, bearing
    found[0], found[1], found[2], found[3], found[4], found[5] = inside, came, moving, aside, angle, nearest


@cache
def kernels() -> tuple[Any, Any]:
    """The compiled `_slowed` and `_ahead`."""
    size, real = numba.int64, numba.float64
    points, row = numba.types.Array(real, 2, "C"), numba.types.Array(real, 1, "C")
    here = [Path(__file__)]
    slowed = compiled(_slowed, real(points, size, *[real] * 3, row, row, *[real] * 7, row), here, nogil=True)
    ahead = compiled(_ahead, numba.void(points, size, *[real] * 8, row), here, nogil=True)
    return slowed, ahead
