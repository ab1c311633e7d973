"""The rules that follow from the section ``navigation``, and which messages the rules make commands."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from bridge.config.sections.navigation import ACTION, GOAL_POSE, NavigationSection
from bridge.config.sections.routing import RoutingSection, Rule

TWIST, POSE = "geometry_msgs/msg/Twist", "geometry_msgs/msg/PoseStamped"
PATH, GRID = "nav_msgs/msg/Path", "nav_msgs/msg/OccupancyGrid"


class MadeRule(Rule):
    """A rule that is in no file; ``of`` says in words what it follows from."""

    of: str


def with_navigation(routing: RoutingSection, navigation: NavigationSection) -> RoutingSection:
    """The rules of the file, after those that follow from ``navigation``; a ``deny`` of either wins.

    What planners tell besides comes last: where the file limits its rate, so it is.
    """
    if not navigation.planner:
        return routing
    rules = *made_rules(navigation), *routing.rules, *_told(navigation)
    return routing.model_copy(update={"rules": rules})


def made_rules(section: NavigationSection) -> Iterator[MadeRule]:
    """The rules of a section that names a planner."""
    doors = section.doors
    for planner in section.others.values():
        of = f"navigation (planner {planner.name})"
        if planner.side != "zenoh":
            yield _rule(of, kind="action", topic=planner.action, from_=planner.side, rename=planner.on_hub)
        if planner.side != "zenoh":  # a stop cancels these, too, whatever the file says of other actions
            for action in planner.motion:
                yield _rule(of, kind="action", topic=action, from_=planner.side)
        if planner.velocity and section.velocity and planner.velocity != section.velocity:
            yield _rule(
                of, kind="topic", topic=planner.velocity, type=TWIST, from_=planner.side, rename=section.velocity,
                priority="command",
            )  # fmt: skip
    taken: dict[tuple[str, str], str] = {
        (planner.side, planner.action): planner.name for planner in section.others.values()
    }
    for side, action, goal in (("ros1", doors.ros1, doors.ros1_goal), ("ros2", doors.ros2, doors.ros2_goal)):
        yield from _door(side, action, goal, taken.get((side, action), ""))
    yield _rule("navigation", topic="/navigation/**")
    if section.velocity:
        yield _rule("navigation.velocity", kind="topic", topic=section.velocity, type=TWIST, priority="command")


def _told(section: NavigationSection) -> Iterator[MadeRule]:
    """The rules of the topics on which planners tell their ways, local maps and goals."""
    for planner in section.others.values():
        told = (planner.path, PATH), (planner.local_map, GRID), (planner.current_goal, POSE)
        for topic, kind in told:
            if topic and planner.side != "zenoh":
                yield _rule(
                    f"navigation (planner {planner.name})", kind="topic", topic=topic, type=kind, from_=planner.side
                )


def _door(side: str, action: str, goal: str, owner: str) -> Iterator[MadeRule]:
    """The rules of one side's door; where a planner has its name, what is said there is the planner's alone."""
    of = f"navigation ({owner} has {action} there itself)" if owner else f"navigation.doors.{side}"
    if owner or not action:
        yield _rule(of, kind="action", topic=ACTION, to=side, deny=True)
    else:
        yield _rule(of, kind="action", topic=ACTION, to=side, rename=action)
    if not goal:
        return
    if owner:  # the planner hears it there; what others say there must not reach it either
        yield _rule(of, kind="topic", topic=goal, type=POSE, from_=side, to="zenoh", deny=True)
        yield _rule(of, kind="topic", topic=goal, type=POSE, to=side, deny=True)
    else:
        yield _rule(of, kind="topic", topic=goal, type=POSE, from_=side, rename=GOAL_POSE)


def _rule(of: str, **values: Any) -> MadeRule:
    return MadeRule.model_validate({"of": of, **values})


EVERY = "*"  # in place of the last part of a name: topics of any name
ALWAYS: Mapping[str, str] = {
    "geometry_msgs/msg/Twist": EVERY,
    "geometry_msgs/msg/TwistStamped": EVERY,
    # ROS 1's actionlib cancels with it; its goals, and ROS 2's goals and cancels, are known by the end of their types
    "actionlib_msgs/msg/GoalID": EVERY,
    # /move_base_simple/goal, /goal_pose, /goal_update
    "geometry_msgs/msg/PoseStamped": "goal*",
}
"""Types that command whatever the rules say, and of which topics."""

_PART = re.compile(r"[A-Za-z0-9_]+\*?")
_TYPE = re.compile(r"[A-Za-z]\w*/(?:msg|srv|action)/[A-Za-z]\w*", re.ASCII)


@dataclass(frozen=True, slots=True)
class Untyped:
    """A command rule of which the door cannot tell the type."""

    index: int
    text: str


def commands(routing: RoutingSection) -> dict[str, frozenset[str]]:
    """Types that command, each with the last parts of its topics' names: words, with ``*`` at the end at most."""
    found: dict[str, set[str]] = {type_name: {part} for type_name, part in ALWAYS.items()}
    for rule in routing.rules:
        if rule.priority == "command" and rule.type is not None:
            found.setdefault(rule.type, set()).update(_last_parts(rule))
    return {name: frozenset({EVERY}) if EVERY in parts else frozenset(parts) for name, parts in found.items()}


def untyped(routing: RoutingSection) -> list[Untyped]:
    """The command rules whose type is not told exactly."""
    return [
        Untyped(
            index,
            "with hub.open a command rule says its type, for example 'type: geometry_msgs/msg/Twist': the door tells"
            " commands by their types",
        )
        for index, rule in enumerate(routing.rules)
        if rule.priority == "command" and not (rule.type and _TYPE.fullmatch(rule.type))
    ]


def _last_parts(rule: Rule) -> set[str]:
    """What the topics' names end with, on the way in and after a renaming."""
    if rule.topic is None:
        return {EVERY}
    names = [rule.topic, *([rule.rename] if rule.rename else [])]
    return {_last_part(name) for name in names}


def _last_part(name: str) -> str:
    part = name.rpartition("/")[2]
    return part if _PART.fullmatch(part) else EVERY
