"""What a camera on the robot sees of the floor plan, in plain colours; standard library only."""

from __future__ import annotations

import math

from bridge.demo.floor_plan import FloorPlan

WIDTH, HEIGHT = 640, 480
"""Pixels."""

_FIELD_OF_VIEW = math.radians(70)
_RAYS = 160
_STRIPE = WIDTH // _RAYS
_REACH = 10.0
_CEILING, _FLOOR = bytes((70, 90, 110)) * _STRIPE, bytes((60, 55, 50)) * _STRIPE
_WALL = (205, 190, 160)


def picture(plan: FloorPlan, x: float, y: float, yaw: float) -> bytes:
    """An rgb8 image, row by row."""
    offsets = [_FIELD_OF_VIEW * (0.5 - i / (_RAYS - 1)) for i in range(_RAYS)]
    depths = [plan.cast(x, y, yaw + offset, _REACH) * math.cos(offset) for offset in offsets]
    stripes = [(HEIGHT / 2 / max(depth, 0.1), _shade(depth)) for depth in depths]
    upper = [b"".join(wall if above < half else _CEILING for half, wall in stripes) for above in range(HEIGHT // 2)]
    lower = [b"".join(wall if below < half else _FLOOR for half, wall in stripes) for below in range(HEIGHT // 2)]
    return b"".join([*reversed(upper), *lower])


def _shade(depth: float) -> bytes:
    light = 1.0 - 0.8 * min(depth, _REACH) / _REACH
    return bytes(int(light * part) for part in _WALL) * _STRIPE
