"""Casts a depth camera's rays against upright boxes and cylinders and the floor, in compiled code.

A ray's direction has length 1 along the camera's axis, so that the ray parameter of a hit is its depth. Each solid is
processed once, and only for the pixels in the bounding rectangle of its outline. Depths are exact.
"""

from __future__ import annotations

import math

import cython

if cython.compiled:
    from cython.cimports.libc.math import isfinite, sqrt
else:
    from math import isfinite, sqrt

_INFINITY = cython.declare(cython.double, math.inf)
_NEAR = cython.declare(cython.double, 1e-3)  # near plane for the projection of outlines, meters
_PARALLEL = cython.declare(cython.double, 1e-12)


@cython.boundscheck(False)  # shapes are checked first, and pixels are clipped to the picture
@cython.wraparound(False)
@cython.initializedcheck(False)
@cython.cdivision(True)  # divisors are compared with 0 first, and focal lengths are checked
def render(
    # (n, 8) x, y of the middle, cosine and sine of the yaw, half length, half width (0: a cylinder with the half length
    # as its radius), lowest and highest z; lengths in meters
    solids: cython.const[cython.double][:, ::1],
    drops: cython.const[cython.double][:, ::1],  # (m, 8) boxes cut out of the floor, which is at z = 0; same columns
    eye: cython.const[cython.double][::1],  # (3) the camera's position, meters
    turned: cython.const[cython.double][
        :, ::1
    ],  # (3, 3) from the camera's optical frame (z ahead, x right, y down) to the world
    lens: cython.const[cython.double][::1],  # (4) fx, fy, cx, cy, pixels
    farthest: cython.double,  # meters; greater depths become infinite
    out: cython.float[:, ::1],  # (rows, columns) receives the depths, meters
) -> None:
    """Compute each pixel's depth. Solids that are empty, not finite, or contain the camera are ignored.

    Raises:
        ValueError: the arrays' shapes do not fit, or the camera's pose or lens is invalid.
    """
    rows: cython.Py_ssize_t = out.shape[0]
    columns: cython.Py_ssize_t = out.shape[1]
    cython.declare(row=cython.Py_ssize_t, column=cython.Py_ssize_t, k=cython.Py_ssize_t, i=cython.int)
    if (
        solids.shape[1] != 8 or drops.shape[1] != 8 or eye.shape[0] != 3 or lens.shape[0] != 4
        or turned.shape[0] != 3 or turned.shape[1] != 3
    ):  # fmt: skip
        raise ValueError("expected solids (n, 8), drops (m, 8), a position (3), a rotation (3, 3) and a lens (4)")
    if not (lens[0] > 0.0 and lens[1] > 0.0 and isfinite(lens[0] + lens[1] + lens[2] + lens[3])):
        raise ValueError("a lens needs focal lengths above 0 and a finite center")
    for i in range(3):
        if not isfinite(eye[i] + turned[i, 0] + turned[i, 1] + turned[i, 2]):
            raise ValueError("the camera's pose must be finite")
    with cython.nogil:
        for row in range(rows):
            y: cython.double = (row - lens[3]) / lens[1]
            for column in range(columns):
                x: cython.double = (column - lens[2]) / lens[0]
                down: cython.double = -(turned[2, 0] * x + turned[2, 1] * y + turned[2, 2])
                out[row, column] = eye[2] / down if down > _PARALLEL and eye[2] / down <= farthest else _INFINITY
        for k in range(drops.shape[0]):
            _render_solid(drops, k, True, eye, turned, lens, farthest, out)
        for k in range(solids.shape[0]):
            _render_solid(solids, k, False, eye, turned, lens, farthest, out)


