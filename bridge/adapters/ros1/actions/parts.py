"""The five parts that a ROS 2 action is made of, by name and type as this edge spells them."""

from __future__ import annotations

SEND_GOAL, GET_RESULT, CANCEL_GOAL = "send_goal", "get_result", "cancel_goal"
FEEDBACK, STATUS = "feedback", "status"

SERVICES = (SEND_GOAL, GET_RESULT, CANCEL_GOAL)
TOPICS = (FEEDBACK, STATUS)

_BETWEEN = "/_action/"
_CANCEL_TYPE = "action_msgs/srv/CancelGoal"
_STATUS_TYPE = "action_msgs/GoalStatusArray"
_OF_ACTION = {SEND_GOAL: "_SendGoal", GET_RESULT: "_GetResult", FEEDBACK: "_FeedbackMessage"}


def name_of(action: str, part: str) -> str:
    """The full name of one part of an action."""
    return f"{action}{_BETWEEN}{part}"


def type_of(action_type: str, part: str) -> str:
    """The type of one part of an action (``move_base_msgs/MoveBase``)."""
    if part == CANCEL_GOAL:
        return _CANCEL_TYPE
    if part == STATUS:
        return _STATUS_TYPE
    return action_type.replace("/", "/action/", 1) + _OF_ACTION[part]


def split(name: str, type_name: str) -> tuple[str, str] | None:
    """Action and part of a service or topic, None of what is no part of an action."""
    action, between, part = name.rpartition(_BETWEEN)
    if not between or not action or part not in (*SERVICES, *TOPICS):
        return None
    suffix = _OF_ACTION.get(part)
    fits = type_name == type_of("", part) if suffix is None else "/action/" in type_name and type_name.endswith(suffix)
    return (action, part) if fits else None


def action_type(type_name: str, part: str) -> str:
    """The action's type by that of its send_goal, get_result or feedback."""
    return type_name.removesuffix(_OF_ACTION[part]).replace("/action/", "/", 1)
