"""``Things``: whatever comes or goes, which says what it is when it is asked for (`yarp/os/Things.h`)."""

from __future__ import annotations

from typing import Any, TypeVar

from yarp_compat.os.data.bottle import Bottle, Property, Value
from yarp_compat.wire.portable import Portable, PortReader, PortWriter

T = TypeVar("T", bound=Portable)


class Things:
    """Something that is to be written, to be read into, or has come on a connection."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Be nothing."""
        self._writer: PortWriter | None = None
        self._reader: PortReader | None = None
        self._connection: Any = None
        self._portable: Portable | None = None
        self._been_read = False

    def setPortWriter(self, writer: PortWriter | None) -> None:
        """Be what is to be written."""
        self._writer = writer

    def getPortWriter(self) -> PortWriter | None:
        """What is to be written."""
        return self._writer

    def setPortReader(self, reader: PortReader | None) -> None:
        """Be what is to be read into."""
        self._reader = reader

    def getPortReader(self) -> PortReader | None:
        """What is to be read into."""
        return self._reader

    def setConnectionReader(self, connection: Any) -> bool:
        """Be what a connection holds, a `ConnectionReader`; it is read when it is asked for."""
        self._connection, self._portable = connection, None
        return True

    def write(self, connection: Any) -> bool:
        """Put it on a connection; False where there is nothing."""
        thing = self._writer or self._portable
        return thing is not None and thing.write(connection)

    def hasBeenRead(self) -> bool:
        """Whether it was read from its connection."""
        return self._been_read

    def cast_as(self, kind: type[T]) -> T | None:
        """It as data of a class; None where it is something else."""
        held = self._writer or self._reader or self._portable
        if held is None and self._connection is not None:
            made = kind()
            if not made.read(self._connection):
                return None
            held = self._portable = made
            self._been_read = True
        return held if isinstance(held, kind) else None

    def asValue(self) -> Value | None:
        """It as a Value."""
        return self.cast_as(Value)

    def asBottle(self) -> Bottle | None:
        """It as a Bottle."""
        return self.cast_as(Bottle)

    def asProperty(self) -> Property | None:
        """It as a Property."""
        return self.cast_as(Property)

    def asVector(self) -> Any:
        """It as a Vector."""
        from yarp_compat.sig.vector import Vector

        return self.cast_as(Vector)

    def asMatrix(self) -> Any:
        """It as a Matrix."""
        from yarp_compat.sig.matrix import Matrix

        return self.cast_as(Matrix)

    def asImage(self) -> Any:
        """It as an image of any pixels."""
        from yarp_compat.sig.image import FlexImage, Image

        return self.cast_as(FlexImage) or self.cast_as(Image)

    def asImageOfPixelRgb(self) -> Any:
        """It as an ImageRgb."""
        from yarp_compat.sig.image import ImageRgb

        return self.cast_as(ImageRgb)

    def asImageOfPixelBgr(self) -> Any:
        """It as an ImageBgr."""
        from yarp_compat.sig.image import ImageBgr

        return self.cast_as(ImageBgr)

    def asImageOfPixelMono(self) -> Any:
        """It as an ImageMono."""
        from yarp_compat.sig.image import ImageMono

        return self.cast_as(ImageMono)
