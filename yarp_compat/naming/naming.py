"""What a port needs of whatever knows the names: the name server's client, or a table in a test."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from yarp_compat.wire.contact import Contact


class Naming(Protocol):
    """Registers ports and finds them. Every call may raise NamingError, and takes a bounded time."""

    def register(self, name: str, host: str = "", port: int = 0, *, carrier: str = "") -> Contact:
        """Register a port; the server fills in what is empty or 0 (the name too: ``/tmp/port/N``).

        Raises:
            NoNameServerError: nobody answers.
            NameRefusedError: the name was not taken.
        """
        ...

    def unregister(self, name: str) -> None:
        """Forget a port; one that is not known is no error."""
        ...

    def query(self, name: str) -> Contact | None:
        """Where a port is; None where it is not known."""
        ...

    def set_property(self, name: str, key: str, *values: Any) -> None:
        """Keep values under a key of a registered port."""
        ...

    def get_property(self, name: str, key: str) -> Sequence[Any]:
        """The values under a key of a registered port; empty where there are none."""
        ...

    def announce(self, name: str, alive: bool = True) -> None:
        """Say that a port listens now (the server makes its persistent connections), or that it does not respond."""
        ...
