"""The connection to one subscriber of velocity commands: no command waits for its network and arrives late.

While a subscriber's computer cannot be reached, the system keeps what was sent, and delivers all of it when the network
is back. So a command is dropped while an earlier one is unacknowledged for longer than a command may be old, and a stop
(zero velocity) follows those that were sent before. What the subscriber's computer has acknowledged cannot be taken
back, even if its program has not read it yet.
"""

from __future__ import annotations

import socket
import sys
import time
from collections import deque
from collections.abc import Callable

from typing_extensions import override

from bridge.adapters.ros1.topics.outlet import SubscriberConnection
from bridge.messages.velocities import VELOCITIES

_VELOCITIES = frozenset(name.replace("/msg/", "/") for name in VELOCITIES)
_VELOCITY = 48
"""Size in bytes of the six float64 at the end of these messages."""


def unacknowledged(sock: socket.socket) -> int:
    """Return the number of sent bytes that the peer's system has not acknowledged; raises `OSError` (tcp(7)).

    Only Linux shows it in this way: on other systems it is 0, as if the peer had acknowledged everything.
    """
    if sys.platform != "linux":
        return 0
    import fcntl
    import termios

    return int.from_bytes(fcntl.ioctl(sock, termios.TIOCOUTQ, bytes(4)), sys.byteorder)


def stop_after(type_name: str, payload: bytes) -> bytes:
    """Return a command (ROS 1 bytes) with its velocity set to zero; "" if the type is not a velocity."""
    return payload[:-_VELOCITY] + bytes(_VELOCITY) if type_name in _VELOCITIES else b""


class CommandConnection(SubscriberConnection):
    """A connection that queues no command; ``lifespan`` is the time in seconds for which one may be unacknowledged.

    `send` and `check` are called by one thread at a time.
    """

    def __init__(
        self, sock: socket.socket, name: str, node: str, ended: Callable[[SubscriberConnection], None],
        type_name: str, lifespan: float,
    ) -> None:  # fmt: skip
        super().__init__(sock, name, node, ended)
        self._type_name, self._lifespan = type_name, lifespan
        self._sent: deque[tuple[int, float]] = deque()
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
        self._sent.append((self.bytes, time.monotonic()))
        return sent

    def check(self) -> bool:
        """Send a stop after commands that have become late; return whether a command is unacknowledged and not late."""
        if self._is_late():
            self._stop("")
            return False
        return bool(self._sent)

    def _is_late(self) -> bool:
        if not self._sent:
            return False
        try:
            acknowledged = self.bytes - unacknowledged(self._sock)
        except (OSError, ValueError):  # closed
            self._sent.clear()
            return False
        while self._sent and self._sent[0][0] <= acknowledged:
            self._sent.popleft()
        return bool(self._sent) and time.monotonic() - self._sent[0][1] > self._lifespan

    def _stop(self, source: str) -> None:
        stop = stop_after(self._type_name, self._last)
        if stop and not self._stopped:
            self._stopped = True
            super().send(stop, source, 1)
