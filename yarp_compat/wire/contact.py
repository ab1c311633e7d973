"""Contacts: a port's name, its address and the carrier it was registered with; and the names of connections.

Spellings (measured, see the tests): ``/name``, ``tcp://name`` and ``tcp:/name`` (a carrier for the port ``/name``),
``tcp://host:10002/``, ``/host:10002/name`` (an address that needs no name server), and the name server's line
``registration name /name ip 127.0.0.1 port 10002 type tcp``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

MAX_NAME = 1024  # longest port name that is taken, in characters

_ADDRESS = re.compile(r"/(?P<host>[^:/]*):(?P<port>\d+)(?=/|$)")
_REFUSED = re.compile(r"[\x00-\x20\x7f\"\\]")


@dataclass(frozen=True, slots=True)
class PortContact:
    """A port's registration at a name server, or as much of it as is known."""

    name: str  # the port's registered name, with its leading slash; empty where only the address is known
    host: str = ""  # its IP address or host name; empty where it is not known
    port: int = -1  # its TCP (for mcast UDP) port number; -1 where it is not known
    carrier: str = "tcp"  # the carrier it was registered with; may be empty

    @property
    def is_valid(self) -> bool:
        """Whether the address is known."""
        return self.port >= 0 and bool(self.host)

    @property
    def target(self) -> str:
        """The spelling for a port's admin command ``[add]``: ``tcp://reader`` for ``/reader`` by tcp."""
        return f"{self.carrier}:/{self.name}" if self.carrier else self.name

    @property
    def uri(self) -> str:
        """The address alone: ``tcp://127.0.0.1:10002/``."""
        address = f"/{self.host}:{self.port}/" if self.is_valid else ""
        return f"{self.carrier}:/{address}" if self.carrier else address

    @property
    def registration(self) -> str:
        """The name server's line about this contact, without its line end."""
        return f"registration name {self.name} ip {self.host} port {self.port} type {self.carrier}"

    def named(self, name: str) -> PortContact:
        """The same address under another name."""
        return replace(self, name=name)

    def by(self, carrier: str) -> PortContact:
        """The same contact by another carrier."""
        return replace(self, carrier=carrier)

    @classmethod
    def parse(cls, text: str) -> PortContact:
        """Read any spelling but the registration line; what is not said stays empty."""
        carrier, rest = "", text
        at = text.find(":/")
        if at >= 0:
            carrier, rest = text[:at], text[at + 1 :]
            if rest.startswith("//"):
                rest = rest[1:]
        found = _ADDRESS.match(rest)
        if not found:
            return cls(name="" if rest == "/" else rest, carrier=carrier)
        tail = rest[found.end() :]
        number = int(found["port"][:6])
        return cls(
            name="" if tail == "/" else tail,
            host=found["host"],
            port=number if number <= 0xFFFF else -1,
            carrier=carrier or "tcp",
        )

    @classmethod
    def from_registration(cls, line: str) -> PortContact | None:
        """Read the name server's line; None where it is not one."""
        words = [word for word in line.replace('"', "").strip("\r\n").split(" ") if word]
        if len(words) < 9 or words[0] != "registration":
            return None
        if not words[6].isdigit() or int(words[6]) > 0xFFFF:
            return None
        return cls(name=words[2], carrier=words[8], host=words[4], port=int(words[6]))


@dataclass(frozen=True, slots=True)
class ConnectionRoute:
    """One connection, in the direction its data flow."""

    source: str
    target: str
    carrier: str


def rooted(name: str) -> bool:
    """Whether a name is a registered port's; tools that introduce themselves as ``admin`` and the like are not."""
    return name.startswith("/")


def is_port_name(name: str) -> bool:
    """Whether YARP takes this for the name of a port: ``/a`` or ``/a/b``, without spaces, not ending in ``/``."""
    return len(name) > 1 and name[0] == "/" and name[-1] != "/" and is_name(name)


def is_name(name: str) -> bool:
    """Whether a name can be registered at all: not empty, of sane length, nothing that breaks a line of text."""
    return bool(name) and len(name) <= MAX_NAME and not _REFUSED.search(name)
