"""Base classes for a program's callbacks: ``PortReader`` gets messages, ``PortReport`` events of connections.

``ConnectionReader`` and ``ConnectionWriter`` are a message as a `PortReader` gets it, and the reply it writes.
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
from yarp_compat.wire.reply import recognise
from yarp_compat.wire.text import to_text

T = TypeVar("T", int, float)

log = logging.getLogger("yarp.os.ConnectionReader")


def _append(layout: str, doc: str) -> Callable[[ConnectionWriter, Any], None]:
    def append(self: ConnectionWriter, value: Any) -> None:
        self._put(layout, value)

    append.__doc__ = doc
    return append


def _expect(kind: type[T], layout: str, doc: str) -> Callable[[ConnectionReader], T]:
    def expect(self: ConnectionReader) -> T:
        return kind(self._take(layout))

    expect.__doc__ = doc
    return expect


class ConnectionWriter:
    """Collects a reply."""

    def __init__(self, profile: Profile, *, text: bool = False) -> None:
        self.writer = ElementWriter(profile)
        self._text = text
        self._failed = False

    appendInt8 = _append("<b", "One byte.")
    appendInt16 = _append("<h", "Two bytes.")
    appendInt32 = _append("<i", "Four bytes.")
    appendInt64 = _append("<q", "Eight bytes.")
    appendFloat32 = _append("<f", "Four bytes.")
    appendFloat64 = _append("<d", "Eight bytes.")

    def appendString(self, text: str) -> None:
        """The text's length in four bytes, and the text."""
        self.writer.string(text, tagged=False)

    def appendText(self, text: str, terminate: str = "\n") -> None:
        """The text and a last character."""
        self.writer.block((text + terminate).encode())

    def appendBlock(self, data: Buffer, length: int | None = None) -> None:
        """Bytes as they are."""
        self.writer.block(bytes(data[:length]))

    appendExternalBlock = appendBlock

    isTextMode = getter("_text", bool, "Whether the peer reads text; the reply is turned into it by the port.")
    isBareMode = always(False, "Whether the peer reads bytes without tags: never here.")
    convertTextMode = always(True, "Nothing to do: the port turns replies into text.")
    isValid = always(True, "Whether a reply can be written.")

    isActive = isValid

    isNull = always(False, "Whether what is written goes nowhere.")
    isError = getter("_failed", bool, "Whether something could not be written.")

    def lines(self) -> bytes | None:
        """What was written as text, a line for each value; None where it is no values one after another."""
        data = b"".join(self.writer.buffers())
        lines, at = [], 0
        try:
            while at < len(data):
                values, at = decode_prefix(data, self.writer.profile, at)
                lines.append(to_text(values) + "\r\n")
        except WireError:
            return None
        return "".join(lines).encode(errors="surrogateescape")

    def _put(self, layout: str, value: Any) -> None:
        try:
            self.writer.raw(struct.Struct(layout), value)
        except WireError as err:
            log.error("a reply cannot be written: %s", err)
            self._failed = True


class ConnectionReader:
    """Reads one message, or as a port's end none. Missing or wrong content reads as 0 and sets `isError`."""

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

    expectInt8 = _expect(int, "<b", "One byte.")
    expectInt16 = _expect(int, "<h", "Two bytes.")
    expectInt32 = _expect(int, "<i", "Four bytes.")
    expectInt64 = _expect(int, "<q", "Eight bytes.")
    expectFloat32 = _expect(float, "<f", "Four bytes.")
    expectFloat64 = _expect(float, "<d", "Eight bytes.")

    def expectString(self) -> str:
        """A length in four bytes, and as much text."""
        return self.expectBlock(self.expectInt32()).decode("utf-8", "surrogateescape")

    def expectBlock(self, length: int) -> bytes:
        """Bytes as they are."""
        try:
            return bytes(self.reader.block(length if length >= 0 else sys.maxsize))
        except WireError as err:
            self._fail(err)
            return b""

    def expectText(self, terminatingChar: str | int = "\n") -> str:
        """Text up to a character."""
        stop = terminatingChar.encode() if isinstance(terminatingChar, str) else bytes([terminatingChar])
        rest = bytes(self.reader.data[self.reader.at :])
        text, found, _ = rest.partition(stop)
        self.reader.at += len(text) + len(found)
        return text.decode("utf-8", "surrogateescape")

    isTextMode = always(False, "Whether the bytes are text: never, the port has turned it into a Bottle.")
    isBareMode = always(False, "Whether the bytes have no tags: never here.")
    convertTextMode = always(True, "Nothing to do: the port has turned text into a Bottle.")

    def getSize(self) -> int:
        """The number of bytes left in the message."""
        return self._size - self.reader.at

    def getWriter(self) -> ConnectionWriter | None:
        """The writer of the reply; None when no reply is wanted."""
        return self._writer

    def readEnvelope(self) -> str:
        """The message's envelope as text."""
        return "" if self._message is None else self._message.envelope

    def getRemoteContact(self) -> Contact:
        """The contact of the sender, by name."""
        return Contact("" if self._message is None else self._message.peer.route.source)

    getLocalContact = getter("_local", Contact, "The contact of the receiver.")

    def isValid(self) -> bool:
        """Whether there is a message; otherwise the port closes."""
        return self._message is not None

    isActive = isValid

    isError = getter("_failed", bool, "Whether something was missing or of another kind.")

    def requestDrop(self) -> None:
        """Ask that the connection end with this message."""
        if self._message is not None:
            self._message.drop()

    def _take(self, layout: str) -> Any:
        try:
            return self.reader.raw(struct.Struct(layout))[0]
        except WireError as err:
            self._fail(err)
            return 0

    def _fail(self, err: WireError) -> None:
        if not self._failed:
            log.warning(
                "a message of %s is shorter than its reader expects: %s", self.getRemoteContact().getName(), err
            )
        self._failed = True


def profile_of(message: PortMessage | None, default: Profile) -> Profile:
    """The dialect of a message: its sender's where that is known, else told by the bytes, else the default."""
    return (recognised(message) if message is not None else None) or default


def recognised(message: PortMessage) -> Profile | None:
    """The dialect of a message's sender, as known up to now; None where nothing that came has told it."""
    if message.peer.profile is None:
        with contextlib.suppress(WireError):
            message.peer.profile = recognise(message.payload)
    return message.peer.profile


@dataclass
class PortInfo:
    """One thing about a port.

    ``tag`` is `PORTINFO_CONNECTION` or `PORTINFO_MISC`; ``created`` is False where a connection went; ``message`` is
    the same in words.
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
    """Derive from it to get events of connections: ``port.getReport(reporter)``, ``port.setReporter(reporter)``."""

    def report(self, info: PortInfo) -> None:
        """Take one thing about a port."""
        raise NotImplementedError(f"{type(self).__name__} has no report")


def report(core: PortCore, reporter: PortReport, event: ConnectionEvent | None = None) -> None:
    """Tell a reporter of one event, or of a port and all its connections."""
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
    words = f"There is an {kind} connection from {route.source} to {route.target} using {route.carrier}"
    tag = PortInfo.PORTINFO_CONNECTION
    return PortInfo(tag, incoming, created, name, route.source, route.target, route.carrier, words)
