"""Images (`yarp/sig/Image.h`): rows of pixels, each row padded to a multiple of the quantum (8 bytes by default).

On the wire (`yarp/sig/ImageNetworkHeader.h`): ``[mat] [code] (depth size quantum width height) {rows}``. Before 4.0
the upper half of the quantum said whether the top row comes first: 3.4 to 3.9 write and obey 0 for yes, 3.10 to 3.12
write 1 whatever it is and obey nothing (measured on 3.12.3), 4.0 knows only the quantum. So 0 is written, and 1 is not
looked at.

:meth:`Image.numpy` shares the image's memory. An image that was read shares the message's; one that wraps an array
(:meth:`Image.setExternal`) is read into that array as long as what comes has its size.
"""

from __future__ import annotations

import struct
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from yarp_compat.sig.conversion import convert
from yarp_compat.sig.pixels import PIXELS, PixelCode, format_of
from yarp_compat.sig.raster import Raster, padded
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.tags import BLOB, INT32, LIST, VOCAB32
from yarp_compat.wire.writer import Writer

_HEADER = struct.Struct("<13i")
_MAT = int.from_bytes(b"mat\0", "little")


class Image(Raster, Portable):
    """A picture. Use the class of its pixels (:class:`ImageRgb`), or :class:`FlexImage` for any."""

    TYPE = "yarp/image"

    @classmethod
    def of(cls, array: NDArray[Any]) -> Self:
        """An image of an array (height, width[, channels]), which shares its memory where that is in one piece.

        Raises:
            ValueError: the array does not have this class's pixels.
        """
        image = cls()
        image._wrap(array)
        return image

    def pixel(self, x: int, y: int) -> Any:
        """The pixel in column x of row y: a number, or an object of its numbers, which are the image's."""
        self._check(x, y)
        kind = PIXELS.get(self._code)
        if kind is None:
            return self.getPixel(x, y)
        self._own()
        return kind.at(self.numpy()[y, x])

    access = pixel

    def safePixel(self, x: int, y: int) -> Any:
        """The pixel, or one of 0 where there is none."""
        if self.isPixel(x, y):
            return self.pixel(x, y)
        kind = PIXELS.get(self._code)
        return 0 if kind is None else kind()

    def getPixel(self, x: int, y: int) -> Any:
        """A pixel's number, or its numbers as a tuple."""
        self._check(x, y)
        found = self.numpy()[y, x].tolist()
        return tuple(found) if isinstance(found, list) else found

    def setPixel(self, x: int, y: int, value: Any) -> None:
        """Change a pixel to a number, or to as many as it has."""
        self._check(x, y)
        self._own()
        self.numpy()[y, x] = tuple(value) if hasattr(value, "__iter__") else value

    def copy(self, other: Image, width: int | None = None, height: int | None = None) -> bool:
        """Become another image, of this class's pixels and, where it is given, of another size by a coarse scaling.

        Raises:
            ValueError: YARP has no conversion between the pixels.
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

    def isEqual(self, other: object) -> bool:
        """Whether both are the same picture of the same pixels."""
        return self == other

    def notEqual(self, other: object) -> bool:
        """Whether they differ."""
        return self != other

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Image):
            return NotImplemented
        if self._code != other.getPixelCode() or (self._width, self._height) != (other.width(), other.height()):
            return False
        return not self._code or self.numpy().tobytes() == other.numpy().tobytes()

    __hash__ = None  # type: ignore[assignment] # it changes

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self._width} x {self._height} of code {self._code}>"

    def _wrap(self, array: NDArray[Any]) -> None:
        form = self._format()
        channels = array.shape[2] if array.ndim == 3 else 1
        if array.ndim not in (2, 3) or channels != len(form.channels) or array.dtype != form.dtype:
            msg = (
                f"an image of {'/'.join(form.channels)} in {form.dtype} cannot be made of an array of {array.shape} in "
                f"{array.dtype}"
            )
            raise ValueError(msg)
        self.setExternal(np.ascontiguousarray(array, form.dtype), array.shape[1], array.shape[0])

    def _write(self, out: Writer) -> None:
        form = format_of(self._code) if self._code else None
        size = self._memory.nbytes
        out.begin(4)
        out.raw(
            _HEADER, VOCAB32, _MAT, VOCAB32, int(self._code), LIST | INT32, 5, form.size if form else 0, size,
            self._quantum, self._width, self._height, BLOB, size,
        )  # fmt: skip
        out.block(self._memory)

    def _whole(self, data: Buffer, profile: Profile) -> None:
        source = Reader(data, profile)
        found = _parsed(source)
        source.finish()
        self._take(*found)

    def _read(self, source: Reader) -> None:
        self._take(*_parsed(source))

    def _take(self, code: int, quantum: int, width: int, height: int, data: memoryview) -> None:
        """Become what was read: in place of memory given from outside, as a view into the message, or converted."""
        size = format_of(code).size if code else 0
        row = padded(width * size, quantum)
        own = padded(width * size, self._quantum or quantum)
        if self.code in (PixelCode.INVALID, code) and own == row:
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


def _parsed(source: Reader) -> tuple[int, int, int, int, memoryview]:
    """An image's code, quantum, width, height and rows."""
    at = source.at
    count = source.begin()
    names, word, named, code, listed, numbers, depth, size, quantum, width, height, blob, length = source.raw(_HEADER)
    if quantum >> 16 == 1:
        quantum &= 0xFFFF
    told = (source.unit, count, names, word, named, listed, numbers, blob)
    if told != (0, 4, VOCAB32, _MAT, VOCAB32, LIST | INT32, 5, BLOB):
        raise WireError(f"what begins at byte {at} is no image")
    if min(size, quantum, width, height) < 0 or size != length:
        raise WireError(f"an image of {width} x {height} pixels in rows of {quantum} and {size} or {length} bytes")
    try:
        form = format_of(code) if code or size else None
    except ValueError as error:
        raise WireError(f"an image whose pixels are unknown: {error}") from error
    if form and (depth != form.size or padded(width * depth, quantum) * height != size):
        raise WireError(f"an image of {width} x {height} pixels of {depth} bytes cannot have {size} bytes")
    data = source.block(size)
    source.leave()
    return code, quantum, width, height, data


