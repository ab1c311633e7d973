"""The section ``navigation``: the planners, and the names that their clients use; see docs/navigation/navigation.md."""

from __future__ import annotations

import re
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator
from typing_extensions import override

from bridge.config.sections.section import (
    FACTORY,
    Enabled,
    Factory,
    FrameName,
    MapSource,
    OptionalTopic,
    PortName,
    PoseSourceName,
    Section,
    SmallName,
    TopicName,
    differ,
    setting,
    subsection,
)
from bridge.messages.velocities import VELOCITIES

OURS = ("robot_path_planner", "robot_goto")  # planners that are modules of Midspan
ACTION = "/navigate_to_pose"  # the gateway's action on the hub
THROUGH_POSES = "/navigation/navigate_through_poses"
"""The gateway's action for several poses. A planner's own action has Nav2's name on the hub, so this one differs."""

GOAL_POSE = "/goal_pose"  # the hub's topic on which the gateway receives goals
HOLD, HOLD_TYPE = "/navigation/hold", "std_msgs/msg/Bool"
"""The gateway's latched topic: whether the planner's velocities are held back; see `bridge.routing.hold`."""


NAV2_MOTION = (
    "follow_path", "spin", "backup", "drive_on_heading", "assisted_teleop", "navigate_through_poses",
    "follow_waypoints", "follow_gps_waypoints", "follow_object", "dock_robot", "undock_robot",
)  # fmt: skip
"""Nav2's actions that move the base besides ``navigate_to_pose`` (default names; follow_object since Lyrical)."""


NAV2_NODES = (
    "map_server", "amcl", "controller_server", "smoother_server", "planner_server", "route_server", "behavior_server",
    "velocity_smoother", "collision_monitor", "bt_navigator", "waypoint_follower", "docking_server",
)  # fmt: skip
"""Nav2's lifecycle nodes, in the order in which its managers start them (Jazzy's default names)."""

NAV2_MANAGERS = ("lifecycle_manager_localization", "lifecycle_manager_navigation")
"""Nav2's lifecycle managers (Jazzy's default names), in the order in which they start."""


def planner_action(name: str) -> str:
    """Return a planner's action on the hub."""
    return f"/planner/{name}/navigate_to_pose"


def through_poses(action: str) -> str:
    """Return the name of `NavigateThroughPoses` in the namespace of an action `NavigateToPose`."""
    return f"{action.rpartition('/')[0]}/navigate_through_poses"


def module_name(factory: str) -> str:
    """Return the module name of a class: ``own.planners:HallPlanner`` becomes ``hall_planner``."""
    name = factory.rpartition(":")[2]
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower().strip("_")


class Planner(Section):
    """A planner that is not part of Midspan: any server of `NavigateToPose`, or of `MoveBase` on ROS 1."""

    name: SmallName = Field(description="The planner's name: lowercase letters, digits and underscores.")
    side: Literal["ros1", "ros2", "zenoh"] = setting("zenoh", "The side that it runs on; `zenoh` is the hub.")
    action: OptionalTopic = setting(
        "", 'Its action on that side, such as `/move_base`; "": `/planner/<name>/navigate_to_pose` on the hub.'
    )
    factory: Factory | None = setting(
        None, "Its class as `package.module:Class`, which Midspan hosts as a module; empty: it is a separate program."
    )
    options: dict[str, Any] = Field(default_factory=dict, description="Options for its class.")
    path: OptionalTopic = setting("", 'Topic of its path (`nav_msgs/msg/Path`); "": none.')
    local_map: OptionalTopic = setting("", 'Topic of its local map (`nav_msgs/msg/OccupancyGrid`); "": none.')
    current_goal: OptionalTopic = setting("", 'Topic of its current goal (`geometry_msgs/msg/PoseStamped`); "": none.')
    velocity: OptionalTopic = setting("", "Its velocity topic, if not `navigation.velocity`.")
    motion_actions: tuple[TopicName, ...] | None = setting(
        None, "Other actions on its side that move the base; a stop cancels them too. Not set: Nav2's; on ROS 1, none."
    )
    lifecycle_managers: tuple[TopicName, ...] | None = setting(
        None, "Its lifecycle managers in the order in which they start. Not set: Nav2's two; on ROS 1, none."
    )

    @field_validator("name")
    @classmethod
    def _name_is_free(cls, value: str) -> str:
        if value in OURS:
            raise ValueError(f"{value} is the name of a built-in planner; choose another one")
        return value

    @model_validator(mode="before")
    @classmethod
    def _action_on_the_hub(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("side", "zenoh") == "zenoh" and not data.get("action"):
            return {**data, "action": planner_action(str(data.get("name", "")))}
        return data

    @model_validator(mode="after")
    def _action_is_named(self) -> Planner:
        if not self.action:
            raise ValueError(f"name the planner's action on {self.side}, for example 'action: /navigate_to_pose'")
        if self.factory and (self.side, self.action) != ("zenoh", planner_action(self.name)):
            raise ValueError(f"Midspan itself hosts {self.factory} on the hub; remove 'side' and 'action'")
        return self

    @property
    def motion(self) -> tuple[str, ...]:
        """The other actions on its side that move the base."""
        return self._nav2(NAV2_MOTION) if self.motion_actions is None else self.motion_actions

    @property
    def managers(self) -> tuple[str, ...]:
        """Its lifecycle managers, in the order in which they start."""
        return self._nav2(NAV2_MANAGERS) if self.lifecycle_managers is None else self.lifecycle_managers

    @property
    def lifecycle_nodes(self) -> tuple[str, ...]:
        """The lifecycle nodes that it may consist of: Nav2's, in the namespace of its action; none on ROS 1."""
        return self._nav2(NAV2_NODES)

    def _nav2(self, names: tuple[str, ...]) -> tuple[str, ...]:
        namespace = self.action.rpartition("/")[0]
        return () if self.side == "ros1" else tuple(f"{namespace}/{name}" for name in names)

    @property
    def on_hub(self) -> str:
        """The planner's action on the hub."""
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
    "nav2_zenoh": Planner(name="nav2_zenoh", action=ACTION, path="/plan", local_map="/local_costmap/costmap"),
}
"""Planners that need no entry in ``planners``."""


