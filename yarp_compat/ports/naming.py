"""Name servers for ports that nobody else is to find: a table in this process, or one that is only asked."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Sequence
from typing import Any

from yarp_compat.naming.naming import Naming
from yarp_compat.wire.contact import Contact


class LocalNaming:
    """Knows the ports of one process.

    No socket, and nothing outlives the process. For tests, and for ports that nobody else is to find.
    """

    def __init__(self, host: str = "127.0.0.1") -> None:
        self._host = host
        self._lock = threading.Lock()
        self._contacts: dict[str, Contact] = {}
        self._properties: dict[tuple[str, str], tuple[Any, ...]] = {}
        self._numbers = itertools.count(1)

    def register(self, name: str, host: str = "", port: int = 0, *, carrier: str = "") -> Contact:
        """Register a port; with a number of 0 it is to choose one, and register again."""
        with self._lock:
            if name in ("", "..."):
                name = f"/tmp/port/{next(self._numbers)}"  # noqa: S108  # a port's name, no file's
            contact = Contact(name, host or self._host, port, carrier or "tcp")
            self._contacts[name] = contact
            return contact

    def unregister(self, name: str) -> None:
        """Forget a port."""
        with self._lock:
            self._contacts.pop(name, None)

    def query(self, name: str) -> Contact | None:
        """Where a port is."""
        with self._lock:
            return self._contacts.get(name)

    def list(self, prefix: str = "") -> list[Contact]:
        """All registered ports, or those whose names begin so."""
        with self._lock:
            return [contact for name, contact in self._contacts.items() if name.startswith(prefix)]

    def set_property(self, name: str, key: str, *values: Any) -> None:
        """Keep values under a key of a port."""
        self._properties[name, key] = values

    def get_property(self, name: str, key: str) -> Sequence[Any]:
        """The values under a key of a port."""
        return self._properties.get((name, key), ())

    def announce(self, name: str, alive: bool = True) -> None:
        """Nobody waits for it here."""


class Unregistered:
    """A name server that is only asked, not told: for ports that call others and are not to be found themselves."""

    def __init__(self, naming: Naming) -> None:
        self.query = naming.query
        self.get_property = naming.get_property

    def register(self, name: str, host: str = "", port: int = 0, *, carrier: str = "") -> Contact:
        """Have the port listen where it wants to."""
        return Contact(name, host or "127.0.0.1", port, carrier or "tcp")

    def unregister(self, name: str) -> None:
        """There is nothing to forget."""

    def set_property(self, name: str, key: str, *values: Any) -> None:
        """Nobody keeps properties of a port that is not registered."""

    def announce(self, name: str, alive: bool = True) -> None:
        """Nobody waits for it."""
