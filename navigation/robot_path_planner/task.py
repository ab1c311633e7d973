"""A goal that is being driven to, and jumps of the localisation on the way."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from navigation.constraints import Constraints
from navigation.goals import MapPlace
from navigation.pose import Pose, wrapped
from navigation.robot_path_planner.atlas import Leg
from navigation.robot_path_planner.way import Waypoint


@dataclass
class DriveTask:
    """One goal under way. Times are the caller's seconds."""

    goal: MapPlace  #: where to
    wanted: Constraints  #: what whoever sent it asks for
    since: float  #: when it came
    then: tuple[MapPlace, ...] = ()  #: where to go on to from there, one after the other
    due: str = "a new goal"  #: why a way is to be planned; empty where that is not so
    not_before: float = -math.inf  #: when that is tried next
    leg: Leg | None = None  #: what is driven on the map at hand
    waypoints: tuple[Waypoint, ...] = field(default=())  #: of the way at hand
    at: int = 0  #: the number of the one that is driven to
    note: str = ""  #: what people should know of the way
    attempts: int = 0  #: other ways that were tried since the robot last came nearer
    recoveries: int = 0  #: the same in all
    best: float = math.inf  #: metres to the goal, the least so far
    driven: bool = False  #: whether a local navigator has taken anything
    gone_since: float | None = None  #: since when there is no local navigator
    lost_since: float | None = None  #: since when it is not known where the robot is
    blocked_since: float | None = None  #: since when what the laser sees closes every way
    closed_since: float | None = None  #: since when it lies on the way at hand
    arrived: float | None = None  #: when the robot came to the end of the leg, from where it goes on to another map

    def is_on(self, map_name: str) -> None:
        """Its places that were said without a map are on this one."""
        places = (self.goal, *self.then)
        self.goal, *further = (replace(one, map_name=one.map_name or map_name) for one in places)
        self.then = tuple(further)

    @property
    def waypoint(self) -> Waypoint:
        """The one that is driven to."""
        return self.waypoints[self.at]

    @property
    def last(self) -> bool:
        """Whether that is the last one."""
        return self.at == len(self.waypoints) - 1


_TURNED = math.radians(30.0)
_FRESH = 1.0  # seconds after which a pose says nothing of the next


class JumpDetector:
    """Compares each pose with the one before."""

    def __init__(self) -> None:
        self.pose: Pose | None = None  # the last one; None before the first
        self._at = -math.inf

    def add(self, now: float, pose: Pose, least: float) -> str:
        """Take up a pose on the map; a message about a jump (so many metres, or 30 degrees), or nothing. Seconds."""
        before, passed = self.pose, now - self._at
        self.pose, self._at = pose, now
        if before is None or not 0 <= passed < _FRESH:
            return ""
        moved, turned = pose.distance(before), abs(wrapped(pose.theta - before.theta))
        if moved > least + passed or turned > _TURNED + math.pi * passed:
            return f"localisation moved the robot by {moved:.2f} m and {math.degrees(turned):.0f} degrees at once"
        return ""
