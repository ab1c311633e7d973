"""Images (`yarp/sig/Image.h`): rows of pixels, each row padded to a multiple of the quantum (8 bytes by default).

On the wire (`yarp/sig/ImageNetworkHeader.h`): ``[mat] [code] (depth size quantum width height) {rows}``. Before 4.0
the upper 16 bits of the quantum were a flag for the order of the rows: 3.4 to 3.9 write 0 for "top row first", and
interpret it so; 3.10 to 3.12 always write 1, and ignore the received flag (measured on 3.12.3); 4.0 has no flag. So
this module writes 0, and ignores 1.

`Image.numpy` shares the image's memory. A received image shares the message's memory; an image that wraps an array
(`Image.setExternal`) copies a received image into that array if both have the same size and pixel code.
"""

from __future__ import annotations

import struct
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from yarp_compat.overriding import override
from yarp_compat.sig.pixels import PIXELS, Format, PixelCode, convert, format_of
from yarp_compat.sig.vector import Comparable, VectorOf, as_array
from yarp_compat.wire.accessors import getter
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.tags import BLOB, INT32, LIST, VOCAB32

QUANTUM = 8  # rows are padded to a multiple of this number of bytes by default


class RawImage(np.ndarray[Any, np.dtype[np.uint8]]):
    """An image's bytes; ``int()`` returns their address."""

    @override
    def __int__(self) -> int:
        return int(self.ctypes.data)


