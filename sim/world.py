"""One floor and the base in DART. To save time, only things near the base, or near a box that it can push, collide."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.base import STEP_NS, Base, BasePose
from sim.bodies import fixed, ground, movable, place_of, yaw_of
from sim.environment import SimError, dartpy
from sim.pieces import Piece, Walker, distance, leaf, occupant, of_box, of_person, standing
from sim.plan import Box, Floor, Person

Floats = NDArray[np.float64]

_NEAR = 3.0  # meters; DART's world has the movable boxes within this distance of the base, and others stand still
_ROOM = 0.05  # meters around the base at which people wait, and within which contacts count as the base's
_REST = 1e-9  # a slower body is at rest, m/s or rad/s; the residual speed of a standing base falls tenfold in 50 ticks
_BUMP_HEIGHT = 0.03  # meters; contacts below this height are with the floor
_SPAWNED = 200  # maximum number of added things, movable boxes and people, including those of the plan


@dataclass
class Crate:
    """A box that can be pushed."""

    piece: Piece
    skeleton: Any
    inside: bool = False

    def now(self) -> Piece:
        """Return the box at its current pose."""
        at = self.skeleton.getBodyNode(0).getTransform()
        x, y, _ = at.translation()
        return self.piece.moved(float(x), float(y), yaw_of(at.rotation()))


class FloorWorld:
    """One floor, whose things are identified by name.

    Args:
        laser_height: meters above the floor; the laser sees only things at this height, and people.

    Attributes:
        pieces: everything but movable boxes: walls and fixed things, then the doors' leaves, then people.
        first_leaf: index of the first leaf.
        doors: whether each door is open.
        people: walking people.
        crates: movable boxes.
        extra: fixed things that were added.
    """

    def __init__(self, floor: Floor, base: Base, laser_height: float) -> None:
        self.floor, self.base, self._laser_height = floor, base, laser_height
        dart = dartpy()
        self._world = dart.simulation.World("midspan")
        self._world.setGravity([0.0, 0.0, -9.81])
        self._world.setTimeStep(STEP_NS / 1e9)
        self._world.setCollisionDetector(dart.collision.BulletCollisionDetector())
        self._world.addSkeleton(ground(floor.reach, floor.drops))
        # the lower parts of the floor, in the format of `solids`
        self.drops = solids_of([Piece("", *d.at, 0.0, *d.size, d.depth, above=-d.depth) for d in floor.drops])
        self._world.addSkeleton(base.skeleton)
        self.doors = {door.name: door.open for door in floor.doors}
        self.people = {person.name: Walker(person) for person in floor.people}
        self.crates = {box.name or f"box{i}": _crate(box) for i, box in enumerate(floor.boxes) if box.mass is not None}
        self.extra: dict[str, Piece] = {}
        self._rests = False
        self._rebuild()

    def _rebuild(self) -> None:
        """Rebuild the fixed pieces: at the start, and when a thing is added or removed."""
        floor = self.floor
        fixtures = [*standing(floor), *self.extra.values()]
        leaves = [leaf(door, floor) for door in floor.doors]
        self.pieces = [*fixtures, *leaves, *(walker.piece() for walker in self.people.values())]
        self.first_leaf = len(fixtures)
        self._first_person = self.first_leaf + len(leaves)
        self._fixed, nodes = fixed(self.pieces)
        self.window = Window(self._world.getConstraintSolver().getCollisionGroup(), nodes, self.pieces)
        for i, is_open in enumerate(self.doors.values()):
            self.window.set_present(self.first_leaf + i, present=not is_open)
        self._filter()
        self._prepare_sensing()
        self.update_near()

    @property
    def names(self) -> set[str]:
        """The names of all named things."""
        return {*(p.name for p in self.pieces if p.name), *self.crates}

    def _filter(self) -> None:
        """Let wheels collide only with the floor, because as spheres they protrude from the base."""
        # the options are a copy, but contain the solver's own filter
        blacklist = self._world.getConstraintSolver().getCollisionOption().collisionFilter
        blacklist.removeAllBodyNodePairsFromBlackList()
        others = [self._fixed.getBodyNode(0), *(crate.skeleton.getBodyNode(0) for crate in self.crates.values())]
        for wheel in self.base.wheels:
            blacklist.addBodyNodePairToBlackList(wheel, self.base.body)
            for other in others:
                blacklist.addBodyNodePairToBlackList(wheel, other)
        if len(self.base.wheels) > 1:
            blacklist.addBodyNodePairToBlackList(*self.base.wheels)

    def _prepare_sensing(self) -> None:
        """Precompute the shapes of the fixed pieces for the laser and the camera."""
        seen = [p for p in self.pieces[: self.first_leaf] if p.above <= self._laser_height < p.top]
        boxes = [p.segments() for p in seen if not p.radius]
        self._segments = np.vstack(boxes) if boxes else np.zeros((0, 4))
        self._circles = np.array([(p.x, p.y, p.radius) for p in seen if p.radius]).reshape(-1, 3)
        self._solids = solids_of(self.pieces[: self.first_leaf])

    def solids(self) -> Floats:
        """Return the current solids for a camera, (n, 8), in the format of `sim.depth_kernel.render`."""
        moving = [*(crate.now() for crate in self.crates.values()), *self.leaves(is_open=False)]
        moving += [walker.piece() for walker in self.people.values()]
        return np.vstack([self._solids, solids_of(moving)])

    def seen(self) -> tuple[Floats, Floats]:
        """Return the laser's current shapes: segments (n, 4) and circles (m, 3), meters."""
        moving = [crate.now() for crate in self.crates.values()]
        more = [p.segments() for p in (*moving, *self.leaves(is_open=False)) if p.height > self._laser_height]
        segments = np.vstack([self._segments, *more]) if more else self._segments
        people = [(w.x, w.y, w.person.radius) for w in self.people.values()]
        circles = np.vstack([self._circles, np.array(people)]) if people else self._circles
        return segments, circles

    def leaves(self, *, is_open: bool) -> list[Piece]:
        """Return the leaves of the open or of the closed doors, each in the closed position."""
        return [self.pieces[self.first_leaf + i] for i, now in enumerate(self.doors.values()) if now == is_open]

    def step(self, count: int, *, aims_still: bool = False) -> None:
        """Run DART steps; the motors keep their commands.

        If the motors are commanded to stand still and nothing moves, steps are skipped, as they would change nothing.
        """
        if aims_still and self._rests:
            return
        step = self._world.step
        for _ in range(count):
            step(False)  # False: keep the motors' commands
        self._rests = aims_still and self._slowed_down()

    @property
    def rests(self) -> bool:
        """Whether nothing moved or was commanded to move in the last step, and nothing was changed since."""
        return self._rests

    def _slowed_down(self) -> bool:
        moving = [self.base.skeleton, *(crate.skeleton for crate in self.crates.values() if crate.inside)]
        return all(float(np.abs(skeleton.getVelocities()).max()) < _REST for skeleton in moving)

    def walk(self, seconds: float) -> None:
        """Let people walk for a time; they wait if the robot is in their path."""
        if not self.people:
            return
        x, y, _ = self.base.pose()
        reach = self.base.robot.body.radius
        for i, walker in enumerate(self.people.values()):
            if walker.walk(seconds, (x, y), reach + _ROOM) and self.window.move(self._first_person + i, walker.piece()):
                self._rests = False

    def update_near(self) -> None:
        """Update which things near the base can collide; call this 20 times per simulated second."""
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
        if self.window.select(bodies):
            self._rests = False

    def bumps(self) -> list[tuple[float, float]]:
        """Return the points at which the base touches anything but the floor: x, y in meters."""
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
        """Open or close a door; raises `SimError` if it is unknown, or cannot close because something stands in it."""
        if door not in self.doors:
            raise SimError(f"unknown door {door!r}; doors: {', '.join(self.doors) or 'none'}")
        index = self.first_leaf + list(self.doors).index(door)
        if not is_open and (occupant := self._within(self.pieces[index])):
            raise SimError(f"the door {door!r} cannot be closed: {occupant} stands in it")
        self.doors[door] = is_open
        self.window.set_present(index, present=not is_open)
        self.update_near()

    def _within(self, piece: Piece) -> str:
        """Return what occupies the place of a piece, "" if it is free."""
        x, y, _ = self.base.pose()
        things = [("the robot", x, y, self.base.robot.body.radius)]
        things += [(name, w.x, w.y, w.person.radius) for name, w in self.people.items()]
        things += [(name, (p := crate.now()).x, p.y, p.reach) for name, crate in self.crates.items()]
        for name, x, y, reach in things:
            low = name == "the robot" and piece.above >= self.base.robot.body.tall
            if not low and distance(piece, x, y) < reach:
                return name
        return ""

    def spawn(self, thing: Box | Person | Piece, name: str) -> None:
        """Add a box, a person or a fixed piece.

        Raises `SimError` if the name is empty or taken, the place is occupied, or there are too many things.
        """
        if not name or name in self.names:
            raise SimError(f"the name {name!r} is taken" if name else "a thing needs a name")
        if len(self.extra) + len(self.crates) + len(self.people) >= _SPAWNED:
            raise SimError(f"limit of {_SPAWNED} things reached; remove some")
        piece = _solid(thing)
        if occupant := self._within(piece):
            raise SimError(f"cannot place {name!r}: {occupant} stands there")
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
        """Remove an added thing, a movable box or a person; raises `SimError` if the name is unknown."""
        group: dict[str, Any] | None = next((m for m in (self.extra, self.crates, self.people) if name in m), None)
        if group is None:
            known = ", ".join((*self.extra, *self.crates, *self.people)) or "none"
            raise SimError(f"cannot remove {name!r}; removable things: {known}")
        self._clear()
        removed = group.pop(name)
        if isinstance(removed, Crate) and removed.inside:
            self._world.removeSkeleton(removed.skeleton)
        self._rebuild()

    def place(self, pose: BasePose) -> None:
        """Move the base to a pose, at rest; raises `SimError` if the place is occupied."""
        obstacles = [*self.pieces[: self.first_leaf], *self.leaves(is_open=False)]
        obstacles += [walker.piece() for walker in self.people.values()]
        obstacles += [replace(crate.now(), name=name) for name, crate in self.crates.items()]
        if reason := occupant(obstacles, self.base.robot.body, pose.x, pose.y):
            raise SimError(reason)
        self.base.place(pose)
        self._rests = False
        self.update_near()

    def release_base(self) -> None:
        """Remove the base from this world, for use in another."""
        self.window.clear()
        self._world.removeSkeleton(self.base.skeleton)

    def take_base(self) -> None:
        """Add the base again after `release_base`, at its current pose."""
        self._world.addSkeleton(self.base.skeleton)
        self._rests = False
        self.update_near()


