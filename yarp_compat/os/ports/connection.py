"""Base classes for callbacks: ``PortReader`` receives messages, ``PortReport`` connection events.

A `PortReader` reads a message from a ``ConnectionReader``, and writes its reply to a ``ConnectionWriter``.
"""

from __future__ import annotations

import contextlib
import logging
import struct
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from yarp_compat.os.ports.contact import Contact
from yarp_compat.ports.connections import ConnectionEvent
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.accessors import always, getter
from yarp_compat.wire.binary import decode_prefix
from yarp_compat.wire.contact import ConnectionRoute
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import Buffer, PortCommand
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.reply import recognize
from yarp_compat.wire.text import to_text

T = TypeVar("T", int, float)

log = logging.getLogger("yarp.os.ConnectionReader")


def _append(layout: str, doc: str) -> Callable[[ConnectionWriter, Any], None]:
    def append(self: ConnectionWriter, value: Any) -> None:
        self._append_number(layout, value)

    append.__doc__ = doc
    return append


def _expect(kind: type[T], layout: str, doc: str) -> Callable[[ConnectionReader], T]:
    def expect(self: ConnectionReader) -> T:
        return kind(self._read_number(layout))

    expect.__doc__ = doc
    return expect


class ConnectionWriter:
    """A buffer for a reply."""

    def __init__(self, profile: Profile, *, text: bool = False) -> None:
        self.writer = ElementWriter(profile)
        self._text = text
        self._failed = False

    appendInt8 = _append("<b", "Append an int of one byte.")
    appendInt16 = _append("<h", "Append an int of two bytes.")
    appendInt32 = _append("<i", "Append an int of four bytes.")
    appendInt64 = _append("<q", "Append an int of eight bytes.")
    appendFloat32 = _append("<f", "Append a float of four bytes.")
    appendFloat64 = _append("<d", "Append a float of eight bytes.")

    def appendString(self, text: str) -> None:
        """Append the text's length in four bytes, and the text."""
        self.writer.string(text, tagged=False)

    def appendText(self, text: str, terminate: str = "\n") -> None:
        """Append the text and a final character."""
        self.writer.block((text + terminate).encode())

    def appendBlock(self, data: Buffer, length: int | None = None) -> None:
        """Append raw bytes."""
        self.writer.block(bytes(data[:length]))

    appendExternalBlock = appendBlock

    isTextMode = getter("_text", bool, "Whether the peer reads text; the port converts the reply.")
    isBareMode = always(False, "Whether the peer reads bytes without tags: never here.")
    convertTextMode = always(True, "Nothing to do: the port converts replies to text.")
    isValid = always(True, "Whether a reply can be written.")

    isActive = isValid

    isNull = always(False, "Whether written data is discarded.")
    isError = getter("_failed", bool, "Whether a value could not be written.")

    def lines(self) -> bytes | None:
        """Return the content as text, one line for each Bottle; None if it is not a sequence of Bottles."""
        data = b"".join(self.writer.buffers())
        lines, at = [], 0
        try:
            while at < len(data):
                values, at = decode_prefix(data, self.writer.profile, at)
                lines.append(to_text(values) + "\r\n")
        except WireError:
            return None
        return "".join(lines).encode(errors="surrogateescape")

    def _append_number(self, layout: str, value: Any) -> None:
        try:
            self.writer.raw(struct.Struct(layout), value)
        except WireError as err:
            log.error("cannot write a reply: %s", err)
            self._failed = True


