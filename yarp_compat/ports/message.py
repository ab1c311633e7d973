"""An incoming message, as the owner of a port gets it."""

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
    """The connection a message came on; who recognises the sender's dialect may set ``profile``."""

    route: ConnectionRoute
    carrier: Carrier
    address: tuple[str, int]
    profile: Profile | None


@dataclass(slots=True, eq=False)
class PortMessage:
    """One message that came in."""

    payload: Buffer  # its bytes, this message's own. Text carriers: the line as a Bottle in the port's dialect
    envelope: str  # its envelope's text, or ""
    peer: MessagePeer  # the connection it came on
    # the sender waits for a reply; it always gets one, an empty Bottle where the owner gives none, unless the port
    # closes first
    wants_reply: bool = False
    replied: Payload | None = field(default=None, init=False)
    is_plain: bool = field(default=False, init=False)  # the reply is sent as it is on text carriers too
    slack: int = field(default=0, init=False)  # bytes behind the reply's acknowledgement, which says to pass over them
    is_last: bool = field(default=False, init=False)  # the connection ends behind the reply
    is_retired: bool = field(default=False, init=False)  # the port waits no more for a reply from another thread
    _later: threading.Event | None = field(default=None, init=False)
    _answered: bool = field(default=False, init=False)

    def reply(self, payload: Payload, *, plain: bool = False, slack: int = 0) -> None:
        """Answer; once, and only where a reply is wanted (elsewhere it goes nowhere).

        ``plain``: it is no Bottle but lines of text, sent as they are on every carrier. ``slack``: bytes that its
        acknowledgement, where the carrier has such, says are behind it.
        """
        if not self._answered:
            self._answered = True
            self.replied = payload
            self.is_plain = plain
            self.slack = slack
            if self._later is not None:
                self._later.set()

    def drop(self) -> None:
        """End the connection behind the reply; call it before ``on_message`` returns, or before the reply."""
        self.is_last = True

    def later(self) -> None:
        """Say, before ``on_message`` returns, that the reply comes from another thread: the connection waits for it."""
        self._later = threading.Event()
        if self.is_retired:
            self.give_up()

    def retire(self) -> bool:
        """Give up a reply that was to come from another thread, as the port closes; whether one still comes."""
        self.is_retired = True
        if self._later is None or self._answered:
            return True
        self.give_up()
        return False

    def give_up(self) -> None:
        """Let the connection go on without a reply, unless it has one."""
        self._answered = True
        if self._later is not None:
            self._later.set()

    def wait(self) -> Payload | None:
        """The reply, or None; waits for a later one; raises `ConnectionAbortedError` where the port closes first."""
        if self._later is not None:
            self._later.wait()
            if self.is_retired and self.replied is None:
                raise ConnectionAbortedError("the port closed before the reply came")
        return self.replied
