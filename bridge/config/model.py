"""The model of Midspan's one YAML file. Every key is optional; the defaults run on one machine as they are."""

from __future__ import annotations

import re
import socket
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator, model_validator

SideName = Literal["ros1", "ros2", "yarp", "zenoh"]
Enabled = Literal["auto", True, False]


_WILDCARD = re.compile(r"\*\*|\*|\?")
_GROUP = re.compile(r"\\(?:([0-9]+)|g<(\w+)>)")
_ROS1_NAME = re.compile(r"(?:/[A-Za-z0-9_]+)+")
_ROS2_NAME = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")


class Section(BaseModel):
    """Base of all sections: frozen, and an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def _zenoh_endpoint(value: str) -> str:
    """Where zenoh listens or connects: ``protocol/address``."""
    if not re.fullmatch(r"[a-z][a-z0-9_-]*/\S+", value):
        msg = f"{value!r} is not a zenoh endpoint; give protocol and address, for example tcp/127.0.0.1:7447"
        raise ValueError(msg)
    return value


def _master_uri(value: str) -> str:
    parts = urlsplit(value)
    if parts.scheme not in {"http", "https"} or not parts.hostname:
        msg = f"{value!r} is not a master's URI; give for example http://robot:11311"
        raise ValueError(msg)
    try:
        port = parts.port
    except ValueError:
        port = None
    if port is None:
        msg = f"{value!r} has no valid port; a master's is 11311 by default, for example http://{parts.hostname}:11311"
        raise ValueError(msg)
    return value


def _node_name(value: str) -> str:
    """A node's base name that ROS 1 and ROS 2 both take."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", value):
        msg = f"{value!r} is not a node name; use letters, digits and underscores, a letter first"
        raise ValueError(msg)
    return value


ZenohEndpoint = Annotated[str, AfterValidator(_zenoh_endpoint)]
MasterUri = Annotated[str, AfterValidator(_master_uri)]
NodeName = Annotated[str, AfterValidator(_node_name)]


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
    if not any((_ROS1_NAME if ros1 else _ROS2_NAME).fullmatch(example) for example in examples):
        return "is no topic name: begin it with a slash; letters, digits and underscores make its parts" + (
            "" if ros1 else ", and none begins with a digit"
        )
    return ""