class ConnectionReader:
    """A reader of one message, or of none when the port closes.

    Missing or invalid content is read as 0 or as an empty text or block, and sets `isError`.
    """

    def __init__(self, message: PortMessage | None, local: Contact, profile: Profile = Profile.YARP3) -> None:
        self._message = message
        self._local = local
        self._failed = False
        data: Buffer = b"" if message is None else message.payload
        self._size = memoryview(data).nbytes
        self.reader = ElementReader(data, profile_of(message, profile))
        wanted = message is not None and message.wants_reply
        text = message is not None and message.peer.carrier.text
        self._writer = ConnectionWriter(self.reader.profile, text=text) if wanted else None

    expectInt8 = _expect(int, "<b", "Read an int of one byte.")
    expectInt16 = _expect(int, "<h", "Read an int of two bytes.")
    expectInt32 = _expect(int, "<i", "Read an int of four bytes.")
    expectInt64 = _expect(int, "<q", "Read an int of eight bytes.")
    expectFloat32 = _expect(float, "<f", "Read a float of four bytes.")
    expectFloat64 = _expect(float, "<d", "Read a float of eight bytes.")

    def expectString(self) -> str:
        """Read a length in four bytes, and a text of that length."""
        return self.expectBlock(self.expectInt32()).decode("utf-8", "surrogateescape")

    def expectBlock(self, length: int) -> bytes:
        """Read raw bytes."""
        try:
            return bytes(self.reader.block(length if length >= 0 else sys.maxsize))
        except WireError as err:
            self._fail(err)
            return b""

    def expectText(self, terminatingChar: str | int = "\n") -> str:
        """Read text up to a terminating character, and skip the character."""
        stop = terminatingChar.encode() if isinstance(terminatingChar, str) else bytes([terminatingChar])
        unread = bytes(self.reader.data[self.reader.at :])
        text, end, _ = unread.partition(stop)
        self.reader.at += len(text) + len(end)
        return text.decode("utf-8", "surrogateescape")

    isTextMode = always(False, "Whether the bytes are text: never, the port has converted it to a Bottle.")
    isBareMode = always(False, "Whether the bytes have no tags: never here.")
    convertTextMode = always(True, "Nothing to do: the port has converted text to a Bottle.")

    def getSize(self) -> int:
        """Return the number of unread bytes."""
        return self._size - self.reader.at

    def getWriter(self) -> ConnectionWriter | None:
        """Return the writer of the reply; None if no reply is wanted."""
        return self._writer

    def readEnvelope(self) -> str:
        """Return the message's envelope as text."""
        return "" if self._message is None else self._message.envelope

    def getRemoteContact(self) -> Contact:
        """Return the sender's contact, with only its name."""
        return Contact("" if self._message is None else self._message.peer.route.source)

    getLocalContact = getter("_local", Contact, "The contact of the receiver.")

    def isValid(self) -> bool:
        """Return whether this has a message; if not, the port is closing."""
        return self._message is not None

    isActive = isValid

    isError = getter("_failed", bool, "Whether content was missing or of another type.")

    def requestDrop(self) -> None:
        """End the connection after this message."""
        if self._message is not None:
            self._message.drop()

    def _read_number(self, layout: str) -> Any:
        try:
            return self.reader.raw(struct.Struct(layout))[0]
        except WireError as err:
            self._fail(err)
            return 0

    def _fail(self, err: WireError) -> None:
        if not self._failed:
            log.warning(
                "a message from %s is shorter than its reader expects: %s", self.getRemoteContact().getName(), err
            )
        self._failed = True


def profile_of(message: PortMessage | None, default: Profile) -> Profile:
    """Return the dialect of a message: its sender's if known, else detected from the bytes, else the default."""
    return (sender_profile(message) if message is not None else None) or default


def sender_profile(message: PortMessage) -> Profile | None:
    """Return the dialect of a message's sender; None if no message has shown it so far."""
    if message.peer.profile is None:
        with contextlib.suppress(WireError):
            message.peer.profile = recognize(message.payload)
    return message.peer.profile


@dataclass
class PortInfo:
    """An item of a port's report.

    ``tag`` is `PORTINFO_CONNECTION` or `PORTINFO_MISC`; ``created`` is False if a connection closed; ``message`` has
    the same content as text.
    """

    PORTINFO_NULL = 0
    PORTINFO_CONNECTION = 1
    PORTINFO_MISC = 2

    tag: int = PORTINFO_NULL
    incoming: bool = False
    created: bool = True
    portName: str = ""
    sourceName: str = ""
    targetName: str = ""
    carrierName: str = ""
    message: str = ""


class PortReport:
    """The base class of receivers of connection events, for ``port.getReport(r)`` and ``port.setReporter(r)``."""

    def report(self, info: PortInfo) -> None:
        """Handle one item of a report."""
        raise NotImplementedError(f"{type(self).__name__} has no report")


def report(core: PortCore, reporter: PortReport, event: ConnectionEvent | None = None) -> None:
    """Report one event, or a port and all its connections."""
    if event is not None:
        reporter.report(_connection(core.name, event.route, incoming=event.incoming, created=event.up))
        return
    reporter.report(PortInfo(PortInfo.PORTINFO_MISC, portName=core.name, message=core.execute(PortCommand("*"))[0]))
    for route in core.outputs():
        reporter.report(_connection(core.name, route, incoming=False, created=True))
    for route in core.inputs():
        reporter.report(_connection(core.name, route, incoming=True, created=True))


def _connection(name: str, route: ConnectionRoute, *, incoming: bool, created: bool) -> PortInfo:
    kind = "input" if incoming else "output"
    text = f"There is an {kind} connection from {route.source} to {route.target} using {route.carrier}"
    tag = PortInfo.PORTINFO_CONNECTION
    return PortInfo(tag, incoming, created, name, route.source, route.target, route.carrier, text)
