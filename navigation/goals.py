"""Goals from the hub: their places, the current goal, and the presence of its client."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

from typing_extensions import override

from bridge.clock import steady_ns
from bridge.hub.zenoh_config import LEASE_MS
from bridge.modules.action_server import ActionServer, Goal
from bridge.modules.host import Host
from bridge.modules.loop import EventLoop
from navigation.constraints import Constraints
from navigation.frames import FramesError, RobotFrames
from navigation.maps.grid import yaw_of
from navigation.pose import Pose, check_rotation
from navigation.status import NO_GOAL, Fault, PlanError, PlannerStatus, State

MOST_POSES = 1000
"""Maximum number of poses of one goal."""

_FARTHEST = 1e6  # meters; no map is as large, and sums of far larger numbers lose their precision


@dataclass(frozen=True)
class MapPlace:
    """A pose on a map; `name` is its name for people."""

    map_name: str
    pose: Pose
    name: str = ""


def goal_of(
    goal: Mapping[str, Any], frames: RobotFrames, maps: Callable[[], Collection[str]]
) -> tuple[MapPlace, Constraints]:
    """Return the place and the constraints of a ``NavigateToPose`` goal; raises `PlanError` with the reason.

    The goal's frame is that of maps, any frame on `/tf`, or the name of a map that ``maps`` lists. A map whose name is
    not a valid frame is named in the goal's text: ``midspan: map=NAME``.
    """
    try:
        wanted = Constraints.from_text(goal["behavior_tree"])
    except ValueError as err:
        raise PlanError(Fault.BAD_GOAL, f"the goal's behavior_tree: {err}") from None
    stamped = goal["pose"]
    place, turn = stamped["pose"]["position"], stamped["pose"]["orientation"]
    theta = yaw_of(turn)
    if not all(map(math.isfinite, (place["x"], place["y"], theta))):
        raise PlanError(Fault.BAD_GOAL, f"the goal's x, y and heading must be finite, not {place} and {turn}")
    if wanted.heading:
        try:
            check_rotation(turn, "the goal's")
        except ValueError as err:
            raise PlanError(Fault.BAD_GOAL, str(err)) from None
    if max(abs(place["x"]), abs(place["y"])) > _FARTHEST:
        raise PlanError(Fault.BAD_GOAL, f"the goal is farther than {_FARTHEST:g} m: {place['x']:g}, {place['y']:g}")
    pose, frame = Pose(place["x"], place["y"], theta), stamped["header"]["frame_id"].lstrip("/")
    if frame in ("", frames.map_frame):
        return MapPlace(wanted.map, pose), wanted
    try:
        return MapPlace("", frames.on_map(frame) @ pose), wanted
    except FramesError as err:
        if frame in maps():
            return MapPlace(frame, pose), wanted
        reason = f"the goal is in the frame '{frame}': {err}; send it again once the frame is published"
        raise PlanError(Fault.UNKNOWN_FRAME, reason) from None


def places_of(
    goal: Mapping[str, Any], frames: RobotFrames, maps: Callable[[], Collection[str]]
) -> tuple[list[MapPlace], Constraints]:
    """Return the places and the constraints of a ``NavigateToPose`` or ``NavigateThroughPoses`` goal; see `goal_of`."""
    poses = goal["poses"] if "poses" in goal else [goal["pose"]]
    if not 0 < len(poses) <= MOST_POSES:
        raise PlanError(Fault.BAD_GOAL, f"the goal has {len(poses)} poses; send 1 to {MOST_POSES}")
    places, constraints = zip(*(goal_of({**goal, "pose": pose}, frames, maps) for pose in poses), strict=True)
    return list(places), constraints[0]


class CurrentGoal:
    """The current goal of the hub's action; its cancellation calls ``stop`` with the reason, which ends the goal."""

    def __init__(self, loop: EventLoop, stop: Callable[[str], Any]) -> None:
        self._loop, self._stop = loop, stop
        self.goal: Goal | None = None

    @property
    def id(self) -> bytes:
        """The goal's 16 bytes, zeros without a goal."""
        return self.goal.id if self.goal else NO_GOAL

    def replace(self, goal: Goal | None) -> None:
        """End the goal and execute another goal."""
        self.end(PlannerStatus(State.IDLE, "another goal replaced it", Fault.OTHER))
        self.goal = goal
        if goal is not None:
            goal.execute()

    def cancel(self, goal: Goal) -> bool:
        """Handle a client's cancellation of a goal; return whether it is this goal."""
        if goal is not self.goal:
            return False
        self._loop.post(lambda: self._stop("canceled") if goal is self.goal else None)
        return True

    def end(self, status: PlannerStatus) -> None:
        """End the goal with this status; `State.IDLE` means canceled."""
        goal, self.goal = self.goal, None
        if goal is None:
            return
        end = {State.REACHED: goal.succeed, State.IDLE: goal.canceled}.get(status.state, goal.abort)
        end(result(status.fault, "" if status.state is State.REACHED else status.reason))


def result(fault: int, reason: str) -> dict[str, Any]:
    """Return the result of a ``NavigateToPose`` goal."""
    return {"error_code": int(fault), "error_msg": reason}


