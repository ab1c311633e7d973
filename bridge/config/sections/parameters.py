"""The rules of parameters, ``routing.parameters``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal

from pydantic import Field, field_validator

from bridge.config.sections.section import Section
from bridge.config.sections.values import ROS2_NAME

_ROS1_KEY = re.compile(r"(?:/[A-Za-z0-9_]+)+")
_PREFIX = re.compile(r"[A-Za-z0-9_]+(?:\.[A-Za-z0-9_]+)*")


class ParameterRule(Section):
    """Parameters that ROS 1 and ROS 2 share: of ROS 1's parameter server and of one ROS 2 node.

    They have one owner, whose value counts. Where `ros1` is `/move_base`, ROS 1's `/move_base/a/b` is the node's `a.b`.
    """

    ros1: str = Field(
        description="Namespace of the parameters on ROS 1's parameter server, or one parameter: `/move_base`."
    )
    node: str = Field(description="The ROS 2 node's full name: `/controller_server`.")
    owner: Literal["ros1", "ros2"] = Field(
        description="Who has them. ros2: the node is there, and its parameters are kept up to date in ROS 1. ros1: they"
        " are on ROS 1's parameter server, and Midspan serves them to ROS 2 as those of a node of that name."
    )
    prefix: str = Field(
        default="",
        description="What the names begin with on the node: `FollowPath`; the whole name where `ros1` is a parameter.",
    )
    names: tuple[str, ...] = Field(
        default=("**",),
        min_length=1,
        description="Globs over what follows `ros1` in the names, as ROS 1 spells it; `*` stays within one part, `**`"
        " crosses parts. Example: `FollowPath/*`.",
    )
    write: bool = Field(default=True, description="Whether the side that does not own them may set them.")

    @field_validator("ros1")
    @classmethod
    def _is_a_key(cls, value: str) -> str:
        if not _ROS1_KEY.fullmatch(value):
            msg = f"{value!r} is no name of ROS 1 parameters: it should look like /move_base or /move_base/base_frame"
            raise ValueError(msg)
        return value

    @field_validator("node")
    @classmethod
    def _is_a_node(cls, value: str) -> str:
        if not ROS2_NAME.fullmatch(value):
            msg = f"{value!r} is no ROS 2 node: it should look like /controller_server"
            raise ValueError(msg)
        return value

    @field_validator("prefix")
    @classmethod
    def _is_a_prefix(cls, value: str) -> str:
        if value and not _PREFIX.fullmatch(value):
            msg = (
                f"{value!r} is no beginning of a ROS 2 parameter's name: it should look like FollowPath or limits.speed"
            )
            raise ValueError(msg)
        return value


def parameters_trouble(rules: Sequence[ParameterRule]) -> str:
    """Why these rules cannot stand beside each other, "" where they can."""
    for number, rule in enumerate(rules, 1):
        for other_number, other in enumerate(rules[number:], number + 1):
            if rule.node == other.node and rule.owner != other.owner:
                return (
                    f"rules {number} and {other_number} give {rule.node} two owners; name another node in one of them"
                )
            shared = _within(rule.ros1, other.ros1) or _within(other.ros1, rule.ros1)
            if shared and "ros2" in (rule.owner, other.owner):
                return (
                    f"rules {number} and {other_number} both take what is in {max(rule.ros1, other.ros1)}, and a ROS 2"
                    " node owns it; give each node a namespace of its own"
                )
    return ""


def _within(name: str, namespace: str) -> bool:
    return name == namespace or name.startswith(f"{namespace}/")
