"""The name server's interface for ports, its errors, and name servers for ports without registration."""

# ruff: noqa: D102 - `Naming` documents the methods

from __future__ import annotations

import itertools
import threading
from collections.abc import Sequence
from typing import Any, Protocol

from yarp_compat.overriding import override
from yarp_compat.wire.contact import PortContact


class NamingError(OSError):
    """A name could not be queried or registered."""


class NoNameServerError(NamingError):
    """No name server answers at the configured address."""


class NameRefusedError(NamingError):
    """The name server refused a name."""


class NamingConfigError(NamingError):
    """The file with the name server's address is invalid, or cannot be read or written."""


class PortError(NamingError):
    """A port does not exist, does not answer, or refuses a request."""


class Naming(Protocol):
    """Registration and lookup of ports. Every call may raise NamingError, and takes a bounded time."""

    @property
    def numbers(self) -> range:
        """The range of TCP port numbers for ports; empty if the name server assigns them."""

    def register(self, name: str, host: str = "", port: int = 0, *, carrier: str = "") -> PortContact:
        """Register a port; empty or 0 values are filled in. Raises `NoNameServerError`, or `NameRefusedError`."""

    def unregister(self, name: str) -> None:
        """Unregister a port; an unknown name is not an error."""

    def query(self, name: str) -> PortContact | None:
        """Return the address of a port; None if it is not registered."""

    def set_property(self, name: str, key: str, *values: Any) -> None:
        """Store values under a key of a registered port."""

    def get_property(self, name: str, key: str) -> Sequence[Any]:
        """Return the values under a key of a registered port; may be empty."""

    def announce(self, name: str, alive: bool = True) -> None:
        """Announce that a port listens (the server makes its persistent connections), or that it does not respond."""


class SilentNaming:
    """A name server that registers nothing, finds no port, and accepts any address."""

    numbers = range(0)

    def register(self, name: str, host: str = "", port: int = 0, *, carrier: str = "") -> PortContact:
        return PortContact(name, host or "127.0.0.1", port, carrier or "tcp")

    def unregister(self, name: str) -> None: ...

    def query(self, name: str) -> PortContact | None:  # noqa: ARG002
        return None

    def set_property(self, name: str, key: str, *values: Any) -> None: ...

    def get_property(self, name: str, key: str) -> Sequence[Any]:  # noqa: ARG002
        return ()

    def announce(self, name: str, alive: bool = True) -> None: ...


class LocalNaming(SilentNaming):
    """A name server inside one process, without a socket: for tests and private ports."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._contacts: dict[str, PortContact] = {}
        self._properties: dict[tuple[str, str], tuple[Any, ...]] = {}
        self._numbers = itertools.count(1)

    @override
    def register(self, name: str, host: str = "", port: int = 0, *, carrier: str = "") -> PortContact:
        """Register a port; a port with the number 0 chooses a number and registers again."""
        with self._lock:
            if name in ("", "..."):
                name = f"/tmp/port/{next(self._numbers)}"  # noqa: S108  # a port's name, not a file's
            self._contacts[name] = super().register(name, host, port, carrier=carrier)
            return self._contacts[name]

    @override
    def unregister(self, name: str) -> None:
        with self._lock:
            self._contacts.pop(name, None)

    @override
    def query(self, name: str) -> PortContact | None:
        with self._lock:
            return self._contacts.get(name)

    def list(self, prefix: str = "") -> list[PortContact]:
        """Return the registered ports whose names begin with ``prefix``."""
        with self._lock:
            return [contact for name, contact in self._contacts.items() if name.startswith(prefix)]

    @override
    def set_property(self, name: str, key: str, *values: Any) -> None:
        self._properties[name, key] = values

    @override
    def get_property(self, name: str, key: str) -> Sequence[Any]:
        return self._properties.get((name, key), ())


class Unregistered(SilentNaming):
    """A name server that finds ports and registers none: for ports that are only clients."""

    def __init__(self, naming: Naming) -> None:
        self._naming = naming

    @override
    def query(self, name: str) -> PortContact | None:
        return self._naming.query(name)

    @override
    def get_property(self, name: str, key: str) -> Sequence[Any]:
        return self._naming.get_property(name, key)
