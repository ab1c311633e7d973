"""What the rules are asked about: a topic, a service, or the action that one of either is a part of.

An action is three services and two topics (ROS 2 design, actions.html). The rules see it whole: by its own name, by its
own type, and a new name moves all five. Its cancel service and its status topic have the same type in every action, so
that the action's type is taken from the other three.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

_MIDDLE = "/_action/"
_ENDINGS = {"send_goal": "_SendGoal", "get_result": "_GetResult", "feedback": "_FeedbackMessage"}
_COMMON = {"cancel_goal": "action_msgs/srv/CancelGoal", "status": "action_msgs/msg/GoalStatusArray"}


@dataclass(frozen=True, slots=True)
class Subject:
    """What the rules are asked about.

    Attributes:
        kind: ``topic``, ``service`` or ``action``.
        name: its name, an action's own.
        type_name: its type as ROS 2 spells it, an action's own; "" while that is not known.
        part: of an action, what it is of it: ``send_goal``, ``status`` ...
    """

    kind: Literal["topic", "service", "action"]
    name: str
    type_name: str
    part: str = ""

    @property
    def unknown(self) -> bool:
        """Whether it belongs to an action of which nothing tells the type yet."""
        return bool(self.part) and not self.type_name

    def part_name(self, name: str) -> str:
        """The topic's or service's name where the whole is called ``name``."""
        return f"{name}{_MIDDLE}{self.part}" if self.part else name


class Actions:
    """The actions of one graph.

    Args:
        named: name and type of each topic and service on it; types as ROS 2 spells them.
    """

    def __init__(self, named: Iterable[tuple[str, str]]) -> None:
        self._types: dict[str, str] = {}
        for name, type_name in named:
            action, part = split(name)
            ending = _ENDINGS.get(part)
            if ending and type_name.endswith(ending):
                self._types[action] = type_name.removesuffix(ending)

    def subject(self, kind: Literal["topic", "service"], name: str, type_name: str) -> Subject:
        """What the rules are asked about for a topic or a service."""
        action, part = split(name)
        if not part or not (_COMMON.get(part) == type_name or type_name.endswith(_ENDINGS.get(part, "/"))):
            return Subject(kind, name, type_name)  # also what is only called like a part of an action
        return Subject("action", action, self._types.get(action, ""), part)


def split(name: str) -> tuple[str, str]:
    """An action's name and the part that this topic or service is of it; "" both where it is none."""
    if _MIDDLE not in name:  # as of most names
        return "", ""
    action, middle, part = name.rpartition(_MIDDLE)
    return (action, part) if middle and action and part in _ENDINGS | _COMMON else ("", "")
