"""An input port of ours: hears YARP programs on behalf of one topic."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from bridge.adapters.base import Deliver, MadeBy
from bridge.adapters.yarp.stamps import on_system_clock, stamp
from bridge.messages.errors import MessageError
from bridge.messages.yarp.codec import Codec
from yarp_compat.ports.message import Message

_log = logging.getLogger(__name__)

HOLD_SECONDS = 2.0
"""Seconds for which the newest message of a new peer is held until it is known who it is."""

MAX_HELD = 64


@dataclass(slots=True)
class _Held:
    """A message that waits, since when, and whether it is being passed on at this moment."""

    since: float
    message: Message
    going: bool = False


@dataclass(eq=False)
class Inlet:
    """What an input port does with messages.

    Attributes:
        port: its name.
        topic: whose messages come.
        type: ROS 2 name of their type.
        only: whether a peer is heard; None: anybody.
        source: the id of the endpoint that messages count as; None: that of the port which sent them.
        made_by: tells who made a port.
        refused: told of a message that is none: topic, reason, why.
    """

    port: str
    topic: str
    type: str
    codec: Codec
    only: Callable[[str], bool] | None
    source: str | None
    made_by: Callable[[str], MadeBy]
    refused: Callable[[str, str, str], None]
    _deliver: Deliver | None = None
    _held: dict[str, _Held] = field(default_factory=dict)
    _changed: threading.Condition = field(default_factory=threading.Condition)

    def on_message(self, message: Message) -> None:
        """Take a message; on the thread of its connection."""
        peer = message.peer.route.source
        if self.only is not None and not self.only(peer):
            return
        made_by = self.made_by(peer)
        if made_by is MadeBy.MIDSPAN:
            return
        deliver = self._deliver
        if deliver is None or made_by is MadeBy.UNKNOWN or peer in self._held:
            self.release()  # an earlier one goes first
            self._hold(peer, message)
            self.release()  # a route may have come meanwhile
            return
        self._pass_on(message, deliver)

    def _hold(self, peer: str, message: Message) -> None:
        """Have a message wait, in the place of an earlier one of its peer, or behind one that is being passed on."""
        with self._changed:
            self._changed.wait_for(lambda: not ((held := self._held.get(peer)) and held.going))
            if peer in self._held or len(self._held) < MAX_HELD:
                self._held[peer] = _Held(time.monotonic(), message)

    def hear(self, deliver: Deliver | None) -> None:
        """Give messages to a route from now on; those that wait are its own with the next `release`."""
        self._deliver = deliver

    def waiting(self) -> set[str]:
        """The peers, gone by now or not, of which a message is held."""
        now = time.monotonic()
        with self._changed:
            for peer, held in list(self._held.items()):
                if now - held.since > HOLD_SECONDS and not held.going:
                    del self._held[peer]
            return set(self._held)

    def release(self) -> None:
        """Look again at what is held: it may be known by now who sent it."""
        while self._held and (found := self._next()) is not None:
            peer, message, deliver = found
            try:
                self._pass_on(message, deliver)
            finally:
                with self._changed:
                    del self._held[peer]
                    self._changed.notify_all()

    def _next(self) -> tuple[str, Message, Deliver] | None:
        """A held message that can be passed on; until that is done, the next of its peer waits."""
        now, deliver = time.monotonic(), self._deliver
        if deliver is None:
            return None
        with self._changed:
            for peer, held in [(peer, held) for peer, held in self._held.items() if not held.going]:
                made_by = self.made_by(peer)
                if made_by is MadeBy.NATIVE and now - held.since <= HOLD_SECONDS:
                    held.going = True
                    return peer, held.message, deliver
                if made_by is not MadeBy.UNKNOWN or now - held.since > HOLD_SECONDS:
                    del self._held[peer]
        return None

    def _pass_on(self, message: Message, deliver: Deliver) -> None:
        peer = message.peer
        stamp_ns = stamp(message.envelope) if message.envelope else None
        try:
            cdr = self.codec.to_hub(message.payload, peer.profile, stamp_ns)
        except MessageError as err:
            self.refused(self.topic, "bad", f"from {peer.route.source}: {err}")
            return
        deliver(cdr, self.source or peer.route.source, on_system_clock(stamp_ns))
