"""Vectors of numbers (`yarp/sig/Vector.h`): a list of one type, in contiguous memory.

In addition to YARP's methods, vectors support indexing, iteration and ``numpy.asarray``. `VectorOf.numpy` shares the
vector's memory; a received vector shares the message's memory, and if that is read-only, copies it before a change.

C++ YARP refuses to read empty vectors, though it writes them. This module reads them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from yarp_compat.overriding import override
from yarp_compat.wire.accessors import getter
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.tags import formats

_TYPES = {
    profile: {tag: np.dtype("<" + letter) for tag, letter in formats(profile).items()} for profile in Profile
}  # fmt: skip
_TAGS = {profile: {dtype: tag for tag, dtype in types.items()} for profile, types in _TYPES.items()}


def tag_of(dtype: np.dtype[Any], profile: Profile) -> int:
    """Return the tag of a numpy type; an unsigned type has the signed type's tag, as in YARP."""
    if dtype.kind == "u":
        dtype = np.dtype(f"<i{dtype.itemsize}")
    return _TAGS[profile][dtype]


def as_array(values: NDArray[Any], dtype: Any, copy: bool | None) -> NDArray[Any]:
    """Implement ``__array__``: convert to a type, copy if asked; raises `ValueError` if a needed copy is forbidden."""
    if dtype is not None and np.dtype(dtype) != values.dtype:
        if copy is False:
            raise ValueError(f"cannot convert {values.dtype} to {np.dtype(dtype)} without a copy")
        return values.astype(dtype)
    return values.copy() if copy else values


def write_numbers(out: ElementWriter, values: NDArray[Any]) -> None:
    """Write contiguous numbers as a list; large arrays are not copied."""
    out.begin(values.size, tag_of(values.dtype, out.profile))
    out.block(values.view(np.uint8).data)


