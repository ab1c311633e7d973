"""A TCP proxy that simulates a bad network: loss, stalls, delay, low bandwidth, half-open and cut connections."""

from __future__ import annotations

import contextlib
import random
import select
import socket
import threading
import time
from collections import deque
from types import TracebackType
from typing import Self

TICK = 0.005
RETRANSMISSION = 0.2
"""Seconds after which Linux retransmits a lost segment at the earliest (TCP_RTO_MIN)."""
BUFFER = 64 << 10
"""Maximum bytes in flight per direction, as on a network with short queues."""


class FaultProxy:
    """Forwards connections to a loopback port. ``up`` is the direction from the client, ``down`` the direction to it.

    Attributes:
        port: the proxy's port on 127.0.0.1.
        delay: additional latency of every byte, seconds.
        loss: share of lost segments. TCP retransmits them, so they arrive `RETRANSMISSION` late and delay all later
            segments.
        lost: number of lost segments.
        rate: bytes per second in each direction, None for unlimited.
        frozen: directions in which nothing is forwarded; connections stay open, and new ones are accepted.
    """

    def __init__(self, to: int) -> None:
        self._to = to
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.delay = self.loss = 0.0
        self.lost = 0
        self.rate: float | None = None
        self.frozen: frozenset[str] = frozenset()
        self._open = True
        self._links: list[tuple[socket.socket, socket.socket]] = []
        self._lock = threading.Lock()
        self._threads = [threading.Thread(target=self._accept, name="fault-proxy")]
        self._threads[0].start()

    def freeze(self, *directions: str) -> None:
        """Stop forwarding in these directions, by default in both."""
        self.frozen = frozenset(directions or ("up", "down"))

    def thaw(self) -> None:
        """Resume forwarding, including the queued data."""
        self.frozen = frozenset()

    def cut(self) -> None:
        """Close all connections; new connections are forwarded."""
        with self._lock:
            links, self._links = self._links, []
        for sock in (sock for link in links for sock in link):
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close all connections, and wait for the threads."""
        self._open = False
        self.thaw()
        self.cut()
        for thread in self._threads:
            thread.join()
        self._listener.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def _accept(self) -> None:
        while self._open:
            if not select.select([self._listener], [], [], 0.05)[0]:
                continue
            near, _ = self._listener.accept()
            try:
                far = socket.create_connection(("127.0.0.1", self._to))
            except OSError:
                near.close()
                continue
            for sock in (near, far):
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with self._lock:
                self._links.append((near, far))
            ends = _Ends(near, far)
            for source, sink, direction in ((near, far, "up"), (far, near, "down")):
                thread = threading.Thread(target=self._pump, args=(source, sink, direction, ends), name="fault-proxy")
                self._threads.append(thread)
                thread.start()

    def _pump(self, source: socket.socket, sink: socket.socket, direction: str, ends: _Ends) -> None:
        waiting: deque[tuple[float, bytes]] = deque()
        held = 0
        with contextlib.suppress(OSError), ends:
            while self._open:
                if direction in self.frozen:
                    time.sleep(TICK)
                    continue
                if held < BUFFER and select.select([source], [], [], TICK)[0]:
                    data = source.recv(4096)
                    if not data:
                        return
                    retransmission = 0.0
                    if random.random() < self.loss:
                        self.lost += 1
                        retransmission = RETRANSMISSION
                    waiting.append((time.monotonic() + self.delay + retransmission, data))
                    held += len(data)
                elif held >= BUFFER:
                    time.sleep(TICK)
                while waiting and waiting[0][0] <= time.monotonic() and direction not in self.frozen:
                    _, data = waiting.popleft()
                    held -= len(data)
                    if self.rate is not None:
                        time.sleep(len(data) / self.rate)
                    sink.sendall(data)


class _Ends:
    """Both sockets of a connection, closed once both directions have ended."""

    def __init__(self, *sockets: socket.socket) -> None:
        self._sockets = sockets
        self._left = 2
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        for sock in self._sockets:
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
        with self._lock:
            self._left -= 1
            if self._left == 0:
                for sock in self._sockets:
                    sock.close()
