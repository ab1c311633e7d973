"""``Things``: a message of any type, which is decoded on demand (`yarp/os/Things.h`)."""

from __future__ import annotations

from typing import Any, TypeVar

from yarp_compat.os.data.bottle import Bottle, Property, Value
from yarp_compat.wire.portable import Portable, PortReader, PortWriter

T = TypeVar("T", bound=Portable)


class Things:
    """An object to write, an object to read into, or a received message."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Remove the content."""
        self._writer: PortWriter | None = None
        self._reader: PortReader | None = None
        self._connection: Any = None
        self._portable: Portable | None = None
        self._been_read = False

    def setPortWriter(self, writer: PortWriter | None) -> None:
        """Set the object to write."""
        self._writer = writer

    def getPortWriter(self) -> PortWriter | None:
        """Return the object to write, or None."""
        return self._writer

    def setPortReader(self, reader: PortReader | None) -> None:
        """Set the object to read into."""
        self._reader = reader

    def getPortReader(self) -> PortReader | None:
        """Return the object to read into, or None."""
        return self._reader

    def setConnectionReader(self, connection: Any) -> bool:
        """Set the received message, a `ConnectionReader`; it is read on demand."""
        self._connection, self._portable = connection, None
        return True

    def write(self, connection: Any) -> bool:
        """Write the content to a connection; return False if there is none, or it cannot be written."""
        thing = self._writer or self._portable
        return thing is not None and thing.write(connection)

    def hasBeenRead(self) -> bool:
        """Return whether the content was read from its connection."""
        return self._been_read

    def cast_as(self, kind: type[T]) -> T | None:
        """Return the content as an object of a class; None if it is of another type."""
        held = self._writer or self._reader or self._portable
        if held is None and self._connection is not None:
            content = kind()
            if not content.read(self._connection):
                return None
            held = self._portable = content
            self._been_read = True
        return held if isinstance(held, kind) else None

    def asValue(self) -> Value | None:
        """Return the content as a Value, or None."""
        return self.cast_as(Value)

    def asBottle(self) -> Bottle | None:
        """Return the content as a Bottle, or None."""
        return self.cast_as(Bottle)

    def asProperty(self) -> Property | None:
        """Return the content as a Property, or None."""
        return self.cast_as(Property)

    def asVector(self) -> Any:
        """Return the content as a Vector, or None."""
        from yarp_compat.sig.vector import Vector

        return self.cast_as(Vector)

    def asMatrix(self) -> Any:
        """Return the content as a Matrix, or None."""
        from yarp_compat.sig.matrix import Matrix

        return self.cast_as(Matrix)

    def asImage(self) -> Any:
        """Return the content as an image with any type of pixels, or None."""
        from yarp_compat.sig.image import FlexImage, Image

        return self.cast_as(FlexImage) or self.cast_as(Image)

    def asImageOfPixelRgb(self) -> Any:
        """Return the content as an ImageRgb, or None."""
        from yarp_compat.sig.image import ImageRgb

        return self.cast_as(ImageRgb)

    def asImageOfPixelBgr(self) -> Any:
        """Return the content as an ImageBgr, or None."""
        from yarp_compat.sig.image import ImageBgr

        return self.cast_as(ImageBgr)

    def asImageOfPixelMono(self) -> Any:
        """Return the content as an ImageMono, or None."""
        from yarp_compat.sig.image import ImageMono

        return self.cast_as(ImageMono)
