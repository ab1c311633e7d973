"""A goal that is being driven to."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from navigation.constraints import Constraints
from navigation.goals import Place
from navigation.robot_path_planner.itinerary import Leg
from navigation.robot_path_planner.way import Waypoint


@dataclass
class Task:
    """What is known of one goal. Times are the caller's seconds.

    Attributes:
        goal: where to.
        wanted: what whoever sent it asks for.
        since: when it came.
        then: where to go on to from there, one after the other.
        due: why a way is to be planned; empty where that is not so.
        not_before: when that is tried next.
        leg: what is driven on the map at hand.
        waypoints: of the way at hand.
        at: the number of the one that is driven to.
        note: what people should know of the way.
        attempts: other ways that were tried since the robot last came nearer.
        recoveries: the same in all.
        best: metres to the goal, the least so far.
        driven: whether a local navigator has taken anything.
        placed: whether it was known where the robot is.
        gone_since: since when there is no local navigator.
        lost_since: since when it is not known where the robot is.
        blocked_since: since when what the laser sees closes every way.
        closed_since: since when it lies on the way at hand.
        arrived: when the robot came to the end of the leg, from where it goes on to another map.
    """

    goal: Place
    wanted: Constraints
    since: float
    then: tuple[Place, ...] = ()
    due: str = "a new goal"
    not_before: float = -math.inf
    leg: Leg | None = None
    waypoints: tuple[Waypoint, ...] = field(default=())
    at: int = 0
    note: str = ""
    attempts: int = 0
    recoveries: int = 0
    best: float = math.inf
    driven: bool = False
    placed: bool = False
    gone_since: float | None = None
    lost_since: float | None = None
    blocked_since: float | None = None
    closed_since: float | None = None
    arrived: float | None = None

    @property
    def waypoint(self) -> Waypoint:
        """The one that is driven to."""
        return self.waypoints[self.at]

    @property
    def last(self) -> bool:
        """Whether that is the last one."""
        return self.at == len(self.waypoints) - 1
