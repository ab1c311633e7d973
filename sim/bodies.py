"""Creates DART skeletons: the floor, fixed pieces and movable boxes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from sim.environment import dartpy
from sim.pieces import Piece
from sim.plan import Drop

WALL_FRICTION = 0.3


def isometry(x: float, y: float, z: float, yaw: float = 0.0) -> Any:
    """Return a pose as a DART isometry; meters and radians."""
    transform = dartpy().math.Isometry3()
    c, s = math.cos(yaw), math.sin(yaw)
    transform.set_rotation(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
    transform.set_translation([x, y, z])
    return transform


def attach(body: Any, shape: Any, place: Any, friction: float) -> Any:
    """Attach a colliding shape to a body, and return the shape node."""
    node = body.createShapeNode(shape)
    node.createCollisionAspect()
    node.createDynamicsAspect().setFrictionCoeff(friction)
    node.setRelativeTransform(place)
    return node


def shape_of(piece: Piece) -> Any:
    """Return the DART shape of a piece."""
    dynamics = dartpy().dynamics
    if piece.radius:
        return dynamics.CylinderShape(piece.radius, piece.height)
    return dynamics.BoxShape([piece.length, piece.width, piece.height])


def place_of(piece: Piece) -> Any:
    """Return the DART pose of a piece."""
    return isometry(piece.x, piece.y, piece.above + piece.height / 2, piece.yaw)


_Part = tuple[float, float, float, float]  # x0, y0, x1, y1, meters


def ground(reach: float, drops: Iterable[Drop] = ()) -> Any:
    """Create the floor, ``reach`` meters to each side, with its top at z = 0; its drops are lower."""
    skeleton = dartpy().dynamics.Skeleton("ground")
    _, body = skeleton.createWeldJointAndBodyNodePair()
    parts: list[tuple[_Part, float]] = [((-reach, -reach, reach, reach), 0.0)]
    for drop in drops:
        (x, y), (length, width) = drop.at, drop.size
        hole = x - length / 2, y - width / 2, x + length / 2, y + width / 2
        parts = [(remainder, top) for part, top in parts for remainder in _around(part, hole)]
        parts.append((hole, -drop.depth))
    for (x0, y0, x1, y1), top in parts:
        shape = dartpy().dynamics.BoxShape([x1 - x0, y1 - y0, 0.2])
        attach(body, shape, isometry((x0 + x1) / 2, (y0 + y1) / 2, top - 0.1), 1.0)
    skeleton.setMobile(False)
    return skeleton


def _around(part: _Part, hole: _Part) -> Iterable[_Part]:
    """Return rectangles that cover ``part`` except for ``hole``."""
    x0, y0, x1, y1 = part
    left, low, right, high = max(x0, hole[0]), max(y0, hole[1]), min(x1, hole[2]), min(y1, hole[3])
    if left >= right or low >= high:
        return [part]
    strips = ((x0, y0, left, y1), (right, y0, x1, y1), (left, y0, right, low), (left, high, right, y1))
    return [strip for strip in strips if strip[0] < strip[2] and strip[1] < strip[3]]


def fixed(pieces: Iterable[Piece]) -> tuple[Any, list[Any]]:
    """Create one body with all pieces as its shapes; return its skeleton, and the shape nodes in the pieces' order."""
    skeleton = dartpy().dynamics.Skeleton("fixed")
    _, body = skeleton.createWeldJointAndBodyNodePair()
    nodes = [attach(body, shape_of(piece), place_of(piece), WALL_FRICTION) for piece in pieces]
    skeleton.setMobile(False)
    return skeleton, nodes


def movable(piece: Piece, mass: float, friction: float) -> Any:
    """Create a box that can be pushed."""
    dynamics = dartpy().dynamics
    skeleton = dynamics.Skeleton(f"box {piece.name}")
    _, body = skeleton.createFreeJointAndBodyNodePair()
    inertia = dynamics.Inertia()
    inertia.setMass(mass)
    a, b, h = (piece.length**2, piece.width**2, piece.height**2)
    inertia.setMoment(np.diag([b + h, a + h, a + b]) * mass / 12)
    body.setInertia(inertia)
    attach(body, shape_of(piece), isometry(0.0, 0.0, 0.0), friction)
    skeleton.setPositions([0.0, 0.0, piece.yaw, piece.x, piece.y, piece.height / 2])
    return skeleton


def yaw_of(rotation: Any) -> float:
    """Return a rotation's angle about the vertical, in radians."""
    return math.atan2(rotation[1, 0], rotation[0, 0])
