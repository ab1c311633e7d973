"""The model of Midspan's one YAML file. Every key is optional; the defaults run on one machine as they are."""

from __future__ import annotations

import ipaddress
import re
import socket
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator, model_validator

SideName = Literal["ros1", "ros2", "yarp", "zenoh", "zenoh_ros2dds", "zenoh_ros1", "zenoh_json"]
Enabled = Literal["auto", True, False]


_WILDCARD = re.compile(r"\*\*|\*|\?")
_GROUP = re.compile(r"\\(?:([0-9]+)|g<(\w+)>)")
_ROS1_NAME = re.compile(r"(?:/[A-Za-z0-9_]+)+")
_PLAIN_KEY = re.compile(r"[^\s/*$?#@]+(?:/[^\s/*$?#@]+)*")
_HUB_KEY = re.compile(r"[0-9]+/.+/.+::dds_::.+/RIHS[0-9]{2}_.+")
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


def is_loopback(endpoint: str) -> bool:
    """Whether only programs of this machine reach what listens at a zenoh endpoint."""
    protocol, _, rest = endpoint.partition("/")
    if protocol.startswith(("unixsock", "unixpipe")):
        return True
    host = re.split(r"[?#]", rest)[0].rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _same_port(one: str, other: str) -> bool:
    """Whether two endpoints have one port of TCP (0 is any free one)."""
    ports = [re.split(r"[?#]", place)[0].rpartition(":")[2] for place in (one, other)]
    return ports[0] == ports[1] != "0" and not one.startswith("quic/")


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
            trouble = rename_trouble(self.rename, self.topic, self.regex, ros1=self.to in ("ros1", "zenoh_ros1"))
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


class OpenSection(Section):
    """The hub's door to other machines; closed until it is told where to listen or connect (see docs/security.md)."""

    listen: tuple[ZenohEndpoint, ...] = Field(
        default=(), description="Where other machines may connect, for example `tls/0.0.0.0:7448`."
    )
    connect: tuple[ZenohEndpoint, ...] = Field(
        default=(),
        description="Machines to connect to, for example `tls/robot1:7448`: by a name or address that is in their"
        " certificate.",
    )
    trusted: tuple[Annotated[str, Field(min_length=1, max_length=64)], ...] = Field(
        default=(),
        description="Machines, by the name in their certificate, from which commands, goals, cancels and service calls"
        " are accepted; `*`: every machine that may join.",
    )
    keys: Path | None = Field(
        default=None,
        description="Folder with `ca.pem`, `<name>.pem` and `<name>.key`, as `midspan keys` makes them, where `<name>`"
        " is the daemon's; default /etc/midspan/keys.",
    )
    certificate: Path | None = Field(
        default=None, description="This machine's certificate (PEM), where it is not in `keys`."
    )
    key: Path | None = Field(default=None, description="Its private key (PEM), where it is not in `keys`.")
    ca: Path | None = Field(
        default=None,
        description="Certificate of the authority that signed every machine's (PEM), where it is not in `keys`.",
    )
    insecure: bool = Field(
        default=False,
        description="Allow endpoints without TLS: whoever reaches them may join, and nobody has a name to be trusted"
        " by.",
    )
    zenoh: dict[str, Any] | Path | None = Field(
        default=None, description="zenoh configuration laid over the door's, like `hub.router_zenoh`."
    )

    @property
    def opened(self) -> bool:
        """Whether the hub is open to other machines."""
        return bool(self.listen or self.connect)

    @model_validator(mode="after")
    def _safe(self) -> OpenSection:
        plain = [place for place in (*self.listen, *self.connect) if not place.startswith(("tls/", "quic/"))]
        named = [name for name in self.trusted if name != "*"]
        if plain and not self.insecure:
            msg = (
                f"{plain[0]} has no TLS: anybody on that network could join; write tls/{plain[0].partition('/')[2]} and"
                " make certificates with 'midspan keys', or say 'insecure: true'"
            )
        elif plain and named:
            msg = f"without TLS nobody shows a certificate, and {named[0]!r} cannot be told from others; use TLS"
        elif (self.trusted or self.insecure) and not self.opened:
            msg = "names no endpoint: give 'listen' or 'connect'"
        else:
            return self
        raise ValueError(msg)


