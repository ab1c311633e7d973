"""The base of all sections of the configuration, and the types of values that several sections use."""

from __future__ import annotations

import difflib
import ipaddress
import re
import types
import typing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple
from urllib.parse import urlsplit

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PrivateAttr, model_validator

from bridge.registration import imported
from bridge.sides import all_networks

if TYPE_CHECKING:
    SideName = str
else:
    SideName = Literal[tuple(all_networks())]

Enabled = Literal["auto", True, False]
Mistake = tuple[tuple[str | int, ...], str]
"""The path of a key within a section, and what is wrong with its value."""


class DrivenTopic(NamedTuple):
    """A topic of the hub whose messages move the robot: the key of its section, its name and its type (ROS 2)."""

    section: str
    topic: str
    type: str


class Section(BaseModel):
    """Base of all sections: frozen, and an unknown key is an error.

    Sections differ also if the files that they name had different contents when they were loaded; see `named_files`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    _digest: str = PrivateAttr("")  # part of the comparison, as all private attributes are

    @model_validator(mode="before")
    @classmethod
    def _one_or_many(cls, data: Any) -> Any:
        """Also accept a single text for a list of texts, and a list with one address for a ``listen``."""
        if not isinstance(data, dict):
            return data
        for name, info in cls.model_fields.items():
            key = info.alias or name
            value = data.get(key)
            if isinstance(value, str) and is_list_of_texts(info.annotation):
                data = {**data, key: [value]}
            elif name == "listen" and isinstance(value, list) and not is_list_of_texts(info.annotation):
                if len(value) != 1:
                    raise ValueError(f"'listen' takes one address here, not {len(value)}")
                data = {**data, key: value[0]}
        return data

    @property
    def driven(self) -> tuple[tuple[str, str], ...]:
        """Topics of the hub whose messages move the robot, with their types (ROS 2 names)."""
        return ()

    def mistakes(self, config: Any) -> Iterable[Mistake]:  # noqa: ARG002 - most sections are checked alone
        """Return the keys that do not fit the contents of files, the section's other keys, or the rest of ``config``.

        This is not asked of a disabled section, in which only each key and value by itself must be valid.
        """
        return ()

    def named_files(self) -> Iterable[Path]:
        """Return the files whose contents belong to the section, so that a reload applies changes of them.

        These are by default the files that its keys name; a section adds those to which its files refer.
        """
        return _files(tuple(value for _, value in self if not isinstance(value, Section)))

    @property
    def digest(self) -> str:
        """A digest of the contents of `named_files` at load; "" without such files."""
        return self._digest

    def set_digest(self, digest: str) -> None:
        """Set the digest of a section that is being loaded or received."""
        self._digest = digest


def _files(value: Any) -> Iterator[Path]:
    """Yield the files that a value of a section names."""
    if isinstance(value, Path) and value.is_file():
        yield value
    elif isinstance(value, Section):
        yield from value.named_files()
    elif isinstance(value, tuple):
        for item in value:
            yield from _files(item)


def is_list_of_texts(annotation: Any) -> bool:
    """Whether a key is a list of texts or paths; one text then stands for a list of one."""
    arguments = typing.get_args(annotation)
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return any(is_list_of_texts(argument) for argument in arguments)
    if typing.get_origin(annotation) is not tuple or arguments[1:] != (Ellipsis,):
        return False
    item = arguments[0]
    while typing.get_origin(item) is Annotated:
        item = typing.get_args(item)[0]
    return item in (str, Path) or (typing.get_origin(item) is Literal and isinstance(typing.get_args(item)[0], str))


def setting(default: Any, description: str, **limits: Any) -> Any:
    """Define a key of a section; ``limits`` of its value are those of `pydantic.Field`: ``ge``, ``lt``, ``pattern``."""
    return Field(default=default, description=description, **limits)


def subsection(section: type[Section], description: str) -> Any:
    """Define a section within a section."""
    return Field(default_factory=section, description=description)


def fields_of(sections: Mapping[str, tuple[str, str]]) -> dict[str, Any]:
    """Return fields for `pydantic.create_model`, from the ``package.module:Model`` and the description of each."""
    models = {name: (imported(target), about) for name, (target, about) in sections.items()}
    return {name: (model, subsection(model, about)) for name, (model, about) in models.items()}


class SideSection(Section):
    """Base class of the sides' sections."""

    enabled: Enabled = setting("auto", "`auto`: enabled if this machine has what the side needs.")

    def joins_as(self, other: Section) -> bool:
        """Whether another section joins the side's network in the same way, so that the worker need not restart."""
        return self == other