class FlexImage(Image):
    """An image of any pixels."""

    def setPixelCode(self, code: int) -> None:
        """Have pixels of this code; the content goes where they are of another size.

        Raises:
            ValueError: there are none such.
        """
        size = format_of(code).size if code else 0
        if size != self.getPixelSize():
            self._place(0, 0, 0, memoryview(bytearray()))
        self._code = code

    def setPixelSize(self, size: int) -> None:
        """Have pixels of so many bytes, of which nothing else is known."""
        if size != self.getPixelSize():
            self.setPixelCode(-size)


class ImageMono(Image):
    """Grey in bytes."""

    code = PixelCode.MONO


class ImageMono16(Image):
    """Grey in two bytes."""

    code = PixelCode.MONO16


class ImageRgb(Image):
    """Red, green, blue in bytes."""

    code = PixelCode.RGB


class ImageRgba(Image):
    """Red, green, blue, opacity in bytes."""

    code = PixelCode.RGBA


class ImageBgr(Image):
    """Blue, green, red in bytes."""

    code = PixelCode.BGR


class ImageBgra(Image):
    """Blue, green, red, opacity in bytes."""

    code = PixelCode.BGRA


class ImageInt(Image):
    """Integers of four bytes."""

    code = PixelCode.INT


class ImageFloat(Image):
    """Floats, as depth images are."""

    code = PixelCode.MONO_FLOAT


class ImageRgbFloat(Image):
    """Red, green, blue in floats."""

    code = PixelCode.RGB_FLOAT


class ImageRgbInt(Image):
    """Red, green, blue in integers of four bytes."""

    code = PixelCode.RGB_INT


class ImageRgbSigned(Image):
    """Red, green, blue in signed bytes."""

    code = PixelCode.RGB_SIGNED


class ImageMonoSigned(Image):
    """Grey in signed bytes."""

    code = PixelCode.MONO_SIGNED


class ImageHsv(Image):
    """Hue, saturation, value in bytes."""

    code = PixelCode.HSV


class ImageHsvFloat(Image):
    """Hue, saturation, value in floats."""

    code = PixelCode.HSV_FLOAT
