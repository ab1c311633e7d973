"""The section ``yarp``: the YARP network, and what its ports carry."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, ConfigDict, Field, field_validator, model_validator
from typing_extensions import override

from bridge.config.sections.section import (
    ROS2_NAME,
    Address,
    Enabled,
    PortName,
    Section,
    SideSection,
    matching,
    setting,
)
from yarp_compat.wire.generation import Findings, Generation, Generations
from yarp_compat.wire.profile import Profile

ProfileName = Literal["yarp3", "yarp4"]

_NUMBERS = re.compile(r"([0-9]{1,5})-([0-9]{1,5})")
_ENTRY = re.compile(r"(deg\()?[A-Za-z]\w*(\.[A-Za-z]\w*)*(\[\d{1,9}\])?(?(1)\))|'[^']*'", re.ASCII)

_Address = Annotated[
    str,
    matching(
        r"[A-Za-z0-9_.-]+:[0-9]{1,5}|\[[0-9a-fA-F:]+\]:[0-9]{1,5}",
        "is not an address with a port, for example 127.0.0.1:10000",
    ),
]
_Scheme = Annotated[
    str,
    matching(
        r"/[^\s,\"'*()\[\]{}]*\{topic\}[^\s,\"'*()\[\]{}]*",
        "is not a scheme of port names: begin it with a slash and put {topic} in it, as in /robot{topic}:o",
    ),
]
_MESSAGE = re.compile(r"[A-Za-z]\w*/msg/[A-Za-z]\w*", re.ASCII)
_SERVICE = re.compile(r"[A-Za-z]\w*/srv/[A-Za-z]\w*", re.ASCII)
_MessageType = Annotated[str, matching(_MESSAGE, "is not a message type of ROS 2, such as std_msgs/msg/String")]
_ServiceType = Annotated[str, matching(_SERVICE, "is not a service type of ROS 2, such as std_srvs/srv/SetBool")]
_Field = Annotated[
    int | float | str,
    matching(_ENTRY, "is not a field: write linear.x, deg(angular.z), position[0], a number, or 'a text'"),
]

_OPENS = ("address", "namespace", "ports", "ip", "profile")  # keys on which ports of modules and the simulator depend
_SAY_THE_RELEASE = (
    "set its release, which 'yarp version' prints there: yarp.peers: [{{port: {peer}, release: '3.9'}}] for this port,"
    " or yarp.release: '3.9' for all"
)


def _release(value: str) -> str:
    try:
        Generation.of(value)
    except ValueError as err:
        raise ValueError(f"{err}, in quotes") from None
    return value


_Release = Annotated[str, AfterValidator(_release)]


class TopicPort(Section):
    """A rule for the content of some topics' ports, or a YARP program's port as a topic.

    Without `port`, the rule applies to the topics' own ports, and the first rule whose `topic` matches is used; with a
    `type`, the input port exists even without other publishers and subscribers of the topic. With `port`, the rule
    applies only to that port, on any machine: Midspan connects to it, and connects again whenever the port returns.
    """

    topic: str = Field(description="The topic, for example `/scan`; without `port` also a glob: `/camera/**`.")
    port: PortName | None = setting(None, "A port of a YARP program to connect, for example `/laser:o`.")
    type: _MessageType | None = setting(None, "The message type as in ROS 2; a port that sends messages needs it.")
    direction: Literal["in", "out", "both"] = setting(
        "both",
        "`in`: from YARP, `out`: to YARP. With `port`: `in` if the port sends messages, `out` if it receives them.",
    )
    as_: Literal["bottle", "natural", "fields"] | None = Field(
        default=None,
        alias="as",
        description="What the port carries. `bottle`: the nested lists of YARP's own converter of ROS messages;"
        " `natural`: the corresponding YARP type, if it exists; `fields`: the Bottle of `fields`."
        " Default: `yarp.as`, or `fields` if that list is given.",
    )
    fields: tuple[_Field, ...] = setting(
        (),
        "The values of a short Bottle: fields of the message (`linear.x`, `position[0]`, or `deg(angular.z)` for"
        " degrees in the Bottle), and constants (numbers, or texts in single quotes). Example:"
        " `[linear.x, linear.y, angular.z]`.",
    )
    carrier: str | None = setting(None, "With `port`: the carrier of the connection, for example `fast_tcp`.")
    profile: ProfileName | None = setting(
        None,
        "The YARP release whose wire format the port uses; not set: Midspan asks the port, else uses `yarp.profile`.",
    )
    latched: bool = setting(False, "Keep the last message from YARP for late joiners.")
    frame: str = setting("", "Frame of messages whose YARP type has none.")
    child_frame: str = setting("", "The robot's frame in odometry; default `base_link`.")
    joints: tuple[str, ...] = setting((), "Names of the joints of a vector of positions, in order.")

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @property
    def form(self) -> Literal["bottle", "natural", "fields"] | None:
        """The content of the port; None if the rule does not define it."""
        return "fields" if self.fields else self.as_

    @property
    def brings(self) -> bool:
        """Whether this rule is enough to receive messages from YARP."""
        return self.type is not None and self.direction != "out"

    @model_validator(mode="after")
    def _fits_together(self) -> TopicPort:
        plain = ROS2_NAME.fullmatch(self.topic) is not None
        if not self.topic.startswith(("/", "**")):
            msg = f"{self.topic!r} is not a topic: names begin with a slash"
        elif self.port is not None and not plain:
            msg = f"{self.topic!r} is not a topic name; a port is one topic, so that globs are not allowed"
        elif self.port is not None and self.direction == "both":
            msg = f"set 'direction: in' if {self.port} sends messages, 'direction: out' if it receives them"
        elif self.port is not None and self.direction == "in" and self.type is None:
            msg = f"a port does not announce its type: give the 'type' of the messages that {self.port} sends"
        elif self.port is None and self.type is not None and not plain:
            msg = f"{self.topic!r} is not a topic name; a rule with a 'type' is for one topic"
        elif self.port is None and self.carrier is not None:
            msg = "'carrier' is for a connection to a 'port'"
        elif self.as_ == "fields" and not self.fields:
            msg = "as: fields needs 'fields'"
        elif self.fields and self.as_ not in (None, "fields"):
            msg = f"has 'fields', which exclude as: {self.as_}"
        else:
            return self
        raise ValueError(msg)


class Peer(Section):
    """A rule for the YARP release of the ports whose names match."""

    port: str = Field(description="Names of ports, such as `/cer/*`; `*` matches anything, including slashes.")
    release: _Release = Field(description="The YARP release, such as `3.9`; see the section's `release`.")


class ServicePort(Section):
    """A rule for the content of some services' RPC ports, or a YARP program's RPC port as a service.

    Without `port`, the rule applies to the services' own RPC ports, and the first rule whose `service` matches is used.
    With `port`, that port, on any machine, serves the service of the type `type`.
    """

    service: str = Field(description="The service, for example `/static_map`; without `port` also a glob.")
    port: PortName | None = setting(None, "An RPC port of a YARP program, for example `/lamp/rpc:i`.")
    type: _ServiceType | None = setting(None, "With `port`: the service's type as in ROS 2: `std_srvs/srv/SetBool`.")
    request: tuple[_Field, ...] = setting(
        (), "The values of the request's Bottle, like `fields` of topics: `['set', data]`; default: nested lists."
    )
    reply: tuple[_Field, ...] = setting((), "The values of the reply's Bottle.")
    carrier: str | None = setting(None, "With `port`: the carrier of the connection, for example `fast_tcp`.")

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="after")
    def _fits_together(self) -> ServicePort:
        if not self.service.startswith(("/", "**")):
            msg = f"{self.service!r} is not a service: names begin with a slash"
        elif self.port is not None and ROS2_NAME.fullmatch(self.service) is None:
            msg = f"{self.service!r} is not a service name; a port is one service, so that globs are not allowed"
        elif self.port is not None and self.type is None:
            msg = f"a port does not announce its type: give the 'type' of the service that {self.port} serves"
        elif self.port is None and (self.type or self.carrier):
            msg = "'type' and 'carrier' are for a 'port'"
        else:
            return self
        raise ValueError(msg)


class YarpSection(SideSection):
    """The YARP network: its name server, and the names and content of the topics' ports."""

    enabled: Enabled = setting("auto", "`auto`: enabled if a yarp.conf names a name server, or this section has a key.")
    nameserver: Literal["auto", "embedded", "site"] = setting(
        "auto",
        "`site`: the one that yarp.conf or `address` names; `embedded`: Midspan's own, in the worker; `auto`: Midspan's"
        " own if the address is on this machine, or not set, and no name server answers there.",
    )
    address: _Address | None = setting(None, "Address of the name server, such as `robot:10000`; default: yarp.conf's.")
    namespace: PortName | None = setting(None, "The name server's port name; default $YARP_NAMESPACE or `/root`.")
    ports: str | None = setting(
        None,
        "Range of TCP ports for Midspan's YARP ports; default `20000-29999` if the name server is at 10000; `server`:"
        " the name server chooses, as for YARP's own programs.",
    )
    ip: Address | None = setting(None, "Address that Midspan's ports listen on and announce; default: that of YARP_IP.")
    profile: ProfileName = setting(
        "yarp3", "Wire format for ports that do not announce their release: `yarp3` for YARP 3, `yarp4` for YARP 4."
    )
    release: _Release | None = setting(
        None,
        "Release of this network's programs, such as `3.9`. It decides the format of replies to their calls, which"
        " changed with 3.11, 3.12 and 4.0. By default Midspan determines each client's release"
        " (docs/sides/yarp.md); unknown clients of YARP 3 get the replies of 3.12, except for failures that another"
        " release would read as a success.",
    )
    peers: tuple[Peer, ...] = setting((), "The release of some ports; the first match is used.")
    as_: Literal["bottle", "natural"] = Field(
        default="bottle", alias="as", description="Content of ports without a matching rule in `topics`."
    )
    output: _Scheme = setting("/midspan{topic}:o", "Name of the port that sends a topic's messages to YARP programs.")
    input: _Scheme = setting("/midspan{topic}:i", "Name of the port that receives a topic's messages from YARP.")
    rpc: _Scheme = setting("/midspan{topic}/rpc", "Name of the RPC port that serves a service to YARP programs.")
    poll: float = setting(0.5, "Seconds between polls of the name server.", ge=0.05, le=10)
    topics: tuple[TopicPort, ...] = setting((), "Rules for what ports carry, and for which ports are topics.")
    services: tuple[ServicePort, ...] = setting(
        (), "Rules for what RPC ports carry, and for which RPC ports are services."
    )

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @property
    def place(self) -> tuple[str, int] | None:
        """Host and port of the name server; None to read yarp.conf."""
        if self.address is None:
            return None
        host, _, port = self.address.rpartition(":")
        return host.strip("[]"), int(port)

    @property
    def numbers(self) -> range | None:
        """The range that `ports` gives, empty for `server`; None for the default."""
        if self.ports is None:
            return None
        first, _, last = self.ports.partition("-")
        return range(0) if self.ports == "server" else range(int(first), int(last) + 1)

    def generations(self, findings: Findings | None = None) -> Generations:
        """Return the object that chooses the reply format for each client, with the ``findings`` about clients."""
        return Generations(
            None if self.release is None else Generation.of(self.release),
            [(peer.port, Generation.of(peer.release)) for peer in self.peers],
            guess=Generation.newest(Profile(self.profile)),
            cure=_SAY_THE_RELEASE,
            findings=findings,
        )

    @override
    def joins_as(self, other: Section) -> bool:
        """Whether both sections join the same network: they differ at most in the releases of its programs."""
        return isinstance(other, YarpSection) and self == other.model_copy(
            update={"release": self.release, "peers": self.peers}
        )

    def opens_as(self, other: YarpSection) -> bool:
        """Whether ports that modules and the simulator opened with another section can stay open."""
        return all(getattr(self, key) == getattr(other, key) for key in _OPENS)

    @property
    def configured(self) -> bool:
        """Whether a key other than `enabled` differs from its default."""
        return self.model_copy(update={"enabled": "auto"}) != YarpSection()

    @field_validator("ports")
    @classmethod
    def _ports_are_a_range(cls, value: str | None) -> str | None:
        if value is None or value == "server":
            return value
        match = _NUMBERS.fullmatch(value)
        if match is None or not 1024 <= int(match[1]) <= int(match[2]) <= 0xFFFF:
            msg = f"{value!r} is neither 'server' nor a range of port numbers from 1024 to 65535, such as 20000-29999"
            raise ValueError(msg)
        return value

    @model_validator(mode="after")
    def _fits_together(self) -> YarpSection:
        ports = [(topic.port, topic.topic) for topic in self.topics if topic.port is not None]
        ports += [(service.port, service.service) for service in self.services if service.port is not None]
        if len({self.output, self.input, self.rpc}) < 3:
            msg = "output, input and rpc must be three different names"
        elif len(set(ports)) < len(ports):
            msg = f"names the port {max(ports, key=ports.count)[0]} twice for one topic"
        else:
            return self
        raise ValueError(msg)
