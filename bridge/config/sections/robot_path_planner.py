"""The section ``modules.robot_path_planner``: ways over the map, driven waypoint by waypoint by a local navigator."""

from __future__ import annotations

import re
from pathlib import Path

from pydantic import Field, field_validator

from bridge.config.sections.module import ModuleSection
from bridge.config.sections.section import Section
from bridge.config.sections.values import ROS2_NAME

_PORT = re.compile(r"(?:/[^\s/\"'*()\[\]{}]+)+")
YARP = "yarp:"
"""Begins the name of a local navigator on YARP."""


class DrivenSection(Section):
    """What holds on the way to a waypoint or to the goal; what is empty is as the local navigator's own settings say.

    The speeds and gains are RobotGoto's; local navigators that are not Midspan's do not hear of them.
    """

    tolerance_lin: float | None = Field(default=None, gt=0.0, le=10.0, description="Metres.")
    tolerance_ang: float | None = Field(default=None, gt=0.0, le=180.0, description="Degrees.")
    max_lin_speed: float | None = Field(default=None, gt=0.0, le=10.0, description="Metres per second.")
    min_lin_speed: float | None = Field(default=None, ge=0.0, le=10.0, description="Metres per second.")
    max_ang_speed: float | None = Field(default=None, gt=0.0, le=720.0, description="Degrees per second.")
    min_ang_speed: float | None = Field(default=None, ge=0.0, le=720.0, description="Degrees per second.")
    lin_speed_gain: float | None = Field(
        default=None, gt=0.0, le=100.0, description="Metres per second for each metre that is left."
    )
    ang_speed_gain: float | None = Field(
        default=None, gt=0.0, le=100.0, description="Degrees per second for each degree that is left."
    )


class WaypointSection(DrivenSection):
    """What holds on the way to a waypoint."""

    tolerance_lin: float | None = Field(
        default=0.1, gt=0.0, le=10.0, description="Metres within which the next waypoint is sent."
    )


class GoalSection(DrivenSection):
    """What holds on the way to the goal itself."""

    tolerance_lin: float | None = Field(default=0.05, gt=0.0, le=10.0, description="Metres.")
    tolerance_ang: float | None = Field(default=0.6, gt=0.0, le=180.0, description="Degrees.")


class RobotPathPlannerSection(ModuleSection):
    """The planner."""

    ini: Path | None = Field(
        default=None,
        description="A `robotPathPlanner` file of an existing robot, read as it is; what stands here beside it is"
        " stronger.",
    )
    map: str | None = Field(
        default=None,
        description="`store` (the store's current map), or a topic (`nav_msgs/msg/OccupancyGrid`); empty: as"
        " `navigation.map` says.",
    )
    frame: str = Field(default="map", min_length=1, max_length=100, description="The map's frame.")
    base_frame: str = Field(default="base_link", min_length=1, max_length=100, description="The robot's frame.")
    navigator: str = Field(
        default="/planner/robot_goto/navigate_to_pose",
        description="Who drives to waypoints: an action on the hub (`nav2_msgs/action/NavigateToPose`), or `yarp:` and"
        " what the ports of an INavigation2D server begin with: `yarp:/robotGoto`.",
    )
    scan: str = Field(
        default="/scan",
        description="The laser (`sensor_msgs/msg/LaserScan`) that shows what stands in the way beyond the map;"
        ' "" for none.',
    )
    robot_radius: float = Field(default=0.3, gt=0.0, le=10.0, description="Metres kept to walls and keep-out cells.")
    clearance: float = Field(
        default=0.2, ge=0.0, le=10.0, description="Metres beyond the radius that are kept where there is room."
    )
    waypoint: WaypointSection = Field(default_factory=WaypointSection, description="On the way to waypoints.")
    goal: GoalSection = Field(default_factory=GoalSection, description="To the goal itself.")
    min_waypoint_distance: float = Field(
        default=0.2,
        ge=0.0,
        le=10.0,
        description="Metres; waypoints nearer to one another are joined where they can be.",
    )
    use_optimized_path: bool = Field(
        default=True, description="Whether a way is made straight where it can be; else every cell is a waypoint."
    )
    recoveries: int = Field(
        default=5, ge=0, le=100, description="How often in a row another way is tried without coming nearer."
    )
    patience: float = Field(
        default=3.0,
        ge=0.0,
        le=600.0,
        description="Seconds that something may stand in the way before it is gone round.",
    )
    max_waiting_time: float = Field(
        default=60.0,
        ge=0.0,
        le=86400.0,
        description="Seconds that it waits where there is no other way, or no localisation, or no local navigator.",
    )
    max_map_waiting_time: float = Field(
        default=300.0, ge=0.0, le=86400.0, description="Seconds that it waits at a link to another map for the change."
    )
    obstacle_memory: float = Field(
        default=30.0, gt=0.0, le=86400.0, description="Seconds for which what the laser saw is remembered."
    )
    obstacle_distance: float = Field(
        default=5.0, gt=0.0, le=100.0, description="Metres up to which what the laser sees is heeded."
    )
    period: float = Field(default=0.05, ge=0.01, le=1.0, description="Seconds between two steps.")
    image_hz: float = Field(
        default=2.0,
        ge=0.0,
        le=30.0,
        description="Pictures of the map a second on `map:o` while somebody sees; 0: none.",
    )
    prefix: str = Field(default="/robotPathPlanner", description='Begins its YARP ports; "" for none.')

    @field_validator("map")
    @classmethod
    def _map_is_one(cls, value: str | None) -> str | None:
        return value if value in (None, "store") else _topic(str(value))

    @field_validator("scan")
    @classmethod
    def _scan_is_a_topic(cls, value: str) -> str:
        return _topic(value) if value else value

    @field_validator("navigator")
    @classmethod
    def _navigator_is_one(cls, value: str) -> str:
        if value.startswith(YARP):
            _port(value.removeprefix(YARP))
            return value
        return _topic(value)

    @field_validator("prefix")
    @classmethod
    def _prefix_begins_ports(cls, value: str) -> str:
        return _port(value) if value else value


def _topic(value: str) -> str:
    if not ROS2_NAME.fullmatch(value):
        msg = f"{value!r} is no name on the hub: begin it with a slash; letters, digits and underscores make its parts"
        raise ValueError(msg)
    return value


def _port(value: str) -> str:
    if not _PORT.fullmatch(value):
        msg = f"{value!r} cannot begin a port's name: write it as /robotPathPlanner"
        raise ValueError(msg)
    return value