class HubSection(Section):
    """The hub: one ROS 2 graph on zenoh in rmw_zenoh's format."""

    domain: int = Field(default=0, ge=0, le=232, description="ROS domain id of the hub, the first part of each key.")
    listen: ZenohEndpoint = Field(
        default="tcp/127.0.0.1:7447",
        description="Where the daemon's own router listens, for this machine alone; `open` lets others in.",
    )
    router: Enabled = Field(
        default="auto",
        description="Whether the daemon runs a router itself; `auto`: unless one answers at `listen` already.",
    )
    open: OpenSection = Field(
        default_factory=OpenSection,
        description="The door to other machines, closed until `listen` or `connect` is given; see"
        " [security](security.md).",
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

    @property
    def indoors(self) -> HubSection:
        """The section as it is with the door closed: what this machine's own programs depend on."""
        return self.model_copy(update={"open": OpenSection()})

    @field_validator("listen")
    @classmethod
    def _listens_on_this_machine(cls, value: str) -> str:
        if not is_loopback(value):
            msg = f"{value!r} is open to other machines; listen on 127.0.0.1, and let others in by hub.open"
            raise ValueError(msg)
        return value

    @model_validator(mode="after")
    def _open_fits(self) -> HubSection:
        taken = [place for place in self.open.listen if _same_port(place, self.listen)]
        if self.open.opened and self.router is False:
            msg = "hub.open needs the daemon's router, and hub.router is false"
        elif self.open.opened and self.listen.startswith(("tls/", "quic/")):
            msg = "with hub.open this machine's own programs join without TLS; write hub.listen: tcp/127.0.0.1:7447"
        elif taken:
            msg = f"{taken[0]} has the port of hub.listen ({self.listen}), which is taken; choose another, such as 7448"
        else:
            return self
        raise ValueError(msg)


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


class DialectKey(Section):
    """A key of a dialect whose publishers announce nothing."""

    key: str | None = Field(default=None, description="`json` alone: the zenoh key, for example `robot/pose`.")
    topic: str | None = Field(
        default=None, description="The topic, for example `/pose`; with `json` by default the key behind a slash."
    )
    type: str = Field(description="The message type, spelled as in ROS 2: `geometry_msgs/msg/Pose`.")
    direction: Literal["in", "out", "both"] = Field(
        default="both",
        description="`json` alone: whether the programs on the key publish (`in`), listen (`out`), or do both.",
    )
    latched: bool = Field(
        default=False, description="`json` alone: keep the last message that comes from the key for late joiners."
    )

    @property
    def hub_topic(self) -> str:
        """The topic's name."""
        return self.topic if self.topic is not None else f"/{self.key}"

    @field_validator("key")
    @classmethod
    def _key_is_plain(cls, value: str | None) -> str | None:
        if value is not None and not _PLAIN_KEY.fullmatch(value):
            msg = f"{value!r} is no plain zenoh key: parts between slashes, without blanks and any of * $ ? # @"
            raise ValueError(msg)
        if value is not None and _HUB_KEY.fullmatch(value):
            msg = f"{value!r} is a key of the hub itself: its programs speak ROS 2, not JSON"
            raise ValueError(msg)
        return value

    @field_validator("type")
    @classmethod
    def _type_is_spelled_as_in_ros2(cls, value: str) -> str:
        if not re.fullmatch(r"[A-Za-z]\w*/msg/[A-Za-z]\w*", value, re.ASCII):
            msg = f"{value!r} is no message type as ROS 2 spells them, for example std_msgs/msg/String"
            raise ValueError(msg)
        return value

    @model_validator(mode="after")
    def _topic_is_legal(self) -> DialectKey:
        if (self.topic is not None or self.key is not None) and not _ROS2_NAME.fullmatch(self.hub_topic):
            msg = f"{self.hub_topic!r} is no topic name; give a 'topic' of letters, digits and underscores, as /pose"
            raise ValueError(msg)
        return self


_USUALLY_LATCHED = ("/tf_static", "/map", "/map_metadata", "/robot_description")


class Dialect(Section):
    """One key dialect that is spoken on the zenoh network."""

    dialect: Literal["ros2dds", "ros1", "json"] = Field(
        description="`ros2dds`: as zenoh-bridge-ros2dds; `ros1`: as zenoh-bridge-ros1; `json`: JSON on plain keys."
    )
    namespace: str | None = Field(
        default=None,
        description="Not with `json`: the namespace of the bridges, as their own configurations have it. ros2dds:"
        " default `/`; ros1 (`bridge_namespace`): default `*`.",
    )
    keys: tuple[DialectKey, ...] = Field(
        default=(),
        description="`json`: all keys. Else topics that programs publish which announce nothing, as free_fleet's do.",
    )
    latched: tuple[str, ...] = Field(
        default=_USUALLY_LATCHED,
        description="`ros1` alone: globs of topics whose last message is kept, since that dialect does not tell what is"
        " latched.",
    )

    @model_validator(mode="after")
    def _fits_together(self) -> Dialect:
        json = self.dialect == "json"
        for_json = any(key.key is not None or key.direction != "both" or key.latched for key in self.keys)
        topics = [key.hub_topic for key in self.keys]
        if json and self.namespace is not None:
            msg = "JSON keys have no namespace; write it into each key"
        elif json and not self.keys:
            msg = "names no keys: JSON is spoken on the keys that are listed here"
        elif json and any(key.key is None for key in self.keys):
            msg = "an entry of keys has no 'key'"
        elif not json and any(key.topic is None for key in self.keys):
            msg = "an entry of keys has no 'topic'"
        elif not json and for_json:
            msg = "'key', 'direction' and 'latched' of an entry of keys are for json alone"
        elif len(set(topics)) < len(topics):
            msg = f"names the topic {max(topics, key=topics.count)} twice"
        elif json and len({key.key for key in self.keys}) < len(self.keys):
            msg = "names a key twice"
        elif self.dialect != "ros1" and self.latched != _USUALLY_LATCHED:
            msg = "'latched' here is for ros1 alone"
        elif self.dialect == "ros2dds" and not re.fullmatch(r"/|(/[A-Za-z_]\w*)+", self.namespace or "/", re.ASCII):
            msg = f"namespace {self.namespace!r} is none of ROS 2, as /robot1"
        elif self.dialect == "ros1" and not re.fullmatch(r"\*|[A-Za-z0-9_.-]+", self.namespace or "*", re.ASCII):
            msg = f"namespace {self.namespace!r} is no single part of a key, as robot1 or *"
        else:
            return self
        raise ValueError(msg)


class ZenohSection(Section):
    """The other key dialects in use on zenoh networks; each is a side of its own for the rules.

    The sides are called ``zenoh_ros2dds``, ``zenoh_ros1`` and ``zenoh_json``; ``zenoh`` stands for the hub itself.
    """

    enabled: Enabled = Field(default="auto", description="`auto`: where a dialect is configured.")
    router: ZenohEndpoint | None = Field(
        default=None,
        description="Router of another zenoh network, for example `tcp/robot1:7447`; default the hub's own network.",
    )
    zenoh: dict[str, Any] | Path | None = Field(
        default=None,
        description="zenoh configuration of the sessions there, inline or the path of a JSON5 or YAML file; without it"
        " and without `router` they join as the hub's sessions do.",
    )
    dialects: tuple[Dialect, ...] = Field(default=(), description="What is spoken there; see below.")

    @model_validator(mode="after")
    def _once_each(self) -> ZenohSection:
        if self.enabled is True and not self.dialects:
            msg = "enabled is true, but no dialect is configured"
            raise ValueError(msg)
        networks = [(d.dialect, d.namespace, tuple(k.key for k in d.keys if k.key)) for d in self.dialects]
        if len(set(networks)) < len(networks):
            msg = "a dialect is given twice"
            raise ValueError(msg)
        return self


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
    zenoh: ZenohSection = Field(
        default_factory=ZenohSection, description="The other key dialects in use on zenoh networks."
    )
    types: TypesSection = Field(default_factory=TypesSection, description="Message types beyond those installed.")
    routing: RoutingSection = Field(default_factory=RoutingSection, description="Which topics cross, and how.")
    limits: LimitsSection = Field(default_factory=LimitsSection, description="What is refused for its size.")
    log: LogSection = Field(default_factory=LogSection, description="Logging.")
