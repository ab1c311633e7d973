"""What the simulator is asked for on the hub, under ``/sim/``."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from bridge.modules.services import Answer
from sim import plan
from sim.base import Pose
from sim.errors import SimError
from sim.pieces import of_round
from sim.simulation import Simulation

Request = dict[str, Any]
_MOST_POINTS = 1000
_BOX, _ROUND, _PERSON = 0, 1, 2


def answered(do: Callable[[Request], str]) -> Callable[[Request, Answer], None]:
    """A service whose reply is success and a message; what cannot be done is told in it."""

    def serve(request: Request, answer: Answer) -> None:
        try:
            text = do(request)
        except (SimError, ValueError) as err:
            answer({"success": False, "message": str(err)})
        else:
            answer({"success": True, "message": text})

    return serve


class Wishes:
    """Changes to what is simulated.

    Args:
        simulation: that.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation

    def services(self) -> dict[str, tuple[str, Callable[[Request], str]]]:
        """By name: its type, and what does it."""
        named = "midspan_msgs/srv/Named"
        return {
            "/sim/emergency_stop": ("std_srvs/srv/SetBool", self._stop),
            "/sim/teleport": ("midspan_msgs/srv/Teleport", self._teleport),
            "/sim/spawn": ("midspan_msgs/srv/Spawn", self._spawn),
            "/sim/walk": ("midspan_msgs/srv/Walk", self._walk),
            "/sim/remove": (named, self._remove),
            "/sim/open": (named, lambda request: self._door(request, is_open=True)),
            "/sim/close": (named, lambda request: self._door(request, is_open=False)),
            "/sim/fail": (named, lambda request: self._simulation.faults.set(request["name"], on=True)),
            "/sim/mend": (named, lambda request: self._simulation.faults.set(request["name"], on=False)),
            "/sim/ride": (named, lambda request: f"on the floor {self._simulation.ride(request['name'])}"),
        }

    def _stop(self, request: Request) -> str:
        self._simulation.stop(on=bool(request["data"]))
        return "the wheels hold still" if request["data"] else "the wheels may turn"

    def _teleport(self, request: Request) -> str:
        wanted = request["pose"]
        to = Pose(*_finite(wanted["x"], wanted["y"], wanted["theta"]))
        self._simulation.teleport(to)
        return f"the robot is at {to.x:.2f}, {to.y:.2f}"

    def _spawn(self, request: Request) -> str:
        name, kind, pose = request["name"], request["kind"], request["pose"]
        x, y, yaw = _finite(pose["x"], pose["y"], pose["theta"])
        thing: plan.Box | plan.Person | Any
        if kind == _BOX:
            mass = request["mass"] or None
            length, width, height = (float(v) for v in request["size"])
            thing = plan.Box(name=name, at=(x, y, math.degrees(yaw)), size=(length, width, height), mass=mass)
        elif kind == _ROUND:
            thing = of_round(plan.Round(name=name, at=(x, y), radius=request["radius"]))
        elif kind == _PERSON:
            thing = plan.Person(name=name, at=(x, y), radius=request["radius"] or 0.2)
        else:
            msg = f"kind {kind} is none of BOX, ROUND and PERSON (0, 1, 2)"
            raise SimError(msg)
        self._simulation.world.spawn(thing, name)
        return f"{name} is there"

    def _walk(self, request: Request) -> str:
        people = self._simulation.world.people
        walker = people.get(request["name"])
        if walker is None:
            msg = f"there is nobody called {request['name']!r}; people: {', '.join(people) or 'none'}"
            raise SimError(msg)
        if len(request["path"]) > _MOST_POINTS:
            msg = f"a path has {_MOST_POINTS} points at most"
            raise SimError(msg)
        points = [_finite(point["x"], point["y"], 0.0)[:2] for point in request["path"]]
        walker.send(((p[0], p[1]) for p in points), loop=bool(request["loop"]))
        return f"{request['name']} is on the way"

    def _remove(self, request: Request) -> str:
        self._simulation.world.remove(request["name"])
        return f"{request['name']} is gone"

    def _door(self, request: Request, *, is_open: bool) -> str:
        self._simulation.world.open(request["name"], is_open=is_open)
        return f"{request['name']} is {'open' if is_open else 'closed'}"


def _finite(*values: float) -> tuple[float, ...]:
    if not all(math.isfinite(value) and abs(value) < 10_000 for value in values):
        msg = f"{values} are not finite numbers within 10 km"
        raise SimError(msg)
    return values
