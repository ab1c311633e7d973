"""The section ``yarp``: the YARP network, and what its ports carry."""

from __future__ import annotations

import re
from typing import Literal

from pydantic import ConfigDict, Field, field_validator, model_validator

from bridge.config.sections.section import Enabled, Section
from bridge.config.sections.values import ROS2_NAME
from yarp_compat.wire.generation import Generation, Generations
from yarp_compat.wire.profile import Profile

ProfileName = Literal["yarp3", "yarp4"]

_PORT = re.compile(r"(?:/[^\s/\"'*()\[\]{}]+)+")
_SCHEME = re.compile(r"/[^\s\"'*()\[\]]*\{topic\}[^\s\"'*()\[\]{}]*")
_ADDRESS = re.compile(r"[A-Za-z0-9_.-]+:[0-9]{1,5}|\[[0-9a-fA-F:]+\]:[0-9]{1,5}")
_TYPE = re.compile(r"[A-Za-z]\w*/msg/[A-Za-z]\w*", re.ASCII)
_SERVICE_TYPE = re.compile(r"[A-Za-z]\w*/srv/[A-Za-z]\w*", re.ASCII)
_ENTRY = re.compile(r"(deg\()?[A-Za-z]\w*(\.[A-Za-z]\w*)*(\[\d{1,9}\])?(?(1)\))|'[^']*'", re.ASCII)


def _release(value: str) -> str:
    try:
        Generation.of(value)
    except ValueError as err:
        msg = f"{err}, in quotes"
        raise ValueError(msg) from None
    return value


class Topic(Section):
    """One rule: what the ports of some topics carry, or which port of a YARP program is a topic.

    Without `port` it is about the topics' own ports, and the first rule whose `topic` matches counts; where it gives a
    `type`, the input port is there even while nobody else has the topic. With `port` it is about that port alone,
    wherever it lives: the connection is made, and made again whenever the port returns.
    """

    topic: str = Field(description="The topic, for example `/scan`; without `port` a glob too: `/camera/**`.")
    port: str | None = Field(
        default=None, description="A port of a YARP program, for example `/laser:o`, that is to be connected."
    )
    type: str | None = Field(
        default=None, description="The message type, spelled as in ROS 2; a port that brings messages needs it."
    )
    direction: Literal["in", "out", "both"] = Field(
        default="both",
        description="`in`: from YARP, `out`: to YARP. With `port`, one of them: whether it writes or reads.",
    )
    as_: Literal["bottle", "natural", "fields"] | None = Field(
        default=None,
        alias="as",
        description="What the port carries. `bottle`: the nested lists of YARP's own converter of ROS messages;"
        " `natural`: the YARP type that says the same, where there is one; `fields`: the Bottle of `fields`."
        " Default `yarp.as`, with `fields` those.",
    )
    fields: tuple[int | float | str, ...] = Field(
        default=(),
        description="The values of a short Bottle: `linear.x`, `deg(angular.z)` for degrees there, `position[0]`, or a"
        " number or a text in single quotes that always stands there. Example: `[linear.x, linear.y, angular.z]`.",
    )
    carrier: str | None = Field(default=None, description="With `port`: how it is connected, for example `fast_tcp`.")
    profile: ProfileName | None = Field(
        default=None,
        description="Whose bytes the port speaks; by default it is asked, and if it does not answer `profile`.",
    )
    latched: bool = Field(default=False, description="Keep the last message from YARP for late joiners.")
    frame: str = Field(default="", description="Frame of messages whose YARP type has none.")
    child_frame: str = Field(default="", description="The robot's frame in odometry; default `base_link`.")
    joints: tuple[str, ...] = Field(default=(), description="Names of the joints of a vector of positions, in order.")

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @property
    def form(self) -> Literal["bottle", "natural", "fields"] | None:
        """What the port carries, None where this does not say it."""
        return "fields" if self.fields else self.as_

    @property
    def brings(self) -> bool:
        """Whether messages come from YARP by this rule alone."""
        return self.type is not None and self.direction != "out"

    @field_validator("port")
    @classmethod
    def _port_is_one(cls, value: str | None) -> str | None:
        if value is not None and not _PORT.fullmatch(value):
            msg = f"{value!r} is no port name, as /laser:o"
            raise ValueError(msg)
        return value

    @field_validator("type")
    @classmethod
    def _type_is_spelled_as_in_ros2(cls, value: str | None) -> str | None:
        if value is not None and not _TYPE.fullmatch(value):
            msg = f"{value!r} is no message type as ROS 2 spells them, for example std_msgs/msg/String"
            raise ValueError(msg)
        return value

    @field_validator("fields")
    @classmethod
    def _fields_are_fields(cls, value: tuple[int | float | str, ...]) -> tuple[int | float | str, ...]:
        for entry in value:
            if isinstance(entry, str) and not _ENTRY.fullmatch(entry):
                msg = f"{entry!r} is no field: write linear.x, deg(angular.z), position[0], a number, or 'a text'"
                raise ValueError(msg)
        return value

    @model_validator(mode="after")
    def _fits_together(self) -> Topic:
        plain = ROS2_NAME.fullmatch(self.topic) is not None
        if not self.topic.startswith(("/", "**")):
            msg = f"{self.topic!r} is no topic: names begin with a slash"
        elif self.port is not None and not plain:
            msg = f"{self.topic!r} is no topic name, and a port is one topic"
        elif self.port is not None and self.direction == "both":
            msg = f"say whether {self.port} brings messages (direction: in) or takes them (direction: out)"
        elif self.port is not None and self.direction == "in" and self.type is None:
            msg = f"a port does not tell its type: give the 'type' of what {self.port} brings"
        elif self.port is None and self.type is not None and not plain:
            msg = f"{self.topic!r} is no topic name; with a 'type' it is about one topic"
        elif self.port is None and self.carrier is not None:
            msg = "'carrier' is for a connection to a 'port'"
        elif self.as_ == "fields" and not self.fields:
            msg = "as: fields needs 'fields'"
        elif self.fields and self.as_ not in (None, "fields"):
            msg = f"has 'fields', and is not as: {self.as_}"
        else:
            return self
        raise ValueError(msg)


