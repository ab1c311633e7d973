"""Lets DART see only what is near.

Its collision detection slows down with everything that there is (500 walls: tenfold), so what stands fast is no part of
the world; the pieces near to the base, and to boxes that it may push, are put into its collision group and taken out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.bodies import place_of
from sim.pieces import Piece

MARGIN = 0.5
"""Metres around a body within which pieces are put in; the fastest base comes 5 cm nearer between two looks."""


class Window:
    """The pieces that stand fast, and which of them collide at the moment.

    Args:
        group: the world's collision group.
        nodes: the pieces' shape nodes.
        pieces: the pieces, in the same order.
    """

    def __init__(self, group: Any, nodes: list[Any], pieces: list[Piece]) -> None:
        self._group, self._nodes = group, nodes
        self._middles = np.array([(p.x, p.y) for p in pieces]).reshape(-1, 2)
        self._half = np.array([(p.length / 2, p.width / 2) for p in pieces]).reshape(-1, 2)
        self._radius = np.array([p.radius for p in pieces])
        self._turned = np.array([(math.cos(p.yaw), math.sin(p.yaw)) for p in pieces]).reshape(-1, 2)
        self._there = np.ones(len(pieces), np.bool_)
        self._in = np.zeros(len(pieces), np.bool_)

    @property
    def count(self) -> int:
        """Pieces that collide at the moment."""
        return int(self._in.sum())

    def look(self, bodies: Iterable[tuple[float, float, float]]) -> None:
        """Put in what is near to these bodies (x, y, reach in metres), and take out the rest."""
        wanted = np.zeros(len(self._in), np.bool_)
        for x, y, reach in bodies:
            wanted |= self._away(x, y) < reach + MARGIN
        wanted &= self._there
        changed = np.flatnonzero(wanted != self._in)
        for i in changed:
            if wanted[i]:
                self._group.addShapeFrame(self._nodes[i])
            else:
                self._group.removeShapeFrame(self._nodes[i])
        if len(changed):
            self._in = wanted

    def _away(self, x: float, y: float) -> NDArray[np.float64]:
        """How far each piece is from a point, metres."""
        dx, dy = x - self._middles[:, 0], y - self._middles[:, 1]
        c, s = self._turned[:, 0], self._turned[:, 1]
        along = np.maximum(np.abs(c * dx + s * dy) - self._half[:, 0], 0.0)
        aside = np.maximum(np.abs(c * dy - s * dx) - self._half[:, 1], 0.0)
        away: NDArray[np.float64] = np.hypot(along, aside) - self._radius
        return away

    def put(self, index: int, piece: Piece) -> None:
        """A piece stands elsewhere now."""
        self._nodes[index].setRelativeTransform(place_of(piece))
        self._middles[index] = piece.x, piece.y

    def there(self, index: int, *, there: bool) -> None:
        """A piece is there, or gone; it collides from the next look on."""
        self._there[index] = there

    def clear(self) -> None:
        """Take all out."""
        for i in np.flatnonzero(self._in):
            self._group.removeShapeFrame(self._nodes[i])
        self._in[:] = False
