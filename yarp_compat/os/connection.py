"""``ConnectionReader`` and ``ConnectionWriter``: a message as a `PortReader` gets it, and the reply it writes."""

from __future__ import annotations

import contextlib
import logging
import struct
import sys
from typing import Any

from yarp_compat.os.contact import Contact
from yarp_compat.ports.message import Message
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.reply import recognise
from yarp_compat.wire.writer import Writer

log = logging.getLogger("yarp.os.ConnectionReader")


class PortReader:
    """Derive from it to take messages as they come: ``port.setReader(reader)``."""

    def read(self, connection: ConnectionReader) -> bool:
        """Take one message; it may answer by ``connection.getWriter()``.

        Returns:
            False when it could not use the message. An invalid connection (``connection.isValid()``) means the end.
        """
        raise NotImplementedError(f"{type(self).__name__} has no read")


class ConnectionWriter:
    """Collects a reply."""

    def __init__(self, profile: Profile, *, text: bool = False) -> None:
        self.writer = Writer(profile)
        self._text = text
        self._failed = False

    def appendInt8(self, value: int) -> None:
        """One byte."""
        self._put("<b", value)

    def appendInt16(self, value: int) -> None:
        """Two bytes."""
        self._put("<h", value)

    def appendInt32(self, value: int) -> None:
        """Four bytes."""
        self._put("<i", value)

    def appendInt64(self, value: int) -> None:
        """Eight bytes."""
        self._put("<q", value)

    def appendFloat32(self, value: float) -> None:
        """Four bytes."""
        self._put("<f", value)

    def appendFloat64(self, value: float) -> None:
        """Eight bytes."""
        self._put("<d", value)

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

    def isTextMode(self) -> bool:
        """Whether the peer reads text; the reply is turned into it by the port."""
        return self._text

    def isBareMode(self) -> bool:
        """Whether the peer reads bytes without tags: never here."""
        return False

    def convertTextMode(self) -> bool:
        """Nothing to do: the port turns replies into text."""
        return True

    def isValid(self) -> bool:
        """Whether a reply can be written."""
        return True

    isActive = isValid

    def isNull(self) -> bool:
        """Whether what is written goes nowhere."""
        return False

    def isError(self) -> bool:
        """Whether something could not be written."""
        return self._failed

    def _put(self, layout: str, value: Any) -> None:
        try:
            self.writer.raw(struct.Struct(layout), value)
        except WireError as err:
            log.error("a reply cannot be written: %s", err)
            self._failed = True


class ConnectionReader:
    """One message, to be read from its beginning. What is missing or of another kind reads as 0, and `isError` tells.

    Args:
        message: what came; None for the end of a port.
        local: the port's own contact.
        profile: the dialect where the peer's is not known.
    """

    def __init__(self, message: Message | None, local: Contact, profile: Profile = Profile.YARP3) -> None:
        self._message = message
        self._local = local
        self._failed = False
        data: Buffer = b"" if message is None else message.payload
        self._size = memoryview(data).nbytes
        self.reader = Reader(data, profile_of(message, profile))
        wanted = message is not None and message.wants_reply
        text = message is not None and message.peer.carrier.text
        self._writer = ConnectionWriter(self.reader.profile, text=text) if wanted else None

    def expectInt8(self) -> int:
        """One byte."""
        return int(self._take("<b"))

    def expectInt16(self) -> int:
        """Two bytes."""
        return int(self._take("<h"))

    def expectInt32(self) -> int:
        """Four bytes."""
        return int(self._take("<i"))

    def expectInt64(self) -> int:
        """Eight bytes."""
        return int(self._take("<q"))

    def expectFloat32(self) -> float:
        """Four bytes."""
        return float(self._take("<f"))

    def expectFloat64(self) -> float:
        """Eight bytes."""
        return float(self._take("<d"))

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

    def isTextMode(self) -> bool:
        """Whether the bytes are text: never, the port has turned it into a Bottle."""
        return False

    def isBareMode(self) -> bool:
        """Whether the bytes have no tags: never here."""
        return False

    def convertTextMode(self) -> bool:
        """Nothing to do: the port has turned text into a Bottle."""
        return True

    def getSize(self) -> int:
        """How many bytes the message has left."""
        return self._size - self.reader.at

    def getWriter(self) -> ConnectionWriter | None:
        """Where to write the reply; None when none is wanted."""
        return self._writer

    def readEnvelope(self) -> str:
        """The message's envelope as text."""
        return "" if self._message is None else self._message.envelope

    def getRemoteContact(self) -> Contact:
        """Who sent it, by name."""
        return Contact("" if self._message is None else self._message.peer.route.source)

    def getLocalContact(self) -> Contact:
        """Who got it."""
        return self._local

    def isValid(self) -> bool:
        """Whether there is a message; otherwise the port closes."""
        return self._message is not None

    isActive = isValid

    def isError(self) -> bool:
        """Whether something was missing or of another kind."""
        return self._failed

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


def profile_of(message: Message | None, default: Profile) -> Profile:
    """The dialect of a message: its sender's where that is known, else told by the bytes, else the default."""
    return (recognised(message) if message is not None else None) or default


def recognised(message: Message) -> Profile | None:
    """The dialect of a message's sender, as known up to now; None where nothing that came has told it."""
    if message.peer.profile is None:
        with contextlib.suppress(WireError):
            message.peer.profile = recognise(message.payload)
    return message.peer.profile
