"""A message on its way to several outputs: written once for each carrier and dialect among them."""

from __future__ import annotations

from collections.abc import Callable

from yarp_compat.ports.lines import to_line
from yarp_compat.ports.message import Payload
from yarp_compat.ports.sending import flat
from yarp_compat.wire import carriers, message
from yarp_compat.wire.carriers import Carrier
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile

Content = Payload | Callable[[Profile], Payload]
"""A payload, or what makes it in the dialect of its reader."""


class Outgoing:
    """One message.

    Args:
        content: its payload.
        envelope: sent with it, or "".
        key: ``D``, or ``d`` where a reply is wanted.
        text: makes the line for text carriers; None: the payload's own text.
    """

    __slots__ = ("_content", "_envelope", "_key", "_text", "_written")

    def __init__(self, content: Content, envelope: str, key: str, text: Callable[[], str] | None = None) -> None:
        self._content = content
        self._envelope = envelope if envelope.isprintable() else _one_line(envelope)
        self._key = key
        self._text = text
        self._written: list[tuple[Carrier | None, Profile, list[Buffer]]] = []

    def buffers(self, carrier: Carrier, profile: Profile) -> list[Buffer]:
        """All bytes of the message for an output."""
        kind = carrier if carrier.text else None
        for written_kind, written_profile, found in self._written:
            if written_kind is kind and written_profile is profile:
                return found
        payload = self._content(profile) if callable(self._content) else self._content
        found = [self._line(payload, carrier, profile)] if carrier.text else framed(payload, self._envelope, self._key)
        self._written.append((kind, profile, found))
        return found

    def _line(self, payload: Payload, carrier: Carrier, profile: Profile) -> bytes:
        content = self._text().encode(errors="surrogateescape") + b"\r\n" if self._text else to_line(payload, profile)
        if carrier is carriers.HTTP:
            return b"%x\r\n%b\r\n" % (len(content), content)  # a chunk of the page
        word = f"{self._key} {self._envelope}" if self._envelope else self._key
        return word.encode() + b"\r\n" + content


def _one_line(envelope: str) -> str:
    """An envelope up to its first control character, as YARP sends it."""
    return next((envelope[:i] for i, c in enumerate(envelope) if ord(c) < 32), envelope)


def framed(payload: Payload, envelope: str, key: str) -> list[Buffer]:
    """All bytes of a message in binary."""
    if isinstance(payload, bytes):
        head = message.prefix(len(payload), key, envelope)
        return [head + payload] if len(payload) < message.JOINED else [head, payload]
    buffers = [payload] if isinstance(payload, (bytearray, memoryview)) else payload
    return flat([message.prefix(message.size(payload), key, envelope), *buffers])