class DoorsSection(Section):
    """The names that clients on each side use. If a planner serves one of them itself, the gateway does not."""

    ros1: OptionalTopic = setting("/move_base", 'The actionlib server (`MoveBase`) on ROS 1; "": none.')
    ros1_goal: OptionalTopic = setting("/move_base_simple/goal", 'Topic of goals on ROS 1 (`PoseStamped`); "": none.')
    ros2: OptionalTopic = setting(
        "/navigate_to_pose",
        'The action (`NavigateToPose`) on ROS 2 (DDS), with `navigate_through_poses` in the same namespace; "": none.',
    )
    ros2_goal: OptionalTopic = setting("/goal_pose", 'Topic of goals on ROS 2 (`PoseStamped`); "": none.')
    yarp: tuple[PortName, ...] = setting(
        ("/navigation2D_nws_yarp", "/navigationServer"),
        "Prefixes of the ports for YARP's `navigation2D_nwc_yarp`; each gets `rpc` and `status:o`.",
    )


class NavigationSection(Section):
    """The planner that drives the robot, and the names under which its clients send goals."""

    planner: str = setting(
        "",
        "The planner: `robot_path_planner` or `robot_goto` (Midspan's modules), `move_base` (ROS 1), `nav2` (ROS 2,"
        " over DDS), `nav2_zenoh` (over rmw_zenoh),"
        ' one of `planners`, or a class of your own as `package.module:Class`; "": none, and the gateway does not run.',
    )
    planners: tuple[Planner, ...] = setting(
        (), "Planners that are not part of Midspan, other than `move_base`, `nav2` and `nav2_zenoh`."
    )
    localizer: PoseSourceName | None = setting(
        None, "The source of the robot's pose, as in `modules.localization_server.source`; empty: that key decides."
    )
    map: MapSource = setting("store", "The map for Midspan's planner and localizer: `store`, or a topic.")
    frame: FrameName = setting("map", "The frame of maps and locations.")
    base_frame: FrameName = setting("base_link", "The robot's frame.")
    velocity: OptionalTopic = setting("/cmd_vel", "The base's velocity topic on the hub (`Twist` or `TwistStamped`).")
    stamped: Enabled = setting(
        "auto",
        "Midspan's own velocities: `true`: `TwistStamped`, `false`: `Twist`, `auto`: what the base subscribes to.",
    )
    patience: float = setting(
        10.0, "Seconds that a goal waits if its planner is missing, or disappears during the drive.", ge=0.0, le=3600.0
    )
    silence: float = setting(
        5.0, "Seconds without status and feedback after which a planner counts as silent; 0: never.", ge=0.0, le=3600.0
    )
    doors: DoorsSection = subsection(DoorsSection, "The names that clients use.")

    @property
    @override
    def driven(self) -> tuple[tuple[str, str], ...]:
        topics = {self.velocity, *(planner.velocity for planner in self.others.values())} - {""}
        return tuple((topic, kind) for topic in sorted(topics) for kind in VELOCITIES)

    @model_validator(mode="before")
    @classmethod
    def _planner_of_a_class(cls, data: Any) -> Any:
        """If ``planner`` names a class, add the class to ``planners``, and choose it by its name there."""
        factory = data.get("planner") if isinstance(data, dict) else None
        if not (isinstance(factory, str) and FACTORY.fullmatch(factory)):
            return data
        name = module_name(factory)
        planners = data.get("planners", ())
        return {**data, "planner": name, "planners": [*planners, {"name": name, "factory": factory}]}

    @model_validator(mode="after")
    def _planner_is_known(self) -> NavigationSection:
        names = [planner.name for planner in self.planners]
        differ(names, "two planners have the name")
        known = sorted({*OURS, *KNOWN, *names})
        if self.planner and self.planner not in known:
            msg = f"no planner is named {self.planner!r}; add it to 'planners', or choose one of {', '.join(known)}"
            raise ValueError(msg)
        return self

    @property
    def others(self) -> dict[str, Planner]:
        """The planners of this deployment that are not part of Midspan, by name."""
        planners = {planner.name: planner for planner in self.planners}
        if self.planner in KNOWN:
            planners.setdefault(self.planner, KNOWN[self.planner])
        return planners

    def other(self, name: str) -> Planner | None:
        """Return a planner of this deployment that is not part of Midspan, or one that Midspan knows; else None."""
        return self.others.get(name, KNOWN.get(name))

    @property
    def choices(self) -> tuple[str, ...]:
        """The planners that clients can choose at run time."""
        return (*OURS, *self.others)

    def through(self, planner: str) -> str:
        """Return the action `NavigateThroughPoses` on the hub that a planner may serve; "" if it has none."""
        other = self.others.get(planner)
        if other is None:
            return through_poses(planner_action(planner)) if planner == OURS[0] else ""
        name = through_poses(other.action)
        return name if name in other.motion else ""

    def has_action(self, planner: str) -> bool:
        """Return whether a planner on the hub serves the gateway's own action, so that the gateway cannot."""
        return self.at(planner) == ACTION

    def at(self, planner: str) -> str:
        """Return a planner's action on the hub."""
        return self.others[planner].on_hub if planner in self.others else planner_action(planner)
