"""Makes DART's skeletons: the floor, what stands fast, boxes, the base."""

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
    """A pose as DART has it."""
    made = dartpy().math.Isometry3()
    c, s = math.cos(yaw), math.sin(yaw)
    made.set_rotation(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
    made.set_translation([x, y, z])
    return made


def attach(body: Any, shape: Any, place: Any, friction: float) -> Any:
    """Give a body a shape that collides; the shape node."""
    node = body.createShapeNode(shape)
    node.createCollisionAspect()
    node.createDynamicsAspect().setFrictionCoeff(friction)
    node.setRelativeTransform(place)
    return node


def shape_of(piece: Piece) -> Any:
    """A piece's shape."""
    dynamics = dartpy().dynamics
    if piece.radius:
        return dynamics.CylinderShape(piece.radius, piece.height)
    return dynamics.BoxShape([piece.length, piece.width, piece.height])


def place_of(piece: Piece) -> Any:
    """Where a piece is."""
    return isometry(piece.x, piece.y, piece.above + piece.height / 2, piece.yaw)


_Part = tuple[float, float, float, float]  # x0, y0, x1, y1, metres


def ground(reach: float, drops: Iterable[Drop] = ()) -> Any:
    """The floor, a box whose top is at zero, so many metres each way; where it has drops, the boxes around them."""
    skeleton = dartpy().dynamics.Skeleton("ground")
    _, body = skeleton.createWeldJointAndBodyNodePair()
    parts: list[tuple[_Part, float]] = [((-reach, -reach, reach, reach), 0.0)]
    for drop in drops:
        (x, y), (length, width) = drop.at, drop.size
        hole = x - length / 2, y - width / 2, x + length / 2, y + width / 2
        parts = [(rest, top) for part, top in parts for rest in _around(part, hole)]
        parts.append((hole, -drop.depth))
    for (x0, y0, x1, y1), top in parts:
        shape = dartpy().dynamics.BoxShape([x1 - x0, y1 - y0, 0.2])
        attach(body, shape, isometry((x0 + x1) / 2, (y0 + y1) / 2, top - 0.1), 1.0)
    skeleton.setMobile(False)
    return skeleton


def _around(part: _Part, hole: _Part) -> Iterable[_Part]:
    """What is left of a rectangle around a hole."""
    x0, y0, x1, y1 = part
    left, low, right, high = max(x0, hole[0]), max(y0, hole[1]), min(x1, hole[2]), min(y1, hole[3])
    if left >= right or low >= high:
        return [part]
    rests = ((x0, y0, left, y1), (right, y0, x1, y1), (left, y0, right, low), (left, high, right, y1))
    return [rest for rest in rests if rest[0] < rest[2] and rest[1] < rest[3]]


def fixed(pieces: Iterable[Piece]) -> tuple[Any, list[Any]]:
    """One body with all pieces as its shapes, and the shape nodes in their order."""
    skeleton = dartpy().dynamics.Skeleton("fixed")
    _, body = skeleton.createWeldJointAndBodyNodePair()
    nodes = [attach(body, shape_of(piece), place_of(piece), WALL_FRICTION) for piece in pieces]
    skeleton.setMobile(False)
    return skeleton, nodes


def movable(piece: Piece, mass: float, friction: float) -> Any:
    """A box that can be pushed."""
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
    """A rotation's part about the vertical, radians."""
    return math.atan2(rotation[1, 0], rotation[0, 0])
