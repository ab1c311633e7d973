"""The section ``routing``: the rules."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from bridge.config.sections.section import ROS2_NAME, Section, SideName, matching, setting, subsection

_ROS1_NAME = re.compile(r"(?:/[A-Za-z0-9_]+)+")
_Key = Annotated[str, matching(_ROS1_NAME, "is not a ROS 1 parameter: write it as /move_base or /move_base/base_frame")]
_Node = Annotated[str, matching(ROS2_NAME, "is not a ROS 2 node: write it as /controller_server")]
_Prefix = Annotated[
    str,
    matching(
        r"(?:[A-Za-z0-9_]+(?:\.[A-Za-z0-9_]+)*)?",
        "cannot begin a ROS 2 parameter's name: write it as FollowPath or limits.speed",
    ),
]


class ParameterRule(Section):
    """Parameters that ROS 1's parameter server and one ROS 2 node share.

    The value of their owner is used. If `ros1` is `/move_base`, ROS 1's `/move_base/a/b` is the node's `a.b`.
    """

    ros1: _Key = Field(description="Namespace on ROS 1's parameter server, or one parameter: `/move_base`.")
    node: _Node = Field(description="The ROS 2 node's full name: `/controller_server`.")
    owner: Literal["ros1", "ros2"] = Field(
        description="Their owner. `ros2`: the node runs, and Midspan copies its parameters to ROS 1. `ros1`: they are"
        " on ROS 1's parameter server, and Midspan serves them to ROS 2 under that node name."
    )
    prefix: _Prefix = setting("", "Prefix on the node: `FollowPath`; the whole name if `ros1` is one parameter.")
    names: tuple[str, ...] = setting(
        ("**",),
        "Globs over the names below `ros1`; `*` matches within one part, `**` across parts: `FollowPath/*`.",
        min_length=1,
    )
    write: bool = setting(True, "Whether the other side may set them.")


def parameters_trouble(rules: Sequence[ParameterRule]) -> str:
    """Return why these rules contradict each other, "" if they do not."""
    for number, rule in enumerate(rules, 1):
        for other_number, other in enumerate(rules[number:], number + 1):
            if rule.node == other.node and rule.owner != other.owner:
                return f"rules {number} and {other_number} give {rule.node} two owners; change the node in one"
            shared = _within(rule.ros1, other.ros1) or _within(other.ros1, rule.ros1)
            if shared and "ros2" in (rule.owner, other.owner):
                return (
                    f"rules {number} and {other_number} both share the parameters in {max(rule.ros1, other.ros1)},"
                    " which a ROS 2 node owns; give each node its own namespace"
                )
    return ""


def _within(name: str, namespace: str) -> bool:
    return name == namespace or name.startswith(f"{namespace}/")


_WILDCARD = re.compile(r"\*\*|\*|\?")
_GROUP = re.compile(r"\\(?:([0-9]+)|g<(\w+)>)")


class QosOverride(Section):
    """QoS that a rule forces on the bridge's endpoints."""

    reliability: Literal["reliable", "best_effort"] | None = setting(None, "Forced reliability.")
    durability: Literal["volatile", "transient_local"] | None = setting(None, "Forced durability (latching).")


def rename_trouble(rename: str, topic: str | None, regex: str | None, *, ros1: bool) -> str:
    """Return what is wrong with a rule's new name, "" if it is valid; ``ros1``: the name is only used in ROS 1."""
    if regex is not None:
        pattern = re.compile(regex)
        for number, name in _GROUP.findall(rename):
            if (number and int(number) > pattern.groups) or (name and name not in pattern.groupindex):
                return f"uses group {number or name}, which the regular expression does not have"
        examples = [_GROUP.sub("x", rename), _GROUP.sub("/x", rename)]
    else:
        available, used = len(_WILDCARD.findall(topic or "")), len(_WILDCARD.findall(rename))
        if used > available:
            return f"has {used} wildcards, but the topic has only {available} to fill them from"
        examples = [_WILDCARD.sub("x", rename)]
    if not any((_ROS1_NAME if ros1 else ROS2_NAME).fullmatch(example) for example in examples):
        return "is not a topic name: begin it with a slash; letters, digits and underscores make its parts" + (
            "" if ros1 else ", and none begins with a digit"
        )
    return ""


