"""Sockets of connections: how they are set, and several buffers sent at once."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Sequence

from yarp_compat.wire.message import JOINED, Buffer

_KEEP_ALIVE = (("TCP_KEEPIDLE", 30), ("TCP_KEEPINTVL", 10), ("TCP_KEEPCNT", 3))
"""After how many seconds of silence the system asks a peer's machine, how far apart, and how often."""


def tune(sock: socket.socket) -> None:
    """Have small messages sent at once, and the end of a peer's machine noticed."""
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEP_ALIVE:
            if hasattr(socket, name):
                sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def send_all(sock: socket.socket, buffers: Sequence[Buffer]) -> None:
    """Send all of the buffers, in few system calls; waits until the peer took them."""
    left = flat(buffers)
    while left:
        left = sent(left, send_some(sock, left))


def send_some(sock: socket.socket, buffers: Sequence[Buffer]) -> int:
    """Send what the socket takes of the buffers; the number of bytes."""
    if len(buffers) == 1:
        return sock.send(buffers[0])
    if hasattr(sock, "sendmsg"):
        return sock.sendmsg(buffers[:512])
    return sock.send(buffers[0])  # Windows


def flat(buffers: Sequence[Buffer]) -> list[Buffer]:
    """The buffers as bytes, small ones put together, empty ones left out."""
    made = [b if isinstance(b, (bytes, bytearray)) else memoryview(b).cast("B") for b in buffers]
    if sum(map(len, made)) <= JOINED:
        return [b"".join(made)]
    return [b for b in made if len(b)]


def sent(buffers: list[Buffer], count: int) -> list[Buffer]:
    """What remains of the buffers after ``count`` bytes of them."""
    for index, buffer in enumerate(buffers):
        if count < len(buffer):
            return [memoryview(buffer)[count:], *buffers[index + 1 :]]
        count -= len(buffer)
    return []
