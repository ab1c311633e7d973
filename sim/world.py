"""A floor with a base on it, in DART, which sees only what is near."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim import pieces as made
from sim.base import STEP_NS, Base, BasePose
from sim.bodies import fixed, ground, movable, place_of, yaw_of
from sim.environment import SimError, dartpy
from sim.pieces import Piece, Walker
from sim.plan import Box, Floor, Person

Floats = NDArray[np.float64]

_NEAR = 3.0  # metres within which a box that can be pushed is in DART's world; farther away it stands still
_ROOM = 0.05
_REST = 1e-9  # metres or radians per second of a body at rest; a standing base slows down tenfold in 50 ticks
_BUMP_HEIGHT = 0.03  # contacts lower than this are the floor's, metres
_SPAWNED = 200  # things that can be added at most


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


class FloorWorld:
    """One floor. Everything that is on it is known by its name.

    Args:
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
        self._world.addSkeleton(ground(max(50.0, *(abs(v) for v in extent)) + 10.0, floor.drops))
        # where the floor is lower, as `solids` has things
        self.drops = solids_of([Piece("", *d.at, 0.0, *d.size, d.depth, above=-d.depth) for d in floor.drops])
        self._world.addSkeleton(base.skeleton)
        self.doors = {door.name: door.open for door in floor.doors}
        self.people = {person.name: Walker(person) for person in floor.people}
        self.crates = {box.name or f"box{i}": _crate(box) for i, box in enumerate(floor.boxes) if box.mass is not None}
        self.extra: dict[str, Piece] = {}
        self._rests = False
        self._rebuild()

    def _rebuild(self) -> None:
        """Make everything that stands fast anew: at the start, and when something comes or goes."""
        floor = self.floor
        standing = [*made.standing(floor), *self.extra.values()]
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
        seen = [p for p in self.pieces[: self.first_leaf] if p.above <= self._laser_height < p.top]
        boxes = [p.segments() for p in seen if not p.radius]
        self._segments = np.vstack(boxes) if boxes else np.zeros((0, 4))
        self._circles = np.array([(p.x, p.y, p.radius) for p in seen if p.radius]).reshape(-1, 3)
        self._solids = solids_of(self.pieces[: self.first_leaf])

    def solids(self) -> Floats:
        """What a camera sees now, as `sim.depth_kernel.render` has it: (n, 8), metres."""
        moving = [*(crate.now() for crate in self.crates.values()), *self.leaves(is_open=False)]
        moving += [walker.piece() for walker in self.people.values()]
        return np.vstack([self._solids, solids_of(moving)])

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

    def step(self, count: int, *, aims_still: bool = False) -> None:
        """Let so many steps of DART pass; motors keep what they were told.

        Where they were told to stand still and nothing moves any more, nothing is computed: steps would change nothing.
        """
        if aims_still and self._rests:
            return
        step = self._world.step
        for _ in range(count):
            step(False)  # DART keeps what the motors were told
        self._rests = aims_still and self._slowed_down()

    @property
    def rests(self) -> bool:
        """Whether nothing that DART moves has moved in the last step, or been changed since."""
        return self._rests

    def _slowed_down(self) -> bool:
        moving = [self.base.skeleton, *(crate.skeleton for crate in self.crates.values() if crate.inside)]
        return all(float(np.abs(one.getVelocities()).max()) < _REST for one in moving)

    def walk(self, seconds: float) -> None:
        """Let people walk for so long; who would walk into the robot or a crate waits."""
        if not self.people:
            return
        x, y, _ = self.base.pose()
        reach = self.base.robot.body.radius
        for i, walker in enumerate(self.people.values()):
            if walker.walk(seconds, (x, y), reach + _ROOM) and self.window.put(self._first_person + i, walker.piece()):
                self._rests = False

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
                crate.inside, self._rests = near, False
                crate.skeleton.setVelocities(np.zeros(6))
                (self._world.addSkeleton if near else self._world.removeSkeleton)(crate.skeleton)
            if near:
                self._near += 1
                bodies.append((piece.x, piece.y, piece.reach))
        if self.window.look(bodies):
            self._rests = False

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
        """Open or close a door; raises `SimError` if there is none of that name, or somebody stands in it."""
        if door not in self.doors:
            raise SimError(f"there is no door {door!r}; doors: {', '.join(self.doors) or 'none'}")
        index = self.first_leaf + list(self.doors).index(door)
        if not is_open and (who := self._within(self.pieces[index])):
            raise SimError(f"the door {door!r} cannot be closed: {who} stands in it")
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
            low = name == "the robot" and piece.above >= self.base.robot.body.tall
            if name != leave_out and not low and _distance(piece, x, y) < reach:
                return name
        return ""

    def spawn(self, thing: Box | Person | Piece, name: str) -> None:
        """Add a box, a person or something fast; raises `SimError` if name or place is taken, or there are too many."""
        if not name or name in self.names:
            raise SimError(f"a thing needs a name of its own; {name!r} is taken" if name else "a thing needs a name")
        if len(self.extra) + len(self.crates) + len(self.people) >= _SPAWNED:
            raise SimError(f"there are {_SPAWNED} things already; remove some")
        piece = _solid(thing)
        if who := self._within(piece):
            raise SimError(f"{name!r} cannot be put there: {who} stands there")
        self._clear()
        if isinstance(thing, Person):
            self.people[name] = Walker(thing)
        elif isinstance(thing, Box) and thing.mass is not None:
            self.crates[name] = _crate(thing)
        else:
            self.extra[name] = piece
        self._rebuild()

    def _clear(self) -> None:
        self.window.clear()
        self._rests = False

    def remove(self, name: str) -> None:
        """Take away what was added, a box that can be pushed, or a person; raises `SimError` if there is none."""
        among: dict[str, Any] | None = next((m for m in (self.extra, self.crates, self.people) if name in m), None)
        if among is None:
            known = ", ".join((*self.extra, *self.crates, *self.people)) or "nothing"
            raise SimError(f"{name!r} cannot be taken away; what can be: {known}")
        self._clear()
        gone = among.pop(name)
        if isinstance(gone, Crate) and gone.inside:
            self._world.removeSkeleton(gone.skeleton)
        self._rebuild()

    def place(self, pose: BasePose) -> None:
        """Stand the base elsewhere, at rest; raises `SimError` if something stands there."""
        radius = self.base.robot.body.radius
        there = [*self.pieces[: self.first_leaf], *self.leaves(is_open=False)]
        there += [walker.piece() for walker in self.people.values()]
        there += [replace(crate.now(), name=name) for name, crate in self.crates.items()]
        for piece in there:
            if piece.above < self.base.robot.body.tall and _distance(piece, pose.x, pose.y) < radius:
                msg = f"the robot cannot stand at {pose.x:.2f}, {pose.y:.2f}: {piece.name or 'a wall'} is there"
                raise SimError(msg)
        self.base.place(pose)
        self._rests = False
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


