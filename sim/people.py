"""People who walk."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

from sim.pieces import Piece, of_person
from sim.plan import Person, Point

_PATIENCE, _REST = 5.0, 20.0
"""Seconds that somebody waits for a robot in the way before turning to the next point of the path, and rests there."""


class Walker:
    """A person on the way. They are neither pushed nor do they push: they wait where somebody is in the way.

    Who has waited for long turns to the next point of the path: two who wait for one another would do so for ever.

    Attributes:
        person: who, as the plan has them.
        x: where, metres.
        y: where, metres.
    """

    def __init__(self, person: Person) -> None:
        self.person = person
        self.x, self.y = person.at
        self.send(person.path, loop=person.loop)

    def send(self, path: Iterable[Point], *, loop: bool = False) -> None:
        """Have the person walk to these points, one after the other, at once."""
        self._way, self._loop = deque(path), loop
        self._waited, self._rest, self._gives_way = 0.0, 0.0, False

    def piece(self) -> Piece:
        """The person as a solid."""
        return of_person(self.person).moved(self.x, self.y, 0.0)

    def walk(self, seconds: float, robot: Point, room: float) -> bool:
        """Walk for so long; whether the person moved. Within ``room`` metres of the robot they come no nearer."""
        if self._rest > 0.0:
            self._rest -= seconds
            return False
        left = self.person.speed * seconds
        x, y = self.x, self.y
        while self._way and left > 0.0:
            goal = self._way[0]
            away = math.hypot(goal[0] - x, goal[1] - y)
            if away > left:
                x, y = x + (goal[0] - x) / away * left, y + (goal[1] - y) / away * left
                break
            (x, y), left = goal, left - away
            self._way.popleft()
            if self._gives_way:
                self._gives_way, self._rest, left = False, _REST, 0.0
            if self._loop:
                self._way.append(goal)
            if away == 0.0 and len(self._way) <= 1:
                break
        before = math.hypot(self.x - robot[0], self.y - robot[1])
        after = math.hypot(x - robot[0], y - robot[1])
        if after < before and after < room + self.person.radius:
            self._wait(seconds)
            return False
        self._waited = 0.0
        if (x, y) == (self.x, self.y):
            return False
        self.x, self.y = x, y
        return True

    def _wait(self, seconds: float) -> None:
        self._waited += seconds
        if self._waited > _PATIENCE and len(self._way) > 1:
            self._waited, self._gives_way = 0.0, True
            self._way.rotate(-1)