class ModuleSection(Section):
    """A module of Midspan; its key in `modules` is its name."""

    enabled: bool = setting(False, "Whether the module runs.")


def matching(pattern: str | re.Pattern[str], mistake: str) -> AfterValidator:
    """Return a validator that requires a pattern to match a whole text; ``mistake`` follows the text in the error."""

    def check(value: str | float) -> str | float:
        if isinstance(value, str) and not re.fullmatch(pattern, value):
            raise ValueError(f"{value!r} {mistake}")
        return value

    return AfterValidator(check)


def repeated(values: Sequence[str]) -> str:
    """Return the first text that occurs twice, "" if all differ."""
    return next((value for value in values if values.count(value) > 1), "")


def differ(values: Sequence[str], mistake: str) -> None:
    """Raise `ValueError` if a text occurs twice; ``mistake`` precedes the first such text in the error."""
    if twice := repeated(values):
        raise ValueError(f"{mistake} {twice}")


ROS2_NAME = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")
YARP_PORT = re.compile(r"(?:/[^\s,/\"'*()\[\]{}]+)+")
_NOT_A_TOPIC = "is not a topic name: begin it with a slash; letters, digits and underscores make its parts"
_NOT_A_PORT = "is not a name of a YARP port: write it as /robot/laser:o"

TopicName = Annotated[str, matching(ROS2_NAME, _NOT_A_TOPIC)]
OptionalTopic = Annotated[str, matching(f"(?:{ROS2_NAME.pattern})?", _NOT_A_TOPIC)]
MapSource = Annotated[str, matching(f"store|{ROS2_NAME.pattern}", _NOT_A_TOPIC)]  # `store`, or a topic of maps
FrameName = Annotated[str, Field(min_length=1, max_length=100)]
FACTORY = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)
Factory = Annotated[str, matching(FACTORY, "does not name a class: write package.module:Class")]
SOURCES = (
    "own",
    "amcl",
    "tf",
    "topic",
    "port",
    "server",
)  # of the robot pose; others are named by class
PoseSourceName = Annotated[
    str,
    matching(
        "|".join((*SOURCES, FACTORY.pattern)),
        f"is not a source of poses: write one of {', '.join(SOURCES)}, or a class of your own as package.module:Class",
    ),
]
FLOOR = (
    "Height of the floor in `base_frame`, meters; empty: that of the frame `base_footprint`, or 0 if it does not exist."
)
PortName = Annotated[str, matching(YARP_PORT, _NOT_A_PORT)]
OptionalPort = Annotated[str, matching(f"(?:{YARP_PORT.pattern})?", _NOT_A_PORT)]
PORT, PORT_OR_NONE = f"^{YARP_PORT.pattern}$", f"^({YARP_PORT.pattern})?$"


PROTOCOLS = ("tcp", "udp", "tls", "quic", "ws", "unixsock-stream")
"""The protocols of zenoh's Python package (1.10), through which all sessions connect; zenohd may have more."""


def not_one_of(value: str, known: Sequence[str]) -> str:
    """Return the text of a problem: a value that is not among the known ones."""
    near = difflib.get_close_matches(value, known, n=1)
    return f"{value!r} is not one of {', '.join(known)}" + (f"; did you mean {near[0]!r}?" if near else "")