_EVERY = 0.25  # seconds between two checks
_MISSES = 3  # checks in a row without a client before it counts as gone, because a link may be reopened

GONE = "the goal's client is unreachable, and no other client could cancel it"
_CUT_OFF = "the goal's client is unreachable: the program has exited, or the link to its machine is cut"
_SUSPENDED_SECONDS = 0.75 * LEASE_MS / 1000
"""Seconds of a suspension after which a client may have lost contact: sessions send four signs of life per lease."""

_NOTICED_SECONDS = 3.0
"""Seconds after a suspension within which the session notices that links have ended meanwhile."""


class Clients:
    """Watches the clients of an action while it has a goal of theirs.

    If all clients have disappeared, the link to them has been cut, so ``gone`` is called once.
    """

    def __init__(self, host: Host, server: ActionServer, gone: Callable[[], None]) -> None:
        self._server, self._gone = server, gone
        self._seen, self._missed = False, 0
        host.loop.every(_EVERY, self._check)

    def _check(self) -> None:
        if all(goal.local for goal in self._server.active):
            self._seen, self._missed = False, 0
        elif self._server.clients:
            self._seen, self._missed = True, 0
        elif self._seen:
            self._missed += 1
            if self._missed >= _MISSES:
                self._seen = False
                self._gone()


@dataclass
class _Far:
    """A goal's client: whether its link is direct, whether it was ever on the graph, and checks since it was there."""

    near: bool = False
    seen: bool = False
    missed: int = 0


@dataclass(frozen=True)
class _Suspension:
    """A suspension of this process.

    ``until`` is the time at which it has noticed all links that ended meanwhile, ``links`` their number before.
    """

    seconds: float
    until: float
    links: int

    @override
    def __str__(self) -> str:
        return f"the process that executes it was suspended, or got no processor time, for {self.seconds:.1f} s"


class FarClients:
    """Watches the clients that reach this session through a router: if they are cut off, they cannot stop the robot.

    These are the clients on other machines, and short-lived programs on this machine such as ``midspan goto``. The goal
    of a directly linked client continues when the client exits. ``gone`` is called with the goal of a missing client,
    and the reason. If this process was suspended for so long that one of its links has ended, all clients in other
    processes count as missing: for them the goal has ended, and no other client knows that the robot would drive on.
    """

    def __init__(self, host: Host, server: ActionServer, gone: Callable[[Goal, str], None]) -> None:
        self._hub, self._server, self._gone = host.node.hub, server, gone
        self._known: dict[bytes, _Far] = {}
        self._checked, self._links_ended = _now(), self._hub.mesh.ended
        self._suspension: _Suspension | None = None
        server.met = self._on_goal
        self._timer = host.loop.every(_EVERY, self._check)

    def close(self) -> None:
        self._timer.close()

    def _on_goal(self, goal: Goal) -> None:
        """Note the client when the goal arrives, because the link may be cut before the next check."""
        if goal.client:
            self._known[goal.id] = far = _Far()
            self._update(far, goal, self._direct_sessions())

    def _direct_sessions(self) -> set[str]:
        """Return the sessions with a direct link, and this session, which the nodes of all modules share."""
        return self._hub.neighbors() | {self._hub.zid}

    def _update(self, far: _Far, goal: Goal, near: Collection[str]) -> None:
        session = self._hub.graph.zid_of(goal.client)
        far.near = far.near or session in near
        far.seen = far.seen or bool(session)
        far.missed = 0 if session else far.missed + 1

    def _lost_contact(self) -> str:
        """Return why the clients have lost contact, if that is because this process was suspended; else ""."""
        before, self._checked = self._checked, _now()
        seconds, computed = self._checked[0] - before[0], self._checked[1] - before[1]
        if seconds - computed > _SUSPENDED_SECONDS:  # a thread that is only busy uses processor time
            self._suspension = _Suspension(seconds, self._checked[0] + _NOTICED_SECONDS, self._links_ended)
        self._links_ended = self._hub.mesh.ended
        if self._suspension is None:
            return ""
        cut_off, over = self._suspension.links < self._links_ended, self._suspension.until < self._checked[0]
        reason = f"the goal's client has lost contact: {self._suspension}" if cut_off else ""
        if cut_off or over:
            self._suspension = None
        return reason

    def _check(self) -> None:
        reason = self._lost_contact()
        goals = [goal for goal in self._server.active if goal.client]
        if reason:
            for goal in goals:
                if self._hub.graph.zid_of(goal.client) != self._hub.zid:
                    self._gone(goal, reason)
            return
        self._known = {goal.id: self._known.get(goal.id) or _Far() for goal in goals}
        if not goals:
            return
        near = self._direct_sessions()
        for goal in goals:
            far = self._known[goal.id]
            self._update(far, goal, near)
            if far.seen and not far.near and far.missed >= _MISSES:
                self._gone(goal, _CUT_OFF)


def _now() -> tuple[float, float]:
    """Return the time, which includes suspensions of the machine, and this process's processor time, in seconds."""
    return steady_ns() / 1e9, time.process_time()
