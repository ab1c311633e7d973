# cython: boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
# Each kernel checks its arrays' shapes first. Indices of points are below their number, which `slowed` determines for
# `_struck`; divisors are compared with 0 before each division, or are a full turn.
"""Whether a moving robot can still stop before the obstacles around it, and which obstacles are ahead.

The robot is a disc. Its path is simulated from its current velocity: until the next command takes effect (reaction),
the velocity approaches the commanded one, then the robot brakes; linear and angular velocity change as fast as the base
allows. This is the dynamic window's admissibility (Fox, Burgard, Thrun 1997) with the true braking path instead of an
arc.
"""

from __future__ import annotations

import math

import cython
import numpy as np

if cython.compiled:
    from cython.cimports.libc.math import atan2, cos, isfinite, rint, sin, sqrt
else:
    from math import atan2, cos, isfinite, sin, sqrt

    from numpy import rint

# shares of the wanted velocity that are tried
_SCALES = cython.declare(cython.double[9], [1.0, 0.8, 0.6, 0.45, 0.3, 0.2, 0.1, 0.05, 0.0])
_UNKNOWN = cython.declare(cython.double, 2.0)
_STEP = cython.declare(cython.double, 0.05)  # seconds
_CLOSER = cython.declare(cython.double, 1e-4)  # meters; a smaller approach is tolerated, and adds up over commands
_LONGEST = cython.declare(cython.double, 600.0)
"""Seconds for which the path to a stop is simulated; a robot that needs longer must not move."""

_FASTEST = cython.declare(cython.double, 1e100)
"""A speed whose square is not infinite, m/s; a faster robot must not move."""

_PI = cython.declare(cython.double, math.pi)
_INFINITY = cython.declare(cython.double, math.inf)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _length(x: cython.double, y: cython.double) -> cython.double:
    """Return a vector's length; libm's ``hypot`` rounds differently on x86-64 and arm64."""
    return sqrt(x * x + y * y)


def slowed(
    # (n, 3) x, y, and `navigation.algorithms.rolling_grid.UNKNOWN` for the center of an unseen cell
    points: cython.const[cython.double][:, ::1],
    count: cython.Py_ssize_t,  # the number of points
    x: cython.double,  # the robot's position in the points' frame, meters
    y: cython.double,  # the same
    theta: cython.double,  # the robot's heading, radians
    has: cython.const[cython.double][::1],  # (3) current vx, vy (m/s, in the robot's frame), omega (rad/s)
    wanted: cython.const[cython.double][::1],  # (3) the same, as commanded
    reaction: cython.double,  # the minimum duration of a command, seconds
    linear: cython.double,  # acceleration, m/s2
    angular: cython.double,  # angular acceleration, rad/s2
    radius: cython.double,  # the robot's radius, meters
    slow: cython.double,  # clearance beyond the radius when creeping, meters
    fast: cython.double,  # clearance at the top speed
    top: cython.double,  # the top speed, m/s
    blocker: cython.double[::1],  # (3) receives the point that limits the speed; the third value is -1 without one
) -> float:
    """Return the largest share of the wanted linear velocity with which the robot can stop in time.

    The share is 0 if the robot cannot stop in time at any speed, if a relevant number is not finite, or if braking is
    impossible or takes too long.

    Raises:
        ValueError: the arrays do not fit.
    """
    if not (0 <= count <= points.shape[0] and points.shape[1] == 3):
        raise ValueError(f"points must be (n, 3) with at least {count} rows")
    if has.shape[0] != 3 or wanted.shape[0] != 3 or blocker.shape[0] != 3:
        raise ValueError("velocities and blocker must have three numbers")
    near: cython.double[:, ::1] = np.empty((count, 4))
    kept: cython.Py_ssize_t = 0
    cython.declare(i=cython.Py_ssize_t, k=cython.Py_ssize_t)
    scale: cython.double = 0.0
    blocker[2] = -1.0
    longest: cython.double = _length(has[0], has[1]) + _length(wanted[0], wanted[1])
    numbers: cython.double = x + y + theta + has[2] + wanted[2] + angular + radius + slow + fast
    if not (isfinite(numbers) and linear > 0.0):
        return 0.0
    stops: cython.double = reaction + longest / linear
    if not (stops < _LONGEST and longest < _FASTEST):
        return 0.0
    with cython.nogil:
        reach: cython.double = radius + fast + longest * stops + 0.1
        for i in range(count):
            away: cython.double = _length(points[i, 0] - x, points[i, 1] - y)
            if away < reach:
                near[kept, 0] = points[i, 0]
                near[kept, 1] = points[i, 1]
                near[kept, 2] = points[i, 2]
                near[kept, 3] = away
                kept += 1
        for k in range(9):
            scale = _SCALES[k]
            hit: cython.Py_ssize_t = _struck(
                near, kept, x, y, theta, has, scale * wanted[0], scale * wanted[1], wanted[2],
                reaction, linear, angular, radius, slow, fast, top,
            )  # fmt: skip
            if hit < 0:
                break
            blocker[0] = near[hit, 0]
            blocker[1] = near[hit, 1]
            blocker[2] = near[hit, 2]
    return scale


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _struck(
    near: cython.const[cython.double][:, ::1],
    count: cython.Py_ssize_t,
    x: cython.double,
    y: cython.double,
    heading: cython.double,
    has: cython.const[cython.double][::1],
    to_x: cython.double,
    to_y: cython.double,
    to_turn: cython.double,
    reaction: cython.double,
    linear: cython.double,
    angular: cython.double,
    radius: cython.double,
    slow: cython.double,
    fast: cython.double,
    top: cython.double,
) -> cython.Py_ssize_t:
    """Return the index of the first point that the robot comes too close to with a command, or -1.

    ``near`` (n, 4) is x, y, `_UNKNOWN` or not, and the current distance; the other parameters are those of `slowed`.
    """
    vx: cython.double = has[0]
    vy: cython.double = has[1]
    turn: cython.double = has[2]
    speed: cython.double = max(_length(vx, vy), _length(to_x, to_y))
    room: cython.double = radius + slow + (fast - slow) * (min(1.0, speed / top) if top > 0.0 else 1.0)
    passed: cython.double = 0.0
    i: cython.Py_ssize_t
    while passed < reaction or abs(vx) + abs(vy) >= 1e-6 or passed == 0.0:
        if passed >= reaction:
            to_x = to_y = to_turn = 0.0
        change: cython.double = _length(to_x - vx, to_y - vy)
        share: cython.double = min(1.0, linear * _STEP / change) if change > 0.0 else 1.0
        vx = vx + (to_x - vx) * share
        vy = vy + (to_y - vy) * share
        turn += min(angular * _STEP, max(-angular * _STEP, to_turn - turn))
        heading += turn * _STEP
        c: cython.double = cos(heading)
        s: cython.double = sin(heading)
        x = x + (c * vx - s * vy) * _STEP
        y = y + (s * vx + c * vy) * _STEP
        passed += _STEP
        for i in range(count):
            least: cython.double = room if near[i, 2] != _UNKNOWN else radius
            away: cython.double = _length(near[i, 0] - x, near[i, 1] - y)
            if away < least and away < near[i, 3] - _CLOSER:
                return i
    return -1


