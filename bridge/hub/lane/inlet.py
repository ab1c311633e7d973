"""The reading end of a lane: a connection to one writing session, and the subscriptions that use it."""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import time
from collections.abc import Callable
from functools import partial
from threading import Lock, Thread
from typing import Protocol

from bridge.hub.errors import HubWireError
from bridge.hub.lane.lent import LentPayload, Mapped
from bridge.hub.lane.numbering import Receiver, read_lane
from bridge.hub.lane.wire import (
    BLOCK,
    BODY,
    DATA,
    FENCE,
    FREE,
    HEAD,
    LOAN,
    MARK,
    OFF,
    ON,
    PART,
    PIECE,
    ROOM,
    SAMPLE,
    TOKEN,
)
from bridge.hub.wire.keys import unpack_attachment
from bridge.hub.zenoh_config import MAX_PAYLOAD

_log = logging.getLogger(__name__)


class LaneReader(Protocol):
    """A subscription that receives from lanes; called on the connection's thread."""

    key: str
    receiver: Receiver | None
    """Handles plain messages instead of `on_message`, if it is the only subscription to its key."""

    def on_message(self, inlet: Inlet, attachment: tuple[int, int, bytes], payload: bytes | LentPayload) -> None:
        """Handle a message; ``attachment`` is its number, source time and publisher (GID), ``payload`` is CDR."""

    def on_mark(self, inlet: Inlet, gid: bytes, sequence: int) -> None:
        """Handle a mark: the publisher sends all messages after this number on this lane."""

    def on_fence(self, inlet: Inlet) -> None:
        """Handle a returned fence: everything sent on this lane before the call of `Inlet.fence` has arrived."""


class _Key:
    """A key on one lane, with its subscriptions and incomplete messages."""

    __slots__ = ("number", "parts", "readers")

    def __init__(self, number: int) -> None:
        self.number = number
        self.readers: tuple[LaneReader, ...] = ()
        self.parts: dict[bytes, tuple[int, bytearray]] = {}


