"""Routing rules derived from other sections, and the message types that rules mark as commands."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from bridge.config.sections.navigation import (
    ACTION,
    GOAL_POSE,
    THROUGH_POSES,
    NavigationSection,
    Planner,
    through_poses,
)
from bridge.config.sections.routing import RoutingSection, Rule
from bridge.config.sections.section import DrivenTopic
from bridge.messages.velocities import COMMAND_NAME, VELOCITIES

POSE, PATH, GRID = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Path", "nav_msgs/msg/OccupancyGrid"

GET_STATE = "lifecycle_msgs/srv/GetState"


class MadeRule(Rule):
    """A rule derived from a section; ``of`` names that section as users see it."""

    of: str


class CommandRule(MadeRule):
    """Marks a topic's messages as commands, unless another rule sets their class; it does not let anything pass."""


def with_commands(routing: RoutingSection, driven: Iterable[DrivenTopic]) -> RoutingSection:
    """Return the rules with a `CommandRule` for each topic that moves the robot.

    Topics whose names and types already imply commands need none.
    """
    rules = [
        CommandRule(of=of, kind="topic", topic=topic, type=type_name, priority="command")
        for of, topic, type_name in driven
        if not (type_name in VELOCITIES and COMMAND_NAME.search(topic))
    ]
    return routing.model_copy(update={"rules": (*routing.rules, *rules)}) if rules else routing


def with_navigation(routing: RoutingSection, navigation: NavigationSection) -> RoutingSection:
    """Return the file's rules combined with those derived from ``navigation``; a ``deny`` in any of them wins.

    The derived rules come first, except those for planners' paths, local maps and goals: these come last, so that the
    file can limit their rates.
    """
    if not navigation.planner:
        return routing
    rules = *made_rules(navigation), *routing.rules, *_telemetry_rules(navigation)
    return routing.model_copy(update={"rules": rules})


def made_rules(section: NavigationSection) -> Iterator[MadeRule]:
    """Yield the rules of a section that names a planner."""
    doors = section.doors
    for planner in section.others.values():
        of = f"navigation (planner {planner.name})"
        if planner.side != "zenoh":
            yield _rule(of, kind="action", topic=planner.action, from_=planner.side, rename=planner.on_hub)
        if planner.side != "zenoh":  # a stop must cancel these actions too, even if the file denies actions by default
            for action in planner.motion:
                yield _rule(of, kind="action", topic=action, from_=planner.side)
            yield from _lifecycle_rules(of, planner)
        if planner.velocity and section.velocity and planner.velocity != section.velocity:
            for velocity in VELOCITIES:
                yield _rule(
                    of, kind="topic", topic=planner.velocity, type=velocity, from_=planner.side,
                    rename=section.velocity, priority="command",
                )  # fmt: skip
    owners: dict[tuple[str, str], str] = {
        (planner.side, planner.action): planner.name for planner in section.others.values()
    }
    for side, action, goal in (("ros1", doors.ros1, doors.ros1_goal), ("ros2", doors.ros2, doors.ros2_goal)):
        yield from _entry_rules(side, action, goal, owners.get((side, action), ""))
    yield from _rules_of_poses(section)
    yield _rule("navigation", topic="/navigation/**")
    for velocity in VELOCITIES if section.velocity else ():
        yield _rule("navigation.velocity", kind="topic", topic=section.velocity, type=velocity, priority="command")


def _lifecycle_rules(of: str, planner: Planner) -> Iterator[MadeRule]:
    """Yield the rules of a planner's lifecycle managers, and of its nodes' states, which are private otherwise."""
    for manager in planner.managers:
        yield _rule(of, kind="service", topic=f"{manager}/*", from_=planner.side)
    if planner.lifecycle_nodes:
        nodes = "|".join(planner.lifecycle_nodes)
        yield _rule(of, kind="service", regex=f"(?:{nodes})/get_state", type=GET_STATE, from_=planner.side)


def _rules_of_poses(section: NavigationSection) -> Iterator[MadeRule]:
    """Yield the rules of the gateway's `NavigateThroughPoses`, next to ROS 2's entry point; ROS 1 has none."""
    door = section.doors.ros2
    name = through_poses(door) if door else ""
    owner = next((p for p in section.others.values() if p.side in ("ros2", "zenoh") and name in p.motion), None)
    if owner is not None and owner.side == "zenoh":
        of = f"navigation ({owner.name} has {name} on the hub)"
        yield _rule(of, kind="action", topic=name, to="ros2")
    else:
        of = f"navigation ({owner.name} has {name} there itself)" if owner else "navigation.doors.ros2"
    if owner is not None or not name:
        yield _rule(of, kind="action", topic=THROUGH_POSES, to="ros2", deny=True)
    else:
        yield _rule(of, kind="action", topic=THROUGH_POSES, to="ros2", rename=name)
    yield _rule("navigation (ROS 1 has no such action)", kind="action", topic=THROUGH_POSES, to="ros1", deny=True)


