"""One kind of pixels from another, as YARP does it when an image is copied or read into one of another kind.

Grey is the mean of red, green and blue; from grey all three are the same; opacity becomes 255; brightness alone becomes
the value of hue, saturation, value. Integers keep their lowest bits, floats are cut to what the integer can hold (C++
leaves that open). What YARP cannot convert either (from or to hue, bayer patterns, YUV) is refused.
(`yarp/sig/Image.copyPixels.cpp`)
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from yarp_compat.sig.pixels import Format, PixelCode, format_of

_RAW = {code for code in PixelCode if "BAYER" in code.name or "YUV" in code.name}
_RGB = ("r", "g", "b")


def convert(pixels: NDArray[Any], source: int, target: int) -> NDArray[Any]:
    """Other pixels of the same picture.

    Args:
        pixels: array of (height, width) or (height, width, channels).
        source: their code.
        target: the code to convert to.

    Raises:
        ValueError: there is no conversion.
    """
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
    made = np.empty((*pixels.shape[:2], len(wanted.channels)), wanted.dtype)
    for place, name in enumerate(wanted.channels):
        plane = planes[name]
        made[..., place] = plane if isinstance(plane, int) else _cast(plane, wanted.dtype)
    return made


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
    return ValueError(f"YARP has no way from {names[0]} pixels to {names[1]} pixels: read them into a FlexImage")
