"""Contacts: a port's name, address and registered carrier; and the names of connections.

Text forms (measured, see the tests): ``/name``, ``tcp://name`` and ``tcp:/name`` (the port ``/name`` with a carrier),
``tcp://host:10002/``, ``/host:10002/name`` (an address, used without asking the name server), and the line of the name
server, ``registration name /name ip 127.0.0.1 port 10002 type tcp``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from yarp_compat.wire.text import split_words

MAX_NAME = 1024  # maximum characters of a port name

_ADDRESS = re.compile(r"/(?P<host>[^:/]*):(?P<port>\d+)(?=/|$)")
_REFUSED = re.compile(r"[\x00-\x20\x7f\"\\]")


@dataclass(frozen=True, slots=True)
class PortContact:
    """A port's registration at a name server, or the known part of it."""

    name: str  # the port's registered name, with its leading slash; empty if only the address is known
    host: str = ""  # its IP address or host name; empty if unknown
    port: int = -1  # its TCP (for mcast UDP) port number; -1 if unknown
    carrier: str = "tcp"  # its registered carrier; may be empty

    @property
    def is_valid(self) -> bool:
        """Whether the address is known."""
        return self.port >= 0 and bool(self.host)

    @property
    def target(self) -> str:
        """The form that the admin command ``[add]`` takes: ``tcp://reader`` connects to ``/reader`` over tcp."""
        return f"{self.carrier}:/{self.name}" if self.carrier else self.name

    @property
    def uri(self) -> str:
        """The address without the name: ``tcp://127.0.0.1:10002/``."""
        address = f"/{self.host}:{self.port}/" if self.is_valid else ""
        return f"{self.carrier}:/{address}" if self.carrier else address

    @property
    def registration(self) -> str:
        """The name server's line for this contact, without its line end."""
        return f"registration name {self.name} ip {self.host} port {self.port} type {self.carrier}"

    def named(self, name: str) -> PortContact:
        """Return the contact with another name."""
        return replace(self, name=name)

    def by(self, carrier: str) -> PortContact:
        """Return the contact with another carrier."""
        return replace(self, carrier=carrier)

    @classmethod
    def parse(cls, text: str) -> PortContact:
        """Parse any text form except the registration line.

        A missing name, host or carrier is empty, and a missing port is -1; the carrier of an address is tcp by default.
        """
        carrier, address = "", text
        at = text.find(":/")
        if at >= 0:
            carrier, address = text[:at], text[at + 1 :]
            if address.startswith("//"):
                address = address[1:]
        match = _ADDRESS.match(address)
        if not match:
            return cls(name="" if address == "/" else address, carrier=carrier)
        tail = address[match.end() :]
        number = int(match["port"][:6])
        return cls(
            name="" if tail == "/" else tail,
            host=match["host"],
            port=number if number <= 0xFFFF else -1,
            carrier=carrier or "tcp",
        )

    @classmethod
    def from_registration(cls, line: str) -> PortContact | None:
        """Parse the name server's line; return None for other text."""
        parts = [part for part in line.replace('"', "").strip("\r\n").split(" ") if part]
        if len(parts) < 9 or parts[0] != "registration":
            return None
        port = int(parts[6]) if parts[6].isascii() and parts[6].isdigit() and len(parts[6]) < 6 else -1
        if not 0 <= port <= 0xFFFF:
            return None
        return cls(name=parts[2], carrier=parts[8], host=parts[4], port=port)


@dataclass(frozen=True, slots=True)
class ConnectionRoute:
    """The names of a connection, in the direction of its data."""

    source: str
    target: str
    carrier: str


def rooted(name: str) -> bool:
    """Return whether a name has the leading slash of port names; tools use names such as ``admin``."""
    return name.startswith("/")


def is_port_name(name: str) -> bool:
    """Return whether this is a valid port name: ``/a`` or ``/a/b``, one word, not ending in ``/``."""
    return len(name) > 1 and name[0] == "/" and name[-1] != "/" and is_name(name)


def is_name(name: str) -> bool:
    """Return whether a name can be registered: not empty, not too long, and one word of a text line.

    A name server reads ``register /a,b`` as the port ``/a`` with the carrier ``b``, and drops an unclosed bracket.
    """
    return bool(name) and len(name) <= MAX_NAME and not _REFUSED.search(name) and split_words(name)[0] == [name]