@cython.boundscheck(False)  # as in `render`
@cython.wraparound(False)
@cython.initializedcheck(False)
@cython.cdivision(True)
@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _render_solid(
    solids: cython.const[cython.double][:, ::1],
    k: cython.Py_ssize_t,
    hollow: cython.bint,
    eye: cython.const[cython.double][::1],
    turned: cython.const[cython.double][:, ::1],
    lens: cython.const[cython.double][::1],
    farthest: cython.double,
    out: cython.float[:, ::1],
) -> cython.void:
    """Render one solid, or one drop if ``hollow``."""
    cython.declare(row=cython.Py_ssize_t, column=cython.Py_ssize_t)
    c: cython.double = solids[k, 2]
    s: cython.double = solids[k, 3]
    half: cython.double = solids[k, 4]
    wide: cython.double = solids[k, 5]
    low: cython.double = solids[k, 6] - eye[2]
    high: cython.double = solids[k, 7] - eye[2]
    round_: cython.bint = wide == 0.0
    if round_:
        wide = half
    dx: cython.double = eye[0] - solids[k, 0]
    dy: cython.double = eye[1] - solids[k, 1]
    # the camera's position and axes in the solid's own frame
    ox: cython.double = c * dx + s * dy
    oy: cython.double = c * dy - s * dx
    if not (isfinite(ox + oy + half + wide + low + high) and half > 0.0 and high > low):
        return
    ax: cython.double = c * turned[0, 0] + s * turned[1, 0]
    ay: cython.double = c * turned[1, 0] - s * turned[0, 0]
    bx: cython.double = c * turned[0, 1] + s * turned[1, 1]
    by: cython.double = c * turned[1, 1] - s * turned[0, 1]
    ex: cython.double = c * turned[0, 2] + s * turned[1, 2]
    ey: cython.double = c * turned[1, 2] - s * turned[0, 2]
    # the bounding rectangle of the solid's outline: the parts of the box's edges in front of the camera
    left: cython.double = _INFINITY
    right: cython.double = -_INFINITY
    top: cython.double = _INFINITY
    bottom: cython.double = -_INFINITY
    nearest: cython.double = _INFINITY
    cython.declare(corner=cython.int, axis=cython.int, end=cython.int)
    for corner in range(8):
        for axis in range(3):
            if corner & (1 << axis):
                continue
            x0: cython.double = (half if corner & 1 else -half) - ox
            y0: cython.double = (wide if corner & 2 else -wide) - oy
            z0: cython.double = high if corner & 4 else low
            x1: cython.double = half - ox if axis == 0 else x0
            y1: cython.double = wide - oy if axis == 1 else y0
            z1: cython.double = high if axis == 2 else z0
            far0: cython.double = ex * x0 + ey * y0 + turned[2, 2] * z0
            far1: cython.double = ex * x1 + ey * y1 + turned[2, 2] * z1
            if far0 < _NEAR and far1 < _NEAR:
                continue
            for end in range(2):
                far: cython.double = far1 if end else far0
                px: cython.double = x1 if end else x0
                py: cython.double = y1 if end else y0
                pz: cython.double = z1 if end else z0
                if far < _NEAR:
                    share: cython.double = (_NEAR - far0) / (far1 - far0)
                    px = x0 + share * (x1 - x0)
                    py = y0 + share * (y1 - y0)
                    pz = z0 + share * (z1 - z0)
                    far = _NEAR
                u: cython.double = lens[2] + lens[0] * (ax * px + ay * py + turned[2, 0] * pz) / far
                v: cython.double = lens[3] + lens[1] * (bx * px + by * py + turned[2, 1] * pz) / far
                left, right = min(left, u), max(right, u)
                top, bottom = min(top, v), max(bottom, v)
                nearest = min(nearest, far)
    if not nearest <= farthest:
        return
    first: cython.Py_ssize_t = cython.cast(cython.Py_ssize_t, min(max(top - 1.0, 0.0), out.shape[0]))
    last: cython.Py_ssize_t = cython.cast(cython.Py_ssize_t, min(max(bottom + 2.0, 0.0), out.shape[0]))
    begin: cython.Py_ssize_t = cython.cast(cython.Py_ssize_t, min(max(left - 1.0, 0.0), out.shape[1]))
    stop: cython.Py_ssize_t = cython.cast(cython.Py_ssize_t, min(max(right + 2.0, 0.0), out.shape[1]))
    for row in range(first, last):
        y: cython.double = (row - lens[3]) / lens[1]
        for column in range(begin, stop):
            x: cython.double = (column - lens[2]) / lens[0]
            gx: cython.double = ax * x + bx * y + ex
            gy: cython.double = ay * x + by * y + ey
            gz: cython.double = turned[2, 0] * x + turned[2, 1] * y + turned[2, 2]
            enter: cython.double = 0.0
            leave: cython.double = _INFINITY
            if gz > _PARALLEL or gz < -_PARALLEL:
                enter = max(enter, min(low / gz, high / gz))
                leave = min(leave, max(low / gz, high / gz))
            elif low > 0.0 or high < 0.0:
                continue
            above: cython.double = enter  # where the ray crosses the height of the top or of the underside
            if round_:
                square: cython.double = gx * gx + gy * gy
                along: cython.double = ox * gx + oy * gy
                inside: cython.double = along * along - square * (ox * ox + oy * oy - half * half)
                if inside < 0.0 or (square < _PARALLEL and ox * ox + oy * oy > half * half):
                    continue
                if square >= _PARALLEL:
                    enter = max(enter, (-along - sqrt(inside)) / square)
                    leave = min(leave, (-along + sqrt(inside)) / square)
            else:
                if gx > _PARALLEL or gx < -_PARALLEL:
                    enter = max(enter, min((-half - ox) / gx, (half - ox) / gx))
                    leave = min(leave, max((-half - ox) / gx, (half - ox) / gx))
                elif ox > half or ox < -half:
                    continue
                if gy > _PARALLEL or gy < -_PARALLEL:
                    enter = max(enter, min((-wide - oy) / gy, (wide - oy) / gy))
                    leave = min(leave, max((-wide - oy) / gy, (wide - oy) / gy))
                elif oy > wide or oy < -wide:
                    continue
            if not 0.0 < enter <= leave:
                continue
            if hollow:
                if enter == above and gz < 0.0:  # through the hole in the floor
                    out[row, column] = leave if leave <= farthest else _INFINITY
            elif enter < out[row, column] and enter <= farthest:
                out[row, column] = enter
