"""The identities of the SDK's clients, which the front passes on with a secret that only this process knows.

The SDK numbers its clients, but does not authenticate them. The front does, and therefore sends a first message on each
connection: it advertises a channel whose topic is a secret that was generated for this client.
"""

from __future__ import annotations

import json
import secrets
import time
from dataclasses import dataclass, field
from threading import Lock

from bridge.web.serving.access import Grant

MARK = 0xFFFF_FFFF
"""The number of the channel that the front advertises; a client that closes this channel itself becomes unknown."""


@dataclass(eq=False)
class Visitor:
    """One connection; ``sent`` counts the bytes sent to the client."""

    grant: Grant
    address: str
    since: float = field(default_factory=time.monotonic)
    sent: int = 0

    @property
    def person(self) -> str:
        """Identifies the client across its connections: its name, if known, else its address."""
        return self.grant.name or self.address

    @property
    def who(self) -> str:
        """The client's name, if known, and its address."""
        return f"{self.grant.name} at {self.address}" if self.grant.name else self.address


class Visitors:
    """Registry of the connected clients. Safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._open: dict[Visitor, str] = {}
        self._secrets: dict[str, Visitor] = {}
        self._clients: dict[int, Visitor] = {}

    def expect(self, visitor: Visitor) -> bytes:
        """Register a connection; return the first text to send on it to the SDK's server."""
        secret = secrets.token_hex(16)
        with self._lock:
            self._open[visitor] = secret
            self._secrets[secret] = visitor
        channel = {"id": MARK, "topic": secret, "encoding": "json", "schemaName": ""}
        return json.dumps({"op": "advertise", "channels": [channel]}).encode()

    def disconnected(self, visitor: Visitor) -> None:
        """Remove a visitor whose connection has ended."""
        with self._lock:
            self._secrets.pop(self._open.pop(visitor, ""), None)

    def identify(self, client: int, secret: str) -> None:
        """Link the SDK's client to the visitor with this secret, which is valid once."""
        with self._lock:
            visitor = self._secrets.pop(secret, None)
            if visitor is not None:
                self._clients[client] = visitor

    def remove_client(self, client: int) -> None:
        """Remove a client that the SDK has closed."""
        with self._lock:
            self._clients.pop(client, None)

    def visitor_of(self, client: int) -> Visitor | None:
        """Return the visitor for a client of the SDK; None if the client did not connect through the front."""
        return self._clients.get(client)

    def all(self) -> list[Visitor]:
        """Return the visitors with open connections."""
        with self._lock:
            return list(self._open)
