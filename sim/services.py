"""The simulator's services on the hub, under ``/sim/``: changes to the simulation, and single steps."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from bridge.modules.loop import EventLoop, Timer
from bridge.modules.services import Answer
from sim import messages, plan
from sim.base import TICK_NS, BasePose
from sim.environment import SimError
from sim.pieces import of_round
from sim.simulation import Simulation

Request = dict[str, Any]
_MOST_POINTS = 1000
_BOX, _ROUND, _PERSON = 0, 1, 2  # constants of midspan_msgs/srv/Spawn


def answered(do: Callable[[Request], str]) -> Callable[[Request, Answer], None]:
    """Return a service handler that replies with success and a message, or with the error of a refused request."""

    def serve(request: Request, answer: Answer) -> None:
        try:
            text = do(request)
        except (SimError, ValueError) as err:
            answer({"success": False, "message": str(err)})
        else:
            answer({"success": True, "message": text})

    return serve


class ChangeServices:
    """The services that change the simulation."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation

    def services(self) -> dict[str, tuple[str, Callable[[Request], str]]]:
        """Return the type and the handler of each service, by its name."""
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
        return "emergency stop on" if request["data"] else "emergency stop off"

    def _teleport(self, request: Request) -> str:
        wanted = request["pose"]
        to = BasePose(*_finite(wanted["x"], wanted["y"], wanted["theta"]))
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
            raise SimError(f"unknown kind {kind}; kinds: BOX (0), ROUND (1), PERSON (2)")
        self._simulation.world.spawn(thing, name)
        return f"{name} was added"

    def _walk(self, request: Request) -> str:
        people = self._simulation.world.people
        walker = people.get(request["name"])
        if walker is None:
            raise SimError(f"unknown person {request['name']!r}; people: {', '.join(people) or 'none'}")
        if len(request["path"]) > _MOST_POINTS:
            raise SimError(f"a path may have at most {_MOST_POINTS} points")
        points = [_finite(point["x"], point["y"], 0.0)[:2] for point in request["path"]]
        walker.send(((p[0], p[1]) for p in points), loop=bool(request["loop"]))
        return f"{request['name']} walks"

    def _remove(self, request: Request) -> str:
        self._simulation.world.remove(request["name"])
        return f"{request['name']} was removed"

    def _door(self, request: Request, *, is_open: bool) -> str:
        self._simulation.world.open(request["name"], is_open=is_open)
        return f"{request['name']} is {'open' if is_open else 'closed'}"


def _finite(*values: float) -> tuple[float, ...]:
    if not all(math.isfinite(value) and abs(value) < 10_000 for value in values):
        raise SimError(f"{values} are not finite numbers within 10 km")
    return values


_LONGEST_STEP = 3600.0  # seconds
_BUNDLE = 50  # ticks between two rounds of message handling


class Stepping:
    """Serves ``/sim/step``, which replies once all named participants have acknowledged the time of the step.

    If some have not after the request's ``patience``, it replies so. Only one step runs at a time. Used only on the
    module's thread.

    Args:
        tick: runs one tick, and returns its stamp in ns.
        paced: whether the caller sets the pace with `advance`; otherwise a step runs as fast as possible.
    """

    def __init__(self, loop: EventLoop, tick: Callable[[], int], *, paced: bool = False) -> None:
        self._loop, self._tick, self._paced = loop, tick, paced
        self._answer: Answer | None = None
        self._left = 0
        self._now = 0
        self._wait_for: set[str] = set()
        self._acknowledged: dict[str, int] = {}
        self._patience = 0.0
        self._timer: Timer | None = None

    @property
    def busy(self) -> bool:
        """Whether a step is in progress."""
        return self._answer is not None

    def serve(self, request: dict[str, Any], answer: Answer) -> None:
        """Start a step of simulated time; an invalid request gets the reason at once."""
        seconds, patience = request["seconds"], request["patience"]
        if not (math.isfinite(seconds) and 0.0 < seconds <= _LONGEST_STEP and math.isfinite(patience)):
            text = f"a step must be more than 0 and at most {_LONGEST_STEP:g} seconds, and its patience finite"
            answer(_reply(self._now, text))
            return
        if self.busy:
            answer(_reply(self._now, "another step is in progress; wait for its reply"))
            return
        self._answer, self._left = answer, max(1, round(seconds * 1e9 / TICK_NS))
        self._wait_for, self._patience = set(request["wait_for"]), max(0.0, patience)
        if not self._paced:
            self._go()

    def acknowledge(self, message: dict[str, Any]) -> None:
        """Record that a participant has processed everything up to a time."""
        at = message["stamp"]["sec"] * 1_000_000_000 + message["stamp"]["nanosec"]
        if message["frame_id"] in self._wait_for:
            self._acknowledged[message["frame_id"]] = at
            self._finish()

    def give_up(self, why: str) -> None:
        """End the step in progress; ``why`` is the reason for its failure, "" if it succeeded."""
        answer, self._answer = self._answer, None
        self._left, self._acknowledged = 0, {}
        if self._timer is not None:
            self._timer.close()
        if answer is not None:
            answer(_reply(self._now, why))

    def _go(self) -> None:
        if self._answer is not None and self.advance(_BUNDLE):
            self._loop.post(self._go)

    def advance(self, ticks: int) -> bool:
        """Run at most this many ticks of the step in progress; return whether some are left."""
        if not self._left:
            return False
        count = min(self._left, ticks)
        for _ in range(count):
            self._now = self._tick()
        self._left -= count
        if not self._left:
            if self._wait_for:
                self._timer = self._loop.after(self._patience, self._on_timeout)
            self._finish()
        return self._left > 0

    def _unacknowledged(self) -> set[str]:
        return {name for name in self._wait_for if self._acknowledged.get(name, -1) < self._now}

    def _finish(self) -> None:
        if self._answer is not None and not self._left and not self._unacknowledged():
            self.give_up("")

    def _on_timeout(self) -> None:
        if self._answer is not None and not self._left and (missing := self._unacknowledged()):
            self.give_up(f"not acknowledged by {', '.join(sorted(missing))} within {self._patience:g} s")


def _reply(time_ns: int, why: str) -> dict[str, Any]:
    return {"success": not why, "message": why, "stamp": messages.stamp(time_ns)}