def _telemetry_rules(section: NavigationSection) -> Iterator[MadeRule]:
    """Yield the rules of the topics on which planners publish their paths, local maps and goals."""
    for planner in section.others.values():
        topics = (planner.path, PATH), (planner.local_map, GRID), (planner.current_goal, POSE)
        for topic, kind in topics:
            if topic and planner.side != "zenoh":
                yield _rule(
                    f"navigation (planner {planner.name})", kind="topic", topic=topic, type=kind, from_=planner.side
                )


def _entry_rules(side: str, action: str, goal: str, owner: str) -> Iterator[MadeRule]:
    """Yield the rules of one side's entry point; a planner that serves the same name there itself keeps it."""
    of = f"navigation ({owner} has {action} there itself)" if owner else f"navigation.doors.{side}"
    if owner or not action:
        yield _rule(of, kind="action", topic=ACTION, to=side, deny=True)
    else:
        yield _rule(of, kind="action", topic=ACTION, to=side, rename=action)
    if not goal:
        return
    if owner:  # the planner itself subscribes to the topic, and must not receive goals from other sides there
        yield _rule(of, kind="topic", topic=goal, type=POSE, from_=side, to="zenoh", deny=True)
        yield _rule(of, kind="topic", topic=goal, type=POSE, to=side, deny=True)
    else:
        yield _rule(of, kind="topic", topic=goal, type=POSE, from_=side, rename=GOAL_POSE)


def _rule(of: str, **values: Any) -> MadeRule:
    return MadeRule.model_validate({"of": of, **values})


EVERY = "*"  # as the last part of a name: topics of any name
ALWAYS: Mapping[str, str] = {
    "geometry_msgs/msg/Twist": EVERY,
    "geometry_msgs/msg/TwistStamped": EVERY,
    # ROS 1's actionlib cancels with it; all other goals and cancels are recognized by the suffix of their type
    "actionlib_msgs/msg/GoalID": EVERY,
    # /move_base_simple/goal, /goal_pose, /goal_update
    "geometry_msgs/msg/PoseStamped": "goal*",
}
"""Types that are commands under any rules, and the last parts of their topics' names."""

_PART = re.compile(r"[A-Za-z0-9_]+\*?")
_TYPE = re.compile(r"[A-Za-z]\w*/(?:msg|srv|action)/[A-Za-z]\w*", re.ASCII)


@dataclass(frozen=True, slots=True)
class Untyped:
    """A command rule without an exact type, which the external listener cannot enforce."""

    index: int
    text: str


def commands(routing: RoutingSection) -> dict[str, frozenset[str]]:
    """Return the command types, each with the last parts of its topics' names, which may end with ``*``."""
    last_parts: dict[str, set[str]] = {type_name: {part} for type_name, part in ALWAYS.items()}
    for rule in routing.rules:
        if rule.priority == "command" and rule.type is not None:
            last_parts.setdefault(rule.type, set()).update(_last_parts(rule))
    return {name: frozenset({EVERY}) if EVERY in parts else frozenset(parts) for name, parts in last_parts.items()}


def untyped(routing: RoutingSection) -> list[Untyped]:
    """Return the command rules without an exact type."""
    return [
        Untyped(
            index,
            "with hub.open a command rule needs an exact type, for example 'type: geometry_msgs/msg/Twist': the"
            " external listener recognizes commands by their types",
        )
        for index, rule in enumerate(routing.rules)
        if rule.priority == "command" and not (rule.type and _TYPE.fullmatch(rule.type))
    ]


def _last_parts(rule: Rule) -> set[str]:
    """Return the last parts of the topics' names, before and after renaming."""
    if rule.topic is None:
        return {EVERY}
    names = [rule.topic, *([rule.rename] if rule.rename else [])]
    return {_last_part(name) for name in names}


def _last_part(name: str) -> str:
    part = name.rpartition("/")[2]
    return part if _PART.fullmatch(part) else EVERY
