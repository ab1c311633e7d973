"""The section ``routing``: the rules."""

from __future__ import annotations

import re
from typing import Literal

from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from bridge.config.sections.parameters import ParameterRule, parameters_trouble
from bridge.config.sections.section import Section, SideName
from bridge.config.sections.values import ROS2_NAME

_WILDCARD = re.compile(r"\*\*|\*|\?")
_GROUP = re.compile(r"\\(?:([0-9]+)|g<(\w+)>)")
_ROS1_NAME = re.compile(r"(?:/[A-Za-z0-9_]+)+")


class QosOverride(Section):
    """QoS that a rule forces on the endpoints that the bridge makes."""

    reliability: Literal["reliable", "best_effort"] | None = Field(default=None, description="Forced reliability.")
    durability: Literal["volatile", "transient_local"] | None = Field(
        default=None, description="Forced durability (latching)."
    )


def rename_trouble(rename: str, topic: str | None, regex: str | None, *, ros1: bool) -> str:
    """What is wrong with a rule's new name, "" where it is good; ``ros1``: only ROS 1 gets to see it."""
    if regex is not None:
        pattern = re.compile(regex)
        for number, name in _GROUP.findall(rename):
            if (number and int(number) > pattern.groups) or (name and name not in pattern.groupindex):
                return f"takes group {number or name}, which the regular expression does not have"
        examples = [_GROUP.sub("x", rename), _GROUP.sub("/x", rename)]
    else:
        had, taken = len(_WILDCARD.findall(topic or "")), len(_WILDCARD.findall(rename))
        if taken > had:
            return f"has {taken} wildcards, and the topic has {had} to fill them from"
        examples = [_WILDCARD.sub("x", rename)]
    if not any((_ROS1_NAME if ros1 else ROS2_NAME).fullmatch(example) for example in examples):
        return "is no topic name: begin it with a slash; letters, digits and underscores make its parts" + (
            "" if ros1 else ", and none begins with a digit"
        )
    return ""


class Rule(Section):
    """One rule: which topics, services and actions it names, and what becomes of them.

    Of the rules that match, any with ``deny`` wins; else the first one that matches gives rename, rate, priority,
    depth and QoS.
    """

    kind: Literal["topic", "service", "action"] | None = Field(
        default=None, description="Only topics, only services or only actions; without it all three."
    )
    topic: str | None = Field(
        default=None,
        description="Glob over the name of the topic, service or action where the rule is applied: `*` stays within one"
        " name part, `**` crosses parts. Example: `/camera/**`.",
    )
    regex: str | None = Field(
        default=None, description="Regular expression that must match the whole name; an alternative to `topic`."
    )
    type: str | None = Field(
        default=None,
        description="Glob over the type's ROS 2 name: `sensor_msgs/msg/*`, `nav_msgs/srv/GetMap`,"
        " `nav2_msgs/action/*`.",
    )
    from_: SideName | None = Field(default=None, alias="from", description="Only what comes from this side.")
    to: SideName | None = Field(
        default=None,
        description="Only on the way out to this side; without it the rule holds where the topic enters the hub.",
    )
    deny: bool = Field(default=False, description="It does not cross; wins over every other rule.")
    rename: str | None = Field(
        default=None,
        description="New name. With `regex`, groups as `\\1`; with a glob, each `*` or `**` of the new name stands for"
        " what the wildcard at that place matched.",
    )
    rate: float | None = Field(
        default=None,
        gt=0,
        le=10000,
        description="At most so many messages a second, the newest ones. Of topics alone, as are the next four.",
    )
    priority: Literal["state", "command", "stream"] | None = Field(
        default=None, description="state: kept; command: newest only, never latched or late; stream: drops oldest."
    )
    depth: int | None = Field(
        default=None, ge=1, le=100000, description="Length of the route's queue, and history depth."
    )
    timeout: float | None = Field(
        default=None, gt=0, le=60, description="Seconds after which a command is too old to be delivered (default 0.5)."
    )
    qos: QosOverride = Field(default_factory=QosOverride, description="QoS forced on the bridge's endpoints.")

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @field_validator("regex")
    @classmethod
    def _regex_compiles(cls, value: str | None) -> str | None:
        if value is not None:
            try:
                re.compile(value)
            except re.error as err:
                msg = f"not a regular expression: {err}"
                raise ValueError(msg) from None
        return value

    @field_validator("topic")
    @classmethod
    def _topic_is_absolute(cls, value: str | None) -> str | None:
        if value is not None and not value.startswith(("/", "**")):
            msg = (
                f"{value!r} matches no topic: names begin with a slash; write /{value}, or **/{value} in any namespace"
            )
            raise ValueError(msg)
        return value

    @field_validator("type")
    @classmethod
    def _type_is_spelled_as_in_ros2(cls, value: str | None, info: ValidationInfo) -> str | None:
        if value is not None and "**" not in value and value.count("/") == 1:
            middle = {"service": "srv", "action": "action"}.get(info.data.get("kind") or "", "msg")
            spelled = value.replace("/", f"/{middle}/")
            msg = f"{value!r} matches no type: they are spelled as in ROS 2, {spelled}"
            raise ValueError(msg)
        return value

    @model_validator(mode="after")
    def _one_pattern(self) -> Rule:
        if self.topic is not None and self.regex is not None:
            msg = "give either 'topic' (a glob) or 'regex', not both"
            raise ValueError(msg)
        if self.rename is not None:
            trouble = rename_trouble(self.rename, self.topic, self.regex, ros1=self.to in ("ros1", "zenoh_ros1"))
            if trouble:
                msg = f"rename {self.rename!r} {trouble}"
                raise ValueError(msg)
        if self.deny and (self.rename or self.rate or self.priority or self.depth or self.timeout):
            msg = "a rule that denies has no rename, rate, priority, depth or timeout"
            raise ValueError(msg)
        if self.kind in ("service", "action") and (
            self.rate or self.priority or self.depth or self.timeout or self.qos != QosOverride()
        ):
            msg = f"rate, priority, depth, timeout and qos are of topics; a rule of kind {self.kind} has none of them"
            raise ValueError(msg)
        return self


class RoutingSection(Section):
    """What crosses, and how."""

    default: Literal["allow", "deny"] = Field(
        default="allow",
        description="What becomes of what no rule names. With `deny`, the rules are the allow list.",
    )
    private: bool = Field(
        default=True,
        description="Keep back what is private to a side (rosout, parameter events, the services that each node"
        " has for itself, and the like).",
    )
    rules: tuple[Rule, ...] = Field(default=(), description="The rules; see below.")
    parameters: tuple[ParameterRule, ...] = Field(
        default=(), description="Parameters that ROS 1 and ROS 2 share; none without a rule."
    )

    @field_validator("parameters")
    @classmethod
    def _parameters_agree(cls, value: tuple[ParameterRule, ...]) -> tuple[ParameterRule, ...]:
        trouble = parameters_trouble(value)
        if trouble:
            raise ValueError(trouble)
        return value
