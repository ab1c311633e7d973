"""A socket whose whole conversation has to end by a point in time, however slowly the peer trickles."""

from __future__ import annotations

import math
import socket
import time
from typing import Any


class DeadlineSocket(socket.socket):
    """A TCP socket with one deadline for all that is sent and received.

    A plain time-out counts for each operation anew: a peer that sends a byte now and then would hold a thread for ever.
    """

    deadline = math.inf

    @classmethod
    def connected(cls, host: str, port: int, deadline: float) -> DeadlineSocket:
        """Connect; ``deadline`` is on the monotonic clock. Raises `OSError`."""
        left = deadline - time.monotonic()
        if left <= 0:
            raise TimeoutError
        plain = socket.create_connection((host, port), timeout=left)
        sock = cls(fileno=plain.detach())
        sock.deadline = deadline
        return sock

    def _arm(self) -> None:
        if self.deadline == math.inf:
            self.settimeout(None)
            return
        left = self.deadline - time.monotonic()
        if left <= 0:
            raise TimeoutError
        self.settimeout(left)

    def recv(self, *args: Any) -> bytes:
        """As `socket.socket.recv`, until the deadline."""
        self._arm()
        return super().recv(*args)

    def recv_into(self, *args: Any) -> int:
        """As `socket.socket.recv_into`, until the deadline."""
        self._arm()
        return super().recv_into(*args)

    def sendall(self, *args: Any) -> None:
        """As `socket.socket.sendall`, until the deadline."""
        self._arm()
        super().sendall(*args)
