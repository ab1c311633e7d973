"""Outgoing messages, encoded once for each carrier and dialect, and the send queue of one connection."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from yarp_compat.ports.message import Payload
from yarp_compat.ports.sockets import flat
from yarp_compat.wire import carriers, framing
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.carriers import Carrier
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text, to_text


def to_line(payload: Payload, profile: Profile | None = None, *, plain: bool = False) -> bytes:
    """Return a Bottle as a line with CR LF, or ``plain`` text unchanged; raises `WireError` if it is not a Bottle."""
    data = payload if isinstance(payload, (bytes, bytearray, memoryview)) else b"".join(payload)
    if plain:
        return bytes(data)
    return to_text(decode(data, profile)).encode(errors="surrogateescape") + b"\r\n"


def from_line(line: bytes, profile: Profile) -> bytes:
    """Return the bytes of the Bottle in a line."""
    return encode(from_text(line.decode(errors="surrogateescape")), profile)


ITEM_BYTES = 192  # overhead of a queued message in bytes (measured: 174 in CPython 3.11)


@dataclass(slots=True, eq=False)
class Item:
    """A message being sent."""

    buffers: list[Buffer]
    writer_completes: bool  # the writing thread completes the message, not the shared thread
    done: bool = False
    dropped: bool = False  # a newer message replaced it, or the queue was full

    def copy_bytes(self) -> None:
        """Copy the bytes, so that their owner may change them from now on."""
        if self.buffers:
            self.buffers = [b"".join(self.buffers)]


class SendQueue:
    """A queue bounded in bytes, overhead included; a single message always fits."""

    def __init__(self, limit: int, dropped: Callable[[str], None]) -> None:
        self._limit = limit
        self._dropped = dropped
        self._items: deque[Item] = deque()
        self._bytes = 0

    def __bool__(self) -> bool:
        return bool(self._items)

    def put(self, item: Item, strict: bool) -> None:
        """Queue a message and drop the oldest if the queue is full; if not ``strict``, first drop all others."""
        if not strict:
            while (replaced := self.next()) is not None:
                self._drop(replaced, "replaced")
        size = _cost(item)
        while self._bytes + size > self._limit and (oldest := self.next()) is not None:
            self._drop(oldest, "full")
        self._items.append(item)
        self._bytes += size

    def _drop(self, item: Item, reason: str) -> None:
        item.dropped = True
        self._dropped(reason)

    def next(self) -> Item | None:
        """Remove and return the oldest message, if any."""
        if not self._items:
            return None
        item = self._items.popleft()
        self._bytes -= _cost(item)
        return item

    def clear(self) -> int:
        """Empty the queue; return how many messages it had."""
        count = len(self._items)
        self._items.clear()
        self._bytes = 0
        return count


def _cost(item: Item) -> int:
    return framing.size(item.buffers) + ITEM_BYTES


Content = Payload | Callable[[Profile], Payload]  # a payload, or a function that encodes it in the reader's dialect


class OutgoingMessage:
    """One message: ``key`` is ``D``, or ``d`` if a reply is wanted; ``text`` returns the line for text carriers."""

    __slots__ = ("_content", "_envelope", "_key", "_text", "_written")

    def __init__(self, content: Content, envelope: str, key: str, text: Callable[[], str] | None = None) -> None:
        self._content = content
        self._envelope = envelope if envelope.isprintable() else _one_line(envelope)
        self._key = key
        self._text = text
        self._written: list[tuple[Carrier | None, Profile, list[Buffer]]] = []

    def buffers(self, carrier: Carrier, profile: Profile) -> list[Buffer]:
        """Return the message's bytes for an output."""
        kind = carrier if carrier.text else None
        for written_kind, written_profile, parts in self._written:
            if written_kind is kind and written_profile is profile:
                return parts
        payload = self._content(profile) if callable(self._content) else self._content
        parts = [self._line(payload, carrier, profile)] if carrier.text else framed(payload, self._envelope, self._key)
        self._written.append((kind, profile, parts))
        return parts

    def _line(self, payload: Payload, carrier: Carrier, profile: Profile) -> bytes:
        content = self._text().encode(errors="surrogateescape") + b"\r\n" if self._text else to_line(payload, profile)
        if carrier is carriers.HTTP:
            return b"%x\r\n%b\r\n" % (len(content), content)  # a chunk of the page
        command = f"{self._key} {self._envelope}" if self._envelope else self._key
        return command.encode() + b"\r\n" + content


def _one_line(envelope: str) -> str:
    """Return an envelope up to its first control character, as YARP sends it."""
    return next((envelope[:i] for i, c in enumerate(envelope) if ord(c) < 32), envelope)


def framed(payload: Payload, envelope: str, key: str) -> list[Buffer]:
    """Return the bytes of a message for binary carriers."""
    if isinstance(payload, bytes):
        head = framing.prefix(len(payload), key, envelope)
        return [head + payload] if len(payload) < framing.JOINED else [head, payload]
    buffers = [payload] if isinstance(payload, (bytearray, memoryview)) else payload
    return flat([framing.prefix(framing.size(payload), key, envelope), *buffers])