class Peer(Section):
    """One rule: which release of YARP the ports of some name are of."""

    port: str = Field(description="Port names: `/cer/*`, where `*` stands for anything, slashes too.")
    release: str = Field(description="Such as `3.9`; see `release` of the section.")

    @field_validator("release")
    @classmethod
    def _release_is_one(cls, value: str) -> str:
        return _release(value)


class Service(Section):
    """One rule: what the RPC port of some services carries, or which RPC port of a YARP program is a service.

    Without `port` it is about the services' own RPC ports, and the first rule whose `service` matches counts. With
    `port` that port, wherever it lives, serves the service of the type `type`.
    """

    service: str = Field(description="The service, for example `/static_map`; without `port` a glob too.")
    port: str | None = Field(default=None, description="An RPC port of a YARP program, for example `/lamp/rpc:i`.")
    type: str | None = Field(
        default=None, description="The service's type, spelled as in ROS 2: `std_srvs/srv/SetBool`; with `port`."
    )
    request: tuple[int | float | str, ...] = Field(
        default=(),
        description="The values of the request's Bottle, as `fields` of topics: `['set', data]`; default all fields as"
        " nested lists.",
    )
    reply: tuple[int | float | str, ...] = Field(default=(), description="The values of the reply's Bottle.")
    carrier: str | None = Field(default=None, description="With `port`: how it is connected, for example `fast_tcp`.")

    model_config = ConfigDict(extra="forbid", frozen=True)

    @field_validator("port")
    @classmethod
    def _port_is_one(cls, value: str | None) -> str | None:
        return Topic._port_is_one(value)

    @field_validator("type")
    @classmethod
    def _type_is_spelled_as_in_ros2(cls, value: str | None) -> str | None:
        if value is not None and not _SERVICE_TYPE.fullmatch(value):
            msg = f"{value!r} is no service type as ROS 2 spells them, for example std_srvs/srv/SetBool"
            raise ValueError(msg)
        return value

    @field_validator("request", "reply")
    @classmethod
    def _fields_are_fields(cls, value: tuple[int | float | str, ...]) -> tuple[int | float | str, ...]:
        return Topic._fields_are_fields(value)

    @model_validator(mode="after")
    def _fits_together(self) -> Service:
        if not self.service.startswith(("/", "**")):
            msg = f"{self.service!r} is no service: names begin with a slash"
        elif self.port is not None and ROS2_NAME.fullmatch(self.service) is None:
            msg = f"{self.service!r} is no service's name, and a port is one service"
        elif self.port is not None and self.type is None:
            msg = f"a port does not tell its type: give the 'type' of the service that {self.port} serves"
        elif self.port is None and (self.type or self.carrier):
            msg = "'type' and 'carrier' are for a 'port'"
        else:
            return self
        raise ValueError(msg)


