"""Watches a drive: whether the robot touches anything, and whether it is where it must not be."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from benchmarks.closedloop.robot import Robot
from benchmarks.closedloop.worlds import Rectangle

Floats = NDArray[np.float64]

STANDING = 0.01
"""m/s; a robot slower than this is not driving into anybody: people come near by themselves."""

_LOOK = 5
"""Ticks between two looks at distances: 1.5 cm of the way at R1's speed."""


class Judge:
    """Looks at the robot after every tick.

    Args:
        robot: whom.
        keep_out: areas that its hull must not enter.

    Attributes:
        contacts: ticks in which its hull touched something while it was moving.
        room: meters between its hull and the nearest thing while it was moving, the least so far.
        entered: looks at which its hull was in a keep-out area.
        keep_out_room: meters between its hull and the nearest keep-out area, the least so far.
        where: the time and place of the first contact or entry, for people.
    """

    def __init__(self, robot: Robot, keep_out: Iterable[Rectangle]) -> None:
        self._robot, self._keep_out = robot, tuple(keep_out)
        self._ticks = 0
        self.contacts = self.entered = 0
        self.room = self.keep_out_room = math.inf
        self.where = ""

    def check(self) -> None:
        """Look; to be called once each tick."""
        robot = self._robot
        self._ticks += 1
        touches = bool(robot.simulation.bumps)
        if not touches and self._ticks % _LOOK:
            return
        moving = robot.moving > STANDING
        if touches and moving:
            self.contacts += 1
            self._note("touches something")
        if self._ticks % _LOOK:
            return
        x, y, _, _ = robot.truth
        if moving:
            self.room = min(self.room, nearest(x, y, *robot.simulation.world.seen()) - robot.radius)
        away = min((_outside(x, y, area) for area in self._keep_out), default=math.inf) - robot.radius
        self.keep_out_room = min(self.keep_out_room, away)
        if away < 0.0:
            self.entered += 1
            self._note("is in a keep-out area")

    def _note(self, what: str) -> None:
        if not self.where:
            x, y, theta, _ = self._robot.truth
            self.where = f"{what} at {self._robot.now:.1f} s, {x:.2f} {y:.2f} {math.degrees(theta):.0f} deg"


def nearest(x: float, y: float, segments: Floats, circles: Floats) -> float:
    """How far the nearest thing is from a point, meters.

    Args:
        x: of the point, meters.
        y: of the point, meters.
        segments: (n, 4) x1, y1, x2, y2.
        circles: (m, 3) x, y, radius.
    """
    least = math.inf
    if len(segments):
        start, vectors = segments[:, :2], segments[:, 2:] - segments[:, :2]
        to = np.array((x, y)) - start
        along = np.clip((to * vectors).sum(1) / np.maximum((vectors * vectors).sum(1), 1e-12), 0.0, 1.0)
        least = float(np.hypot(*(to - along[:, None] * vectors).T).min())
    if len(circles):
        least = min(least, float((np.hypot(circles[:, 0] - x, circles[:, 1] - y) - circles[:, 2]).min()))
    return least


def _outside(x: float, y: float, area: Rectangle) -> float:
    """How far a point is from a rectangle, meters; 0 within it."""
    x0, y0, x1, y1 = area
    return math.hypot(max(x0 - x, 0.0, x - x1), max(y0 - y, 0.0, y - y1))
