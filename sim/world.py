"""A floor with a base on it, in DART."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim import pieces as made
from sim.base import STEP_NS, Base, Pose
from sim.bodies import fixed, ground, movable, yaw_of
from sim.dart import dartpy
from sim.errors import SimError
from sim.people import Walker
from sim.pieces import Piece
from sim.plan import Box, Floor, Person
from sim.window import Window

Floats = NDArray[np.float64]

_NEAR = 3.0
"""Metres within which a box that can be pushed is in DART's world; farther away it stands still."""

_ROOM = 0.05
_BUMP_HEIGHT = 0.03
"""Contacts lower than this are the floor's, metres."""

_SPAWNED = 200
"""Things that can be added at most."""


@dataclass
class Crate:
    """A box that can be pushed."""

    piece: Piece
    skeleton: Any
    inside: bool = False

    def now(self) -> Piece:
        """The box as it is now."""
        at = self.skeleton.getBodyNode(0).getTransform()
        x, y, _ = at.translation()
        return self.piece.moved(float(x), float(y), yaw_of(at.rotation()))


class World:
    """One floor. Everything that is on it is known by its name.

    Args:
        floor: what it is like.
        base: who stands on it.
        laser_height: metres; what is lower is not seen by the laser.

    Attributes:
        pieces: what stands fast: walls and things, then the doors' leaves, then people.
        first_leaf: where the leaves begin.
        doors: whether each is open.
        people: who walk about.
        crates: the boxes that can be pushed.
        extra: things that were added.
    """

    def __init__(self, floor: Floor, base: Base, laser_height: float) -> None:
        self.floor, self.base, self._laser_height = floor, base, laser_height
        dart = dartpy()
        self._world = dart.simulation.World("midspan")
        self._world.setGravity([0.0, 0.0, -9.81])
        self._world.setTimeStep(STEP_NS / 1e9)
        self._world.setCollisionDetector(dart.collision.BulletCollisionDetector())
        extent = floor.extent
        self._world.addSkeleton(ground(max(50.0, *(abs(v) for v in extent)) + 10.0))
        self._world.addSkeleton(base.skeleton)
        self.doors = {door.name: door.open for door in floor.doors}
        self.people = {person.name: Walker(person) for person in floor.people}
        self.crates = {box.name or f"box{i}": _crate(box) for i, box in enumerate(floor.boxes) if box.mass is not None}
        self.extra: dict[str, Piece] = {}
        self._rebuild()

    def _rebuild(self) -> None:
        """Make everything that stands fast anew: at the start, and when something comes or goes."""
        floor = self.floor
        standing = [*made.walls(floor), *(made.of_box(box) for box in floor.boxes if box.mass is None)]
        standing += [*(made.of_round(thing) for thing in floor.rounds), *self.extra.values()]
        leaves = [made.leaf(door, floor) for door in floor.doors]
        self.pieces = [*standing, *leaves, *(walker.piece() for walker in self.people.values())]
        self.first_leaf = len(standing)
        self._first_person = self.first_leaf + len(leaves)
        self._fixed, nodes = fixed(self.pieces)
        self.window = Window(self._world.getConstraintSolver().getCollisionGroup(), nodes, self.pieces)
        for i, is_open in enumerate(self.doors.values()):
            self.window.there(self.first_leaf + i, there=not is_open)
        self._filter()
        self._see()
        self.look()

    @property
    def names(self) -> set[str]:
        """Of everything that has one."""
        return {*(p.name for p in self.pieces if p.name), *self.crates}

    def _filter(self) -> None:
        """Wheels touch the floor and nothing else: as spheres they would stick out of the base."""
        # the options are a copy, the filter in them is the solver's own
        none = self._world.getConstraintSolver().getCollisionOption().collisionFilter
        none.removeAllBodyNodePairsFromBlackList()
        others = [self._fixed.getBodyNode(0), *(crate.skeleton.getBodyNode(0) for crate in self.crates.values())]
        for wheel in self.base.wheels:
            none.addBodyNodePairToBlackList(wheel, self.base.body)
            for other in others:
                none.addBodyNodePairToBlackList(wheel, other)
        if len(self.base.wheels) > 1:
            none.addBodyNodePairToBlackList(*self.base.wheels)

    def _see(self) -> None:
        """What the laser sees of the things that stand fast."""
        seen = [p for p in self.pieces[: self.first_leaf] if p.height > self._laser_height]
        boxes = [p.segments() for p in seen if not p.radius]
        self._segments = np.vstack(boxes) if boxes else np.zeros((0, 4))
        self._circles = np.array([(p.x, p.y, p.radius) for p in seen if p.radius]).reshape(-1, 3)

    def seen(self) -> tuple[Floats, Floats]:
        """What the laser sees now: segments (n, 4) and circles (m, 3), metres."""
        moving = [crate.now() for crate in self.crates.values()]
        more = [p.segments() for p in (*moving, *self.leaves(is_open=False)) if p.height > self._laser_height]
        segments = np.vstack([self._segments, *more]) if more else self._segments
        people = [(w.x, w.y, w.person.radius) for w in self.people.values()]
        circles = np.vstack([self._circles, np.array(people)]) if people else self._circles
        return segments, circles

    def leaves(self, *, is_open: bool) -> list[Piece]:
        """The leaves of the doors that are open, or of those that are closed, as if those stood in their frames."""
        return [self.pieces[self.first_leaf + i] for i, now in enumerate(self.doors.values()) if now == is_open]

    def step(self, count: int) -> None:
        """Let so many steps of DART pass; motors keep what they were told."""
        step = self._world.step
        for _ in range(count):
            step(False)  # DART keeps what the motors were told

    def walk(self, seconds: float) -> None:
        """Let people walk for so long; who would walk into the robot or a crate waits."""
        if not self.people:
            return
        x, y, _ = self.base.pose()
        reach = self.base.robot.body.radius
        for i, walker in enumerate(self.people.values()):
            if walker.walk(seconds, (x, y), reach + _ROOM):
                self.window.put(self._first_person + i, walker.piece())

    def look(self) -> None:
        """Put what is near into DART's world; to be called twenty times a second of simulated time."""
        x, y, _ = self.base.pose()
        reach = self.base.robot.body.radius
        bodies = [(x, y, reach)]
        self._near = 0
        for crate in self.crates.values():
            piece = crate.now()
            near = math.hypot(piece.x - x, piece.y - y) < _NEAR + piece.reach
            if near != crate.inside:
                crate.inside = near
                crate.skeleton.setVelocities(np.zeros(6))
                (self._world.addSkeleton if near else self._world.removeSkeleton)(crate.skeleton)
            if near:
                self._near += 1
                bodies.append((piece.x, piece.y, piece.reach))
        self.window.look(bodies)

    def bumps(self) -> list[tuple[float, float]]:
        """Where the base touches something else than the floor: x, y in metres."""
        if not (self.window.count or self._near):
            return []
        result = self._world.getLastCollisionResult()
        points = [result.getContact(i).point for i in range(result.getNumContacts())]
        x, y, _ = self.base.pose()
        near = self.base.robot.body.radius + _ROOM
        return [
            (float(p[0]), float(p[1])) for p in points if p[2] > _BUMP_HEIGHT and math.hypot(p[0] - x, p[1] - y) < near
        ]

    def open(self, door: str, *, is_open: bool) -> None:
        """Open or close a door.

        Raises:
            SimError: there is none of that name, or somebody stands in it.
        """
        if door not in self.doors:
            msg = f"there is no door {door!r}; doors: {', '.join(self.doors) or 'none'}"
            raise SimError(msg)
        index = self.first_leaf + list(self.doors).index(door)
        if not is_open and (who := self._within(self.pieces[index])):
            msg = f"the door {door!r} cannot be closed: {who} stands in it"
            raise SimError(msg)
        self.doors[door] = is_open
        self.window.there(index, there=not is_open)
        self.look()

    def _within(self, piece: Piece, leave_out: str = "") -> str:
        """Who is where a piece would be, "" where nobody is."""
        x, y, _ = self.base.pose()
        things = [("the robot", x, y, self.base.robot.body.radius)]
        things += [(name, w.x, w.y, w.person.radius) for name, w in self.people.items()]
        things += [(name, (p := crate.now()).x, p.y, p.reach) for name, crate in self.crates.items()]
        for name, x, y, reach in things:
            if name != leave_out and _distance(piece, x, y) < reach:
                return name
        return ""

    def spawn(self, thing: Box | Person | Piece, name: str) -> None:
        """Add a box, a person or something that stands fast.

        Raises:
            SimError: the name is taken, somebody stands there, or there are too many things.
        """
        if not name or name in self.names:
            msg = f"a thing needs a name of its own; {name!r} is taken" if name else "a thing needs a name"
            raise SimError(msg)
        if len(self.extra) + len(self.crates) + len(self.people) >= _SPAWNED:
            msg = f"there are {_SPAWNED} things already; remove some"
            raise SimError(msg)
        piece = _solid(thing)
        if who := self._within(piece):
            msg = f"{name!r} cannot be put there: {who} stands there"
            raise SimError(msg)
        self.window.clear()
        if isinstance(thing, Person):
            self.people[name] = Walker(thing)
        elif isinstance(thing, Box) and thing.mass is not None:
            self.crates[name] = _crate(thing)
        else:
            self.extra[name] = piece
        self._rebuild()

    def remove(self, name: str) -> None:
        """Take away what was added, a box that can be pushed, or a person.

        Raises:
            SimError: there is nothing of that name that can be taken away.
        """
        among: dict[str, Any] | None = next((m for m in (self.extra, self.crates, self.people) if name in m), None)
        if among is None:
            known = ", ".join((*self.extra, *self.crates, *self.people)) or "nothing"
            msg = f"{name!r} cannot be taken away; what can be: {known}"
            raise SimError(msg)
        self.window.clear()
        gone = among.pop(name)
        if isinstance(gone, Crate) and gone.inside:
            self._world.removeSkeleton(gone.skeleton)
        self._rebuild()

    def place(self, pose: Pose) -> None:
        """Stand the base elsewhere, at rest.

        Raises:
            SimError: something stands there.
        """
        radius = self.base.robot.body.radius
        there = [*self.pieces[: self.first_leaf], *self.leaves(is_open=False)]
        there += [walker.piece() for walker in self.people.values()]
        there += [replace(crate.now(), name=name) for name, crate in self.crates.items()]
        for piece in there:
            if _distance(piece, pose.x, pose.y) < radius:
                msg = f"the robot cannot stand at {pose.x:.2f}, {pose.y:.2f}: {piece.name or 'a wall'} is there"
                raise SimError(msg)
        self.base.place(pose)
        self.look()

    def leave(self) -> None:
        """Give the base back: another world takes it."""
        self.window.clear()
        self._world.removeSkeleton(self.base.skeleton)


def _crate(box: Box) -> Crate:
    piece = made.of_box(box)
    return Crate(piece, movable(piece, box.mass or 1.0, box.friction))


def _solid(thing: Box | Person | Piece) -> Piece:
    if isinstance(thing, Piece):
        return thing
    return made.of_box(thing) if isinstance(thing, Box) else made.of_person(thing)


def _distance(piece: Piece, x: float, y: float) -> float:
    """From a point to a piece, metres; 0 within it."""
    dx, dy = x - piece.x, y - piece.y
    if piece.radius:
        return max(0.0, math.hypot(dx, dy) - piece.radius)
    c, s = math.cos(piece.yaw), math.sin(piece.yaw)
    along, aside = abs(c * dx + s * dy) - piece.length / 2, abs(c * dy - s * dx) - piece.width / 2
    return math.hypot(max(0.0, along), max(0.0, aside))
