"""Messages in datagrams, each of which begins with a checksum and its number within the message.

``uint32 zlib.crc32(piece)``, ``int32 number`` (0, 1, 2, ... within one message), then a piece of the message. A
datagram with the number -1 is empty. (``DgramTwoWayStream.cpp``; measured on udp and mcast of 4.0)
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Sequence

from yarp_compat.wire import framing
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import Buffer

LARGEST = 65499  # maximum bytes of a message in one datagram
_HEAD = struct.Struct("<Ii")


def split(buffers: Sequence[Buffer]) -> Iterator[bytes]:
    """Yield the datagrams of a message given in pieces."""
    number = 0
    gathered: list[Buffer] = []
    room = LARGEST
    for buffer in buffers:
        view = memoryview(buffer).cast("B")
        while len(view):
            part, view = view[:room], view[room:]
            gathered.append(part)
            room -= len(part)
            if not room:
                yield datagram(b"".join(gathered), number)
                number, gathered, room = number + 1, [], LARGEST
    if gathered:
        yield datagram(b"".join(gathered), number)


def datagram(piece: bytes, number: int) -> bytes:
    """Return one datagram."""
    return _HEAD.pack(zlib.crc32(piece), number) + piece


class Assembler:
    """Reassembles messages from datagrams in order; a lost, late or duplicate datagram drops its message.

    ``spoiled`` counts datagrams that are too short or have a wrong checksum, ``incomplete`` the messages that were
    dropped because of the order of their datagrams.
    """

    def __init__(self, limit: int = framing.DEFAULT_LIMIT) -> None:
        self._limit = limit
        self._received = bytearray()
        self._next = 0
        self._size = 0
        self._lost = False
        self.spoiled = 0
        self.incomplete = 0

    def add(self, data: Buffer) -> bytes | None:
        """Add a datagram; return the message that it completes, or None. Raises `WireError` if invalid or too large."""
        if len(data) < _HEAD.size:
            self.spoiled += 1
            return None
        checksum, number = _HEAD.unpack_from(data)
        piece = memoryview(data)[_HEAD.size :]
        if zlib.crc32(piece) != checksum:
            self.spoiled += 1
            return None
        if number == -1:
            return None
        if number == 0:
            self._begin()
        elif number != self._next or self._lost:
            self._lose()
            return None
        self._next = number + 1
        self._received += piece
        try:
            return self._whole()
        except WireError:
            self._received = bytearray()
            self._next, self._lost = 0, True
            raise

    def _begin(self) -> None:
        if self._next and not self._lost:
            self.incomplete += 1
        self._received = bytearray()
        self._next, self._size, self._lost = 0, 0, False

    def _lose(self) -> None:
        if not self._lost:
            self.incomplete += 1
        self._received = bytearray()
        self._lost = True

    def _whole(self) -> bytes | None:
        received = self._received
        if not self._size:
            if len(received) < framing.HEAD_SIZE:
                return None
            index = framing.index_size(received)
            if len(received) < index:
                return None
            self._size = index + framing.body_size(received, 0, self._limit)
        if len(received) < self._size:
            return None
        if len(received) > self._size:
            raise WireError(f"the datagrams of a message of {self._size} bytes have {len(received)} bytes")
        self._received = bytearray()
        self._next, self._size = 0, 0
        return bytes(received)