class Rule(Section):
    """One rule: which topics it names, and what becomes of them.

    Of the rules that match, any with ``deny`` wins; else the first one that matches gives rename, rate, priority,
    depth and QoS.
    """

    topic: str | None = Field(
        default=None,
        description="Glob over the topic's name where the rule is applied: `*` stays within one name part, `**` crosses"
        " parts. Example: `/camera/**`.",
    )
    regex: str | None = Field(
        default=None, description="Regular expression that must match the whole name; an alternative to `topic`."
    )
    type: str | None = Field(
        default=None, description="Glob over the type's ROS 2 name, for example `sensor_msgs/msg/*`."
    )
    from_: SideName | None = Field(default=None, alias="from", description="Only topics that come from this side.")
    to: SideName | None = Field(
        default=None,
        description="Only on the way out to this side; without it the rule holds where the topic enters the hub.",
    )
    deny: bool = Field(default=False, description="The topic does not cross; wins over every other rule.")
    rename: str | None = Field(
        default=None,
        description="New name. With `regex`, groups as `\\1`; with a glob, each `*` or `**` of the new name stands for"
        " what the wildcard at that place matched.",
    )
    rate: float | None = Field(
        default=None, gt=0, le=10000, description="At most so many messages a second, the newest ones."
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
    def _type_is_spelled_as_in_ros2(cls, value: str | None) -> str | None:
        if value is not None and "**" not in value and value.count("/") == 1:
            msg = f"{value!r} matches no type: they are spelled as in ROS 2, {value.replace('/', '/msg/')}"
            raise ValueError(msg)
        return value

    @model_validator(mode="after")
    def _one_pattern(self) -> Rule:
        if self.topic is not None and self.regex is not None:
            msg = "give either 'topic' (a glob) or 'regex', not both"
            raise ValueError(msg)
        if self.rename is not None:
            trouble = rename_trouble(self.rename, self.topic, self.regex, ros1=self.to == "ros1")
            if trouble:
                msg = f"rename {self.rename!r} {trouble}"
                raise ValueError(msg)
        if self.deny and (self.rename or self.rate or self.priority or self.depth or self.timeout):
            msg = "a rule that denies has no rename, rate, priority, depth or timeout"
            raise ValueError(msg)
        return self


class RoutingSection(Section):
    """Which topics cross, and how."""

    default: Literal["allow", "deny"] = Field(
        default="allow",
        description="What becomes of a topic that no rule names. With `deny`, the rules are the allow list.",
    )
    private: bool = Field(
        default=True, description="Keep back what is private to a side (rosout, parameter events and the like)."
    )
    rules: tuple[Rule, ...] = Field(default=(), description="The rules; see below.")


class HubSection(Section):
    """The hub: one ROS 2 graph on zenoh in rmw_zenoh's format."""

    domain: int = Field(default=0, ge=0, le=232, description="ROS domain id of the hub, the first part of each key.")
    listen: ZenohEndpoint = Field(default="tcp/127.0.0.1:7447", description="Where the daemon's own router listens.")
    router: Enabled = Field(
        default="auto",
        description="Whether the daemon runs a router itself; `auto`: unless one answers at `listen` already.",
    )
    zenoh: dict[str, Any] | Path | None = Field(
        default=None,
        description="zenoh configuration, inline or the path of a JSON5 or YAML file, laid over the defaults of the"
        " workers' sessions: mode (peer, client), connect, listen, transport/link/tls, access_control.",
    )
    router_zenoh: dict[str, Any] | Path | None = Field(
        default=None, description="The same for the router that the daemon runs itself."
    )
    shared_memory: bool = Field(
        default=True, description="Shared memory between this machine's workers for large messages."
    )


class Ros1Section(Section):
    """The ROS 1 side."""

    enabled: Enabled = Field(default="auto", description="`auto`: where rospy is installed.")
    master: MasterUri | None = Field(
        default=None, description="ROS master URI; default $ROS_MASTER_URI or http://localhost:11311."
    )
    ip: str | None = Field(default=None, description="Address that this machine gives to ROS 1 peers (ROS_IP).")
    hostname: str | None = Field(
        default=None, description="Host name that this machine gives to ROS 1 peers (ROS_HOSTNAME)."
    )
    node: NodeName = Field(default="midspan", description="Node name on the ROS 1 graph.")
    poll: float = Field(default=0.5, ge=0.05, le=10, description="Seconds between looks at the master's graph.")
    packages: Path | None = Field(
        default=None, description="Folder with the ROS 1 Python packages; default the system's dist-packages."
    )


class Ros2Section(Section):
    """The ROS 2 (DDS) side."""

    enabled: Enabled = Field(default="auto", description="`auto`: where rclpy is installed.")
    domain: int | None = Field(
        default=None, ge=0, le=232, description="ROS_DOMAIN_ID; default the environment's, else 0."
    )
    node: NodeName = Field(default="midspan", description="Node name on the ROS 2 graph.")
    transport: Literal["auto", "shared_memory", "udp"] = Field(
        default="auto",
        description="Fast DDS transports. `auto`: shared memory beside UDP, UDP alone where /dev/shm is too small or"
        " other users' ROS 2 nodes are on this machine (shared memory delivers nothing between users).",
    )
    profile: Path | None = Field(
        default=None, description="A Fast DDS XML profile of your own, used instead of the generated one."
    )
    localhost_only: bool = Field(default=True, description="Discover ROS 2 nodes of this machine only.")


class TypesSection(Section):
    """Message types beyond those installed."""

    folders: tuple[Path, ...] = Field(
        default=(),
        description="Folders of .msg files, as `<folder>/<package>/msg/<Name>.msg` or `<package>/<Name>.msg`.",
    )
    mapping_rules: tuple[Path, ...] = Field(default=(), description="ros1_bridge mapping-rule files (YAML).")


class LimitsSection(Section):
    """What is refused for its size."""

    message: int = Field(
        default=256,
        ge=1,
        le=256,
        description="Megabytes (1,048,576 bytes) of the largest message, on every side and both ways. A larger one is"
        " refused and counted as `large`; everything else flows on.",
    )

    @property
    def message_bytes(self) -> int:
        """Bytes of the largest message."""
        return self.message << 20


class LogSection(Section):
    """Logging."""

    level: Literal["debug", "info", "warning", "error"] = Field(
        default="info", description="Least level that is written."
    )


class Config(Section):
    """Midspan's configuration."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,62}$")] = Field(
        default_factory=lambda: re.sub(r"[^A-Za-z0-9_.-]", "-", socket.gethostname())[:63] or "midspan",
        description="Name of this daemon; default the machine's.",
    )
    state: Path | None = Field(
        default=None,
        description="State folder; default $STATE_DIRECTORY, else $XDG_STATE_HOME/midspan, else"
        " ~/.local/state/midspan.",
    )
    hub: HubSection = Field(default_factory=HubSection, description="The hub.")
    ros1: Ros1Section = Field(default_factory=Ros1Section, description="The ROS 1 side.")
    ros2: Ros2Section = Field(default_factory=Ros2Section, description="The ROS 2 (DDS) side.")
    types: TypesSection = Field(default_factory=TypesSection, description="Message types beyond those installed.")
    routing: RoutingSection = Field(default_factory=RoutingSection, description="Which topics cross, and how.")
    limits: LimitsSection = Field(default_factory=LimitsSection, description="What is refused for its size.")
    log: LogSection = Field(default_factory=LogSection, description="Logging.")
