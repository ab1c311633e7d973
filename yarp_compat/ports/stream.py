"""Reads whole messages or lines from a blocking socket, with few system calls and bounded memory."""

from __future__ import annotations

import socket
import struct
import time

from yarp_compat.wire import framing
from yarp_compat.wire.errors import TooLargeError, WireError
from yarp_compat.wire.framing import Buffer

_BUFFER = 1 << 16
_AT_ONCE = 1 << 20  # bytes allocated for a large message before its data arrives; more only as it arrives
_COMMON = struct.Struct("<18sIIiIsBBB")
_COMMON_SIZE = _COMMON.size
_COMMON_HEAD = framing.prefix(0)[: framing.HEAD_SIZE]
_KEYS = {ord(k): k for k in "dDaq"}


class ByteStream:
    """A connection's incoming bytes; large payloads are writable views of memory that is reused when it is free."""

    def __init__(self, sock: socket.socket, received: bytes = b"", limit: int = framing.DEFAULT_LIMIT) -> None:
        self._sock = sock
        self._limit = limit
        self._buffer = bytearray(max(4096, len(received)))
        self._buffer[: len(received)] = received
        self._view = memoryview(self._buffer)
        self._start = 0
        self._end = len(received)
        self._spare = bytearray()
        self._spared = 0.0

    def message(self) -> tuple[str, str, Buffer] | None:
        """Return a message's key, command text and payload; None at the end.

        Raises `WireError` if the message is invalid or too large.
        """
        while True:
            start, have = self._start, self._end - self._start
            if have >= _COMMON_SIZE:
                head, first, length, _, _, mark, key, _, _ = _COMMON.unpack_from(self._buffer, start)
                if head == _COMMON_HEAD and first == 8 and key in _KEYS and mark == b"~":
                    if length > self._limit:
                        raise TooLargeError(f"a message announces {length} bytes; the limit is {self._limit}")
                    self._start = start + _COMMON_SIZE
                    payload = self._read(length)
                    return None if payload is None else (_KEYS[key], "", payload)
            if have >= framing.HEAD_SIZE:
                size = framing.index_size(self._buffer, start)
                if have >= size:
                    return self._uncommon(start, size)
            if not self.receive():
                return None

    def _uncommon(self, start: int, size: int) -> tuple[str, str, Buffer] | None:
        """Read a message with an envelope, in several blocks, or with only a command."""
        total = framing.body_size(self._buffer, start, self._limit)
        self._start = start + size
        body = self._read(total)
        if body is None:
            return None
        command, begin = framing.parse_command(body)
        return command.key, command.text, body[begin:]

    def _read(self, length: int) -> Buffer | None:
        start = self._start
        if length <= self._end - start:
            self._start = start + length
            return bytes(self._view[start : start + length])
        if length > _BUFFER // 2:
            return self._read_large(length)
        while self._end - self._start < length:
            if not self.receive():
                return None
        self._start += length
        return bytes(self._view[self._start - length : self._start])

    def _read_large(self, length: int) -> Buffer | None:
        memory = self._memory(length)
        have = self._end - self._start
        memory[:have] = self._view[self._start : self._end]
        self._start = self._end = 0
        while have < length:
            if have == len(memory):
                memory.extend(bytes(min(length - have, have)))
            with memoryview(memory) as view, view[have:] as target:
                got = self._sock.recv_into(target)
            if not got:
                return None
            have += got
        self._spare, self._spared = memory, time.monotonic()
        return memoryview(memory)

    def _memory(self, length: int) -> bytearray:
        """Return memory for a large message: the last message's, if it has the right size and is no longer used."""
        spare, self._spare = self._spare, bytearray()
        if len(spare) == length:
            try:
                spare.append(spare.pop())
            except BufferError:
                pass
            else:
                return spare
        return bytearray(min(length, _AT_ONCE))

    @property
    def kept(self) -> int:
        """Bytes of memory reserved for the next large message."""
        return len(self._spare)

    def free_unused(self, seconds: float) -> None:
        """Free the reserved memory if no large message arrived for ``seconds``; thread-safe."""
        if self._spare and time.monotonic() - self._spared >= seconds:
            self._spare = bytearray()

    def line(self, longest: int | None = None) -> bytes | None:
        """Return the next line, or None at the end of the connection. Raises `WireError` beyond ``longest`` bytes."""
        longest = min(longest or self._limit, self._limit)
        parts: list[bytes] = []
        size = 0
        while True:
            end = self._buffer.find(b"\n", self._start, self._end)
            stop = self._end if end < 0 else end
            size += stop - self._start
            if size > longest:
                raise WireError(f"a line is longer than {longest} bytes")
            parts.append(bytes(self._view[self._start : stop]))
            self._start = stop if end < 0 else end + 1
            if end >= 0:
                return b"".join(parts).removesuffix(b"\r")
            if not self.receive():
                return None

    def received_line(self, longest: int) -> bytes | None:
        """Return the next line if all its bytes have been received and it has at most ``longest``, else None."""
        end = self._buffer.find(b"\n", self._start, min(self._end, self._start + longest + 1))
        return None if end < 0 else self.line(longest)

    def exactly(self, length: int) -> bytes | None:
        """Wait for ``length`` bytes and return them; None at the end of the connection."""
        parts: list[bytes] = []
        while length:
            part = bytes(self._view[self._start : min(self._end, self._start + length)])
            self._start += len(part)
            length -= len(part)
            parts.append(part)
            if length and not self.receive():
                return None
        return b"".join(parts)

    def left(self) -> bytes:
        """Return the bytes that were received and not read yet."""
        return bytes(self._view[self._start : self._end])

    def receive(self) -> bool:
        """Wait for more bytes; return False at the end of the connection."""
        have = self._end - self._start
        if have == 0 or self._end == len(self._buffer):
            self._buffer[:have] = self._buffer[self._start : self._end]
            self._start, self._end = 0, have
            if len(self._buffer) < _BUFFER:
                self._view.release()
                self._buffer.extend(bytes(_BUFFER - len(self._buffer)))
                self._view = memoryview(self._buffer)
        got = self._sock.recv_into(self._view[self._end :])
        self._end += got
        return bool(got)