class Raster:
    """Pixels in memory."""

    code: ClassVar[int] = PixelCode.INVALID  # the pixel code of the class; INVALID: any

    def __init__(self) -> None:
        self._code: int = self.code
        self._quantum = 0
        self._width = self._height = self._row = 0
        self._memory = memoryview(bytearray())
        self._external = False

    def numpy(self) -> NDArray[Any]:
        """Return the pixels (height, width[, channels]) as a view of the current memory, read-only if the memory is."""
        form = self._format()
        shape: tuple[int, ...] = (self._height, self._width)
        strides: tuple[int, ...] = (self._row, form.size)
        if len(form.channels) > 1:
            shape, strides = (*shape, len(form.channels)), (*strides, form.dtype.itemsize)
        return np.ndarray(shape, form.dtype, self._memory, 0, strides)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return as_array(self.numpy(), dtype, copy)

    width = getter("_width", int, "The number of pixels in a row.")
    height = getter("_height", int, "The number of rows.")

    def getPixelCode(self) -> int:
        """Return the pixel code: a `PixelCode`, or minus the size of a pixel."""
        return int(self._code)

    def getPixelSize(self) -> int:
        """Return the size of a pixel in bytes."""
        return self._format().size if self._code else 0

    getRowSize = getter("_row", int, "The size of a row in bytes, with its padding.")
    getQuantum = getter("_quantum", int, "The number of bytes of which rows are a multiple; 0 until the size is set.")

    def getPadding(self) -> int:
        """Return the number of padding bytes at the end of a row."""
        return self._row - self._width * self.getPixelSize()

    def getRawImage(self) -> RawImage:
        """Return the image's memory as bytes; ``int()`` of the result is their address."""
        return np.ndarray(self._memory.nbytes, np.uint8, self._memory).view(RawImage)

    getRawImageSize = getter("_memory.nbytes", int, "The size of all rows in bytes.")

    def getRow(self, row: int) -> memoryview:
        """Return the bytes of one row's pixels, without the padding, as a view."""
        self._check(0, row)
        return self._memory[row * self._row : row * self._row + self._width * self.getPixelSize()]

    def getRowArray(self) -> tuple[memoryview, ...]:
        """Return `getRow` of all rows."""
        return tuple(map(self.getRow, range(self._height)))

    def getPixelAddress(self, x: int, y: int) -> int:
        """Return the address of a pixel in memory."""
        self._check(x, y)
        return int(self.getRawImage()) + y * self._row + x * self.getPixelSize()

    def topIsLowIndex(self) -> bool:
        """Return True: the top row always comes first (see the module's docstring)."""
        return True

    def setTopIsLowIndex(self, flag: bool) -> None:
        """Do nothing for True, since the top row is always the first; raises `ValueError` for False."""
        if not flag:
            raise ValueError("images must have the top row first; flip them with image.numpy()[::-1]")

    def resize(self, width: int | Raster, height: int = 0) -> None:
        """Change the size to the given one, or to that of another image; a changed size sets all pixels to 0."""
        if isinstance(width, Raster):
            height, width = width.height(), width.width()
        if width < 0 or height < 0:
            raise ValueError(f"an image cannot have {width} x {height} pixels")
        if (width, height) == (self._width, self._height):
            return
        self._quantum = self._quantum or QUANTUM
        row = padded(width * self._format().size, self._quantum)
        self._place(width, height, row, memoryview(bytearray(row * height)))

    def setQuantum(self, quantum: int) -> None:
        """Pad all rows to a multiple of this number of bytes."""
        if quantum <= 0:
            raise ValueError(f"rows cannot be padded to a multiple of {quantum} bytes")
        self._quantum = quantum
        if self._row != padded(self._width * self.getPixelSize(), quantum):
            self._fill(self.numpy())

    def setExternal(self, data: Buffer | NDArray[Any] | VectorOf, width: int, height: int) -> None:
        """Use this memory for the pixels; raises `ValueError` if it is too small or not contiguous.

        Rows are padded to the image's quantum; not at all if it is not set, or the memory has exactly the size of rows
        without padding.
        Received images of the same size and pixel code are copied into this memory.
        """
        held = data.numpy() if isinstance(data, VectorOf) else data  # scripts for YARP's bindings pass a Vector
        view = held.data if isinstance(held, np.ndarray) else memoryview(held)
        if not view.c_contiguous:
            raise ValueError("the memory of an image must be contiguous; use numpy.ascontiguousarray")
        memory = view.cast("B") if view.nbytes else memoryview(b"")
        quantum = self._quantum or 1
        bare = width * self._format().size
        row = padded(bare, quantum)
        if memory.nbytes == bare * height and row != bare:
            quantum, row = 1, bare
        if memory.nbytes < row * height:
            raise ValueError(f"{width} x {height} pixels need {row * height} bytes, not {memory.nbytes}")
        self._quantum = quantum
        self._place(width, height, row, memory[: row * height], external=True)

    setExternal2 = setExternal

    def tostring(self) -> bytes:
        """Return a copy of the rows' bytes."""
        return bytes(self._memory)

    def fromstring(self, data: Buffer, width: int, height: int) -> None:
        """Use these bytes for the rows, without a copy."""
        self.setExternal(data, width, height)

    def zero(self) -> None:
        """Set every byte to 0."""
        self._writable()
        np.ndarray(self._memory.nbytes, np.uint8, self._memory)[:] = 0

    def isPixel(self, x: int, y: int) -> bool:
        """Return whether the pixel is inside the image."""
        return 0 <= x < self._width and 0 <= y < self._height

    def _format(self) -> Format:
        return format_of(self._code)

    def _check(self, x: int, y: int) -> None:
        if not (0 <= x < max(self._width, 1) and 0 <= y < self._height):
            raise IndexError(f"pixel ({x}, {y}) is outside of the image of {self._width} x {self._height}")

    def _place(self, width: int, height: int, row: int, memory: memoryview, *, external: bool = False) -> None:
        self._width, self._height, self._row, self._memory, self._external = width, height, row, memory, external

    def _writable(self) -> None:
        """Make the memory writable; copy it if needed."""
        if self._memory.readonly:
            self._memory = memoryview(bytearray(self._memory))

    def _fill(self, pixels: NDArray[Any]) -> None:
        """Replace the pixels, in the current memory if they fit, else in new memory."""
        height, width = pixels.shape[:2]
        self._quantum = self._quantum or QUANTUM
        row = padded(width * self._format().size, self._quantum)
        if (width, height, row) != (self._width, self._height, self._row) or self._memory.readonly:
            self._place(width, height, row, memoryview(bytearray(row * height)))
        self.numpy()[...] = pixels


