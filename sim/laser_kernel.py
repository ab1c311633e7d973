"""Casts a laser's beams against segments and circles, in compiled code.

Each segment is processed once, and only for the beams that it spans, so the cost grows with the nearby segments, not
with beams times segments. Distances are exact.
"""

from __future__ import annotations

import math

import cython

if cython.compiled:
    from cython.cimports.libc.math import asin, atan2, ceil, cos, floor, isfinite, isinf, isnan, rint, sin, sqrt
else:
    from math import asin, atan2, ceil, cos, floor, isfinite, isinf, isnan, sin, sqrt

    from numpy import rint

_SLACK = cython.declare(cython.double, 1e-9)  # tolerance at the ends of a segment, in beams
_PI = cython.declare(cython.double, math.pi)
_INFINITY = cython.declare(cython.double, math.inf)
_MANY = cython.declare(cython.double, 2.0**40)  # more beams than any laser has


@cython.boundscheck(False)  # shapes are checked first, and beam numbers are within the range
@cython.wraparound(False)
@cython.initializedcheck(False)
@cython.cdivision(True)  # divisors are compared with 0 first, and the step is checked
def cast(
    segments: cython.const[cython.double][:, ::1],  # (n, 4) x1, y1, x2, y2, meters
    circles: cython.const[cython.double][:, ::1],  # (m, 3) x, y, radius, meters; not seen from inside
    x: cython.double,  # the laser's pose: x and y in meters, yaw in radians
    y: cython.double,
    yaw: cython.double,
    # (k, 2) cosine and sine of each beam's direction, from ``first`` by ``step`` radians
    beams: cython.const[cython.double][:, ::1],
    first: cython.double,  # radians
    step: cython.double,  # radians, above 0
    farthest: cython.double,  # meters; greater distances become infinite
    out: cython.double[::1],  # (k) receives the distances, meters
) -> None:
    """Compute each beam's distance. A pose that is not finite sees nothing; shapes that are not finite are ignored.

    Raises:
        ValueError: the step is not above 0, or the arrays' shapes do not fit.
    """
    two_pi: cython.double = 2.0 * _PI
    count: cython.longlong = beams.shape[0]
    cython.declare(i=cython.Py_ssize_t, k=cython.Py_ssize_t)
    cython.declare(beam=cython.longlong, part=cython.longlong)
    cython.declare(r=cython.double)
    if segments.shape[1] != 4 or circles.shape[1] != 3 or beams.shape[1] != 2 or out.shape[0] != count:
        raise ValueError("expected segments (n, 4), circles (m, 3), beams (k, 2) and an output (k)")
    if not step > 0.0:
        raise ValueError(f"beams must be more than 0 radians apart, not {step}")
    if not isfinite(x + y + yaw + first):
        out[:] = _INFINITY
        return
    with cython.nogil:
        for i in range(count):
            out[i] = _INFINITY
        around: cython.longlong = cython.cast(cython.longlong, rint(min(two_pi / step, _MANY)))
        c: cython.double = cos(yaw)
        s: cython.double = sin(yaw)
        reach: cython.double = farthest * farthest
        for k in range(segments.shape[0]):
            ax: cython.double = segments[k, 0] - x
            ay: cython.double = segments[k, 1] - y
            bx: cython.double = segments[k, 2] - x
            by: cython.double = segments[k, 3] - y
            dx: cython.double = bx - ax
            dy: cython.double = by - ay
            square: cython.double = dx * dx + dy * dy
            t: cython.double = 0.0 if square == 0.0 else min(1.0, max(0.0, -(ax * dx + ay * dy) / square))
            nx: cython.double = ax + t * dx
            ny: cython.double = ay + t * dy
            if not nx * nx + ny * ny <= reach:
                continue
            # into the laser's own frame, like the beams' directions
            ax, ay = c * ax + s * ay, c * ay - s * ax
            bx, by = c * bx + s * by, c * by - s * bx
            dx, dy = bx - ax, by - ay
            begin: cython.double = atan2(ay, ax)
            end: cython.double = atan2(by, bx)
            span: cython.double = end - begin
            if span > _PI:
                span -= two_pi
            elif span < -_PI:
                span += two_pi
            if span < 0.0:
                begin = end
                span = -span
            begin -= first
            begin -= floor(begin / two_pi) * two_pi
            cross: cython.double = ax * dy - ay * dx
            if not isfinite(cross):
                continue
            low: cython.longlong = _beam(ceil(begin / step - _SLACK), around + count)
            high: cython.longlong = _beam(floor((begin + span) / step + _SLACK), around + count)
            for part in range(2):  # the beams wrap around: after the last comes the first
                for beam in range(max(0, low - part * around), _end(high, part, around, count)):
                    den: cython.double = beams[beam, 0] * dy - beams[beam, 1] * dx
                    if den != 0.0:
                        r = cross / den
                        if 0.0 < r < out[beam]:
                            out[beam] = r
        for k in range(circles.shape[0]):
            ax = circles[k, 0] - x
            ay = circles[k, 1] - y
            radius: cython.double = circles[k, 2]
            away: cython.double = sqrt(ax * ax + ay * ay)
            if not (away - radius <= farthest and 0.0 <= radius < away and isfinite(away)):
                continue
            ax, ay = c * ax + s * ay, c * ay - s * ax
            half: cython.double = asin(radius / away)
            begin = atan2(ay, ax) - half - first
            begin -= floor(begin / two_pi) * two_pi
            low = _beam(ceil(begin / step - _SLACK), around + count)
            high = _beam(floor((begin + 2.0 * half) / step + _SLACK), around + count)
            for part in range(2):
                for beam in range(max(0, low - part * around), _end(high, part, around, count)):
                    along: cython.double = beams[beam, 0] * ax + beams[beam, 1] * ay
                    aside: cython.double = beams[beam, 0] * ay - beams[beam, 1] * ax
                    inside: cython.double = radius * radius - aside * aside
                    if inside >= 0.0:
                        r = along - sqrt(inside)
                        if 0.0 < r < out[beam]:
                            out[beam] = r
        for i in range(count):
            if out[i] > farthest:
                out[i] = _INFINITY


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _beam(value: cython.double, most: cython.longlong) -> cython.longlong:
    """Return a beam's number within 0 and ``most``; 0 for NaN."""
    if value < most:
        return cython.cast(cython.longlong, value) if value > 0.0 else 0
    return most if value >= most else 0


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _end(
    high: cython.longlong, part: cython.longlong, around: cython.longlong, count: cython.longlong
) -> cython.longlong:
    """Return the end (exclusive) of a shape's beams up to ``high``: before the wrap or, with ``part``, after it."""
    if part:
        return min(high - around + 1, count)
    return min(high + 1, around, count)


