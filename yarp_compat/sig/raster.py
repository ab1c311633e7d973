"""The memory of an image: rows of pixels, each row padded to a multiple of the quantum (8 bytes by default)."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from yarp_compat.sig.numbers import as_array
from yarp_compat.sig.pixels import Format, PixelCode, format_of
from yarp_compat.sig.vector import VectorOf
from yarp_compat.wire.message import Buffer

QUANTUM = 8
"""Bytes to whose multiple rows are padded where nothing else is asked for."""


class RawImage(np.ndarray[Any, np.dtype[np.uint8]]):
    """An image's bytes, as a pointer to them where that is asked for."""

    def __int__(self) -> int:
        return int(self.ctypes.data)


class Raster:
    """Pixels in memory."""

    code: ClassVar[int] = PixelCode.INVALID
    """The pixel code that every image of the class has; INVALID: whatever comes."""

    def __init__(self) -> None:
        self._code: int = self.code
        self._quantum = 0
        self._width = self._height = self._row = 0
        self._memory = memoryview(bytearray())
        self._external = False

    def numpy(self) -> NDArray[Any]:
        """The pixels as an array (height, width) or (height, width, channels) in the image's memory.

        It cannot be written to where the image came in memory that cannot. It stays what it is when the image becomes
        another size or is read anew.
        """
        form = self._format()
        shape: tuple[int, ...] = (self._height, self._width)
        strides: tuple[int, ...] = (self._row, form.size)
        if len(form.channels) > 1:
            shape, strides = (*shape, len(form.channels)), (*strides, form.dtype.itemsize)
        return np.ndarray(shape, form.dtype, self._memory, 0, strides)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return as_array(self.numpy(), dtype, copy)

    def width(self) -> int:
        """Pixels in a row."""
        return self._width

    def height(self) -> int:
        """Rows."""
        return self._height

    def getPixelCode(self) -> int:
        """What the pixels hold, a :class:`PixelCode` or minus their size."""
        return int(self._code)

    def getPixelSize(self) -> int:
        """Bytes of a pixel."""
        return self._format().size if self._code else 0

    def getRowSize(self) -> int:
        """Bytes of a row, its padding among them."""
        return self._row

    def getQuantum(self) -> int:
        """Bytes to whose multiple rows are padded; 0 before the first size."""
        return self._quantum

    def getPadding(self) -> int:
        """Bytes of padding at the end of a row."""
        return self._row - self._width * self.getPixelSize()

    def getRawImage(self) -> RawImage:
        """The rows' bytes, which are the image's memory; ``int`` of it is where they are."""
        return np.ndarray(self._memory.nbytes, np.uint8, self._memory).view(RawImage)

    def getRawImageSize(self) -> int:
        """How many bytes the rows have."""
        return self._memory.nbytes

    def getRow(self, row: int) -> memoryview:
        """One row's bytes, which are the image's memory."""
        self._check(0, row)
        return self._memory[row * self._row : row * self._row + self._width * self.getPixelSize()]

    def resize(self, width: int | Raster, height: int = 0) -> None:
        """Become of this size, or another image's; the content of an image that changes its size is 0."""
        if isinstance(width, Raster):
            height, width = width.height(), width.width()
        if width < 0 or height < 0:
            msg = f"an image cannot be {width} x {height} pixels"
            raise ValueError(msg)
        if (width, height) == (self._width, self._height):
            return
        self._quantum = self._quantum or QUANTUM
        row = padded(width * self._format().size, self._quantum)
        self._place(width, height, row, memoryview(bytearray(row * height)))

    def setQuantum(self, quantum: int) -> None:
        """Pad rows to a multiple of so many bytes from now on, those that there are too."""
        if quantum <= 0:
            msg = f"rows cannot be padded to a multiple of {quantum} bytes"
            raise ValueError(msg)
        self._quantum = quantum
        if self._row != padded(self._width * self.getPixelSize(), quantum):
            self._fill(self.numpy())

    def setExternal(self, data: Buffer | NDArray[Any] | VectorOf, width: int, height: int) -> None:
        """Use this memory for the pixels: an array, a vector's, or any buffer in one piece.

        Rows are taken to be padded to the image's quantum, or not at all where the memory's size says so. The image
        is read into this memory as long as what comes has this size and kind.

        Raises:
            ValueError: it is too small, or not in one piece.
        """
        held = data.numpy() if isinstance(data, VectorOf) else data  # which scripts for YARP's bindings do
        view = held.data if isinstance(held, np.ndarray) else memoryview(held)
        if not view.c_contiguous:
            msg = "the memory of an image must be in one piece: numpy.ascontiguousarray makes it so"
            raise ValueError(msg)
        memory = view.cast("B") if view.nbytes else memoryview(b"")
        quantum = self._quantum or 1
        bare = width * self._format().size
        row = padded(bare, quantum)
        if memory.nbytes == bare * height and row != bare:
            quantum, row = 1, bare
        if memory.nbytes < row * height:
            msg = f"{width} x {height} pixels need {row * height} bytes, and there are {memory.nbytes}"
            raise ValueError(msg)
        self._quantum = quantum
        self._place(width, height, row, memory[: row * height], external=True)

    setExternal2 = setExternal

    def tostring(self) -> bytes:
        """The rows' bytes."""
        return bytes(self._memory)

    def fromstring(self, data: Buffer, width: int, height: int) -> None:
        """Use these bytes for the rows."""
        self.setExternal(data, width, height)

    def zero(self) -> None:
        """Set every byte to 0."""
        self._own()
        np.ndarray(self._memory.nbytes, np.uint8, self._memory)[:] = 0

    def isPixel(self, x: int, y: int) -> bool:
        """Whether there is such a pixel."""
        return 0 <= x < self._width and 0 <= y < self._height

    def _format(self) -> Format:
        return format_of(self._code)

    def _check(self, x: int, y: int) -> None:
        if not (0 <= x < max(self._width, 1) and 0 <= y < self._height):
            msg = f"there is no pixel ({x}, {y}) in an image of {self._width} x {self._height}"
            raise IndexError(msg)

    def _place(self, width: int, height: int, row: int, memory: memoryview, *, external: bool = False) -> None:
        self._width, self._height, self._row, self._memory, self._external = width, height, row, memory, external

    def _own(self) -> None:
        """Have memory that can be changed."""
        if self._memory.readonly:
            self._memory = memoryview(bytearray(self._memory))

    def _fill(self, pixels: NDArray[Any]) -> None:
        """Become these pixels, in the memory that there is where they fit, else in new memory."""
        height, width = pixels.shape[:2]
        self._quantum = self._quantum or QUANTUM
        row = padded(width * self._format().size, self._quantum)
        if (width, height, row) != (self._width, self._height, self._row) or self._memory.readonly:
            self._place(width, height, row, memoryview(bytearray(row * height)))
        self.numpy()[...] = pixels


def padded(size: int, quantum: int) -> int:
    """Bytes of a row with its padding."""
    return -(-size // quantum) * quantum if quantum else size
