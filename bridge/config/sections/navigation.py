"""The section ``navigation``: which planner drives, and who is where on each side; see docs/navigation.md."""

from __future__ import annotations

import re
from typing import Literal

from pydantic import Field, field_validator, model_validator

from bridge.config.sections.section import Section
from bridge.config.sections.values import ROS2_NAME

_ID = re.compile(r"[a-z][a-z0-9_]{0,62}")
_PORT = re.compile(r"(?:/[^\s/\"'*()\[\]{}]+)+")

OURS = ("robot_path_planner", "robot_goto")
"""Planners that are modules of Midspan's."""

ACTION = "/navigate_to_pose"
"""The gateway's own action on the hub."""

GOAL_POSE = "/goal_pose"
"""The topic of the hub on which the gateway hears goals."""


def planner_action(name: str) -> str:
    """Where a planner serves its action on the hub."""
    return f"/planner/{name}/navigate_to_pose"


def _named(value: str) -> str:
    if value and not ROS2_NAME.fullmatch(value):
        msg = f"{value!r} is no name: begin it with a slash; letters, digits and underscores make its parts"
        raise ValueError(msg)
    return value


class Planner(Section):
    """A planner that is not Midspan's: any server of `NavigateToPose`, or of `MoveBase` on ROS 1."""

    name: str = Field(description="What it is called here: small letters, digits and underscores.")
    side: Literal["ros1", "ros2", "zenoh"] = Field(description="Where it runs.")
    action: str = Field(description="Its action there: `/move_base`.")
    path: str = Field(default="", description='Topic of its path (`nav_msgs/msg/Path`); "" where it has none.')
    local_map: str = Field(
        default="", description='Topic of its local map (`nav_msgs/msg/OccupancyGrid`); "" where it has none.'
    )
    current_goal: str = Field(
        default="",
        description='Topic on which it tells its goal (`geometry_msgs/msg/PoseStamped`); "" where it does not.',
    )
    velocity: str = Field(
        default="", description="Its topic of velocities, where that is another than `navigation.velocity`."
    )

    @field_validator("name")
    @classmethod
    def _name_is_one(cls, value: str) -> str:
        if not _ID.fullmatch(value):
            msg = f"{value!r} is no planner's name: small letters, digits and underscores, a letter first"
            raise ValueError(msg)
        if value in OURS:
            msg = f"{value} is a planner of Midspan's; call yours otherwise"
            raise ValueError(msg)
        return value

    @field_validator("action", "path", "local_map", "current_goal", "velocity")
    @classmethod
    def _is_a_name(cls, value: str) -> str:
        return _named(value)

    @model_validator(mode="after")
    def _leaves_the_gateway_its_name(self) -> Planner:
        if not self.action:
            raise ValueError("say the planner's action, for example /move_base")
        if self.side == "zenoh" and self.action == ACTION:
            raise ValueError(
                f"{ACTION} is the gateway's on the hub; have the planner serve {planner_action(self.name)}"
            )
        return self

    @property
    def on_hub(self) -> str:
        """Its action on the hub: there it is where it is."""
        return self.action if self.side == "zenoh" else planner_action(self.name)


KNOWN = {
    "move_base": Planner(
        name="move_base",
        side="ros1",
        action="/move_base",
        path="/move_base/NavfnROS/plan",
        local_map="/move_base/local_costmap/costmap",
        current_goal="/move_base/current_goal",
    ),
    "nav2": Planner(
        name="nav2", side="ros2", action="/navigate_to_pose", path="/plan", local_map="/local_costmap/costmap"
    ),
}
"""Planners that need no entry in ``planners``."""