def _crate(box: Box) -> Crate:
    piece = of_box(box)
    return Crate(piece, movable(piece, box.mass or 1.0, box.friction))


def _solid(thing: Box | Person | Piece) -> Piece:
    if isinstance(thing, Piece):
        return thing
    return of_box(thing) if isinstance(thing, Box) else of_person(thing)


def solids_of(pieces: Iterable[Piece]) -> Floats:
    """Return pieces in the format of `sim.depth_kernel.render`, (n, 8)."""
    rows = []
    for p in pieces:
        half = (p.radius, 0.0) if p.radius else (p.length / 2, p.width / 2)
        rows.append((p.x, p.y, math.cos(p.yaw), math.sin(p.yaw), *half, p.above, p.top))
    return np.array(rows, float).reshape(-1, 8)


MARGIN = 0.5
"""Meters around a body within which pieces collide; between two updates the fastest base moves 5 cm."""


class Window:
    """All pieces except movable boxes, and which of these pieces can currently collide.

    DART's collision detection slows down with the number of objects (tenfold with 500 walls). The pieces are therefore
    not part of DART's world. Only pieces near the base, or near a box that it can push, are in the collision group.

    Args:
        nodes: the pieces' shape nodes.
        pieces: the pieces, in the same order.

    Attributes:
        count: number of pieces that can currently collide.
    """

    def __init__(self, group: Any, nodes: list[Any], pieces: list[Piece]) -> None:
        self._group, self._nodes = group, nodes
        self._middles = np.array([(p.x, p.y) for p in pieces]).reshape(-1, 2)
        self._half = np.array([(p.length / 2, p.width / 2) for p in pieces]).reshape(-1, 2)
        self._radius = np.array([p.radius for p in pieces])
        self._turned = np.array([(math.cos(p.yaw), math.sin(p.yaw)) for p in pieces]).reshape(-1, 2)
        self._present = np.ones(len(pieces), np.bool_)
        self._in = np.zeros(len(pieces), np.bool_)
        self.count = 0

    def select(self, bodies: Iterable[tuple[float, float, float]]) -> bool:
        """Enable the pieces near these bodies (x, y, reach in meters), disable others; return whether any changed."""
        wanted = np.zeros(len(self._in), np.bool_)
        for x, y, reach in bodies:
            wanted |= self._away(x, y) < reach + MARGIN
        wanted &= self._present
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
        """Return each piece's distance from a point, in meters."""
        dx, dy = x - self._middles[:, 0], y - self._middles[:, 1]
        c, s = self._turned[:, 0], self._turned[:, 1]
        along = np.maximum(np.abs(c * dx + s * dy) - self._half[:, 0], 0.0)
        aside = np.maximum(np.abs(c * dy - s * dx) - self._half[:, 1], 0.0)
        away: NDArray[np.float64] = np.hypot(along, aside) - self._radius
        return away

    def move(self, index: int, piece: Piece) -> bool:
        """Move a piece; return whether it can currently collide."""
        self._nodes[index].setRelativeTransform(place_of(piece))
        self._middles[index] = piece.x, piece.y
        return bool(self._in[index])

    def set_present(self, index: int, *, present: bool) -> None:
        """Set whether a piece exists; applied at the next `select`."""
        self._present[index] = present

    def clear(self) -> None:
        """Disable all pieces."""
        for i in np.flatnonzero(self._in):
            self._group.removeShapeFrame(self._nodes[i])
        self._in[:] = False
        self.count = 0
