"""``Contact``: a port's name and address, with YARP's method names; ``ContactStyle``: how to connect."""

from __future__ import annotations

import socket
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self, TypeVar

from yarp_compat.wire.accessors import getter, setter
from yarp_compat.wire.contact import PortContact as Address

T = TypeVar("T")


def _sets(part: str, kind: Callable[..., T], doc: str) -> Callable[[Contact, T], None]:  # noqa: ARG001
    def set_part(self: Contact, value: T) -> None:
        self._address = replace(self._address, **{part: value})  # type: ignore[arg-type] # by name

    set_part.__doc__ = doc
    return set_part


class Contact:
    """A port's name and address.

    Created by ``Contact(name)``, ``(host, number)``, ``(carrier, host, number)`` or ``(name, carrier, host, number)``;
    other parts are "", the number -1.
    """

    def __init__(self, *parts: Any) -> None:
        self._timeout = -1.0
        self._address: Address
        if len(parts) == 1 and isinstance(parts[0], Contact):
            self._address, self._timeout = parts[0]._address, parts[0]._timeout
        elif len(parts) == 2 and isinstance(parts[1], int):
            self._address = Address("", parts[0], parts[1], "")
        elif len(parts) == 3 and isinstance(parts[2], int):
            self._address = Address("", parts[1], parts[2], parts[0])
        else:
            missing: tuple[Any, ...] = ("", "", "", -1)[len(parts) :]
            name, carrier, host, number = parts + missing
            self._address = Address(str(name), str(host), int(number), str(carrier))

    @classmethod
    def of(cls, address: Address | None) -> Self:
        """Return the contact of an address; an invalid one for None."""
        contact = cls()
        contact._address = address or contact._address
        return contact

    @classmethod
    def fromString(cls, text: str) -> Self:
        """Parse ``/name``, ``tcp://name``, ``tcp://host:10002/`` and similar forms."""
        return cls.of(Address.parse(text))

    @classmethod
    def fromConfig(cls, config: Any) -> Self:
        """Read ``name``, ``ip``, ``port_number`` and ``carrier`` (by default ``tcp``) from a Searchable."""
        number = config.find("port_number").asInt32() if config.check("port_number") else -1
        carrier = config.find("carrier").asString() if config.check("carrier") else "tcp"
        return cls.of(Address(config.find("name").asString(), config.find("ip").asString(), number, carrier))

    @property
    def address(self) -> Address:
        """The address in the library's internal form."""
        return self._address

    def getName(self) -> str:
        """Return the port's name; without one, its address, ``/127.0.0.1:10002``."""
        return self._address.name or self._address.by("").uri.removesuffix("/")

    getRegName = getter("_address.name", str, 'The port\'s registered name, or "".')
    setName = _sets("name", str, "Set the port's name.")
    getHost = getter("_address.host", str, "The IP address or host name.")
    setHost = _sets("host", str, "Set the IP address or host name.")
    getPort = getter("_address.port", int, "The port number; -1 if unknown.")
    setPort = _sets("port", int, "Set the port number.")
    getCarrier = getter("_address.carrier", str, "The carrier, such as ``tcp``.")
    setCarrier = _sets("carrier", str, "Set the carrier.")

    def setSocket(self, carrier: str, host: str, number: int) -> None:
        """Set all parts except the name."""
        self._address = Address(self._address.name, host, number, carrier)

    def hasTimeout(self) -> bool:
        """Return whether a timeout is set."""
        return self._timeout >= 0

    getTimeout = getter("_timeout", float, "The timeout in seconds; negative for none.")
    setTimeout = setter("_timeout", float, "Set the timeout of operations with the contact.")

    def isValid(self) -> bool:
        """Return whether the port number is known."""
        return self._address.port >= 0

    def toURI(self, includeCarrier: bool = True) -> str:
        """Return the address, ``tcp://127.0.0.1:10002/``."""
        return (self._address if includeCarrier else self._address.by("")).uri

    def toString(self) -> str:
        """Return the name, or else the address, with its carrier: ``tcp://name``, ``tcp://127.0.0.1:10002``."""
        return self._address.named(self.getName()).target

    toString_c = toString
    __str__ = toString

    @staticmethod
    def convertHostToIp(host: str) -> str:
        """Return a host name's IPv4 address, or the name itself if it cannot be resolved."""
        try:
            return socket.gethostbyname(host)
        except (OSError, ValueError):
            return host


@dataclass
class ContactStyle:
    """Options for connecting. Times are in seconds, negative for the default."""

    OPENENDED = 0
    END_WITH_FROM_PORT = 1
    END_WITH_TO_PORT = 2
    NO_PERSISTENCE = 3

    admin: bool = False
    quiet: bool = False
    verboseOnSuccess: bool = True
    timeout: float = -1.0
    carrier: str = ""
    expectReply: bool = True
    persistent: bool = False
    persistenceType: int = END_WITH_TO_PORT
