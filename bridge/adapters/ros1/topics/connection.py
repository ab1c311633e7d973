"""A connection to one publisher, which delivers whole messages as bytes."""

from __future__ import annotations

import contextlib
import logging
import socket
import struct
import threading
from collections.abc import Callable

from typing_extensions import override

from bridge.adapters.ros1.compiled import Stream
from bridge.adapters.ros1.connection_loop import ConnectionLoop, is_readable, receiver
from bridge.adapters.ros1.topics.bus import TopicConnection
from bridge.adapters.ros1_peers import DeadlineSocket, Ros1ProtocolError
from bridge.routing.edge import Deliver

_log = logging.getLogger(__name__)

MAX_MESSAGE = 512 * 2**20
"""Size limit in bytes; a larger announced size counts as corrupt, and the connection is closed."""

_CLOSED = "the publisher closed the connection"
_LENGTH = struct.Struct("<I")
_CHUNK = 64 * 1024
_LARGE = 32 * 1024
_TRUSTED = 16 * 2**20
"""Maximum number of bytes that are allocated when a length is announced; more are allocated once these have arrived."""

Refused = Callable[[str, str], None]
"""``refused(reason, why)``: a message is not delivered; ``reason`` is ``bad`` or ``large``."""


class PublisherConnection(TopicConnection):
    """Reads one publisher's messages until the connection ends.

    The loop's thread reads them until a large message arrives; from then on, or without a loop, a separate thread reads
    them. ``dropped`` is the number of messages above the limit, which are not delivered. ``source`` identifies the
    publisher in calls of ``deliver(payload, source, None)``.
    """

    direction, joins = "i", True

    def __init__(
        self, sock: DeadlineSocket, topic: str, uri: str, deliver: Deliver, source: str,
        ended: Callable[[str], None], refused: Refused, limit: int = MAX_MESSAGE, loop: ConnectionLoop | None = None,
    ) -> None:  # fmt: skip
        super().__init__(sock, uri)  # its lock decides which thread closes the socket
        self._deliver, self._source, self._ended, self._refused, self._limit = deliver, source, ended, refused, limit
        self._loop, self._partial = loop, b""
        if Stream is not None and loop is not None:
            self.stream = Stream(deliver, source, min(limit, _LARGE))
        self._receive = receiver(self._sock, _CHUNK)
        self._started = self._has_partial = False
        self._thread = threading.Thread(target=self._run, name=f"midspan-ros1-in{topic}", daemon=True)

    def start(self) -> None:
        """Start reading, unless closed."""
        with self._lock:
            if self.done:
                return
            self._started = True
            try:
                if self._loop is not None:
                    if not self._loop.add(self):
                        self.done = True
                        self._sock.close()
                    return
            except OSError as err:
                _log.warning("%s is read on a separate thread: %s", self._thread.name, err)
        self._read_on_own_thread()

    @property
    def unread(self) -> bool:
        """Whether a message may have arrived, in full or in part, that has not been delivered yet."""
        with self._lock:  # prevents closing the socket meanwhile
            if self.done:
                return False
            readable = not self._started or is_readable(self._sock)  # first: what is read from now on shows below
            reading = self.stream is not None and self.stream.reading
            return readable or reading or self._has_partial or bool(self._partial)

    @override
    def counts(self) -> tuple[int, int]:
        size, messages = super().counts()
        return (size, messages) if self.stream is None else (size + self.stream.bytes, messages + self.stream.messages)

    def close(self) -> None:
        """Stop reading; nothing is delivered from now on."""
        if self.stream is not None:
            self.stream.closed = True
        with self._lock:
            self.done = True
            with contextlib.suppress(OSError):
                self._sock.shutdown(socket.SHUT_RDWR)
            if not self._started:
                self._sock.close()

    @override
    def on_ready(self) -> Callable[[], None] | None:
        """Deliver small messages; if a large message or the end is next, return a function that handles it."""
        try:
            has_large = self._deliver_small()
        except BlockingIOError:
            return None
        except OSError as err:
            return lambda err=err: self._end(str(err))  # type: ignore[misc]
        except Exception as err:
            _log.exception("reading %s failed", self._thread.name)
            return lambda err=err: self._end(f"{type(err).__name__}: {err}")  # type: ignore[misc]
        return self._read_on_own_thread if has_large else None

    def _read_on_own_thread(self) -> None:
        try:
            self._thread.start()
        except RuntimeError as err:  # the system is out of threads
            self._end(str(err))

    @override
    def abandon(self) -> None:
        with self._lock:
            self.done = True
            self._sock.close()

    def _run(self) -> None:
        trouble = _CLOSED
        try:
            partial, self._partial = self._partial, b""
            self._read(partial)
        except OSError as err:
            trouble = str(err)
        except Ros1ProtocolError as err:
            trouble = str(err)
            self._refused("bad", trouble)
        except Exception as err:
            trouble = f"{type(err).__name__}: {err}"
            _log.exception("reading %s failed", self._thread.name)
        self._end(trouble)

    def _end(self, trouble: str) -> None:
        with self._lock:
            self._sock.close()
        if not self.done:
            self.done = True
            self._ended(trouble)

    def _deliver_small(self) -> bool:
        """Deliver small messages; return whether a large message is next. Raises `BlockingIOError` without data."""
        stream, small = self.stream, min(self._limit, MAX_MESSAGE, _LARGE)
        self._has_partial = True  # before it is read: from then on, the socket does not show it
        try:
            more = (stream.take() if stream is not None and stream.reading else b"") or self._receive()
        except BlockingIOError:
            self._has_partial = False
            raise
        if not more:
            raise ConnectionResetError(_CLOSED)
        buffer, at = self._partial + more if self._partial else more, 0
        end = len(buffer)
        while (begin := at + 4) <= end:
            (size,) = _LENGTH.unpack_from(buffer, at)
            if size > small or end - begin < size:
                break
            at = begin + size
            self._hand_over(buffer[begin:at])
        else:
            size = 0
        self._partial = buffer[at:]
        if stream is not None:
            stream.direct = not (self._partial or self.done)
        self._has_partial = bool(size > small)
        return self._has_partial

    def _hand_over(self, payload: bytes) -> None:
        self.bytes += len(payload) + 4
        self.messages += 1
        if not self.done:
            self._deliver(payload, self._source, None)

    def _read(self, buffer: bytes = b"") -> None:
        """Read small messages in chunks; after a large message, read the next in one piece, without a copy."""
        at, size = 0, 0
        while not self.done:
            left = len(buffer) - at
            if left < 4:
                self._has_partial = left > 0
                if not left and not self._sock.recv(1, socket.MSG_PEEK):
                    return
                self._has_partial = True  # before it is read: from then on, the socket does not show it
                more = self._sock.recv(4 - left if size > _LARGE else _CHUNK)
                if not more:
                    return
                buffer, at = buffer[at:] + more, 0
                continue
            (size,) = _LENGTH.unpack_from(buffer, at)
            if size > MAX_MESSAGE:
                raise Ros1ProtocolError(
                    f"the publisher announces a message of {size} bytes, but the limit is {MAX_MESSAGE}"
                )
            at += 4
            if size > self._limit:
                self.dropped += 1
                self.bytes += size + 4
                self._refused("large", f"message of {size} bytes, limits.message allows {self._limit}")
                available = min(left - 4, size)
                at += available
                if not self._skip(size - available):
                    return
                continue
            if left - 4 >= size:
                payload = buffer[at : at + size]
                at += size
            else:
                tail = self._exactly(size - left + 4)
                if tail is None:
                    return
                payload = buffer[at:] + tail if left > 4 else tail
                buffer, at = b"", 0
            self._hand_over(payload)

    def _skip(self, count: int) -> bool:
        """Read ``count`` bytes and discard them; return False if the connection ends first."""
        scratch = bytearray(min(count, _CHUNK))
        while count:
            received = self._sock.recv_into(scratch, min(count, _CHUNK))
            if not received:
                return False
            count -= received
        return True

    def _exactly(self, count: int) -> bytes | None:
        data = self._sock.recv(min(count, _TRUSTED), socket.MSG_WAITALL)
        if len(data) == count:
            return data
        parts = [data]
        while data and (count := count - len(data)):
            data = self._sock.recv(count, socket.MSG_WAITALL)
            parts.append(data)
        return b"".join(parts) if data else None
