"""Goals of the hub as places on maps."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

from navigation.constraints import Constraints
from navigation.frames import Frames, FramesError
from navigation.maps.grid import yaw_of
from navigation.plan_error import PlanError
from navigation.pose import Pose
from navigation.status import Fault

_FARTHEST = 1e6
"""Metres; no map is as large, and sums of far greater numbers say nothing any more."""


@dataclass(frozen=True)
class Place:
    """A pose on a map; `name` is how people know it."""

    map_name: str
    pose: Pose
    name: str = ""


def goal_of(goal: Mapping[str, Any], frames: Frames, maps: Callable[[], Collection[str]]) -> tuple[Place, Constraints]:
    """What a ``NavigateToPose`` goal asks for.

    Args:
        goal: the message. Its frame is the map's, any that is on `/tf`, or the name of a map; where that is no name
            of a topic's, the goal's text says it: ``midspan: map=NAME``.
        frames: where frames are.
        maps: says the names of the maps that there are.

    Raises:
        PlanError: it says none; the text says why.
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
        return Place(wanted.map, pose), wanted
    try:
        return Place("", frames.on_map(frame) @ pose), wanted
    except FramesError as err:
        if frame in maps():
            return Place(frame, pose), wanted
        raise PlanError(Fault.UNKNOWN_FRAME, f"the goal is in the frame '{frame}': {err}") from None
