"""Casts a laser's beams on segments and circles, in compiled code.

Each segment is looked at once, and only the beams that it spans are touched: the cost is that of what is near, not of
beams times segments. Distances are exact.
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

_SLACK = 1e-9
"""Beams so near to the end of a segment (in beams) are looked at as well."""


def _cast(
    segments: Floats,
    circles: Floats,
    x: float,
    y: float,
    yaw: float,
    beams: Floats,
    first: float,
    step: float,
    farthest: float,
    out: Floats,
) -> None:
    two_pi = 2.0 * math.pi
    count = beams.shape[0]
    around = round(two_pi / step)
    c, s = math.cos(yaw), math.sin(yaw)
    reach = farthest * farthest
    for i in range(count):
        out[i] = math.inf
    for k in range(segments.shape[0]):
        ax, ay = segments[k, 0] - x, segments[k, 1] - y
        bx, by = segments[k, 2] - x, segments[k, 3] - y
        dx, dy = bx - ax, by - ay
        square = dx * dx + dy * dy
        t = 0.0 if square == 0.0 else min(1.0, max(0.0, -(ax * dx + ay * dy) / square))
        nx, ny = ax + t * dx, ay + t * dy
        if nx * nx + ny * ny > reach:
            continue
        # into the laser's own frame, in which the beams' directions are known
        ax, ay, bx, by = c * ax + s * ay, c * ay - s * ax, c * bx + s * by, c * by - s * bx
        dx, dy = bx - ax, by - ay
        begin, end = math.atan2(ay, ax), math.atan2(by, bx)
        span = end - begin
        if span > math.pi:
            span -= two_pi
        elif span < -math.pi:
            span += two_pi
        if span < 0.0:
            begin, span = end, -span
        begin -= first
        begin -= math.floor(begin / two_pi) * two_pi
        cross = ax * dy - ay * dx
        for i in range(math.ceil(begin / step - _SLACK), math.floor((begin + span) / step + _SLACK) + 1):
            beam = i - around if i >= around else i
            if beam < 0 or beam >= count:
                continue
            den = beams[beam, 0] * dy - beams[beam, 1] * dx
            if den != 0.0:
                r = cross / den
                if 0.0 < r < out[beam]:
                    out[beam] = r
    for k in range(circles.shape[0]):
        ax, ay, radius = circles[k, 0] - x, circles[k, 1] - y, circles[k, 2]
        away = math.hypot(ax, ay)
        if away - radius > farthest or away <= radius:
            continue
        ax, ay = c * ax + s * ay, c * ay - s * ax
        half = math.asin(radius / away)
        begin = math.atan2(ay, ax) - half - first
        begin -= math.floor(begin / two_pi) * two_pi
        for i in range(math.ceil(begin / step - _SLACK), math.floor((begin + 2.0 * half) / step + _SLACK) + 1):
            beam = i - around if i >= around else i
            if beam < 0 or beam >= count:
                continue
            along = beams[beam, 0] * ax + beams[beam, 1] * ay
            aside = beams[beam, 0] * ay - beams[beam, 1] * ax
            inside = radius * radius - aside * aside
            if inside >= 0.0:
                r = along - math.sqrt(inside)
                if 0.0 < r < out[beam]:
                    out[beam] = r
    for i in range(count):
        if out[i] > farthest:
            out[i] = math.inf


def _blend(
    scan: Floats, first: float, step: float, at_x: float, at_y: float, turned: float, merged: Floats, merged_step: float
) -> None:
    """Put one scanner's turn into a virtual one's slots, as cerDoubleLidar does: the last one to hit a slot has it.

    ``scan`` in the scanner's own frame, NaN where it is blind; ``merged`` begins in the base's own direction.
    """
    two_pi = 2.0 * math.pi
    slots = merged.shape[0]
    for i in range(scan.shape[0]):
        r = scan[i]
        if math.isnan(r):
            continue
        angle = first + i * step + turned
        far = math.isinf(r)
        if not far:
            px, py = at_x + r * math.cos(angle), at_y + r * math.sin(angle)
            angle, r = math.atan2(py, px), math.hypot(px, py)
        angle -= math.floor(angle / two_pi) * two_pi
        slot = int(angle / merged_step)
        if slot >= slots:
            slot -= slots
        if not far or math.isnan(merged[slot]):
            merged[slot] = r


_FLOAT, _ROWS, _ROW, _NOTHING = numba.float64, numba.float64[:, ::1], numba.float64[::1], numba.void
_SOURCES = (Path(__file__),)


@cache
def cast() -> Any:
    """``cast(segments, circles, x, y, yaw, beams, first, step, farthest, out)``, compiled.

    Args of what it returns:
        segments: (n, 4) x1, y1, x2, y2, metres.
        circles: (m, 3) x, y, radius, metres; from within one it is not seen.
        x: of the laser, metres; also y, and yaw in radians.
        beams: (k, 2) cosine and sine of each beam's direction, from ``first`` by ``step`` radians.
        farthest: metres; what is beyond is infinite.
        out: (k) distances, metres.
    """
    floats = _FLOAT, _FLOAT, _FLOAT
    signature = _NOTHING(_ROWS, _ROWS, *floats, _ROWS, *floats, _ROW)
    return compiled(_cast, signature, _SOURCES, nogil=True)


@cache
def blend() -> Any:
    """`_blend`, compiled."""
    signature = _NOTHING(_ROW, _FLOAT, _FLOAT, _FLOAT, _FLOAT, _FLOAT, _ROW, _FLOAT)
    return compiled(_blend, signature, _SOURCES, nogil=True)
