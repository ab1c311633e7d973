"""The base class of typed values: conversion to bytes in either profile and to text, and YARP's read and write."""

from __future__ import annotations

from typing import Any, ClassVar, Protocol, Self

from yarp_compat.overriding import override
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
        """The reader at the start of the value."""


class WriterHolder(Protocol):
    """A sink to write a value to: YARP's ConnectionWriter."""

    @property
    def writer(self) -> ElementWriter:
        """The writer to append the value to."""


class PortReader:
    """The base class of message callbacks: ``port.setReader(reader)``."""

    def read(self, connection: Any) -> bool:
        """Handle a message, and reply with ``connection.getWriter()`` if there is one; return False if it is unusable.

        ``connection`` is a `ConnectionReader`; an invalid one (``connection.isValid()``) means that the port closes.
        """
        raise NotImplementedError(f"{type(self).__name__} has no read")

    def getReadType(self) -> Type:
        """Return the type of data that this reader expects."""
        return Type()


class PortWriter:
    """The base class of objects that can be written to a connection."""

    def write(self, connection: Any) -> bool:
        """Write the object to a connection, a `ConnectionWriter`; return False if it cannot be written."""
        raise NotImplementedError(f"{type(self).__name__} has no write")

    def getWriteType(self) -> Type:
        """Return the type of data that this object writes."""
        return Type()

    def onCommencement(self) -> None:
        """Do nothing; YARP calls it before writing."""

    def onCompletion(self) -> None:
        """Do nothing; YARP calls it after writing."""


class Portable(PortReader, PortWriter):
    """The base class of values that ports send and receive."""

    TYPE: ClassVar[str] = ""  # the type name that YARP's ports announce; empty if there is none

    def _write(self, out: ElementWriter) -> None:
        raise NotImplementedError(f"{type(self).__name__} has no elements")

    def _read(self, source: ElementReader) -> None:
        """Read the value's elements; raises `WireError`, and leaves the value unchanged, for other types."""
        raise NotImplementedError(f"{type(self).__name__} has no elements")

    @override
    def getReadType(self) -> Type:
        return Type(self.TYPE)

    getWriteType = getType = getReadType

    @staticmethod
    def copyPortable(writer: Portable, reader: Portable) -> bool:
        """Copy a value into another through its bytes; return False if the types do not match."""
        try:
            reader.from_wire(writer.to_bytes())
        except WireError:
            return False
        return True

    def to_wire(self, profile: Profile = Profile.YARP3, generation: Generation | None = None) -> list[Buffer]:
        """Encode the value in pieces, without copies of large arrays, which must not change until they are sent."""
        out = ElementWriter(profile, generation)
        self._write(out)
        return out.buffers()

    def to_bytes(self, profile: Profile = Profile.YARP3, generation: Generation | None = None) -> bytes:
        """Encode the value; raises `WireError` if it does not fit YARP's type."""
        out = ElementWriter(profile, generation)
        self._write(out)
        return out.payload()

    def from_wire(self, data: Buffer, profile: Profile | None = None) -> None:
        """Decode a whole payload into this value; arrays are views of it. Without a profile, tries YARP 3, then 4.

        Raises `WireError` for other types, and leaves the value unchanged.
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
        """Decode a whole payload into a new value, like `from_wire`."""
        value = cls()
        value.from_wire(payload, profile)
        return value

    def to_values(self) -> list[Any]:
        """Return the value as a Bottle's content."""
        return binary.decode(self.to_bytes(Profile.YARP4), Profile.YARP4)

    def from_values(self, values: list[Any]) -> None:
        """Decode a Bottle's content into this value; raises `WireError` like `from_wire`."""
        self.from_wire(binary.encode(values, Profile.YARP4), Profile.YARP4)

    def to_text(self) -> str:
        """Return the value as a line for text carriers."""
        return text.to_text(self.to_values())

    def from_text(self, line: str) -> None:
        """Decode a line of a text carrier into this value; raises `WireError` like `from_wire`."""
        self.from_values(text.from_text(line))

    @override
    def write(self, connection: WriterHolder) -> bool:
        """Write the value to a connection; return False if it cannot be encoded."""
        try:
            self._write(connection.writer)
        except WireError:
            return False
        return True

    @override
    def read(self, connection: ReaderHolder) -> bool:
        """Read the value from a connection; return False, and change nothing, for other types."""
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
        """Replace the content by another value's."""
        self.__dict__.update(other.__dict__)


def _newer(data: Buffer) -> bool:
    """Return whether a payload begins with a tag that only YARP 4 writes."""
    return bytes(memoryview(data)[:2]) in (b"\x14\x01", b"\x12\x01")
