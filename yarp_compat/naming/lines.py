"""A connection on which lines are spoken, with one deadline for all of it and a bound on what is taken."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

_STEP = 0.1
"""Seconds after which a thread that waits looks whether it still should."""


class LineSocket:
    """A TCP connection for a short exchange of lines.

    Args:
        host: whom to call.
        port: its TCP port number.
        timeout: seconds for the whole exchange.
        limit: bytes that are taken at most.

    Raises:
        OSError: nobody answers there, or (any method) not in time, or with too much.
    """

    def __init__(self, host: str, port: int, timeout: float, limit: int = 1 << 20) -> None:
        self._end = time.monotonic() + timeout
        self._limit = limit
        self._buffer = bytearray()
        self._taken = 0
        self._explain: Callable[[OSError], Exception] | None = None
        self._socket = socket.create_connection((host, port), timeout)
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError:  # it was closed at once
            self.close()
            raise

    def on_error(self, explain: Callable[[OSError], Exception]) -> None:
        """Have later errors raised as something else."""
        self._explain = explain

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, err: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
        if isinstance(err, OSError) and self._explain:
            raise self._explain(err) from None

    def send(self, data: bytes) -> None:
        """Send all of it."""
        self._socket.settimeout(self._left())
        self._socket.sendall(data)

    def line(self) -> str:
        """The next line, without its end."""
        at = self._buffer.find(b"\n")
        while at < 0:
            seen = len(self._buffer)
            self._more()
            at = self._buffer.find(b"\n", seen)
        line = bytes(self._buffer[:at])
        del self._buffer[: at + 1]
        return line.rstrip(b"\r").decode("utf-8", "surrogateescape")

    def _more(self) -> None:
        data = self._some()
        if not data:
            msg = "the connection was closed before the answer was complete"
            raise ConnectionError(msg)
        self._taken += len(data)
        if self._taken > self._limit:
            msg = f"the answer is longer than {self._limit} bytes"
            raise OSError(msg)
        self._buffer += data

    def _some(self) -> bytes:
        while True:
            self._socket.settimeout(min(self._left(), _STEP))
            try:
                return self._socket.recv(65536)
            except TimeoutError:
                continue

    def hurry(self, seconds: float) -> None:
        """Have the exchange end within so many seconds from now; any thread may ask for that."""
        self._end = min(self._end, time.monotonic() + seconds)

    def _left(self) -> float:
        left = self._end - time.monotonic()
        if left <= 0:
            raise TimeoutError
        return left