def padded(size: int, quantum: int) -> int:
    """Return the size of a row with its padding, in bytes."""
    return -(-size // quantum) * quantum if quantum else size


_HEADER = struct.Struct("<13i")
_MAT = int.from_bytes(b"mat\0", "little")


class Image(Raster, Comparable, Portable):
    """The base class of images. Use the class for the pixels, such as `ImageRgb`, or `FlexImage` for any pixels."""

    TYPE = "yarp/image"

    @classmethod
    def of(cls, array: NDArray[Any]) -> Self:
        """Return an image of an array (height, width[, channels]), shared if contiguous; raises `ValueError`."""
        image = cls()
        image._wrap(array)
        return image

    def pixel(self, x: int, y: int) -> Any:
        """Return the pixel in column x of row y: a number, or an object that views its channels in the image."""
        self._check(x, y)
        kind = PIXELS.get(self._code)
        if kind is None:
            return self.getPixel(x, y)
        self._writable()
        return kind.view(self.numpy()[y, x])

    access = pixel

    def safePixel(self, x: int, y: int) -> Any:
        """Return the pixel, or a pixel of zeros outside of the image."""
        if self.isPixel(x, y):
            return self.pixel(x, y)
        kind = PIXELS.get(self._code)
        return 0 if kind is None else kind()

    def getPixel(self, x: int, y: int) -> Any:
        """Return a pixel's number, or a tuple of its channels."""
        self._check(x, y)
        value = self.numpy()[y, x].tolist()
        return tuple(value) if isinstance(value, list) else value

    def setPixel(self, x: int, y: int, value: Any) -> None:
        """Set a pixel to a number, or to one number per channel."""
        self._check(x, y)
        self._writable()
        self.numpy()[y, x] = tuple(value) if hasattr(value, "__iter__") else value

    def copy(self, other: Image, width: int | None = None, height: int | None = None) -> bool:
        """Copy another image, converted to this image's pixel code; raises `ValueError` if that is not possible.

        With ``width`` and ``height``, the copy is scaled to that size by nearest neighbor. An image that has no pixel
        code yet gets the other's.
        """
        if not self._code:
            self._code, self._quantum = other.getPixelCode(), other.getQuantum()
        pixels = convert(other.numpy(), other.getPixelCode(), self._code)
        if width is not None and height is not None and other.width() and other.height():
            rows = np.arange(height) * other.height() // max(height, 1)
            columns = np.arange(width) * other.width() // max(width, 1)
            pixels = pixels[rows[:, None], columns[None, :]]
        self._fill(pixels)
        return True

    def swap(self, alt: Image) -> None:
        """Exchange the contents with another image of this class."""
        if type(alt) is not type(self):
            raise TypeError(f"cannot swap a {type(self).__name__} and a {type(alt).__name__}")
        self.__dict__, alt.__dict__ = alt.__dict__, self.__dict__

    def move(self, alt: Image) -> None:
        """Move another image's content into this image; the other image is then empty."""
        self.swap(alt)
        alt._place(0, 0, 0, memoryview(bytearray()))

    @override
    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Image):
            return NotImplemented
        if self._code != other.getPixelCode() or (self._width, self._height) != (other.width(), other.height()):
            return False
        return not self._code or self.numpy().tobytes() == other.numpy().tobytes()

    @override
    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self._width} x {self._height} of code {self._code}>"

    def _wrap(self, array: NDArray[Any]) -> None:
        form = self._format()
        channels = array.shape[2] if array.ndim == 3 else 1
        if array.ndim not in (2, 3) or channels != len(form.channels) or array.dtype != form.dtype:
            raise ValueError(
                f"cannot make an image of {'/'.join(form.channels)} in {form.dtype} from an array {array.shape} of "
                f"{array.dtype}"
            )
        self.setExternal(np.ascontiguousarray(array, form.dtype), array.shape[1], array.shape[0])

    @override
    def _write(self, out: ElementWriter) -> None:
        form = format_of(self._code) if self._code else None
        size = self._memory.nbytes
        out.begin(4)
        out.raw(
            _HEADER, VOCAB32, _MAT, VOCAB32, int(self._code), LIST | INT32, 5, form.size if form else 0, size,
            self._quantum, self._width, self._height, BLOB, size,
        )  # fmt: skip
        out.block(self._memory)

    @override
    def _whole(self, data: Buffer, profile: Profile) -> None:
        source = ElementReader(data, profile)
        parts = _parse(source)
        source.finish()
        self._store(*parts)

    @override
    def _read(self, source: ElementReader) -> None:
        self._store(*_parse(source))

    def _store(self, code: int, quantum: int, width: int, height: int, data: memoryview) -> None:
        """Store a received image: in the external memory, as a view of the message, or converted."""
        size = format_of(code).size if code else 0
        row = padded(width * size, quantum)
        own_row = padded(width * size, self._quantum or quantum)
        if self.code in (PixelCode.INVALID, code) and own_row == row:
            same = (self._code, self._width, self._height, self._row) == (code, width, height, row)
            if same and self._external and not self._memory.readonly:
                self._memory[:] = data
                return
            self._code, self._quantum = code, self._quantum or quantum
            self._place(width, height, row, data)
            return
        other = FlexImage()
        other._code, other._quantum = code, quantum
        other._place(width, height, row, data)
        if self.code == PixelCode.INVALID:
            self._code = code
        try:
            self.copy(other)
        except ValueError as error:
            raise WireError(str(error)) from error


