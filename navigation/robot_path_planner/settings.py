"""What RobotPathPlanner works by."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from bridge.config.sections.robot_path_planner import RobotPathPlannerSection
from navigation.constraints import Constraints
from navigation.ini import laid_under
from navigation.robot_path_planner.inifile import with_file


@dataclass(frozen=True)
class Settings:
    """Lengths in metres, times in seconds.

    Attributes:
        robot_radius: nothing is planned nearer than this to a wall or to what is kept out of.
        clearance: metres beyond it within which a way costs more.
        waypoint: what holds on the way to a waypoint; its linear tolerance is where the next one is sent.
        goal: the same of the last one.
        min_waypoint_distance: waypoints nearer to one another are joined where the line between is free.
        shortened: whether a way is shortened to waypoints at all; else every cell is one.
        recoveries: how often in a row a blocked robot tries another way without coming nearer.
        patience: how long what the laser sees may lie on the way before another is looked for.
        waiting: how long it waits where there is no other way, or no local navigator, or no localisation.
        map_waiting: how long it waits at a link for the map to change.
        obstacle_memory: how long what the laser saw is remembered.
        obstacle_distance: metres up to which the laser is believed.
        jump: metres that localisation moves at once, or 30 degrees, for a new way.
    """

    robot_radius: float = 0.3
    clearance: float = 0.2
    waypoint: Constraints = field(default_factory=lambda: Constraints(tolerance_lin=0.1, heading=False, through=True))
    goal: Constraints = field(default_factory=lambda: Constraints(tolerance_lin=0.05, tolerance_ang=0.6))
    min_waypoint_distance: float = 0.2
    shortened: bool = True
    recoveries: int = 5
    patience: float = 3.0
    waiting: float = 60.0
    map_waiting: float = 300.0
    obstacle_memory: float = 30.0
    obstacle_distance: float = 5.0
    jump: float = 0.5


def settings_of(section: RobotPathPlannerSection) -> tuple[Settings, RobotPathPlannerSection, list[str]]:
    """What a section and the file that it names say.

    Returns:
        the settings; the section with the file's values; what is odd in the file, each ``file:line: ...``.

    Raises:
        RuntimeError: the file is not there or cannot be used; the text says where and why.
    """
    section, notes = laid_under(section, section.ini, with_file)
    made = Settings(
        robot_radius=section.robot_radius,
        clearance=section.clearance,
        waypoint=replace(Constraints(**section.waypoint.model_dump()), heading=False, through=True),
        goal=Constraints(**section.goal.model_dump()),
        min_waypoint_distance=section.min_waypoint_distance,
        shortened=section.use_optimized_path,
        recoveries=section.recoveries,
        patience=section.patience,
        waiting=section.max_waiting_time,
        map_waiting=section.max_map_waiting_time,
        obstacle_memory=section.obstacle_memory,
        obstacle_distance=section.obstacle_distance,
    )
    return made, section, notes
