"""Goals of the hub, and clicks of yarpview, as places on maps."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from navigation.constraints import Constraints
from navigation.frames import Frames, FramesError
from navigation.maps.grid import yaw_of
from navigation.pose import Pose
from navigation.robot_path_planner.fault import PlanError
from navigation.robot_path_planner.ground import Ground
from navigation.robot_path_planner.itinerary import Place
from navigation.status import Fault


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
    pose, frame = Pose(place["x"], place["y"], theta), stamped["header"]["frame_id"].lstrip("/")
    if frame in ("", frames.map_frame):
        return Place(wanted.map, pose), wanted
    try:
        return Place("", frames.transform(frames.map_frame, frame) @ pose), wanted
    except FramesError as err:
        if frame in maps():
            return Place(frame, pose), wanted
        raise PlanError(Fault.UNKNOWN_FRAME, f"the goal is in the frame '{frame}': {err}") from None


def goal_of_click(ground: Ground | None, values: Sequence[Any]) -> Pose:
    """The goal of a click or drag on the picture of the map.

    Args:
        ground: the map; None where there is none.
        values: ``x y``, or ``x0 y0 x1 y1`` where the robot is to head on from the first pixel to the second; with 0, 0
            the upper left one.

    Raises:
        ValueError: it is none, or there is no map.
    """
    if ground is None:
        raise ValueError("there is no map to click on")
    numbers = [float(value) for value in values if isinstance(value, (int, float)) and not isinstance(value, bool)]
    if len(numbers) != len(values) or len(numbers) not in (2, 4) or not all(map(math.isfinite, numbers)):
        raise ValueError(f"a click is x y, a drag x0 y0 x1 y1: {list(values)!r:.100} is neither")
    x, y = (float(each) for each in ground.grid.centers_of(numbers[:2]))
    if len(numbers) == 2 or numbers[:2] == numbers[2:]:
        return Pose(x, y, math.nan)
    to_x, to_y = (float(each) for each in ground.grid.centers_of(numbers[2:]))
    return Pose(x, y, math.atan2(to_y - y, to_x - x))