def ahead(
    points: cython.const[cython.double][:, ::1],
    count: cython.Py_ssize_t,
    x: cython.double,
    y: cython.double,
    theta: cython.double,
    direction: cython.double,
    length: cython.double,
    end: cython.double,
    half: cython.double,
    radius: cython.double,
    blind: cython.double,
    found: cython.double[::1],
) -> None:
    """Measure the surroundings of a robot that drives in a direction (radians, in its own frame).

    ``points`` are (n, 3): x, y, and 1 for a new object, else 0; the pose is in the same frame. The rectangle ahead is
    ``length`` meters long, with ``half`` its width; points ahead that are nearer than ``radius`` count as inside. The
    drive ends after ``end`` meters: beyond this place, only points closer to it than ``half`` are inside, since the
    robot may turn there.

    ``found`` (6) receives: the number of points in the rectangle, and of new ones among them; the distance of the
    nearest new point within 100 degrees of the direction (meters); the distance of the nearest point that is more than
    ``blind`` radians from the robot's front (meters), and its direction (radians, from the front); the distance of the
    nearest point (meters).
    Raises `ValueError` if the pose or the direction is not finite, or the arrays do not fit.
    """
    inside: cython.Py_ssize_t = 0
    arrived: cython.Py_ssize_t = 0
    i: cython.Py_ssize_t
    if not (0 <= count <= points.shape[0] and points.shape[1] == 3 and found.shape[0] == 6):
        raise ValueError(f"points must be (n, 3) with at least {count} rows, and found six numbers")
    if not isfinite(x + y + theta + direction):
        raise ValueError(f"pose and direction must be finite, not {x}, {y}, {theta} and {direction}")
    with cython.nogil:
        moving: cython.double = _INFINITY
        aside: cython.double = _INFINITY
        nearest: cython.double = _INFINITY
        angle: cython.double = 0.0
        c: cython.double = cos(theta + direction)
        s: cython.double = sin(theta + direction)
        for i in range(count):
            dx: cython.double = points[i, 0] - x
            dy: cython.double = points[i, 1] - y
            away: cython.double = _length(dx, dy)
            along: cython.double = c * dx + s * dy
            across: cython.double = c * dy - s * dx
            lately: cython.bint = points[i, 2] != 0.0
            swept: cython.bint = along < length and abs(across) < half
            if swept and along > end:
                swept = _length(along - end, across) < half
            if along > 0.0 and (swept or away < radius):
                inside += 1
                arrived += lately
            if lately and along > -0.17 * away:
                moving = min(moving, away)
            nearest = min(nearest, away)
            if away < aside:
                bearing: cython.double = atan2(dy, dx) - theta
                bearing -= rint(bearing / (2.0 * _PI)) * 2.0 * _PI
                if abs(bearing) > blind:
                    aside = away
                    angle = bearing
        found[0] = inside
        found[1] = arrived
        found[2] = moving
        found[3] = aside
        found[4] = angle
        found[5] = nearest
