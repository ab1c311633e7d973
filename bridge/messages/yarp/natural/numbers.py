"""Vectors in a payload, as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from yarp_compat.wire import tags
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer


def write_numbers(out: Writer, numbers: NDArray[Any]) -> None:
    """A vector of the array's own type; unsigned numbers have the tag of the signed ones."""
    kinds = {
        "i1": tags.INT8, "i2": tags.INT16, "i4": tags.INT32, "i8": tags.INT64,
        "f4": out.profile.float32_tag, "f8": out.profile.float64_tag,
    }  # fmt: skip
    kind = numbers.dtype.str[1:]
    out.begin(len(numbers), kinds[kind.replace("u", "i")])
    if len(numbers):
        out.block(np.ascontiguousarray(numbers).data.cast("B"))


def read_numbers(source: Reader) -> NDArray[Any]:
    """The list of numbers that comes next, whatever type they have."""
    at = source.at
    source.begin()
    tag = source.next_tag() if source.left else tags.INT32
    formats = tags.formats(source.profile)
    specialised = bytes(source.data[at : at + 2]) != b"\x00\x01"
    if specialised and tag in formats:
        count = source.left
        dtype = np.dtype("<" + formats[tag])
        data = source.block(count * dtype.itemsize)
        source.leave()
        return np.frombuffer(data, dtype)
    found = [source.float64() for _ in range(source.left)]
    source.end()
    return np.array(found, np.float64)