class YarpSection(Section):
    """The YARP network: its name server, and what the ports of topics are called and carry."""

    enabled: Enabled = Field(
        default="auto",
        description="`auto`: where a yarp.conf says which name server there is, or this section says something.",
    )
    nameserver: Literal["auto", "embedded", "site"] = Field(
        default="auto",
        description="`site`: the one that yarp.conf or `address` names; `embedded`: our own, in the worker; `auto`:"
        " ours where the place is on this machine, or not said, and none answers there.",
    )
    address: str | None = Field(
        default=None, description="Where the name server is, for example `robot:10000`; default what yarp.conf says."
    )
    namespace: str | None = Field(
        default=None, description="The name server's port name; default $YARP_NAMESPACE or `/root`."
    )
    ip: str | None = Field(default=None, description="Address that our ports listen on and tell; default YARP_IP's.")
    profile: ProfileName = Field(
        default="yarp3",
        description="Whose bytes are written to ports that do not answer which YARP they are, and read where they do"
        " not tell: `yarp3` for YARP 3, `yarp4` for 4.",
    )
    release: str | None = Field(
        default=None,
        description="Release of the programs of this network, such as `3.9`: decides how their calls are answered,"
        " which changed with 3.11, 3.12 and 4.0. A client of 4.0 tells it itself. Default `3.12`, with `yarp4` `4.0`.",
    )
    peers: tuple[Peer, ...] = Field(default=(), description="The release of some ports; the first that fits counts.")
    as_: Literal["bottle", "natural"] = Field(
        default="bottle", alias="as", description="What ports carry where no rule of `topics` says it."
    )
    output: str = Field(
        default="/midspan{topic}:o", description="Name of the port that writes a topic's messages to YARP programs."
    )
    input: str = Field(
        default="/midspan{topic}:i", description="Name of the port by which YARP programs write to a topic."
    )
    rpc: str = Field(
        default="/midspan{topic}/rpc", description="Name of the RPC port that serves a service to YARP programs."
    )
    poll: float = Field(default=0.5, ge=0.05, le=10, description="Seconds between looks at the name server.")
    topics: tuple[Topic, ...] = Field(default=(), description="What ports carry, and which ports are topics.")
    services: tuple[Service, ...] = Field(
        default=(), description="What RPC ports carry, and which RPC ports are services."
    )

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @property
    def place(self) -> tuple[str, int] | None:
        """Host and port of the name server, None where yarp.conf is to say it."""
        if self.address is None:
            return None
        host, _, port = self.address.rpartition(":")
        return host.strip("[]"), int(port)

    def generations(self) -> Generations:
        """What decides how the calls of a port's peers are answered; it remembers what these tell of themselves."""
        usual = Generation.newest(Profile(self.profile)) if self.release is None else Generation.of(self.release)
        older = Generation.YARP_3_12 if usual is Generation.YARP_4 else usual
        return Generations(usual, [(peer.port, Generation.of(peer.release)) for peer in self.peers], older)

    @property
    def configured(self) -> bool:
        """Whether anything is said here."""
        return self.model_copy(update={"enabled": "auto"}) != YarpSection()

    @field_validator("address")
    @classmethod
    def _address_has_a_port(cls, value: str | None) -> str | None:
        if value is not None and not _ADDRESS.fullmatch(value):
            msg = f"{value!r} is no address with a port, for example 127.0.0.1:10000"
            raise ValueError(msg)
        return value

    @field_validator("release")
    @classmethod
    def _release_is_one(cls, value: str | None) -> str | None:
        return value if value is None else _release(value)

    @field_validator("namespace")
    @classmethod
    def _namespace_is_a_port(cls, value: str | None) -> str | None:
        if value is not None and not _PORT.fullmatch(value):
            msg = f"{value!r} is no port name, as /root"
            raise ValueError(msg)
        return value

    @field_validator("output", "input", "rpc")
    @classmethod
    def _name_has_the_topic(cls, value: str) -> str:
        if not _SCHEME.fullmatch(value):
            msg = f"{value!r} is no scheme of port names: a slash first, and {{topic}} in it, as in /robot{{topic}}:o"
            raise ValueError(msg)
        return value

    @model_validator(mode="after")
    def _fits_together(self) -> YarpSection:
        ports = [(topic.port, topic.topic) for topic in self.topics if topic.port is not None]
        ports += [(service.port, service.service) for service in self.services if service.port is not None]
        if len({self.output, self.input, self.rpc}) < 3:
            msg = "output, input and rpc are not three names"
        elif len(set(ports)) < len(ports):
            msg = f"names the port {max(ports, key=ports.count)[0]} twice for one topic"
        else:
            return self
        raise ValueError(msg)
