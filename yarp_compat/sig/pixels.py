"""The pixels of YARP's images: their codes, their channels, and conversion (`yarp/sig/Image.h`).

On the wire a code is a vocab, the same from 3.4 to 4.0; a negative code -n means pixels of n unknown bytes.

Pixels are converted as in YARP when an image is copied or read into another class: gray is the mean of red, green and
blue; gray is converted to equal red, green and blue, or to the value of hue, saturation, value; alpha becomes 255.
Integers keep their lowest bits, floats are clipped to the integer's range (undefined in C++). Conversions that YARP
lacks (from or to hue, bayer patterns, YUV) are refused (`Image.copyPixels.cpp`).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from yarp_compat.overriding import override

LARGEST = 1024  # maximum bytes of a pixel with unknown content


def _code(word: str) -> int:
    return int.from_bytes(word.encode().ljust(4, b"\0"), "little")


class PixelCode(IntEnum):
    """The pixel codes; each is the number of its vocab."""

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
    """The format of a pixel: the type of its channels, and their names in memory order."""

    dtype: np.dtype[Any]
    channels: tuple[str, ...]

    @property
    def size(self) -> int:
        """The size of a pixel in bytes."""
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
    """Return the format of a pixel code; raises `ValueError` for an unknown code."""
    if -LARGEST <= code < 0:
        return Format(np.dtype("u1"), tuple(f"byte{index}" for index in range(-code)))
    try:
        return _FORMATS[PixelCode(code)]
    except (ValueError, KeyError):
        text = (code & 0xFFFFFFFF).to_bytes(4, "little").rstrip(b"\0")
        raise ValueError(f"unknown pixel code {text.decode('latin-1')!r} ({code})") from None


class Pixel:
    """A pixel with several channels, by default 0, in its own memory or an image's, which changes with the pixel."""

    __slots__ = ("_memory",)
    names: tuple[str, ...] = ()
    dtype: ClassVar[np.dtype[Any]]

    def __init__(self, *values: float) -> None:
        self._memory: Any = np.zeros(len(self.names), self.dtype)
        for name, value in zip(self._arguments(), values, strict=False):
            setattr(self, name, value)

    @classmethod
    def view(cls, memory: NDArray[Any]) -> Pixel:
        """Return a pixel that views this memory."""
        pixel = cls.__new__(cls)
        pixel._memory = memory
        return pixel

    @classmethod
    def _arguments(cls) -> tuple[str, ...]:
        """Return the names in the order of C++'s constructors: red first, independent of the memory order."""
        return tuple(sorted(cls.names, key="rgbahsv".index))

    def __getattr__(self, name: str) -> Any:
        try:
            return self._memory[self.names.index(name)].item()
        except ValueError:
            raise AttributeError(f"{type(self).__name__} has only {', '.join(self.names)}, not {name!r}") from None

    @override
    def __setattr__(self, name: str, value: Any) -> None:
        if name == "_memory":
            object.__setattr__(self, name, value)
        elif name in self.names:
            self._memory[self.names.index(name)] = value
        else:
            raise AttributeError(f"{type(self).__name__} has only {', '.join(self.names)}, not {name!r}")

    def __iter__(self) -> Any:
        return iter(self._memory.tolist())

    @override
    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Pixel) or type(other) is not type(self):
            return NotImplemented
        return list(self) == list(other)

    @override
    def __repr__(self) -> str:
        values = ", ".join(f"{name}={getattr(self, name)}" for name in self.names)
        return f"{type(self).__name__}({values})"


PIXELS: dict[int, type[Pixel]] = {}  # the classes of pixels with several channels, by code


def _class(name: str, code: PixelCode, doc: str) -> type[Pixel]:
    body = {"__slots__": (), "names": _FORMATS[code].channels, "dtype": _FORMATS[code].dtype, "__doc__": doc}
    PIXELS[code] = type(name, (Pixel,), {**body, "__module__": __name__})
    return PIXELS[code]


PixelRgb = _class("PixelRgb", PixelCode.RGB, "Red, green, blue in bytes.")
PixelBgr = _class("PixelBgr", PixelCode.BGR, "Blue, green, red in bytes.")
PixelRgba = _class("PixelRgba", PixelCode.RGBA, "Red, green, blue, alpha in bytes.")
PixelBgra = _class("PixelBgra", PixelCode.BGRA, "Blue, green, red, alpha in bytes.")
PixelHsv = _class("PixelHsv", PixelCode.HSV, "Hue, saturation, value in bytes.")
PixelRgbSigned = _class("PixelRgbSigned", PixelCode.RGB_SIGNED, "Red, green, blue in signed bytes.")
PixelRgbInt = _class("PixelRgbInt", PixelCode.RGB_INT, "Red, green, blue in integers of four bytes.")
PixelRgbFloat = _class("PixelRgbFloat", PixelCode.RGB_FLOAT, "Red, green, blue in floats.")
PixelHsvFloat = _class("PixelHsvFloat", PixelCode.HSV_FLOAT, "Hue, saturation, value in floats.")

_RAW = {code for code in PixelCode if "BAYER" in code.name or "YUV" in code.name}
_RGB = ("r", "g", "b")


def convert(pixels: NDArray[Any], source: int, target: int) -> NDArray[Any]:
    """Convert an array (height, width[, channels]) to another pixel code; raises `ValueError` if YARP cannot."""
    if source == target:
        return pixels
    given, wanted = format_of(source), format_of(target)
    if source in _RAW or target in _RAW or source < 0 or target < 0:
        raise _none(source, target)
    if given.channels == wanted.channels:
        return _cast(pixels, wanted.dtype)
    if wanted.channels == ("value",):
        if not set(_RGB) <= set(given.channels):
            raise _none(source, target)
        return _cast(_mean(pixels, given, wanted.dtype), wanted.dtype)
    if given.channels == ("value",):
        planes: dict[str, Any] = {**dict.fromkeys(_RGB, pixels), "h": 0, "s": 0, "v": pixels, "a": 255}
    elif set(_RGB) <= set(given.channels) and set(_RGB) <= set(wanted.channels):
        planes = {"a": 255, **{name: pixels[..., place] for place, name in enumerate(given.channels)}}
    else:
        raise _none(source, target)
    converted = np.empty((*pixels.shape[:2], len(wanted.channels)), wanted.dtype)
    for place, name in enumerate(wanted.channels):
        plane = planes[name]
        converted[..., place] = plane if isinstance(plane, int) else _cast(plane, wanted.dtype)
    return converted


def _mean(pixels: NDArray[Any], given: Format, wanted: np.dtype[Any]) -> NDArray[Any]:
    places = [given.channels.index(name) for name in _RGB]
    total: NDArray[Any] = pixels[..., places].sum(axis=2, dtype=np.float64 if given.dtype.kind == "f" else np.int64)
    return total / 3.0 if "f" in (wanted.kind, given.dtype.kind) else np.trunc(total / 3.0).astype(np.int64)


def _cast(values: NDArray[Any], wanted: np.dtype[Any]) -> NDArray[Any]:
    if values.dtype.kind == "f" and wanted.kind != "f":
        limits = np.iinfo(wanted)
        return np.clip(np.nan_to_num(values.astype(np.float64)), limits.min, limits.max).astype(wanted)
    return values.astype(wanted)


def _none(source: int, target: int) -> ValueError:
    names = [PixelCode(code).name if code > 0 else f"of {-code} bytes" for code in (source, target)]
    return ValueError(f"YARP cannot convert {names[0]} pixels to {names[1]} pixels: read them into a FlexImage")
