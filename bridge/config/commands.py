"""Which messages are commands, as the hub's door tells them: by type, and by the last part of the topic's name."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from bridge.config.sections.routing import RoutingSection, Rule

EVERY = "*"
"""In place of the last part of a name: topics of any name."""

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
