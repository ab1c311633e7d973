"""Vectors of numbers (`yarp/sig/Vector.h`): one list of one type, in one piece of memory.

Beside YARP's own names there are Python's: indexing, iteration, ``numpy.asarray``. :meth:`VectorOf.numpy` shares the
vector's memory; a vector that was read shares the message's and copies it before it is changed, where that is needed.

Real YARP refuses to read an empty vector, though it writes one. This reads it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from yarp_compat.sig.numbers import as_array, read_numbers, tag_of, write_numbers
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer


class VectorOf(Portable):
    """A vector; the classes below are those of each type.

    Args:
        content: how many elements, or the elements.
        fill: what each element is, where only their number is given.
    """

    TYPE = "yarp/vector"
    dtype: ClassVar[np.dtype[Any]]
    """The elements' type."""

    def __init__(self, content: int | Iterable[Any] = 0, fill: Any = 0) -> None:
        if isinstance(content, int):
            self._room: NDArray[Any] = np.full(content, fill, self.dtype)
        else:
            given = content if hasattr(content, "__len__") else list(content)
            self._room = np.array(given, self.dtype).reshape(-1)
        self._count = len(self._room)

    @classmethod
    def of(cls, array: NDArray[Any]) -> Self:
        """A vector that shares an array's memory where the array is of its type and in one piece."""
        vector = cls()
        vector._room = np.ascontiguousarray(array, cls.dtype).reshape(-1)
        vector._count = len(vector._room)
        return vector

    def numpy(self) -> NDArray[Any]:
        """The elements as an array that shares the vector's memory, until the vector changes its size.

        It cannot be written to where the vector came in memory that cannot.
        """
        return self._room[: self._count]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return as_array(self.numpy(), dtype, copy)

    def size(self) -> int:
        """How many elements there are."""
        return self._count

    length = size
    getListSize = size

    def getElementSize(self) -> int:
        """Bytes of an element."""
        return self.dtype.itemsize

    def getBottleTag(self) -> int:
        """The elements' tag, in YARP 3."""
        return tag_of(self.dtype, Profile.YARP3)

    def capacity(self) -> int:
        """How many elements there is memory for."""
        return len(self._room)

    def reserve(self, size: int) -> None:
        """Have memory for so many elements."""
        if size > len(self._room):
            room = np.zeros(size, self.dtype)
            room[: self._count] = self._room[: self._count]
            self._room = room

    def resize(self, size: int, fill: Any = None) -> None:
        """Become so long; new elements are 0, or all are ``fill`` where it is given."""
        if size < 0:
            msg = f"a vector cannot have {size} elements"
            raise ValueError(msg)
        if size != self._count:
            room = np.zeros(size, self.dtype)
            kept = min(size, self._count)
            room[:kept] = self._room[:kept]
            self._room, self._count = room, size
        if fill is not None:
            self._own()[:] = fill

    def clear(self) -> None:
        """Become empty."""
        self.resize(0)

    def zero(self) -> None:
        """Set every element to 0."""
        self._own()[:] = 0

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
            msg = "the vector is empty"
            raise IndexError(msg)
        self._count -= 1

    def get(self, index: int) -> Any:
        """One element."""
        return self[index]

    access = get

    def set(self, index: int, value: Any) -> None:
        """Change one element."""
        self[index] = value

    def subVector(self, first: int, last: int) -> Self:
        """The elements from one to another, both included; an empty vector where there are none such."""
        if 0 <= first <= last < self._count:
            return type(self)(self._room[first : last + 1])
        return type(self)()

    def setSubvector(self, position: int, other: VectorOf) -> bool:
        """Copy another vector's elements into this one; False where they do not fit."""
        if position < 0 or position + len(other) > self._count:
            return False
        self._own()[position : position + len(other)] = other.numpy()
        return True

    def toString(self, precision: int = -1, width: int = -1) -> str:
        """The elements as YARP prints them."""
        digits = 6 if precision < 0 else precision
        if self.dtype == np.float64:
            if width < 0:
                return "\t".join(f"{value: .{digits}f}" for value in self.numpy())
            return " ".join(f"{value: {width}.{digits}f}" for value in self.numpy())
        form = "{:f}" if self.dtype.kind == "f" else "{:d}"
        return " ".join(map(form.format, self.numpy()))

    def toString_c(self) -> str:
        """The elements as YARP prints them."""
        return self.toString()

    __str__ = toString_c

    def isEqual(self, other: object) -> bool:
        """Whether both have the same elements."""
        return self == other

    def notEqual(self, other: object) -> bool:
        """Whether they differ."""
        return self != other

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, VectorOf) or other.dtype != self.dtype:
            return NotImplemented
        return np.array_equal(self.numpy(), other.numpy())

    __hash__ = None  # type: ignore[assignment] # it changes

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Any]:
        return iter(self.numpy().tolist())

    def __getitem__(self, index: int | slice) -> Any:
        found = self.numpy()[index]
        return found if isinstance(index, slice) else found.item()

    def __setitem__(self, index: int | slice, value: Any) -> None:
        self._own()[index] = value

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.numpy().tolist()})"

    def _own(self) -> NDArray[Any]:
        """The elements in memory that can be changed."""
        if not self._room.flags.writeable:
            self._room = self._room.copy()
        return self._room[: self._count]

    def _write(self, out: Writer) -> None:
        write_numbers(out, self.numpy())

    def _read(self, source: Reader) -> None:
        self._room = read_numbers(source, self.dtype)
        self._count = len(self._room)


class Vector(VectorOf):
    """Doubles: what YARP means by a vector."""

    dtype = np.dtype("<f8")


class VectorFloat(VectorOf):
    """Floats of four bytes."""

    dtype = np.dtype("<f4")


class VectorInt(VectorOf):
    """Integers of four bytes."""

    dtype = np.dtype("<i4")


class VectorInt8(VectorOf):
    """Integers of one byte."""

    dtype = np.dtype("<i1")


class VectorInt16(VectorOf):
    """Integers of two bytes."""

    dtype = np.dtype("<i2")


class VectorInt64(VectorOf):
    """Integers of eight bytes."""

    dtype = np.dtype("<i8")


class VectorUInt8(VectorOf):
    """Unsigned integers of one byte."""

    dtype = np.dtype("<u1")


class VectorUInt16(VectorOf):
    """Unsigned integers of two bytes."""

    dtype = np.dtype("<u2")


class VectorUInt32(VectorOf):
    """Unsigned integers of four bytes."""

    dtype = np.dtype("<u4")


class VectorUInt64(VectorOf):
    """Unsigned integers of eight bytes."""

    dtype = np.dtype("<u8")


_CLASSES: dict[np.dtype[Any], type[VectorOf]] = {found.dtype: found for found in VectorOf.__subclasses__()}


def vector_of(dtype: Any) -> type[VectorOf]:
    """The class of vectors of a numpy type.

    Raises:
        TypeError: YARP has no vectors of it.
    """
    found = _CLASSES.get(np.dtype(dtype).newbyteorder("<"))
    if found is None:
        msg = f"YARP has no vectors of {np.dtype(dtype)}"
        raise TypeError(msg)
    return found
