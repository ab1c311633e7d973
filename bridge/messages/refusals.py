"""Replies that say no, of the services that have one: an action's three.

A ROS 2 client cannot be told that a call failed, it would wait for ever. A goal that got nowhere is a goal that was
refused, and the result of one whose server is gone is that it was aborted.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bridge.messages.registry import Registry
from bridge.messages.values import Writer

_ABORTED = 6
"""action_msgs/msg/GoalStatus.STATUS_ABORTED"""

_REJECTED = 1
"""action_msgs/srv/CancelGoal_Response.ERROR_REJECTED"""


def refusal(registry: Registry, type_name: str, type_hash: str = "") -> Callable[[], bytes] | None:
    """What gives the refusing reply in CDR; None where the service has none.

    Raises:
        MessageTypeError: the service is one of an action's, and unknown.
    """
    said = _said(type_name)
    if said is None:
        return None
    _, response = registry.service_schemas(type_name, type_hash)
    return lambda: Writer(response).message(said)


def _said(type_name: str) -> dict[str, Any] | None:
    if type_name == "action_msgs/srv/CancelGoal":
        return {"return_code": _REJECTED}
    if "/action/" in type_name and type_name.endswith("_SendGoal"):
        return {"accepted": False}
    if "/action/" in type_name and type_name.endswith("_GetResult"):
        return {"status": _ABORTED}
    return None
