"""Images of ``sensor_msgs``, scaled down for display.

Source: sensor_msgs/image_encodings.hpp for the encodings, REP 118 for depth, compressed_depth_image_transport for the
12 bytes before the PNG of a compressed depth image.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from bridge.messages.errors import ConversionError

MOST_PIXELS = 50_000_000
_FORMATS = ("JPEG", "PNG", "WEBP")
_DEPTH_HEAD = 12

Cells = NDArray[Any]


@dataclass(frozen=True)
class Picture:
    """An image, with the size and encoding of its message.

    ``range``: the values shown as black and white if the message has measurements (usually depth), else None.
    """

    image: Image.Image
    width: int
    height: int
    encoding: str
    range: tuple[float, float] | None = None


def decode(message: Mapping[str, Any], most: int) -> Picture:
    """Decode an ``Image`` or a ``CompressedImage``, with neither side above ``most`` pixels.

    Raises `ConversionError` with the reason if it cannot be shown.
    """
    return _decode_compressed(message, most) if "format" in message else _decode_raw(message, most)


def _colors(order: tuple[int, ...]) -> Callable[[Cells], Image.Image]:
    return lambda cells: Image.fromarray(np.ascontiguousarray(cells[..., list(order)]), "RGB")


def _mono(cells: Cells) -> Image.Image:
    return Image.fromarray(np.ascontiguousarray(cells[..., 0]), "L")


_OCTETS: Mapping[str, tuple[int, Callable[[Cells], Image.Image]]] = {
    **dict.fromkeys(("mono8", "8UC1"), (1, _mono)),
    "rgb8": (3, _colors((0, 1, 2))),
    **dict.fromkeys(("bgr8", "8UC3"), (3, _colors((2, 1, 0)))),
    "rgba8": (4, _colors((0, 1, 2))),
    **dict.fromkeys(("bgra8", "8UC4"), (4, _colors((2, 1, 0)))),
}
"""Encodings with 8-bit channels: the number of channels, and the conversion to an image."""

_MEASURES = {"mono16": "u2", "16UC1": "u2", "16SC1": "i2", "32SC1": "i4", "32FC1": "f4", "64FC1": "f8"}
"""Encodings with one number per pixel, shown from the smallest (black) to the largest (white); 0 means unknown."""

_BAYER = {
    "bayer_rggb8": ((0, 0), (1, 1)), "bayer_bggr8": ((1, 1), (0, 0)),
    "bayer_gbrg8": ((1, 0), (0, 1)), "bayer_grbg8": ((0, 1), (1, 0)),
}  # fmt: skip
"""Row and column of red and of blue in each square of four pixels; the others are green."""

_YUV = {
    **dict.fromkeys(("yuv422", "uyvy"), (1, 0, 3, 2)),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), (0, 1, 2, 3)),
}
"""Positions of first luminance, U, second luminance and V among the four bytes of two pixels."""

KNOWN = (*_OCTETS, *_MEASURES, *_BAYER, *_YUV)


def _decode_raw(message: Mapping[str, Any], most: int) -> Picture:
    encoding, width, height = message["encoding"], int(message["width"]), int(message["height"])
    if encoding not in KNOWN:
        raise ConversionError(f"images encoded as {encoding[:40]!r} are not supported; supported: {', '.join(KNOWN)}")
    if not 0 < width * height <= MOST_PIXELS:
        raise ConversionError(f"an image of {width} x {height} pixels is not shown: the limit is {MOST_PIXELS}")
    order = ">" if message["is_bigendian"] else "<"
    kind = np.dtype(order + _MEASURES[encoding]) if encoding in _MEASURES else np.dtype(np.uint8)
    values = width * (_OCTETS[encoding][0] if encoding in _OCTETS else 2 if encoding in _YUV else 1)
    rows = _rows(message, height, values * kind.itemsize).view(kind).reshape(height, values)
    about = (width, height, encoding)
    if encoding in _MEASURES:
        return _draw_measures(rows[:: _step(height, most), :: _step(width, most)], most, *about)
    if encoding in _OCTETS:
        channels, make = _OCTETS[encoding]
        cells = rows.reshape(height, width, channels)
        image = make(cells[:: _step(height, most), :: _step(width, most)])
    elif encoding in _BAYER:
        image = _bayer(rows, *_BAYER[encoding])
    else:
        image = _yuv(rows, _YUV[encoding])
    return Picture(_fit(image, width, height, most), *about)


def _rows(message: Mapping[str, Any], height: int, octets: int) -> Cells:
    """Return the rows without their padding."""
    data, step = np.frombuffer(message["data"], np.uint8), int(message["step"])
    if step < octets:
        raise ConversionError(f"a row has {step} bytes (step), but its pixels need {octets}")
    if len(data) < step * (height - 1) + octets:
        raise ConversionError(f"the image has {len(data)} bytes, but {height} rows of {step} are needed")
    if len(data) < step * height:  # the last row is not padded
        data = np.concatenate([data, np.zeros(step * height - len(data), np.uint8)])
    return np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :octets])


def _step(size: int, most: int) -> int:
    """Return the step at which pixels are sampled before the image is scaled smoothly."""
    return max(1, size // (2 * most))


def _fit(image: Image.Image, width: int, height: int, most: int) -> Image.Image:
    """Scale the image to the proportions of its message, within ``most``."""
    scale = min(1.0, most / max(width, height))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return image if image.size == size else image.resize(size, Image.Resampling.BILINEAR)


def _draw_measures(values: Cells, most: int, width: int, height: int, encoding: str) -> Picture:
    numbers = values.astype(np.float64)
    known = np.isfinite(numbers) & (numbers != 0)  # a depth of 0 is unknown
    low, high = (float(numbers[known].min()), float(numbers[known].max())) if known.any() else (0.0, 0.0)
    shade = (np.where(known, numbers, low) - low) * (255.0 / (high - low) if high > low else 0.0)
    image = Image.fromarray(np.rint(np.where(known, shade, 0.0)).astype(np.uint8), "L")
    return Picture(_fit(image, width, height, most), width, height, encoding, (low, high))


def _bayer(rows: Cells, red: tuple[int, int], blue: tuple[int, int]) -> Image.Image:
    """Return the image at half the size: each square of four makes one pixel."""
    even = rows[: rows.shape[0] // 2 * 2, : rows.shape[1] // 2 * 2]
    if not even.size:
        raise ConversionError("an image of one row or column has no colors")

    def cells_at(place: tuple[int, int]) -> Cells:
        return even[place[0] :: 2, place[1] :: 2]

    greens = [(y, x) for y in (0, 1) for x in (0, 1) if (y, x) not in (red, blue)]
    green = ((cells_at(greens[0]).astype(np.uint16) + cells_at(greens[1])) // 2).astype(np.uint8)
    return Image.fromarray(np.dstack([cells_at(red), green, cells_at(blue)]), "RGB")


def _yuv(rows: Cells, places: tuple[int, int, int, int]) -> Image.Image:
    """Return the image at half the width: two pixels share their color."""
    pairs = rows[:, : rows.shape[1] // 4 * 4].reshape(rows.shape[0], -1, 4)
    if not pairs.size:
        raise ConversionError("an image of one column has no colors")
    first, u, second, v = (pairs[..., place] for place in places)
    bright = ((first.astype(np.uint16) + second) // 2).astype(np.uint8)
    return Image.frombytes(
        "YCbCr", (pairs.shape[1], pairs.shape[0]), np.dstack([bright, u, v]).tobytes()
    ).convert("RGB")  # fmt: skip


def _decode_compressed(message: Mapping[str, Any], most: int) -> Picture:
    format_ = str(message["format"])
    data = bytes(message["data"])
    if "compressedDepth" in format_:
        data = data[_DEPTH_HEAD:]
    try:
        with Image.open(io.BytesIO(data), formats=_FORMATS) as image:
            width, height = image.size
            if not 0 < width * height <= MOST_PIXELS:
                raise ConversionError(f"an image of {width} x {height} pixels is not shown: the limit is {MOST_PIXELS}")
            image.draft("RGB" if image.mode != "L" else "L", (most, most))  # a JPEG is decoded at reduced size
            image.load()
            about = (width, height, format_ or str(image.format).lower())
            if image.mode.startswith("I"):
                return _draw_measures(np.asarray(image), most, *about)
            return Picture(_fit(image.convert("L" if image.mode == "L" else "RGB"), width, height, most), *about)
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError, Image.DecompressionBombError) as err:
        shown_format = format_[:40] or "no format"
        raise ConversionError(f"cannot read the compressed image ({shown_format}): {err}") from None
