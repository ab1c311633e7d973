"""The pixel codes of YARP's images and what a pixel of each holds (`yarp/sig/Image.h`, the same from 3.4 to 4.0).

On the wire a code is a vocab; a negative code -n means pixels of n bytes of which nothing else is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

LARGEST = 1024
"""Bytes of the largest pixel that only has a size."""


def _code(word: str) -> int:
    return int.from_bytes(word.encode().ljust(4, b"\0"), "little")


class PixelCode(IntEnum):
    """The codes; each is the number of its vocab."""

    INVALID = 0
    MONO = _code("mono")
    MONO16 = _code("mo16")
    RGB = _code("rgb")
    RGBA = _code("rgba")
    BGRA = _code("bgra")
    INT = _code("int")
    HSV = _code("hsv")
    BGR = _code("bgr")
    MONO_SIGNED = _code("sign")
    RGB_SIGNED = _code("rgb-")
    RGB_INT = _code("rgbi")
    MONO_FLOAT = _code("dec")
    RGB_FLOAT = _code("rgb.")
    HSV_FLOAT = _code("hsv.")
    ENCODING_BAYER_GRBG8 = _code("grbg")
    ENCODING_BAYER_GRBG16 = _code("gr16")
    ENCODING_BAYER_BGGR8 = _code("bggr")
    ENCODING_BAYER_BGGR16 = _code("bg16")
    ENCODING_BAYER_GBRG8 = _code("gbrg")
    ENCODING_BAYER_GBRG16 = _code("gb16")
    ENCODING_BAYER_RGGB8 = _code("rggb")
    ENCODING_BAYER_RGGB16 = _code("rg16")
    YUV_420 = _code("yuva")
    YUV_444 = _code("yuvb")
    YUV_422 = _code("yuvc")
    YUV_411 = _code("yuvd")


@dataclass(frozen=True, slots=True)
class Format:
    """What a pixel holds.

    Attributes:
        dtype: type of each number.
        channels: the numbers' names in their order in memory; one pixel is one number where there is one name.
    """

    dtype: np.dtype[Any]
    channels: tuple[str, ...]

    @property
    def size(self) -> int:
        """Bytes of a pixel."""
        return self.dtype.itemsize * len(self.channels)


def _format(letters: str, *channels: str) -> Format:
    return Format(np.dtype("<" + letters), channels)


_FORMATS = {
    PixelCode.MONO: _format("u1", "value"),
    PixelCode.MONO16: _format("u2", "value"),
    PixelCode.RGB: _format("u1", *"rgb"),
    PixelCode.RGBA: _format("u1", *"rgba"),
    PixelCode.BGRA: _format("u1", *"bgra"),
    PixelCode.INT: _format("i4", "value"),
    PixelCode.HSV: _format("u1", *"hsv"),
    PixelCode.BGR: _format("u1", *"bgr"),
    PixelCode.MONO_SIGNED: _format("i1", "value"),
    PixelCode.RGB_SIGNED: _format("i1", *"rgb"),
    PixelCode.RGB_INT: _format("i4", *"rgb"),
    PixelCode.MONO_FLOAT: _format("f4", "value"),
    PixelCode.RGB_FLOAT: _format("f4", *"rgb"),
    PixelCode.HSV_FLOAT: _format("f4", *"hsv"),
    **{
        code: _format("u2" if code.name.endswith("16") else "u1", "value") for code in PixelCode if "BAYER" in code.name
    },
    **{code: _format("u1", "value") for code in PixelCode if "YUV" in code.name},
}


def format_of(code: int) -> Format:
    """What pixels of a code hold.

    Raises:
        ValueError: it is no code of YARP's.
    """
    if -LARGEST <= code < 0:
        return Format(np.dtype("u1"), tuple(f"byte{index}" for index in range(-code)))
    try:
        return _FORMATS[PixelCode(code)]
    except (ValueError, KeyError):
        word = (code & 0xFFFFFFFF).to_bytes(4, "little").rstrip(b"\0")
        msg = f"there are no pixels of code {word.decode('latin-1')!r} ({code})"
        raise ValueError(msg) from None


class Pixel:
    """One pixel of several numbers, in an image's memory or its own; setting one changes the image.

    Args:
        values: its numbers, in the order of the code's name, by default 0.
    """

    __slots__ = ("_memory",)
    names: tuple[str, ...] = ()

    def __init__(self, *values: float) -> None:
        self._memory: Any = np.zeros(len(self.names), self._kind())
        for name, value in zip(self._arguments(), values, strict=False):
            setattr(self, name, value)

    @classmethod
    def at(cls, memory: NDArray[Any]) -> Pixel:
        """The pixel in this memory of its numbers."""
        pixel = cls.__new__(cls)
        pixel._memory = memory
        return pixel

    @classmethod
    def _kind(cls) -> np.dtype[Any]:
        return _KINDS[cls]

    @classmethod
    def _arguments(cls) -> tuple[str, ...]:
        """The names in the order in which C++ takes them: red first, whatever the memory's order."""
        return tuple(sorted(cls.names, key="rgbahsv".index))

    def __getattr__(self, name: str) -> Any:
        try:
            return self._memory[self.names.index(name)].item()
        except ValueError:
            msg = f"{type(self).__name__} has no {name!r}, only {', '.join(self.names)}"
            raise AttributeError(msg) from None

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "_memory":
            object.__setattr__(self, name, value)
        elif name in self.names:
            self._memory[self.names.index(name)] = value
        else:
            msg = f"{type(self).__name__} has no {name!r}, only {', '.join(self.names)}"
            raise AttributeError(msg)

    def __iter__(self) -> Any:
        return iter(self._memory.tolist())

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Pixel) or type(other) is not type(self):
            return NotImplemented
        return list(self) == list(other)

    __hash__ = None  # type: ignore[assignment] # it changes

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={getattr(self, name)}" for name in self.names)
        return f"{type(self).__name__}({values})"


