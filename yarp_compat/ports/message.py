"""An incoming message, as the owner of a port receives it."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

from yarp_compat.wire.carriers import Carrier
from yarp_compat.wire.contact import ConnectionRoute
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.profile import Profile

Payload = Buffer | Sequence[Buffer]


class MessagePeer(Protocol):
    """The connection of a message; code that recognizes the sender's dialect may set ``profile``."""

    route: ConnectionRoute
    carrier: Carrier
    address: tuple[str, int]
    profile: Profile | None


@dataclass(slots=True, eq=False)
class PortMessage:
    """One received message."""

    payload: Buffer  # its bytes, not shared. Text carriers: the line as a Bottle in the port's dialect
    envelope: str  # text of its envelope, or ""
    peer: MessagePeer  # its connection
    # the sender waits for a reply; it always receives one, an empty Bottle if the owner gives none, unless the port
    # closes first
    wants_reply: bool = False
    replied: Payload | None = field(default=None, init=False)
    is_plain: bool = field(default=False, init=False)  # the reply is sent unchanged, even over text carriers
    slack: int = field(default=0, init=False)  # bytes after the reply's acknowledgment, which the peer skips
    is_last: bool = field(default=False, init=False)  # the connection ends after the reply
    is_retired: bool = field(default=False, init=False)  # the port no longer waits for a reply from another thread
    _later: threading.Event | None = field(default=None, init=False)
    _answered: bool = field(default=False, init=False)

    def reply(self, payload: Payload, *, plain: bool = False, slack: int = 0) -> None:
        """Reply to a request; further replies, and replies to other messages, are ignored.

        ``plain``: the reply is lines of text instead of a Bottle, sent unchanged on every carrier. ``slack``: number of
        bytes that its acknowledgment announces after itself, if the carrier has acknowledgments.
        """
        if not self._answered:
            self._answered = True
            self.replied = payload
            self.is_plain = plain
            self.slack = slack
            if self._later is not None:
                self._later.set()

    def drop(self) -> None:
        """End the connection after the reply; call it before ``on_message`` returns, or before the reply."""
        self.is_last = True

    def later(self) -> None:
        """Make the connection wait for a reply from another thread; call it before ``on_message`` returns."""
        self._later = threading.Event()
        if self.is_retired:
            self.give_up()

    def retire(self) -> bool:
        """Stop waiting for a reply from another thread, when the port closes; return False if one was outstanding."""
        self.is_retired = True
        if self._later is None or self._answered:
            return True
        self.give_up()
        return False

    def give_up(self) -> None:
        """Let the connection continue without a reply, unless one was given."""
        self._answered = True
        if self._later is not None:
            self._later.set()

    def wait(self) -> Payload | None:
        """Wait for the reply and return it, or None; raises `ConnectionAbortedError` if the port closes first."""
        if self._later is not None:
            self._later.wait()
            if self.is_retired and self.replied is None:
                raise ConnectionAbortedError("the port closed before the reply")
        return self.replied