def _parse(source: ElementReader) -> tuple[int, int, int, int, memoryview]:
    """Return a received image's code, quantum, width, height and rows."""
    at = source.at
    count = source.begin()
    names, mat, named, code, listed, numbers, depth, size, quantum, width, height, blob, length = source.raw(_HEADER)
    if quantum >> 16 == 1:
        quantum &= 0xFFFF
    constants = (source.unit, count, names, mat, named, listed, numbers, blob)
    if constants != (0, 4, VOCAB32, _MAT, VOCAB32, LIST | INT32, 5, BLOB):
        raise WireError(f"no image at byte {at}")
    if min(size, quantum, width, height) < 0 or size != length:
        raise WireError(
            f"invalid image of {width} x {height} pixels: quantum {quantum}, {size} bytes in the header, {length} in "
            "the blob"
        )
    try:
        form = format_of(code) if code or size else None
    except ValueError as error:
        raise WireError(f"an image has unknown pixels: {error}") from error
    if form and (depth != form.size or padded(width * depth, quantum) * height != size):
        raise WireError(f"an image of {width} x {height} pixels of {depth} bytes cannot have {size} bytes")
    data = source.block(size)
    source.leave()
    return code, quantum, width, height, data


class FlexImage(Image):
    """An image with any pixel code."""

    def setPixelCode(self, code: int) -> None:
        """Set the pixel code; a different pixel size empties the image. Raises `ValueError` for an unknown code."""
        size = format_of(code).size if code else 0
        if size != self.getPixelSize():
            self._place(0, 0, 0, memoryview(bytearray()))
        self._code = code

    def setPixelSize(self, size: int) -> None:
        """Set the pixel size in bytes; if it changes, the pixel code becomes ``-size``: pixels of an unknown kind."""
        if size != self.getPixelSize():
            self.setPixelCode(-size)


class ImageMono(Image):
    """Gray pixels of one byte."""

    code = PixelCode.MONO


class ImageRgb(Image):
    """Pixels of red, green, blue in bytes."""

    code = PixelCode.RGB


def _class(name: str, code: PixelCode, doc: str) -> type[Image]:
    return type(name, (Image,), {"code": code, "__doc__": doc, "__module__": __name__})


ImageMono16 = _class("ImageMono16", PixelCode.MONO16, "Gray pixels of two bytes.")
ImageRgba = _class("ImageRgba", PixelCode.RGBA, "Pixels of red, green, blue, alpha in bytes.")
ImageBgr = _class("ImageBgr", PixelCode.BGR, "Pixels of blue, green, red in bytes.")
ImageBgra = _class("ImageBgra", PixelCode.BGRA, "Pixels of blue, green, red, alpha in bytes.")
ImageInt = _class("ImageInt", PixelCode.INT, "Pixels of integers of four bytes.")
ImageFloat = _class("ImageFloat", PixelCode.MONO_FLOAT, "Pixels of floats, as in depth images.")
ImageRgbFloat = _class("ImageRgbFloat", PixelCode.RGB_FLOAT, "Pixels of red, green, blue in floats.")
ImageRgbInt = _class("ImageRgbInt", PixelCode.RGB_INT, "Pixels of red, green, blue in integers of four bytes.")
ImageRgbSigned = _class("ImageRgbSigned", PixelCode.RGB_SIGNED, "Pixels of red, green, blue in signed bytes.")
ImageMonoSigned = _class("ImageMonoSigned", PixelCode.MONO_SIGNED, "Gray pixels of signed bytes.")
ImageHsv = _class("ImageHsv", PixelCode.HSV, "Pixels of hue, saturation, value in bytes.")
ImageHsvFloat = _class("ImageHsvFloat", PixelCode.HSV_FLOAT, "Pixels of hue, saturation, value in floats.")
