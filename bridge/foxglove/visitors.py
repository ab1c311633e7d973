"""Who the SDK's clients are: the front tells it, by a word that only it and this process know.

The SDK knows its clients by numbers alone, and asks none of them who they are. So the front, which does, says as the
first message of each connection that it advertises a channel whose topic is a secret made for it.
"""

from __future__ import annotations

import json
import secrets
import time
from dataclasses import dataclass, field
from threading import Lock

from bridge.web.serving.access import Grant

MARK = 0xFFFF_FFFF
"""The number of the channel that the front advertises; a client that uses it itself is a stranger from then on."""


@dataclass(eq=False)
class Visitor:
    """One connection. ``sent`` counts the bytes that went to it."""

    grant: Grant
    address: str
    since: float = field(default_factory=time.monotonic)
    sent: int = 0

    @property
    def who(self) -> str:
        """In words."""
        return f"{self.grant.name} at {self.address}" if self.grant.name else self.address


class Visitors:
    """Safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._open: dict[Visitor, str] = {}
        self._secrets: dict[str, Visitor] = {}
        self._clients: dict[int, Visitor] = {}

    def expect(self, visitor: Visitor) -> bytes:
        """A connection is made for a visitor; the text that the SDK's server is to get first on it."""
        secret = secrets.token_hex(16)
        with self._lock:
            self._open[visitor] = secret
            self._secrets[secret] = visitor
        channel = {"id": MARK, "topic": secret, "encoding": "json", "schemaName": ""}
        return json.dumps({"op": "advertise", "channels": [channel]}).encode()

    def disconnected(self, visitor: Visitor) -> None:
        """Its connection has ended."""
        with self._lock:
            self._secrets.pop(self._open.pop(visitor, ""), None)

    def identify(self, client: int, secret: str) -> None:
        """The SDK has a client that said this word; a word is good once."""
        with self._lock:
            visitor = self._secrets.pop(secret, None)
            if visitor is not None:
                self._clients[client] = visitor

    def remove_client(self, client: int) -> None:
        """The SDK's client is gone."""
        with self._lock:
            self._clients.pop(client, None)

    def visitor_of(self, client: int) -> Visitor | None:
        """Who a client of the SDK is, None for one that did not come by the front."""
        return self._clients.get(client)

    def all(self) -> list[Visitor]:
        """Those whose connections are open."""
        with self._lock:
            return list(self._open)