def solids_of(pieces: Iterable[Piece]) -> Floats:
    """Pieces as `sim.depth_kernel.render` has them: (n, 8)."""
    rows = []
    for p in pieces:
        half = (p.radius, 0.0) if p.radius else (p.length / 2, p.width / 2)
        rows.append((p.x, p.y, math.cos(p.yaw), math.sin(p.yaw), *half, p.above, p.top))
    return np.array(rows, float).reshape(-1, 8)


def _distance(piece: Piece, x: float, y: float) -> float:
    """From a point to a piece, metres; 0 within it."""
    dx, dy = x - piece.x, y - piece.y
    if piece.radius:
        return max(0.0, math.hypot(dx, dy) - piece.radius)
    c, s = math.cos(piece.yaw), math.sin(piece.yaw)
    along, aside = abs(c * dx + s * dy) - piece.length / 2, abs(c * dy - s * dx) - piece.width / 2
    return math.hypot(max(0.0, along), max(0.0, aside))


MARGIN = 0.5
"""Metres around a body within which pieces are put in; the fastest base comes 5 cm nearer between two looks."""


class Window:
    """The pieces that stand fast, and which of them collide at the moment.

    DART's collision detection slows down with everything that there is (500 walls: tenfold). So what stands fast is no
    part of the world: the pieces near to the base, and to boxes that it may push, are in its collision group.

    Args:
        nodes: the pieces' shape nodes.
        pieces: the pieces, in the same order.

    Attributes:
        count: of the pieces that collide at the moment.
    """

    def __init__(self, group: Any, nodes: list[Any], pieces: list[Piece]) -> None:
        self._group, self._nodes = group, nodes
        self._middles = np.array([(p.x, p.y) for p in pieces]).reshape(-1, 2)
        self._half = np.array([(p.length / 2, p.width / 2) for p in pieces]).reshape(-1, 2)
        self._radius = np.array([p.radius for p in pieces])
        self._turned = np.array([(math.cos(p.yaw), math.sin(p.yaw)) for p in pieces]).reshape(-1, 2)
        self._there = np.ones(len(pieces), np.bool_)
        self._in = np.zeros(len(pieces), np.bool_)
        self.count = 0

    def look(self, bodies: Iterable[tuple[float, float, float]]) -> bool:
        """Put in what is near to these bodies (x, y, reach in metres), and take out the rest; whether that changed."""
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
            self.count = int(wanted.sum())
        return len(changed) > 0

    def _away(self, x: float, y: float) -> NDArray[np.float64]:
        """How far each piece is from a point, metres."""
        dx, dy = x - self._middles[:, 0], y - self._middles[:, 1]
        c, s = self._turned[:, 0], self._turned[:, 1]
        along = np.maximum(np.abs(c * dx + s * dy) - self._half[:, 0], 0.0)
        aside = np.maximum(np.abs(c * dy - s * dx) - self._half[:, 1], 0.0)
        away: NDArray[np.float64] = np.hypot(along, aside) - self._radius
        return away

    def put(self, index: int, piece: Piece) -> bool:
        """A piece stands elsewhere now; whether it collides at the moment."""
        self._nodes[index].setRelativeTransform(place_of(piece))
        self._middles[index] = piece.x, piece.y
        return bool(self._in[index])

    def there(self, index: int, *, there: bool) -> None:
        """A piece is there, or gone; it collides from the next look on."""
        self._there[index] = there

    def clear(self) -> None:
        """Take all out."""
        for i in np.flatnonzero(self._in):
            self._group.removeShapeFrame(self._nodes[i])
        self._in[:] = False
        self.count = 0
