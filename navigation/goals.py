"""Goals of the hub: the places that they name, the goal at hand, and whether its client is still there."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

from bridge.modules.action_server import ActionServer, Goal
from bridge.modules.host import Host
from bridge.modules.loop import EventLoop
from navigation.constraints import Constraints
from navigation.frames import FramesError, RobotFrames
from navigation.maps.grid import yaw_of
from navigation.pose import Pose
from navigation.status import NO_GOAL, Fault, PlanError, PlannerStatus, State

_FARTHEST = 1e6  # metres; no map is as large, and sums of far greater numbers say nothing any more


@dataclass(frozen=True)
class MapPlace:
    """A pose on a map; `name` is how people know it."""

    map_name: str
    pose: Pose
    name: str = ""


def goal_of(
    goal: Mapping[str, Any], frames: RobotFrames, maps: Callable[[], Collection[str]]
) -> tuple[MapPlace, Constraints]:
    """What a ``NavigateToPose`` goal asks for; raises `PlanError` if it says none; the text says why.

    Its frame is the map's, any that is on `/tf`, or the name of a map that ``maps`` lists; where that is no name of a
    topic's, the goal's text says it: ``midspan: map=NAME``.
    """
    try:
        wanted = Constraints.from_text(goal["behavior_tree"])
    except ValueError as err:
        raise PlanError(Fault.BAD_GOAL, f"the goal's behavior_tree: {err}") from None
    stamped = goal["pose"]
    place, turn = stamped["pose"]["position"], stamped["pose"]["orientation"]
    theta = yaw_of(turn)
    if not all(map(math.isfinite, (place["x"], place["y"], theta))):
        raise PlanError(Fault.BAD_GOAL, f"a goal is a place: x, y and heading are numbers, not {place} and {turn}")
    if max(abs(place["x"]), abs(place["y"])) > _FARTHEST:
        raise PlanError(Fault.BAD_GOAL, f"a goal is within {_FARTHEST:g} m, not at {place['x']:g}, {place['y']:g}")
    pose, frame = Pose(place["x"], place["y"], theta), stamped["header"]["frame_id"].lstrip("/")
    if frame in ("", frames.map_frame):
        return MapPlace(wanted.map, pose), wanted
    try:
        return MapPlace("", frames.on_map(frame) @ pose), wanted
    except FramesError as err:
        if frame in maps():
            return MapPlace(frame, pose), wanted
        why = f"the goal is in the frame '{frame}': {err}; ask again once it is"
        raise PlanError(Fault.UNKNOWN_FRAME, why) from None


class CurrentGoal:
    """The goal of the hub's action at hand; ``stop`` is called with why, once it is cancelled, and ends it."""

    def __init__(self, loop: EventLoop, stop: Callable[[str], Any]) -> None:
        self._loop, self._stop = loop, stop
        self.goal: Goal | None = None  # none where there is none

    @property
    def id(self) -> bytes:
        """Its 16 bytes; zeros for none."""
        return self.goal.id if self.goal else NO_GOAL

    def replace(self, goal: Goal | None) -> None:
        """Another takes its place."""
        self.end(PlannerStatus(State.IDLE, "another goal took its place", Fault.OTHER))
        self.goal = goal
        if goal is not None:
            goal.execute()

    def cancel(self, goal: Goal) -> bool:
        """A client cancels a goal; whether it is this one."""
        if goal is not self.goal:
            return False
        self._loop.post(lambda: self._stop("cancelled") if goal is self.goal else None)
        return True

    def end(self, status: PlannerStatus) -> None:
        """End the goal with this status; `State.IDLE` if it was stopped."""
        goal, self.goal = self.goal, None
        if goal is None:
            return
        end = {State.REACHED: goal.succeed, State.IDLE: goal.canceled}.get(status.state, goal.abort)
        end(result(status.fault, "" if status.state is State.REACHED else status.reason))


def result(fault: int, reason: str) -> dict[str, Any]:
    """The result of a ``NavigateToPose`` goal."""
    return {"error_code": int(fault), "error_msg": reason}


_EVERY = 0.25
_LOOKS = 3  # so often in a row no client is seen before that counts: a link may be made again

GONE = "who gave the goal is gone, and nobody is left who could cancel it"
CUT_OFF = "who gave the goal is on another machine, and is not seen any more: the link is cut, or the program has ended"


class Clients:
    """Watches the clients of an action while it has a goal: where all have gone, their link was cut.

    ``gone`` is called once all have gone that were there, while a goal is under way.
    """

    def __init__(self, host: Host, server: ActionServer, gone: Callable[[], None]) -> None:
        self._server, self._gone = server, gone
        self._seen, self._missed = False, 0
        host.loop.every(_EVERY, self._look)

    def _look(self) -> None:
        if not self._server.active:
            self._seen, self._missed = False, 0
        elif self._server.clients:
            self._seen, self._missed = True, 0
        elif self._seen:
            self._missed += 1
            if self._missed >= _LOOKS:
                self._seen = False
                self._gone()


@dataclass
class _Far:
    """A goal's client: whether it is on this machine, was ever seen, and how often it was missed in a row."""

    near: bool = False
    seen: bool = False
    missed: int = 0


class FarClients:
    """Watches the clients of goals on other machines: one that is cut off can stop no robot.

    A client of this machine may end, and its goal goes on: its session tells it from others, which is this one or has a
    direct link. ``gone`` is called with a goal once its client is not there any more.
    """

    def __init__(self, host: Host, server: ActionServer, gone: Callable[[Goal], None]) -> None:
        self._hub, self._server, self._gone = host.node.hub, server, gone
        self._known: dict[bytes, _Far] = {}
        server.met = self._meet
        host.loop.every(_EVERY, self._look)

    def _meet(self, goal: Goal) -> None:
        """As it comes: whoever sent it may be cut off before the next look."""
        if goal.client:
            self._known[goal.id] = far = _Far()
            self._see(far, goal, self._near())

    def _near(self) -> set[str]:
        """The sessions of this machine; another module's node has the same one."""
        return self._hub.neighbours() | {self._hub.zid}

    def _see(self, far: _Far, goal: Goal, near: Collection[str]) -> None:
        session = self._hub.graph.zid_of(goal.client)
        far.near = far.near or session in near
        far.seen = far.seen or bool(session)
        far.missed = 0 if session else far.missed + 1

    def _look(self) -> None:
        goals = [goal for goal in self._server.active if goal.client]
        self._known = {goal.id: self._known.get(goal.id) or _Far() for goal in goals}
        if not goals:
            return
        near = self._near()
        for goal in goals:
            far = self._known[goal.id]
            self._see(far, goal, near)
            if far.seen and not far.near and far.missed >= _LOOKS:
                self._gone(goal)