class Inlet:
    """A connection to one writing session. Safe to use from any thread.

    Args:
        lost: called when the connection ends.
        later: calls a function after some seconds.

    Attributes:
        zid: the writing session.
        since: time at which the connection was opened (monotonic seconds).
        alive: whether the connection is open.
        answered: whether a mark, fence or part was received yet.
    """

    def __init__(
        self, sock: socket.socket, zid: str, lost: Callable[[Inlet], None],
        later: Callable[[float, Callable[[], None]], None],
    ) -> None:  # fmt: skip
        self.zid = zid
        self.since = time.monotonic()
        self.alive, self.answered = True, False
        self._sock, self._lost = sock, lost
        self._mapped = Mapped(later)
        self._lock = Lock()
        self._keys: dict[str, _Key] = {}
        self._numbers: dict[int, _Key] = {}
        self._receivers: dict[int, Receiver] = {}
        self._fences: dict[int, LaneReader] = {}
        self._next = 0
        self._thread = Thread(target=self._run, name="hub-lane-read", daemon=True)
        self._thread.start()

    def join(self, reader: LaneReader) -> None:
        """Request the messages on the reader's key, and a mark from each publisher."""
        with self._lock:
            key = self._keys.get(reader.key)
            if key is None:
                self._next += 1
                key = self._keys[reader.key] = self._numbers[self._next] = _Key(self._next)
            if reader not in key.readers:
                key.readers += (reader,)
            self._set_receiver(key)
            self._send(HEAD.pack(ON, key.number) + reader.key.encode())

    def fence(self, reader: LaneReader) -> None:
        """Request a fence: `LaneReader.on_fence` is called after everything that was sent until now."""
        with self._lock:
            key = self._keys.get(reader.key)
            if key is not None:
                self._next += 1
                self._fences[self._next] = reader
                self._send(HEAD.pack(FENCE, key.number) + TOKEN.pack(self._next))

    def leave(self, reader: LaneReader) -> None:
        """Stop delivering to the reader."""
        with self._lock:
            key = self._keys.get(reader.key)
            if key is None:
                return
            key.readers = tuple(other for other in key.readers if other is not reader)
            self._set_receiver(key)
            if not key.readers:
                del self._keys[reader.key], self._numbers[key.number]
                self._send(HEAD.pack(OFF, key.number))

    def _set_receiver(self, key: _Key) -> None:
        receiver = key.readers[0].receiver if len(key.readers) == 1 else None
        if receiver is not None:
            self._receivers[key.number] = receiver
        else:
            self._receivers.pop(key.number, None)

    def close(self) -> None:
        """Close the connection. Safe to call twice."""
        self.alive = False
        with contextlib.suppress(OSError):
            self._sock.shutdown(socket.SHUT_RDWR)

    def _send(self, record: bytes) -> None:
        try:
            self._sock.send(record, socket.MSG_DONTWAIT)
        except OSError as err:  # the writer has exited, or does not read
            _log.debug("the lane from %s ends: %s", self.zid, err)
            self.close()

    def _run(self) -> None:
        try:
            if read_lane is not None:
                read_lane(self._sock.fileno(), ROOM, self._receivers, self._message, self._record)
            else:
                self._read()
        except (OSError, HubWireError, ValueError) as err:
            _log.debug("the lane from %s ends: %s", self.zid, err)
        except Exception:
            _log.exception("the lane from %s failed", self.zid)
        finally:
            self.close()
            self._sock.close()
            self._mapped.close()
            self._lost(self)

    def _read(self) -> None:
        while True:
            record, files, _, _ = socket.recv_fds(self._sock, ROOM, 1, socket.MSG_CMSG_CLOEXEC)
            if not record:
                for file in files:
                    os.close(file)
                return
            if record[0] == DATA and not files:
                self._messages(record)
            else:
                self._record(record, files[0] if files else -1)

    def _record(self, record: bytes, file: int) -> None:
        """Handle a record without messages, and the file that came with it; -1 if there is none."""
        try:
            kind, number = HEAD.unpack_from(record)
            payload = self._lent(record, file) if kind == BLOCK else None
        finally:
            if file >= 0:
                os.close(file)
        key = self._numbers.get(number)
        if key is not None:
            self.answered = True
            if payload is not None:
                self._hand(key, unpack_attachment(record[HEAD.size : BODY]), payload)
            elif kind != BLOCK:
                self._other(kind, key, record[HEAD.size : BODY], record)

    def _lent(self, record: bytes, file: int) -> LentPayload | bytes:
        """Return a message in a block, which is given back when all readers have dropped the message.

        Raises `OSError` if this process had no descriptor left. Then the lane ends, so that zenoh carries the messages.
        """
        size, loan, block = LOAN.unpack_from(record, BODY)
        if size > MAX_PAYLOAD:
            raise HubWireError(f"a block has a message of {size} bytes, the limit is {MAX_PAYLOAD}")
        give_back = partial(self._send, HEAD.pack(FREE, loan))
        view = self._mapped.view(block, file, size)
        if isinstance(view, memoryview):
            return LentPayload(view, give_back)
        give_back()
        return view

    def _messages(self, record: bytes) -> None:
        """Deliver the messages in a record."""
        end, whole = 0, len(record)
        while end < whole:
            begin = end + SAMPLE.size
            _, number, size, sequence, time_ns, gid = SAMPLE.unpack_from(record, end)
            end = begin + size
            if end > whole:
                raise HubWireError(f"a record of {whole} bytes ends within a message")
            self._message(number, (sequence, time_ns, gid), record[begin:end])

    def _message(self, number: int, attachment: tuple[int, int, bytes], payload: bytes) -> None:
        key = self._numbers.get(number)
        if key is not None:
            self._hand(key, attachment, payload)

    def _hand(self, key: _Key, message: tuple[int, int, bytes], payload: bytes | LentPayload) -> None:
        for reader in key.readers:
            try:
                reader.on_message(self, message, payload)
            except Exception:  # the other subscriptions must still receive the message
                _log.exception("a message from the lane was not handled")

    def _other(self, kind: int, key: _Key, attachment: bytes, record: bytes) -> None:
        if kind == MARK:
            sequence, _, gid = unpack_attachment(attachment)
            for reader in key.readers:
                reader.on_mark(self, gid, sequence)
        elif kind == FENCE:
            (token,) = TOKEN.unpack(record[HEAD.size :])
            with self._lock:
                fenced = self._fences.pop(token, None)
            if fenced is not None:
                fenced.on_fence(self)
        elif kind == PART:
            self._part(key, attachment, record)

    def _part(self, key: _Key, attachment: bytes, record: bytes) -> None:
        message = unpack_attachment(attachment)
        sequence, gid = message[0], message[2]
        whole, at = PIECE.unpack_from(record, BODY)
        piece = record[BODY + PIECE.size :]
        if at == 0:
            key.parts[gid] = (sequence, bytearray())
        number, data = key.parts.get(gid, (0, bytearray()))
        if number != sequence or len(data) != at:  # the beginning was dropped
            return
        if at + len(piece) > whole or whole > MAX_PAYLOAD:
            del key.parts[gid]
            return
        data += piece
        if len(data) == whole:
            del key.parts[gid]
            self._hand(key, message, bytes(data))
