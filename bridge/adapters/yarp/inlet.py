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
    _held: dict[str, tuple[float, Message]] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def on_message(self, message: Message) -> None:
        """Take a message; on the thread of its connection."""
        peer = message.peer.route.source
        if self.only is not None and not self.only(peer):
            return
        made_by = self.made_by(peer)
        if made_by is MadeBy.MIDSPAN:
            return
        deliver = self._deliver
        if deliver is None or made_by is MadeBy.UNKNOWN:
            with self._lock:
                if peer in self._held or len(self._held) < MAX_HELD:
                    self._held[peer] = time.monotonic(), message
            return
        self._pass_on(message, deliver)

    def hear(self, deliver: Deliver | None) -> None:
        """Give messages to a route from now on, those that wait among them."""
        self._deliver = deliver
        self.release()

    def waiting(self) -> set[str]:
        """The peers, gone by now or not, of which a message is held."""
        now = time.monotonic()
        with self._lock:
            for peer in [peer for peer, (since, _) in self._held.items() if now - since > HOLD_SECONDS]:
                del self._held[peer]
            return set(self._held)

    def release(self) -> None:
        """Look again at what is held: it may be known by now who sent it."""
        deliver = self._deliver
        if deliver is None or not self._held:
            return
        now, ready = time.monotonic(), []
        with self._lock:
            for peer, (since, message) in list(self._held.items()):
                made_by = self.made_by(peer)
                if made_by is not MadeBy.UNKNOWN or now - since > HOLD_SECONDS:
                    del self._held[peer]
                if made_by is MadeBy.NATIVE and now - since <= HOLD_SECONDS:
                    ready.append(message)
        for message in ready:
            self._pass_on(message, deliver)

    def _pass_on(self, message: Message, deliver: Deliver) -> None:
        peer = message.peer
        stamp_ns = stamp(message.envelope) if message.envelope else None
        try:
            cdr = self.codec.to_hub(message.payload, peer.profile, stamp_ns)
        except MessageError as err:
            self.refused(self.topic, "bad", f"from {peer.route.source}: {err}")
            return
        deliver(cdr, self.source or peer.route.source, on_system_clock(stamp_ns))
