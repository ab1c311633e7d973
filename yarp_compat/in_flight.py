"""The messages that a TCP connection's peer has not acknowledged: a system keeps them while the network is down."""

from __future__ import annotations

import socket
import sys
import time
from collections import deque


def unacknowledged(sock: socket.socket) -> int:
    """Return the number of sent bytes that the peer's system has not acknowledged; raises `OSError` (tcp(7)).

    Only Linux shows it in this way: on other systems it is 0, as if the peer had acknowledged everything.
    """
    if sys.platform != "linux":
        return 0
    try:
        import fcntl
        import termios
    except ImportError:  # hidden in tests, as on Windows
        return 0
    return int.from_bytes(fcntl.ioctl(sock, termios.TIOCOUTQ, bytes(4)), sys.byteorder)


class InFlight:
    """The unacknowledged messages of one connection; used by one thread at a time.

    Positions are numbers of bytes since the connection began.
    """

    def __init__(self) -> None:
        self._ends: deque[tuple[int, float]] = deque()

    def __bool__(self) -> bool:
        return bool(self._ends)

    def sent(self, end: int) -> None:
        """Add a message that was sent just now and ends at this position."""
        self._ends.append((end, time.monotonic()))

    def is_late(self, acknowledged: int, lifespan: float) -> bool:
        """Forget the messages up to a position; return whether another was sent more than ``lifespan`` seconds ago."""
        while self._ends and self._ends[0][0] <= acknowledged:
            self._ends.popleft()
        return bool(self._ends) and time.monotonic() - self._ends[0][1] > lifespan

    def clear(self) -> None:
        """Forget all messages, when the connection is closed."""
        self._ends.clear()
