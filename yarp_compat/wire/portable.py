"""The base of every typed value: bytes in either profile, text, and YARP's own read and write."""

from __future__ import annotations

from typing import Any, ClassVar, Protocol, Self

from yarp_compat.wire import binary, text
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.typename import Type


class ReaderHolder(Protocol):
    """A source to read a value from: YARP's ConnectionReader."""

    @property
    def reader(self) -> ElementReader:
        """Where the value begins."""


class WriterHolder(Protocol):
    """A sink to write a value to: YARP's ConnectionWriter."""

    @property
    def writer(self) -> ElementWriter:
        """Where the value goes."""


class PortReader:
    """Derive from it to take messages as they come: ``port.setReader(reader)``."""

    def read(self, connection: Any) -> bool:
        """Take one message; it may answer by ``connection.getWriter()``. False where it could not use the message.

        ``connection`` is a `ConnectionReader`; an invalid one (``connection.isValid()``) means the end.
        """
        raise NotImplementedError(f"{type(self).__name__} has no read")

    def getReadType(self) -> Type:
        """The kind of data that it reads."""
        return Type()


class PortWriter:
    """What can be written to a connection."""

    def write(self, connection: Any) -> bool:
        """Put it on a connection, a `ConnectionWriter`; False where it cannot be written."""
        raise NotImplementedError(f"{type(self).__name__} has no write")

    def getWriteType(self) -> Type:
        """The kind of data that it writes."""
        return Type()

    def onCommencement(self) -> None:
        """Nothing to do: called by YARP before it is written."""

    def onCompletion(self) -> None:
        """Nothing to do: called by YARP when it was written."""


class Portable(PortReader, PortWriter):
    """A value that crosses ports."""

    TYPE: ClassVar[str] = ""  # the name under which YARP's ports announce it; empty where YARP has none

    def _write(self, out: ElementWriter) -> None:
        """Put the value's elements on the wire."""
        raise NotImplementedError(f"{type(self).__name__} has no elements")

    def _read(self, source: ElementReader) -> None:
        """Become what comes next; raises `WireError` where it is something else, and stays what it was."""
        raise NotImplementedError(f"{type(self).__name__} has no elements")

    def getReadType(self) -> Type:
        """The kind of data that it is."""
        return Type(self.TYPE)

    getWriteType = getType = getReadType

    @staticmethod
    def copyPortable(writer: Portable, reader: Portable) -> bool:
        """Have one value become another by what it is on the wire; False where it cannot."""
        try:
            reader.from_wire(writer.to_bytes())
        except WireError:
            return False
        return True

    def to_wire(self, profile: Profile = Profile.YARP3, generation: Generation | None = None) -> list[Buffer]:
        """The value's bytes in pieces, large arrays uncopied: they must stay unchanged until they are sent."""
        out = ElementWriter(profile, generation)
        self._write(out)
        return out.buffers()

    def to_bytes(self, profile: Profile = Profile.YARP3, generation: Generation | None = None) -> bytes:
        """The value's bytes in one piece; raises `WireError` where it does not fit YARP's type."""
        out = ElementWriter(profile, generation)
        self._write(out)
        return out.payload()

    def from_wire(self, data: Buffer, profile: Profile | None = None) -> None:
        """Become what a whole payload holds; arrays stay views into it. Without a profile YARP 3 is tried, then 4.

        Raises `WireError` where it is something else; the value stays what it was.
        """
        if profile is not None:
            self._whole(data, profile)
            return
        try:
            self._whole(data, Profile.YARP3)
        except WireError as first:
            try:
                self._whole(data, Profile.YARP4)
            except WireError as second:
                raise second if _newer(data) else first from None

    @classmethod
    def from_bytes(cls, payload: Buffer, profile: Profile | None = None) -> Self:
        """A value from a whole payload, see :meth:`from_wire`."""
        value = cls()
        value.from_wire(payload, profile)
        return value

    def to_values(self) -> list[Any]:
        """The value as a Bottle's content."""
        return binary.decode(self.to_bytes(Profile.YARP4), Profile.YARP4)

    def from_values(self, values: list[Any]) -> None:
        """Become what a Bottle of this content holds; raises `WireError` as `from_wire`."""
        self.from_wire(binary.encode(values, Profile.YARP4), Profile.YARP4)

    def to_text(self) -> str:
        """The value as a line of a text carrier."""
        return text.to_text(self.to_values())

    def from_text(self, line: str) -> None:
        """Become what a line of a text carrier says; raises `WireError` as `from_wire`."""
        self.from_values(text.from_text(line))

    def write(self, connection: WriterHolder) -> bool:
        """Put the value on a connection; False where it cannot be written."""
        try:
            self._write(connection.writer)
        except WireError:
            return False
        return True

    def read(self, connection: ReaderHolder) -> bool:
        """Become what a connection holds next; False where that is something else."""
        try:
            self._read(connection.reader)
        except WireError:
            return False
        return True

    def _whole(self, data: Buffer, profile: Profile) -> None:
        source = ElementReader(data, profile)
        value = type(self)()
        value._read(source)
        source.finish()
        self._become(value)

    def _become(self, other: Self) -> None:
        """Take over another value's content."""
        self.__dict__.update(other.__dict__)


def _newer(data: Buffer) -> bool:
    """Whether the first tag of a payload is one that only YARP 4 writes."""
    return bytes(memoryview(data)[:2]) in (b"\x14\x01", b"\x12\x01")
