"""How a drive gets on: its status, and how far it still has to go."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from navigation.gateway.drive import ClientDrive
from navigation.gateway.planner_link import PlannerLink
from navigation.gateway.stop import LATE_SECONDS, may_move
from navigation.messages import duration
from navigation.pose import Pose
from navigation.status import Fault, PlannerStatus, State

UNKNOWN = math.nan  # a distance that is not known: no comparison with it is true, where 0.0 would mean "arrived"
_AT_ITS_END = 1.0  # metres from the goal within which a path that leads to it ends


def distance(robot: Pose | None, goal: Pose | None, path: Mapping[str, Any] | None, frame: str) -> float:
    """Metres along the rest of the path, or straight to the goal without one; `UNKNOWN` without a pose.

    Robot and goal are in ``frame``, the map's; the path is the planner's ``nav_msgs/Path``, where it tells one.
    """
    if robot is None or goal is None:
        return UNKNOWN
    poses = [] if path is None else path["poses"]
    if path is not None and len(poses) > 0 and str(path["header"]["frame_id"]).lstrip("/") == frame:
        places = (one["pose"]["position"] for one in poses)
        points = np.array([(place["x"], place["y"]) for place in places])
        if math.hypot(points[-1, 0] - goal.x, points[-1, 1] - goal.y) < _AT_ITS_END:
            return _along(points, robot)
    return robot.distance(goal)


def _along(points: np.ndarray[Any, np.dtype[np.float64]], robot: Pose) -> float:
    away = np.hypot(points[:, 0] - robot.x, points[:, 1] - robot.y)
    nearest = int(away.argmin())
    steps = np.diff(points[nearest:], axis=0)
    return float(away[nearest] + np.hypot(steps[:, 0], steps[:, 1]).sum())


def seconds(metres: float, speed: float | None) -> dict[str, int]:
    """A ``builtin_interfaces/Duration`` for that distance; zero, which is unset, where it is not known."""
    if speed is None or not math.isfinite(metres):
        return {"sec": 0, "nanosec": 0}
    return duration(metres / speed)


def of_drive(drive: ClientDrive, link: PlannerLink, *, stands: bool | None, silence: float) -> PlannerStatus:
    """How a client's drive gets on; ``stands``: whether the base does, None where that is not known.

    A planner that tells nothing for longer than ``silence`` seconds is said not to answer; 0: never.
    """
    if drive.stopping:
        return (
            PlannerStatus(State.MOVING, f"stopping: {drive.stopping}")
            if not _late(drive)
            else may_move(drive.stopping, link)
        )
    if drive.paused:
        if _late(drive) and stands is not True:
            return may_move("it was paused", link)
        return PlannerStatus(State.PAUSED, "" if drive.let_go else f"{link.planner} is stopping")
    below = drive.below
    if drive.waiting:
        # clients take an error for the end, and the drive goes on once the planner is back
        moves = drive.begun and stands is not True
        why = f"the planner {link.planner} is not there; it is waited for" + (
            "; it may still be moving" if moves else ""
        )
        return PlannerStatus(State.MOVING if moves else State.PREPARING, why, Fault.NO_NAVIGATOR)
    if below is None:
        return PlannerStatus(State.MOVING)  # it ended without a reason, which is being looked for
    if silence and not link.ours and link.silent > silence:  # the daemon watches Midspan's own
        why = f"{link.planner} does not answer: no status or feedback of it for {silence:g} s"
        return PlannerStatus(State.MOVING, why, Fault.SILENT)
    if not below.accepted:
        return PlannerStatus(State.PREPARING)
    state, why = link.told(below.id) or (State.MOVING, "")
    if state.ended:
        return PlannerStatus(State.MOVING, "", link.code(below.id))  # how it ended comes as the goal's result
    return PlannerStatus(State.MOVING if state is State.PAUSED else state, why, link.code(below.id))


def _late(drive: ClientDrive) -> bool:
    return not drive.let_go and time.monotonic() > drive.held_at + LATE_SECONDS


def of_others(link: PlannerLink, goal: bytes) -> PlannerStatus:
    """How a goal gets on that the planner was given itself."""
    state, why = link.told(goal) or (State.MOVING, "")
    return PlannerStatus(state, why or _itself(link), link.code(goal))


def of_gone(link: PlannerLink) -> PlannerStatus:
    """Such a goal, as the planner is out of reach: it goes on there, for all that is known."""
    why = f"{_itself(link)}; the planner {link.planner} is not there; it may still be moving"
    return PlannerStatus(State.MOVING, why, Fault.MAY_MOVE)


def of_ended(link: PlannerLink, goal: bytes, state: State, why: str) -> PlannerStatus:
    """How such a goal ended."""
    told = link.told(goal)
    return PlannerStatus(state, why or (told[1] if told else "") or _itself(link), link.code(goal))


def _itself(link: PlannerLink) -> str:
    return f"a goal that {link.planner} was given itself"
