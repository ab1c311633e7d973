"""Makes DART's skeletons: the floor, what stands fast, boxes, the base."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from sim.environment import dartpy
from sim.pieces import Piece

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
    """Where a piece is; it stands on the floor."""
    return isometry(piece.x, piece.y, piece.height / 2, piece.yaw)


def ground(reach: float) -> Any:
    """The floor, a box whose top is at zero, so many metres each way."""
    skeleton = dartpy().dynamics.Skeleton("ground")
    _, body = skeleton.createWeldJointAndBodyNodePair()
    attach(body, dartpy().dynamics.BoxShape([2 * reach, 2 * reach, 0.2]), isometry(0.0, 0.0, -0.1), 1.0)
    skeleton.setMobile(False)
    return skeleton


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
