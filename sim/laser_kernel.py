"""Casts a laser's beams on segments and circles, in compiled code.

Each segment is looked at once, and only the beams that it spans are touched: the cost is that of what is near, not of
beams times segments. Distances are exact.
"""

from __future__ import annotations

import math

import cython

if cython.compiled:
    from cython.cimports.libc.math import asin, atan2, ceil, cos, floor, hypot, isfinite, isinf, isnan, rint, sin, sqrt
else:
    from math import asin, atan2, ceil, cos, floor, isfinite, isinf, isnan, sin, sqrt

    from numpy import hypot, rint  # Python's own hypot rounds otherwise than C's

_SLACK = cython.declare(cython.double, 1e-9)  # beams so near to the end of a segment (in beams) are looked at as well
_PI = cython.declare(cython.double, math.pi)
_INFINITY = cython.declare(cython.double, math.inf)
_MANY = cython.declare(cython.double, 2.0**40)  # no laser has so many beams


@cython.boundscheck(False)  # shapes are checked first, and beams are counted from 0 to their number
@cython.wraparound(False)
@cython.initializedcheck(False)
@cython.cdivision(True)  # by what is compared with 0 before, and by the step, which is checked
def cast(
    segments: cython.const[cython.double][:, ::1],  # (n, 4) x1, y1, x2, y2, metres
    circles: cython.const[cython.double][:, ::1],  # (m, 3) x, y, radius, metres; from within one it is not seen
    x: cython.double,  # of the laser, metres; also y, and yaw in radians
    y: cython.double,  # likewise
    yaw: cython.double,  # likewise
    # (k, 2) cosine and sine of each beam's direction, from ``first`` by ``step`` radians
    beams: cython.const[cython.double][:, ::1],
    first: cython.double,  # radians
    step: cython.double,  # radians, above 0
    farthest: cython.double,  # metres; what is beyond is infinite
    out: cython.double[::1],  # (k) gets the distances, metres
) -> None:
    """Measure each beam's distance. From a pose that is not finite nothing is seen, nor is a shape that is not.

    Raises:
        ValueError: there is no step, or the arrays do not fit.
    """
    two_pi: cython.double = 2.0 * _PI
    count: cython.longlong = beams.shape[0]
    cython.declare(i=cython.Py_ssize_t, k=cython.Py_ssize_t)
    cython.declare(beam=cython.longlong, part=cython.longlong)
    cython.declare(r=cython.double)
    if segments.shape[1] != 4 or circles.shape[1] != 3 or beams.shape[1] != 2 or out.shape[0] != count:
        raise ValueError("a laser looks at segments (n, 4) and circles (m, 3) by beams (k, 2)")
    if not step > 0.0:
        raise ValueError(f"a laser's beams are more than 0 radians apart, not {step}")
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
            # into the laser's own frame, in which the beams' directions are known
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
            for part in range(2):  # from the last beam it goes on with the first
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
            away: cython.double = hypot(ax, ay)
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
    """A beam's number, or the one behind all of them; for what is no number the first."""
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
    """Behind the last beam of a turn's first or second part, where ``high`` is the last one that a shape spans."""
    if part:
        return min(high - around + 1, count)
    return min(high + 1, around, count)


@cython.boundscheck(False)  # a beam's slot is looked up where there is one
@cython.wraparound(False)
@cython.initializedcheck(False)
@cython.cdivision(True)  # by the slots' step, which is checked
def blend(
    scan: cython.const[cython.double][::1],  # metres, in the scanner's own frame; NaN where it is blind
    first: cython.double,  # of its beams, radians; also ``step`` and, on the base, ``turned``
    step: cython.double,  # likewise
    at_x: cython.double,  # of the scanner on the base, metres; also ``at_y``
    at_y: cython.double,  # likewise
    turned: cython.double,  # likewise
    merged: cython.double[::1],  # metres, in the base's frame, beginning in its own direction; changed
    merged_step: cython.double,  # radians from one of its slots to the next
) -> None:
    """Put one scanner's turn into a virtual one's slots, as cerDoubleLidar does: the last one to hit a slot has it.

    Raises:
        ValueError: there is no step between slots.
    """
    two_pi: cython.double = 2.0 * _PI
    slots: cython.longlong = merged.shape[0]
    slot: cython.longlong
    i: cython.Py_ssize_t
    if not merged_step > 0.0:
        raise ValueError(f"slots are more than 0 radians apart, not {merged_step}")
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
                r = hypot(px, py)
            angle -= floor(angle / two_pi) * two_pi
            slot = _beam(angle / merged_step, 2 * slots)
            if slot >= slots:
                slot -= slots
            if 0 <= slot < slots and (not far or isnan(merged[slot])):
                merged[slot] = r