def read_numbers(source: ElementReader, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Read a list of numbers, as a view of the payload if the type matches; raises `WireError` if they do not fit.

    YARP's readers accept only lists of exactly their type; this function also accepts lists of other or mixed types of
    numbers, such as the text ``1 2.5``.
    """
    tag, count, data = source.numbers()
    if data is None:
        read = source.float64 if dtype.kind == "f" else source.integer
        values = [read() for _ in range(count)]
        source.end()
        return _exact(values, dtype)
    if tag == tag_of(dtype, source.profile):
        return np.frombuffer(data, dtype, count)
    found_dtype = _TYPES[source.profile].get(tag)
    if found_dtype is None:
        raise WireError(f"expected a list of numbers, found one of tag {tag}")
    return _exact(np.frombuffer(data, found_dtype, count), dtype)


def _exact(values: Any, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Convert numbers to a type; only floats may lose precision."""
    given = np.asarray(values)
    if dtype.kind == "f" or not given.size:
        return given.astype(dtype)
    if given.dtype.kind == "f":
        raise WireError("expected a list of integers, found floats")
    limits = np.iinfo(dtype)
    if int(given.min()) < limits.min or int(given.max()) > limits.max:
        raise WireError(f"a number in the list does not fit into {dtype.name}")
    return given.astype(dtype)


class Comparable:
    """YARP's names for ``==`` and ``!=``."""

    def isEqual(self, other: object) -> bool:
        """Return whether both are equal."""
        return self == other

    def notEqual(self, other: object) -> bool:
        """Return whether they differ."""
        return self != other


class VectorOf(Comparable, Portable):
    """A vector, created from its length and ``fill``, or from elements; each subclass has one type of elements."""

    TYPE = "yarp/vector"
    dtype: ClassVar[np.dtype[Any]]  # the elements' type

    def __init__(self, content: int | Iterable[Any] = 0, fill: Any = 0) -> None:
        if isinstance(content, int):
            self._room: NDArray[Any] = np.full(content, fill, self.dtype)
        else:
            given = content if hasattr(content, "__len__") else list(content)
            self._room = np.array(given, self.dtype).reshape(-1)
        self._count = len(self._room)

    @classmethod
    def of(cls, array: NDArray[Any]) -> Self:
        """Return a vector that shares an array's memory, if the array has the same type and is contiguous."""
        vector = cls()
        vector._room = np.ascontiguousarray(array, cls.dtype).reshape(-1)
        vector._count = len(vector._room)
        return vector

    def numpy(self) -> NDArray[Any]:
        """Return the elements as a view of the current memory, read-only if the memory is.

        A change of the size, a received message and the first write to read-only memory may replace the memory.
        """
        return self._room[: self._count]

    def data(self) -> NDArray[Any]:
        """Return the elements as a writable view, like C++'s pointer: ``encoders.getEncoders(vector.data())``."""
        return self._writable()

    getMemoryBlock = data
    getFirst = data

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return as_array(self.numpy(), dtype, copy)

    size = getter("_count", int, "The number of elements.")

    length = size
    getListSize = size

    getElementSize = getter("dtype.itemsize", int, "The size of an element in bytes.")

    def getBottleTag(self) -> int:
        """Return the elements' tag in YARP 3."""
        return tag_of(self.dtype, Profile.YARP3)

    def capacity(self) -> int:
        """Return the number of elements with allocated memory."""
        return len(self._room)

    def reserve(self, size: int) -> None:
        """Allocate memory for at least ``size`` elements."""
        if size > len(self._room):
            room = np.zeros(size, self.dtype)
            room[: self._count] = self._room[: self._count]
            self._room = room

    def resize(self, size: int, fill: Any = None) -> None:
        """Change the length; new elements are 0, or all elements are ``fill`` if given."""
        if size < 0:
            raise ValueError(f"a vector cannot have {size} elements")
        if size != self._count:
            room = np.zeros(size, self.dtype)
            kept = min(size, self._count)
            room[:kept] = self._room[:kept]
            self._room, self._count = room, size
        if fill is not None:
            self._writable()[:] = fill

    def clear(self) -> None:
        self.resize(0)

    def zero(self) -> None:
        """Set every element to 0."""
        self._writable()[:] = 0

    def push_back(self, value: Any) -> None:
        """Append an element."""
        if self._count == len(self._room) or not self._room.flags.writeable:
            room = np.zeros(max(8, 2 * self._count), self.dtype)
            room[: self._count] = self._room[: self._count]
            self._room = room
        self._room[self._count] = value
        self._count += 1

    def pop_back(self) -> None:
        """Remove the last element."""
        if not self._count:
            raise IndexError("the vector is empty")
        self._count -= 1

    def get(self, index: int) -> Any:
        """Return one element."""
        return self[index]

    access = get

    def set(self, index: int, value: Any) -> None:
        """Set one element."""
        self[index] = value

    def subVector(self, first: int, last: int) -> Self:
        """Return a copy of a range of elements, ends included; an empty vector if out of range."""
        if 0 <= first <= last < self._count:
            return type(self)(self._room[first : last + 1])
        return type(self)()

    def setSubvector(self, position: int, other: VectorOf) -> bool:
        """Copy another vector's elements into this vector; return False if they do not fit."""
        if position < 0 or position + len(other) > self._count:
            return False
        self._writable()[position : position + len(other)] = other.numpy()
        return True

    def toString(self, precision: int = -1, width: int = -1) -> str:
        """Return the elements in YARP's text format."""
        digits = 6 if precision < 0 else precision
        if self.dtype == np.float64:
            if width < 0:
                return "\t".join(f"{value: .{digits}f}" for value in self.numpy())
            return " ".join(f"{value: {width}.{digits}f}" for value in self.numpy())
        form = "{:f}" if self.dtype.kind == "f" else "{:d}"
        return " ".join(map(form.format, self.numpy()))

    def toString_c(self) -> str:
        """Return the elements in YARP's text format."""
        return self.toString()

    __str__ = toString_c

    @override
    def __eq__(self, other: object) -> bool:
        if not isinstance(other, VectorOf) or other.dtype != self.dtype:
            return NotImplemented
        return np.array_equal(self.numpy(), other.numpy())

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Any]:
        return iter(self.numpy().tolist())

    def __getitem__(self, index: int | slice) -> Any:
        selected = self.numpy()[index]
        return selected if isinstance(index, slice) else selected.item()

    def __setitem__(self, index: int | slice, value: Any) -> None:
        self._writable()[index] = value

    @override
    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.numpy().tolist()})"

    def _writable(self) -> NDArray[Any]:
        """Return the elements in writable memory, copied if needed."""
        if not self._room.flags.writeable:
            self._room = self._room.copy()
        return self._room[: self._count]

    @override
    def _write(self, out: ElementWriter) -> None:
        write_numbers(out, self.numpy())

    @override
    def _read(self, source: ElementReader) -> None:
        self._room = read_numbers(source, self.dtype)
        self._count = len(self._room)


class Vector(VectorOf):
    """A vector of doubles, YARP's standard vector."""

    dtype = np.dtype("<f8")


def _class(name: str, dtype: str, doc: str) -> type[VectorOf]:
    return type(name, (VectorOf,), {"dtype": np.dtype(dtype), "__doc__": doc, "__module__": __name__})


VectorFloat = _class("VectorFloat", "<f4", "A vector of floats of four bytes.")
VectorInt = _class("VectorInt", "<i4", "A vector of integers of four bytes.")
VectorInt8 = _class("VectorInt8", "<i1", "A vector of integers of one byte.")
VectorInt16 = _class("VectorInt16", "<i2", "A vector of integers of two bytes.")
VectorInt64 = _class("VectorInt64", "<i8", "A vector of integers of eight bytes.")
VectorUInt8 = _class("VectorUInt8", "<u1", "A vector of unsigned integers of one byte.")
VectorUInt16 = _class("VectorUInt16", "<u2", "A vector of unsigned integers of two bytes.")
VectorUInt32 = _class("VectorUInt32", "<u4", "A vector of unsigned integers of four bytes.")
VectorUInt64 = _class("VectorUInt64", "<u8", "A vector of unsigned integers of eight bytes.")
_CLASSES: dict[np.dtype[Any], type[VectorOf]] = {kind.dtype: kind for kind in VectorOf.__subclasses__()}


def vector_of(dtype: Any) -> type[VectorOf]:
    """Return the vector class for a numpy type; raises `TypeError` if YARP has none."""
    kind = _CLASSES.get(np.dtype(dtype).newbyteorder("<"))
    if kind is None:
        raise TypeError(f"YARP has no vectors of {np.dtype(dtype)}")
    return kind
