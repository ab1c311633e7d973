"""Lists of numbers between the wire and numpy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.tags import formats
from yarp_compat.wire.writer import Writer

_TYPES = {
    profile: {tag: np.dtype("<" + letter) for tag, letter in formats(profile).items()} for profile in Profile
}  # fmt: skip
_TAGS = {profile: {found: tag for tag, found in types.items()} for profile, types in _TYPES.items()}


def tag_of(dtype: np.dtype[Any], profile: Profile) -> int:
    """The tag of a numpy type; an unsigned one has that of the signed type of its size, as YARP's vectors do."""
    if dtype.kind == "u":
        dtype = np.dtype(f"<i{dtype.itemsize}")
    return _TAGS[profile][dtype]


def as_array(values: NDArray[Any], dtype: Any, copy: bool | None) -> NDArray[Any]:
    """An array of these values as numpy asks for one: of another type, or with memory of its own.

    Raises:
        ValueError: that needs a copy, which was forbidden.
    """
    if dtype is not None and np.dtype(dtype) != values.dtype:
        if copy is False:
            msg = f"numbers of {values.dtype} are no array of {np.dtype(dtype)} without a copy"
            raise ValueError(msg)
        return values.astype(dtype)
    return values.copy() if copy else values


def write_numbers(out: Writer, values: NDArray[Any]) -> None:
    """A list of numbers, one after another in memory, which are passed on uncopied where they are many."""
    out.begin(values.size, tag_of(values.dtype, out.profile))
    out.block(values.view(np.uint8).data)


def read_numbers(source: Reader, dtype: np.dtype[Any]) -> NDArray[Any]:
    """A list of numbers; a view into the payload where they are of this type, else a copy.

    YARP's own readers take only lists of exactly their type; this also takes what people type, such as ``1 2.5``.

    Raises:
        WireError: it is something else, or a number is none of this type.
    """
    tag, count, data = source.numbers()
    if data is None:
        read = source.float64 if dtype.kind == "f" else source.integer
        values = [read() for _ in range(count)]
        source.end()
        return _exact(values, dtype)
    if tag == tag_of(dtype, source.profile):
        return np.frombuffer(data, dtype, count)
    found = _TYPES[source.profile].get(tag)
    if found is None:
        raise WireError(f"expected a list of numbers, found one of tag {tag}")
    return _exact(np.frombuffer(data, found, count), dtype)


def _exact(values: Any, dtype: np.dtype[Any]) -> NDArray[Any]:
    """The same numbers as this type; those of a float type may lose digits."""
    given = np.asarray(values)
    if dtype.kind == "f" or not given.size:
        return given.astype(dtype)
    if given.dtype.kind == "f":
        raise WireError("expected a list of integers, found floats")
    limits = np.iinfo(dtype)
    if int(given.min()) < limits.min or int(given.max()) > limits.max:
        raise WireError(f"a number in the list is no {dtype.name}")
    return given.astype(dtype)