@cython.boundscheck(False)  # slots are within the range
@cython.wraparound(False)
@cython.initializedcheck(False)
@cython.cdivision(True)  # the slots' step is checked
def blend(
    scan: cython.const[cython.double][::1],  # meters, in the scanner's own frame; NaN in blind sectors
    first: cython.double,  # the first beam's angle, radians; ``step``: between beams; ``turned``: of the scanner
    step: cython.double,
    at_x: cython.double,  # position of the scanner on the base, meters; also ``at_y``
    at_y: cython.double,
    turned: cython.double,
    merged: cython.double[::1],  # meters, in the base's frame, counterclockwise from the base's front; updated
    merged_step: cython.double,  # radians between slots
) -> None:
    """Merge one scanner's scan into a virtual scanner's slots, as cerDoubleLidar does: the last hit in a slot wins.

    Raises:
        ValueError: the step between slots is not above 0.
    """
    two_pi: cython.double = 2.0 * _PI
    slots: cython.longlong = merged.shape[0]
    slot: cython.longlong
    i: cython.Py_ssize_t
    if not merged_step > 0.0:
        raise ValueError(f"slots must be more than 0 radians apart, not {merged_step}")
    with cython.nogil:
        for i in range(scan.shape[0]):
            r: cython.double = scan[i]
            angle: cython.double = first + i * step + turned
            if isnan(r) or not isfinite(angle + at_x + at_y):
                continue
            far: cython.bint = isinf(r)
            if not far:
                px: cython.double = at_x + r * cos(angle)
                py: cython.double = at_y + r * sin(angle)
                angle = atan2(py, px)
                r = sqrt(px * px + py * py)
            angle -= floor(angle / two_pi) * two_pi
            slot = _beam(angle / merged_step, 2 * slots)
            if slot >= slots:
                slot -= slots
            if 0 <= slot < slots and (not far or isnan(merged[slot])):
                merged[slot] = r
