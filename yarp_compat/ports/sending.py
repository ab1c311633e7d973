"""Sending several buffers at once on a blocking socket."""

from __future__ import annotations

import socket
from collections.abc import Sequence

from yarp_compat.wire.message import JOINED, Buffer


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