class PixelRgb(Pixel):
    """Red, green, blue in bytes."""

    __slots__ = ()
    names = tuple("rgb")


class PixelBgr(Pixel):
    """Blue, green, red in bytes."""

    __slots__ = ()
    names = tuple("bgr")


class PixelRgba(Pixel):
    """Red, green, blue, opacity in bytes."""

    __slots__ = ()
    names = tuple("rgba")


class PixelBgra(Pixel):
    """Blue, green, red, opacity in bytes."""

    __slots__ = ()
    names = tuple("bgra")


class PixelHsv(Pixel):
    """Hue, saturation, value in bytes."""

    __slots__ = ()
    names = tuple("hsv")


class PixelRgbSigned(Pixel):
    """Red, green, blue in signed bytes."""

    __slots__ = ()
    names = tuple("rgb")


class PixelRgbInt(Pixel):
    """Red, green, blue in integers of four bytes."""

    __slots__ = ()
    names = tuple("rgb")


class PixelRgbFloat(Pixel):
    """Red, green, blue in floats."""

    __slots__ = ()
    names = tuple("rgb")


class PixelHsvFloat(Pixel):
    """Hue, saturation, value in floats."""

    __slots__ = ()
    names = tuple("hsv")


PIXELS: dict[int, type[Pixel]] = {
    PixelCode.RGB: PixelRgb,
    PixelCode.BGR: PixelBgr,
    PixelCode.RGBA: PixelRgba,
    PixelCode.BGRA: PixelBgra,
    PixelCode.HSV: PixelHsv,
    PixelCode.RGB_SIGNED: PixelRgbSigned,
    PixelCode.RGB_INT: PixelRgbInt,
    PixelCode.RGB_FLOAT: PixelRgbFloat,
    PixelCode.HSV_FLOAT: PixelHsvFloat,
}
"""The class of pixels of several numbers, by code."""
_KINDS = {found: format_of(code).dtype for code, found in PIXELS.items()}
