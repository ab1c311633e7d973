"""The section ``modules.robot_path_planner``, the global planner."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, ClassVar

from typing_extensions import override

from bridge.config.sections.navigation import ACTION, OURS, planner_action
from bridge.config.sections.obstacles import ObstacleSection
from bridge.config.sections.section import (
    ROS2_NAME,
    YARP_PORT,
    FrameName,
    MapSource,
    Mistake,
    OptionalPort,
    OptionalTopic,
    Section,
    matching,
    setting,
    subsection,
)
from navigation.file_section import FileSection

YARP = "yarp:"  # begins the name of a local navigator on YARP
_Navigator = Annotated[
    str,
    matching(
        f"{YARP}{YARP_PORT.pattern}|{ROS2_NAME.pattern}",
        "is neither an action on the hub (/planner/robot_goto/navigate_to_pose) nor ports of YARP (yarp:/robotGoto)",
    ),
]


class DrivenSection(Section):
    """Settings for driving to a waypoint or to the goal; an empty setting keeps the local navigator's own value.

    Speeds and gains only apply to RobotGoto, not to other local navigators.
    """

    tolerance_lin: float | None = setting(None, "Meters.", gt=0.0, le=10.0)
    tolerance_ang: float | None = setting(None, "Degrees.", gt=0.0, le=180.0)
    max_lin_speed: float | None = setting(None, "Meters per second.", gt=0.0, le=10.0)
    min_lin_speed: float | None = setting(None, "Meters per second.", ge=0.0, le=10.0)
    max_ang_speed: float | None = setting(None, "Degrees per second.", gt=0.0, le=720.0)
    min_ang_speed: float | None = setting(None, "Degrees per second.", ge=0.0, le=720.0)
    lin_speed_gain: float | None = setting(None, "Meters per second for each meter to go.", gt=0.0, le=100.0)
    ang_speed_gain: float | None = setting(None, "Degrees per second for each degree to go.", gt=0.0, le=100.0)


class WaypointSection(DrivenSection):
    """Settings for driving to a waypoint."""

    tolerance_lin: float | None = setting(
        0.1, "Distance to the waypoint, in meters, at which the next one is sent.", gt=0.0, le=10.0
    )


class GoalSection(DrivenSection):
    """Settings for driving to the goal itself."""

    tolerance_lin: float | None = setting(0.05, "Meters.", gt=0.0, le=10.0)
    tolerance_ang: float | None = setting(2.0, "Degrees.", gt=0.0, le=180.0)


class RobotPathPlannerSection(FileSection):
    """The path planner, which sends waypoints to the local navigator."""

    reader: ClassVar[str] = "navigation.robot_path_planner.settings:read_file"
    merged: ClassVar[tuple[str, ...]] = ("waypoint", "goal")

    ini: Path | None = setting(None, "A `robotPathPlanner` file of an existing robot; keys set here override it.")
    map: MapSource | None = setting(
        None, "`store` (its current map), or a topic (`nav_msgs/msg/OccupancyGrid`); empty: `navigation.map`."
    )
    frame: FrameName = setting("map", "The map's frame.")
    base_frame: FrameName = setting("base_link", "The robot's frame.")
    navigator: _Navigator = setting(
        "/planner/robot_goto/navigate_to_pose",
        "The local navigator, which drives to waypoints: an action on the hub (`nav2_msgs/action/NavigateToPose`), or"
        " `yarp:` and the port prefix of an INavigation2D server: `yarp:/robotGoto`.",
    )
    scan: OptionalTopic = setting("/scan", 'Laser that shows new obstacles (`sensor_msgs/msg/LaserScan`); "": none.')
    obstacles: tuple[ObstacleSection, ...] = setting(
        (), "Layers whose obstacles the paths avoid, in addition to those of the laser."
    )
    robot_radius: float = setting(
        0.3, "Distance that paths keep from walls and keep-out cells, meters.", gt=0.0, le=10.0
    )
    clearance: float = setting(0.2, "Additional distance that paths keep if the space allows, meters.", ge=0.0, le=10.0)
    waypoint: WaypointSection = subsection(WaypointSection, "Settings for driving to waypoints.")
    goal: GoalSection = subsection(GoalSection, "Settings for driving to the goal.")
    min_waypoint_distance: float = setting(
        0.2, "Waypoints closer together than this are joined if possible, meters.", ge=0.0, le=10.0
    )
    use_optimized_path: bool = setting(True, "Whether paths are straightened; otherwise every cell is a waypoint.")
    recoveries: int = setting(5, "Attempts in a row without progress before the goal is aborted.", ge=0, le=100)
    patience: float = setting(
        3.0, "Seconds for which an obstacle may block the path before a detour is driven.", ge=0.0, le=600.0
    )
    max_waiting_time: float = setting(
        60.0,
        "Seconds of waiting for a path, localization, a layer or the local navigator, before the goal is aborted.",
        ge=0.0,
        le=86400.0,
    )
    max_map_waiting_time: float = setting(
        300.0,
        "Seconds of waiting for the change of maps at a link to another map, before the goal is aborted.",
        ge=0.0,
        le=86400.0,
    )
    obstacle_memory: float = setting(
        30.0, "Seconds for which obstacles that the laser saw are remembered.", gt=0.0, le=86400.0
    )
    obstacle_distance: float = setting(5.0, "Range up to which the laser's points are used, meters.", gt=0.0, le=100.0)
    period: float = setting(0.05, "Seconds between two steps of the planner.", ge=0.01, le=1.0)
    image_hz: float = setting(2.0, "Pictures per second on `map:o` while it is connected; 0: none.", ge=0.0, le=30.0)
    prefix: OptionalPort = setting("/robotPathPlanner", 'Prefix of the YARP ports; "": none.')

    @override
    def misfits(self) -> Iterator[Mistake]:
        own = {ACTION, planner_action(OURS[0]), f"{YARP}{self.prefix}"}
        if self.navigator in own:
            text = (
                f"{self.navigator} leads back to RobotPathPlanner itself: name the program that drives the robot, such"
                f" as {planner_action(OURS[1])}"
            )
            yield ("navigator",), text
        for index, source in enumerate(self.obstacles):
            if source.type == "cloud":
                text = f"{source.topic} is a cloud: RobotPathPlanner plans around layers; give clouds to RobotGoto"
                yield ("obstacles", index), text
