"""The interface that ports need of a name server, its errors, and name servers for ports that nobody else finds."""

# ruff: noqa: D102 - `Naming` says what each method does

from __future__ import annotations

import itertools
import threading
from collections.abc import Sequence
from typing import Any, Protocol

from yarp_compat.wire.contact import PortContact


class NamingError(OSError):
    """A name could not be asked for or registered."""


class NoNameServerError(NamingError):
    """No name server answers where the configuration says it is."""


class NameRefusedError(NamingError):
    """The name server did not take a name."""


class NamingConfigError(NamingError):
    """The file that says where the name server is, is missing what it needs."""


class PortError(NamingError):
    """A port does not exist, does not answer, or does not do what it is asked."""


class Naming(Protocol):
    """Registers ports and finds them. Every call may raise NamingError, and takes a bounded time."""

    @property
    def numbers(self) -> range:
        """The TCP port numbers that ports choose theirs from; empty where the name server chooses."""

    def register(self, name: str, host: str = "", port: int = 0, *, carrier: str = "") -> PortContact:
        """Register a port; fills in what is empty or 0. Raises `NoNameServerError`, `NameRefusedError` for the name."""

    def unregister(self, name: str) -> None:
        """Forget a port; one that is not known is no error."""

    def query(self, name: str) -> PortContact | None:
        """The address of a port; None where it is not known."""

    def set_property(self, name: str, key: str, *values: Any) -> None:
        """Keep values under a key of a registered port."""

    def get_property(self, name: str, key: str) -> Sequence[Any]:
        """The values under a key of a registered port; may be empty."""

    def announce(self, name: str, alive: bool = True) -> None:
        """Say that a port listens now (the server makes its persistent connections), or that it does not respond."""


class SilentNaming:
    """A name server that registers nothing, knows nobody, and lets a port listen where it wants to."""

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
    """Knows the ports of one process, without a socket: for tests, and for ports that nobody else is to find."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._contacts: dict[str, PortContact] = {}
        self._properties: dict[tuple[str, str], tuple[Any, ...]] = {}
        self._numbers = itertools.count(1)

    def register(self, name: str, host: str = "", port: int = 0, *, carrier: str = "") -> PortContact:
        """Register a port; one with a number of 0 chooses one, and registers again."""
        with self._lock:
            if name in ("", "..."):
                name = f"/tmp/port/{next(self._numbers)}"  # noqa: S108  # a port's name, no file's
            self._contacts[name] = super().register(name, host, port, carrier=carrier)
            return self._contacts[name]

    def unregister(self, name: str) -> None:
        with self._lock:
            self._contacts.pop(name, None)

    def query(self, name: str) -> PortContact | None:
        with self._lock:
            return self._contacts.get(name)

    def list(self, prefix: str = "") -> list[PortContact]:
        """All registered ports, or those whose names begin so."""
        with self._lock:
            return [contact for name, contact in self._contacts.items() if name.startswith(prefix)]

    def set_property(self, name: str, key: str, *values: Any) -> None:
        self._properties[name, key] = values

    def get_property(self, name: str, key: str) -> Sequence[Any]:
        return self._properties.get((name, key), ())


class Unregistered(SilentNaming):
    """A name server at which ports are not registered: for ports that only call others."""

    def __init__(self, naming: Naming) -> None:
        self._naming = naming

    def query(self, name: str) -> PortContact | None:
        return self._naming.query(name)

    def get_property(self, name: str, key: str) -> Sequence[Any]:
        return self._naming.get_property(name, key)