class Rule(Section):
    """A rule for some topics, services and actions: which names it matches, and what happens to them.

    If several rules match, one with ``deny`` wins; otherwise the first one gives rename, rate, priority, depth and QoS.
    """

    kind: Literal["topic", "service", "action"] | None = setting(
        None, "Only topics, only services or only actions; by default all three."
    )
    topic: str | None = setting(
        None, "Glob over the name: `*` matches within one part, `**` across parts: `/camera/**`."
    )
    regex: str | None = setting(None, "Regular expression over the whole name, instead of `topic`.")
    type: str | None = setting(
        None, "Glob over the type's ROS 2 name: `sensor_msgs/msg/*`, `nav_msgs/srv/GetMap`, `nav2_msgs/action/*`."
    )
    from_: SideName | None = Field(default=None, alias="from", description="Only what comes from this side.")
    to: SideName | None = setting(
        None, "Apply only from the hub to this side; by default a rule applies from a side to the hub."
    )
    deny: bool = setting(False, "Do not bridge what matches; this overrides all other rules.")
    rename: str | None = setting(
        None, "New name; with `regex`, groups as `\\1`; with a glob, `*` and `**` keep what they matched there."
    )
    rate: float | None = setting(
        None,
        "Maximum messages per second; the newest are bridged. Only for topics, like the next four.",
        gt=0,
        le=10000,
    )
    priority: Literal["state", "command", "stream"] | None = setting(
        None,
        "`state`: queued until delivered; `command`: newest only, never latched or late; `stream`: drops the oldest.",
    )
    depth: int | None = setting(None, "Length of the route's queue, and history depth.", ge=1, le=100000)
    timeout: float | None = setting(None, "Seconds after which a command is too old (default 0.5).", gt=0, le=60)
    stamped: bool | None = setting(None, "Convert velocities to `TwistStamped` (true) or to `Twist` (false).")
    qos: QosOverride = subsection(QosOverride, "QoS forced on the bridge's endpoints.")

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @field_validator("regex")
    @classmethod
    def _regex_compiles(cls, value: str | None) -> str | None:
        if value is not None:
            try:
                re.compile(value)
            except re.error as err:
                raise ValueError(f"not a regular expression: {err}") from None
        return value

    @field_validator("topic")
    @classmethod
    def _topic_is_absolute(cls, value: str | None) -> str | None:
        if value is not None and not value.startswith(("/", "**")):
            raise ValueError(f"{value!r} matches no topic: write /{value}, or **/{value} for any namespace")
        return value

    @field_validator("type")
    @classmethod
    def _type_is_spelled_as_in_ros2(cls, value: str | None, info: ValidationInfo) -> str | None:
        if value is not None and "**" not in value and value.count("/") == 1:
            middle = {"service": "srv", "action": "action"}.get(info.data.get("kind") or "", "msg")
            spelled = value.replace("/", f"/{middle}/")
            raise ValueError(f"{value!r} matches no type: they are spelled as in ROS 2, {spelled}")
        return value

    @model_validator(mode="after")
    def _one_pattern(self) -> Rule:
        if self.topic is not None and self.regex is not None:
            raise ValueError("give either 'topic' (a glob) or 'regex', not both")
        if self.rename is not None:
            trouble = rename_trouble(self.rename, self.topic, self.regex, ros1=self.to in ("ros1", "zenoh_ros1"))
            if trouble:
                raise ValueError(f"rename {self.rename!r} {trouble}")
        if self.deny and (self.rename or self.rate or self.priority or self.depth or self.timeout):
            raise ValueError("a rule that denies has no rename, rate, priority, depth or timeout")
        if self.stamped is not None and (self.deny or self.kind in ("service", "action")):
            raise ValueError(
                "stamped is for topics that are bridged; leave it out of a rule that denies, and set kind: topic"
            )
        if self.kind in ("service", "action") and (
            self.rate or self.priority or self.depth or self.timeout or self.qos != QosOverride()
        ):
            msg = f"rate, priority, depth, timeout and qos are for topics; a rule of kind {self.kind} cannot have them"
            raise ValueError(msg)
        return self


class RoutingSection(Section):
    """What is bridged between the sides and the hub, and how."""

    default: Literal["allow", "deny"] = setting(
        "allow", "What happens to names that no rule matches. With `deny`, the rules are the allow list."
    )
    private: bool = setting(
        True,
        "Do not bridge private names: rosout, parameter events, each node's own services and the like.",
    )
    rules: tuple[Rule, ...] = setting((), "The rules; see below.")
    parameters: tuple[ParameterRule, ...] = setting((), "Parameters that ROS 1 and ROS 2 share; none without a rule.")

    @field_validator("parameters")
    @classmethod
    def _parameters_agree(cls, value: tuple[ParameterRule, ...]) -> tuple[ParameterRule, ...]:
        trouble = parameters_trouble(value)
        if trouble:
            raise ValueError(trouble)
        return value
