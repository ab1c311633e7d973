"""Watches a drive for contacts and for entries into keep-out areas."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from benchmarks.closedloop.robot import Robot
from benchmarks.closedloop.worlds import Rectangle

Floats = NDArray[np.float64]

STANDING = 0.01
"""Speed below which the robot is not at fault for a contact, because people walk up to it, m/s."""

_CHECK_TICKS = 5
"""Ticks between two distance checks, in which the R1 drives 1.5 cm."""


class Judge:
    """Checks the robot after every tick.

    Args:
        robot: the robot.
        keep_out: areas that the hull must not enter.

    Attributes:
        contacts: ticks in which the hull touched something while the robot was moving.
        room: minimum distance between the hull and the nearest thing while the robot was moving, meters.
        driving_room: as ``room``, but only while the robot was commanded to move, so not while it braked and people
            walked up to it.
        entered: distance checks at which its hull was in a keep-out area.
        keep_out_room: minimum distance between its hull and the nearest keep-out area, meters.
        where: time and place of the first contact or entry, for display.
    """

    def __init__(self, robot: Robot, keep_out: Iterable[Rectangle]) -> None:
        self._robot, self._keep_out = robot, tuple(keep_out)
        self._ticks = 0
        self.contacts = self.entered = 0
        self.room = self.driving_room = self.keep_out_room = math.inf
        self.where = ""

    def check(self) -> None:
        """Check the robot; call this once per tick."""
        robot = self._robot
        self._ticks += 1
        touches = bool(robot.simulation.bumps)
        if not touches and self._ticks % _CHECK_TICKS:
            return
        moving = robot.moving > STANDING
        if touches and moving:
            self.contacts += 1
            self._note("touches something")
        if self._ticks % _CHECK_TICKS:
            return
        x, y, _, _ = robot.truth
        if moving:
            room = nearest(x, y, *robot.simulation.world.seen()) - robot.radius
            self.room = min(self.room, room)
            if robot.commanded > STANDING:
                self.driving_room = min(self.driving_room, room)
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
    """Return the distance from a point to the nearest thing, in meters.

    Args:
        x: the point's x, meters.
        y: the point's y, meters.
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
    """Return a point's distance from a rectangle, in meters; 0 inside it."""
    x0, y0, x1, y1 = area
    return math.hypot(max(x0 - x, 0.0, x - x1), max(y0 - y, 0.0, y - y1))
