"""Rotations as quaternions (x, y, z, w), for compiled functions.

They are used as they are, not normalised first, since tf2 does so: within the tolerance for what it takes up, answers
are then the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

_njit: Any = numba.njit


def jit(function: F) -> F:
    """Compile a function that only compiled functions call."""
    made: F = _njit(function)
    return made


@jit
def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """First ``b``, then ``a``."""
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] + a[1] * b[3] + a[2] * b[0] - a[0] * b[2],
        a[3] * b[2] + a[2] * b[3] + a[0] * b[1] - a[1] * b[0],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


@jit
def inverse(q: Quaternion) -> Quaternion:
    """The rotation back."""
    return -q[0], -q[1], -q[2], q[3]


@jit
def rotate(q: Quaternion, v: Vector) -> Vector:
    """A vector, rotated; longer by the square of the rotation's length."""
    turned = product(product(q, (v[0], v[1], v[2], 0.0)), inverse(q))
    return turned[0], turned[1], turned[2]


@jit
def slerp(a: Quaternion, b: Quaternion, ratio: float) -> Quaternion:
    """The rotation on the short way from ``a`` (ratio 0) to ``b`` (1); beyond them, it goes on turning as fast."""
    dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    lengths = (a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + a[3] * a[3]) * (
        b[0] * b[0] + b[1] * b[1] + b[2] * b[2] + b[3] * b[3]
    )
    sign = -1.0 if dot < 0.0 else 1.0
    # rounding may give a cosine a bit over 1, of which tf2 makes NaN
    angle = math.acos(min(abs(dot) / math.sqrt(lengths), 1.0))
    if angle == 0.0:
        return a
    whole = math.sin(angle)
    one = math.sin((1.0 - ratio) * angle) / whole
    two = sign * math.sin(ratio * angle) / whole
    return (
        one * a[0] + two * b[0],
        one * a[1] + two * b[1],
        one * a[2] + two * b[2],
        one * a[3] + two * b[3],
    )


@jit
def normalized(q: Quaternion) -> Quaternion:
    """The rotation with length 1."""
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] / length, q[1] / length, q[2] / length, q[3] / length


@jit
def of_matrix(q: Quaternion) -> Quaternion:
    """The one of the two quaternions of a rotation that tf2 makes of its matrix: w, else the largest, is positive."""
    if 4.0 * q[3] * q[3] > 1.0:
        chosen = q[3]
    else:
        x, y, z = abs(q[0]), abs(q[1]), abs(q[2])
        chosen = q[0] if x >= max(y, z) else q[1] if y >= z else q[2]
    if chosen < 0.0:
        return -q[0], -q[1], -q[2], -q[3]
    return q
