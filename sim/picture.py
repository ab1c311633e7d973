"""Draws the floor from above: DART's package draws nothing without a display."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from sim.pieces import Piece
from sim.simulation import Simulation

_LONGEST = 800
"""Pixels of the picture's longer side."""

_MARGIN = 0.3
_FLOOR, _WALL, _DOOR, _CRATE = (250, 250, 247), (60, 62, 70), (190, 140, 80), (200, 165, 110)
_PERSON, _ROBOT, _NOSE, _HIT, _BUMP = (60, 120, 200), (40, 160, 90), (255, 255, 255), (220, 60, 60), (255, 120, 0)


def draw(simulation: Simulation) -> NDArray[np.uint8]:
    """The floor as it is now: (height, width, 3) bytes, north up."""
    canvas = _Canvas(simulation.world.floor.extent)
    world = simulation.world
    for piece in (*world.pieces[: world.first_leaf], *world.leaves(is_open=False)):
        canvas.solid(piece, _DOOR if piece.name in world.doors else _WALL)
    for piece in world.leaves(is_open=True):
        canvas.outline(piece, _DOOR)
    for crate in world.crates.values():
        canvas.solid(crate.now(), _CRATE)
    for walker in world.people.values():
        canvas.disc(walker.x, walker.y, walker.person.radius, _PERSON)
    canvas.dots(_hits(simulation), _HIT)
    x, y, yaw = simulation.base.pose()
    radius = simulation.robot.body.radius
    canvas.disc(x, y, radius, _ROBOT)
    canvas.line((x, y), (x + radius * math.cos(yaw), y + radius * math.sin(yaw)), _NOSE)
    canvas.dots(np.array(simulation.bumps).reshape(-1, 2), _BUMP, 3)
    return canvas.pixels()


def png(simulation: Simulation, file: Any) -> None:
    """Write the picture as PNG to a path or an open file."""
    Image.fromarray(draw(simulation)).save(file, format="PNG")


def _hits(simulation: Simulation) -> NDArray[np.float64]:
    """Where the laser's beams ended, (n, 2) metres."""
    scan, (x, y, yaw) = simulation.scan, simulation.base.pose()
    angles = yaw + scan.first + np.arange(len(scan.ranges)) * scan.step
    seen = np.isfinite(scan.ranges)
    far = scan.ranges[seen]
    return np.stack([x + far * np.cos(angles[seen]), y + far * np.sin(angles[seen])], axis=1)


class _Canvas:
    def __init__(self, extent: tuple[float, float, float, float]) -> None:
        self._left, low, right, self._top = (
            extent[0] - _MARGIN,
            extent[1] - _MARGIN,
            extent[2] + _MARGIN,
            extent[3] + _MARGIN,
        )
        self._scale = _LONGEST / max(right - self._left, self._top - low)
        size = max(1, round((right - self._left) * self._scale)), max(1, round((self._top - low) * self._scale))
        self._image = Image.new("RGB", size, _FLOOR)
        self._draw = ImageDraw.Draw(self._image)

    def _at(self, x: float, y: float) -> tuple[float, float]:
        return (x - self._left) * self._scale, (self._top - y) * self._scale

    def solid(self, piece: Piece, colour: tuple[int, int, int]) -> None:
        if piece.radius:
            self.disc(piece.x, piece.y, piece.radius, colour)
        else:
            self._draw.polygon([self._at(float(x), float(y)) for x, y in piece.corners()], fill=colour)

    def outline(self, piece: Piece, colour: tuple[int, int, int]) -> None:
        self._draw.polygon([self._at(float(x), float(y)) for x, y in piece.corners()], outline=colour)

    def disc(self, x: float, y: float, radius: float, colour: tuple[int, int, int]) -> None:
        self._draw.ellipse([self._at(x - radius, y + radius), self._at(x + radius, y - radius)], fill=colour)

    def line(self, a: tuple[float, float], b: tuple[float, float], colour: tuple[int, int, int]) -> None:
        self._draw.line([self._at(*a), self._at(*b)], fill=colour, width=2)

    def dots(self, points: NDArray[np.float64], colour: tuple[int, int, int], size: int = 1) -> None:
        for x, y in points:
            px, py = self._at(float(x), float(y))
            self._draw.rectangle([px - size, py - size, px + size - 1, py + size - 1], fill=colour)

    def pixels(self) -> NDArray[np.uint8]:
        return np.asarray(self._image)
