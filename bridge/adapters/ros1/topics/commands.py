"""The connection to one subscriber of velocity commands: no command waits for its network and arrives late.

While a subscriber's computer cannot be reached, the system keeps what was sent, and delivers all of it when the network
is back. So a command is dropped while an earlier one is unacknowledged for longer than a command may be old, and a stop
(zero velocity) follows those that were sent before. What the subscriber's computer has acknowledged cannot be taken
back, even if its program has not read it yet.
"""

from __future__ import annotations

import socket
from collections.abc import Callable

from typing_extensions import override

from bridge.adapters.ros1.topics.outlet import SubscriberConnection
from bridge.messages.velocities import stop_after
from yarp_compat.in_flight import InFlight, unacknowledged


class CommandConnection(SubscriberConnection):
    """A connection that queues no command; ``lifespan`` is the time in seconds for which one may be unacknowledged.

    `send` and `check` are called by one thread at a time.
    """

    native = False

    def __init__(
        self, sock: socket.socket, name: str, node: str, ended: Callable[[SubscriberConnection], None],
        type_name: str, lifespan: float,
    ) -> None:  # fmt: skip
        super().__init__(sock, name, node, ended)
        self._type_name, self._lifespan = type_name, lifespan
        self._in_flight = InFlight()
        self._last, self._stopped = b"", False

    @override
    def send(self, payload: bytes, source: str, depth: int) -> bool:
        """Send a command, or drop it while an earlier one is late or waits; return False if disconnected."""
        if self._is_late() or self.busy:
            self.dropped += 1
            self._stop(source)
            return not self.done
        self._last, self._stopped = payload, False
        sent = super().send(payload, source, 1)
        self._in_flight.sent(self.bytes)
        return sent

    def check(self) -> bool:
        """Send a stop after commands that have become late; return whether a command is unacknowledged and not late."""
        if self._is_late():
            self._stop("")
            return False
        return bool(self._in_flight)

    def _is_late(self) -> bool:
        if not self._in_flight:
            return False
        try:
            acknowledged = self.bytes - unacknowledged(self._sock)
        except (OSError, ValueError):
            self._in_flight.clear()
            return False
        return self._in_flight.is_late(acknowledged, self._lifespan)

    def _stop(self, source: str) -> None:
        stop = stop_after(self._type_name, self._last)
        if stop and not self._stopped:
            self._stopped = True
            super().send(stop, source, 1)
