"""Reads and writes PNG images (RFC 2083) as arrays: reads pixels of all kinds, writes gray and color with 8 bits."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER = struct.Struct(">IIBBBBB")
_GRAY, _RGB, _PALETTE, _GRAY_ALPHA, _RGBA = 0, 2, 3, 4, 6
_CHANNELS = {_GRAY: 1, _RGB: 3, _PALETTE: 1, _GRAY_ALPHA: 2, _RGBA: 4}
_DEPTHS = {_GRAY: (1, 2, 4, 8, 16), _PALETTE: (1, 2, 4, 8)}
LARGEST = 1 << 28  # size limit of an image to read, in bytes of pixels


def write(pixels: NDArray[np.uint8]) -> bytes:
    """Return an image, (height, width) gray or (height, width, 3) color, as a PNG file."""
    height, width = pixels.shape[:2]
    kind = _GRAY if pixels.ndim == 2 else _RGB
    rows = np.ascontiguousarray(pixels).reshape(height, -1)
    filtered = np.zeros((height, rows.shape[1] + 1), np.uint8)  # each row begins with its filter type: none
    filtered[:, 1:] = rows
    header = _HEADER.pack(width, height, 8, kind, 0, 0, 0)
    packed = zlib.compress(filtered.tobytes())
    return _SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", packed) + _chunk(b"IEND", b"")


def read(data: bytes) -> NDArray[np.uint8]:
    """Return a file's pixels, (height, width) gray or (height, width, 3) color, with 8 bits, without alpha.

    Raises `ValueError` if the file is not PNG, or is truncated, interlaced or larger than `LARGEST`.
    """
    if not data.startswith(_SIGNATURE):
        raise ValueError("not a PNG file")
    header, palette, packed = b"", b"", bytearray()
    for kind, content in _chunks(data):
        if kind == b"IHDR":
            header = content
        elif kind == b"PLTE":
            palette = content
        elif kind == b"IDAT":
            packed += content
    if len(header) != _HEADER.size:
        raise ValueError("the header is missing")
    width, height, depth, color_type, _, _, interlaced = _HEADER.unpack(header)
    if color_type not in _CHANNELS or depth not in _DEPTHS.get(color_type, (8, 16)):
        raise ValueError(f"invalid color type {color_type} with {depth} bits")
    if interlaced:
        raise ValueError("interlaced images are not supported; save it without interlacing")
    channels = _CHANNELS[color_type]
    samples = _unpacked(_rows(bytes(packed), height, width * channels * depth, depth, channels), depth)
    values = samples[:, : width * channels].reshape(height, width, channels)
    if color_type == _PALETTE:
        table = np.frombuffer(palette[: len(palette) // 3 * 3], np.uint8).reshape(-1, 3)
        if values.size and int(values.max()) >= len(table):
            raise ValueError("it uses colors that its palette lacks")
        return np.ascontiguousarray(table[values[:, :, 0]])
    scaled = values if depth == 8 else values >> 8 if depth == 16 else values * (255 // ((1 << depth) - 1))
    pixels = scaled[:, :, 0] if color_type in (_GRAY, _GRAY_ALPHA) else scaled[:, :, :3]
    return np.ascontiguousarray(pixels.astype(np.uint8))


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = len(_SIGNATURE)
    while at < len(data):
        if len(data) - at < 12:
            raise ValueError("the file is truncated")
        (length,) = struct.unpack_from(">I", data, at)
        kind, content = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        if len(content) < length:
            raise ValueError("the file is truncated")
        yield kind, content
        if kind == b"IEND":
            return
        at += 12 + length


def _rows(packed: bytes, height: int, bits: int, depth: int, channels: int) -> NDArray[np.uint8]:
    """Return the bytes of the rows, without filters."""
    length = (bits + 7) // 8
    if height * (length + 1) > LARGEST:
        raise ValueError(f"it has more than {LARGEST} bytes")
    try:
        opened = zlib.decompressobj().decompress(packed, height * (length + 1) or 1)
    except zlib.error as error:
        raise ValueError(f"cannot decompress its pixels: {error}") from None
    if len(opened) < height * (length + 1):
        raise ValueError("the file is truncated")
    raw = np.frombuffer(opened, np.uint8).reshape(height, length + 1)
    step = max(depth * channels // 8, 1)
    out = np.zeros((height, length), np.uint8)
    above = np.zeros(length, np.uint8)
    for row in range(height):
        above = out[row] = _unfiltered(int(raw[row, 0]), raw[row, 1:], above, step)
    return out


def _unfiltered(kind: int, row: NDArray[np.uint8], above: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """Undo a row's filter, which predicts each byte from those to the left and above."""
    if kind == 0:
        return row
    if kind == 2:
        return row + above
    if kind == 1:
        padded = np.zeros(-(-len(row) // step) * step, np.uint8)
        padded[: len(row)] = row
        sums: NDArray[np.uint8] = np.cumsum(padded.reshape(-1, step), axis=0, dtype=np.uint8)
        return sums.reshape(-1)[: len(row)]
    if kind not in (3, 4):
        raise ValueError(f"a row has the unknown filter {kind}")
    out, over = bytearray(row.tobytes()), above.tobytes()
    for at in range(len(out)):
        left = out[at - step] if at >= step else 0
        if kind == 3:
            out[at] = out[at] + (left + over[at]) // 2 & 255
        else:
            corner = over[at - step] if at >= step else 0
            out[at] = out[at] + _paeth(left, over[at], corner) & 255
    return np.frombuffer(bytes(out), np.uint8)


def _paeth(left: int, above: int, corner: int) -> int:
    """Return the one of the three values that is nearest to ``left + above - corner``."""
    to_left, to_above, to_corner = abs(above - corner), abs(left - corner), abs(left + above - 2 * corner)
    if to_left <= to_above and to_left <= to_corner:
        return left
    return above if to_above <= to_corner else corner


def _unpacked(rows: NDArray[np.uint8], depth: int) -> NDArray[Any]:
    """Return the samples of the rows' bytes."""
    if depth == 8:
        return rows
    if depth == 16:
        return rows.view(">u2")
    weights = 1 << np.arange(depth - 1, -1, -1)
    samples: NDArray[Any] = np.unpackbits(rows, axis=1).reshape(len(rows), -1, depth) @ weights
    return samples