class DoorsSection(Section):
    """Names at which each side's clients ask; where a planner has one of them itself, the gateway does not take it."""

    ros1: str = Field(default="/move_base", description='The actionlib server (`MoveBase`) on ROS 1; "" for none.')
    ros1_goal: str = Field(
        default="/move_base_simple/goal", description='The topic of goals on ROS 1 (`PoseStamped`); "" for none.'
    )
    ros2: str = Field(
        default="/navigate_to_pose", description='The action (`NavigateToPose`) on ROS 2 (DDS); "" for none.'
    )
    ros2_goal: str = Field(
        default="/goal_pose", description='The topic of goals on ROS 2 (`PoseStamped`); "" for none.'
    )
    yarp: tuple[str, ...] = Field(
        default=("/navigation2D_nws_yarp", "/navigationServer"),
        description="What the ports for YARP's `navigation2D_nwc_yarp` begin with; each gets `rpc` and `status:o`.",
    )

    @field_validator("ros1", "ros1_goal", "ros2", "ros2_goal")
    @classmethod
    def _is_a_name(cls, value: str) -> str:
        return _named(value)

    @field_validator("yarp")
    @classmethod
    def _are_ports(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for port in value:
            if not _PORT.fullmatch(port):
                msg = f"{port!r} cannot begin a port's name: write it as /navigationServer"
                raise ValueError(msg)
        return value


class NavigationSection(Section):
    """Any planner with any client."""

    planner: str = Field(
        default="",
        description="Who drives: `robot_path_planner` or `robot_goto` (Midspan's modules), `move_base` (ROS 1), `nav2`"
        ' (ROS 2), or one of `planners`. "": nobody, and there is no gateway.',
    )
    planners: tuple[Planner, ...] = Field(
        default=(), description="Planners that are not Midspan's, beside or instead of `move_base` and `nav2`."
    )
    localizer: Literal["own", "amcl", "tf", "topic", "port", "server"] | None = Field(
        default=None,
        description="Who says where the robot is, as `modules.localization_server.source`; empty: as it says there.",
    )
    map: str = Field(
        default="store",
        description="The map that Midspan's planner and localiser use: `store` (the store's current one), or a topic of"
        " any side (`nav_msgs/msg/OccupancyGrid`).",
    )
    frame: str = Field(default="map", min_length=1, max_length=100, description="The frame of maps and locations.")
    base_frame: str = Field(default="base_link", min_length=1, max_length=100, description="The robot's frame.")
    velocity: str = Field(
        default="/cmd_vel", description="Where the base hears velocities (`geometry_msgs/msg/Twist`), as on the hub."
    )
    patience: float = Field(
        default=10.0,
        ge=0.0,
        le=3600.0,
        description="Seconds for which a goal waits for a planner that is not there, or has gone while it drove.",
    )
    doors: DoorsSection = Field(default_factory=DoorsSection, description="At which names clients ask.")

    @field_validator("map")
    @classmethod
    def _map_is_one(cls, value: str) -> str:
        return value if value == "store" else _named(value)

    @field_validator("velocity")
    @classmethod
    def _is_a_name(cls, value: str) -> str:
        return _named(value)

    @model_validator(mode="after")
    def _planner_is_known(self) -> NavigationSection:
        names = [planner.name for planner in self.planners]
        if len(set(names)) < len(names):
            raise ValueError(f"two planners have one name: {', '.join(names)}")
        known = [*OURS, *{*KNOWN, *names}]
        if self.planner and self.planner not in known:
            there = ", ".join(sorted(known))
            msg = f"there is no planner {self.planner!r}; name it in 'planners', or take one of {there}"
            raise ValueError(msg)
        return self

    @property
    def others(self) -> dict[str, Planner]:
        """The planners in this deployment that are not Midspan's, by name."""
        found = {planner.name: planner for planner in self.planners}
        if self.planner in KNOWN:
            found.setdefault(self.planner, KNOWN[self.planner])
        return found

    @property
    def choices(self) -> tuple[str, ...]:
        """The planners that can be chosen while it runs."""
        return (*OURS, *self.others)

    def at(self, planner: str) -> str:
        """A planner's action on the hub."""
        return self.others[planner].on_hub if planner in self.others else planner_action(planner)