def zenoh_endpoint(endpoint: str) -> str:
    """Return a zenoh endpoint; raises `ValueError` if it has no known protocol, or an IP protocol no host or port.

    A listener may have port 0, which means any free port.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_-]*/\S+", endpoint):
        mistake = "is not a zenoh endpoint; give protocol and address, for example tcp/127.0.0.1:7447"
        raise ValueError(f"{endpoint!r} {mistake}")
    protocol, _, rest = endpoint.partition("/")
    if protocol not in PROTOCOLS:
        raise ValueError(f"{endpoint}: {not_one_of(protocol, PROTOCOLS)}")
    if protocol == "unixsock-stream":
        return endpoint
    address = re.fullmatch(r"(\[.+\]|[^/:\[\]]*)(?::(\w*))?", re.split(r"[?#]", rest)[0])
    if address is None:
        raise ValueError(
            f"{endpoint!r} has no valid address; write it like {protocol}/robot1:7447 or {protocol}/[::1]:7447"
        )
    host, port = address[1], address[2] or ""
    if not host:
        raise ValueError(f"{endpoint!r} has no host; write it like {protocol}/robot1:{port or 7447}")
    if not re.fullmatch(r"[0-9]{1,5}", port) or int(port) > 65535:
        raise ValueError(f"{endpoint!r} has no port from 0 to 65535; write it like {protocol}/{host}:7447")
    return endpoint


def zenoh_destination(endpoint: str) -> str:
    """Return a zenoh endpoint to connect to; raises `ValueError` as `zenoh_endpoint` does, and for port 0."""
    address = re.split(r"[?#]", zenoh_endpoint(endpoint))[0]
    if not endpoint.startswith("unixsock-stream/") and not int(address.rpartition(":")[2]):
        raise ValueError(f"{endpoint!r} has port 0, to which no program can connect; give the listener's port")
    return endpoint


ZenohEndpoint = Annotated[str, AfterValidator(zenoh_endpoint)]
ZenohDestination = Annotated[str, AfterValidator(zenoh_destination)]
Address = Annotated[
    str,
    matching(r"[\w.:%-]*", "is not an address or a host name; write it like 192.168.1.20 or robot1.local"),
]
SmallName = Annotated[
    str,
    matching(r"[a-z][a-z0-9_]{0,62}", "is not a name: use lowercase letters, digits and underscores, a letter first"),
]
NodeName = Annotated[
    str, matching(r"[A-Za-z][A-Za-z0-9_]*", "is not a node name; use letters, digits and underscores, a letter first")
]
"""A node's base name that both ROS 1 and ROS 2 accept."""


EMBEDDED = "embedded"
"""The value for Midspan's own master, in place of a master's URI."""


def _master_uri(value: str) -> str:
    if value == EMBEDDED:
        return value
    parts = urlsplit(value)
    if parts.scheme not in {"http", "https"} or not parts.hostname:
        raise ValueError(f"{value!r} is not a master's URI; give for example http://robot:11311")
    try:
        port = parts.port
    except ValueError:
        port = None
    if not port:
        msg = f"{value!r} has no valid port; a master's is 11311 by default, for example http://{parts.hostname}:11311"
        raise ValueError(msg)
    return value


MasterUri = Annotated[str, AfterValidator(_master_uri)]


def is_loopback(endpoint: str) -> bool:
    """Whether only programs on this machine can reach a listener at a zenoh endpoint."""
    protocol, _, address = endpoint.partition("/")
    if protocol.startswith(("unixsock", "unixpipe")):
        return True
    host = re.split(r"[?#]", address)[0].rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def same_port(one: str, other: str) -> bool:
    """Whether two endpoints have the same TCP port; False for port 0, which means any free one."""
    ports = [re.split(r"[?#]", place)[0].rpartition(":")[2] for place in (one, other)]
    return ports[0] == ports[1] != "0" and not one.startswith("quic/")
