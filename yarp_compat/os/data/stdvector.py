"""``DVector`` and similar classes: C++'s ``std::vector`` in YARP's bindings, which is a list in Python."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, ClassVar, Self


class StdVector(list[Any]):
    """A list with the methods of C++'s ``std::vector``; it can also be created from its length, ``DVector(6)``."""

    ZERO: ClassVar[Any] = None

    def __init__(self, content: int | Iterable[Any] = (), value: Any = None) -> None:
        super().__init__(self._fillers(content, value) if isinstance(content, int) else content)

    def _fillers(self, count: int, value: Any) -> list[Any]:
        """Return ``count`` copies of a value, by default of `ZERO`."""
        return [self.ZERO if value is None else value] * count

    def size(self) -> int:
        """Return the number of elements."""
        return len(self)

    capacity = size

    def empty(self) -> bool:
        """Return whether it has no elements."""
        return not self

    def push_back(self, value: Any) -> None:
        """Append an element."""
        self.append(value)

    def pop_back(self) -> None:
        """Remove the last element; raises `IndexError` if empty."""
        self.pop()

    def front(self) -> Any:
        """Return the first element; raises `IndexError` if empty."""
        return self[0]

    def back(self) -> Any:
        """Return the last element; raises `IndexError` if empty."""
        return self[-1]

    def resize(self, size: int, value: Any = None) -> None:
        """Change the length; new elements get ``value``."""
        del self[size:]
        self.extend(self._fillers(size - len(self), value))

    def assign(self, size: int, value: Any) -> None:
        """Replace the content by ``size`` copies of a value."""
        self[:] = [value] * size

    def reserve(self, size: int) -> None:
        """Do nothing: memory is allocated on demand."""

    def swap(self, other: Self) -> None:
        """Exchange the contents with another vector."""
        self[:], other[:] = list(other), list(self)

    def iterator(self) -> Iterator[Any]:
        """Return an iterator over the elements."""
        return iter(self)


def _class(name: str, base: type[StdVector], zero: Any, doc: str) -> type[StdVector]:
    return type(name, (base,), {"ZERO": zero, "__doc__": doc, "__module__": __name__})


DVector = _class("DVector", StdVector, 0.0, "A vector of floats.")
IVector = _class("IVector", StdVector, 0, "A vector of ints.")
ShortVector = _class("ShortVector", IVector, 0, "A vector of ints from -32768 to 32767.")
BVector = _class("BVector", StdVector, False, "A vector of bools.")
SVector = _class("SVector", StdVector, "", "A vector of strings.")
SPairVector = _class("SPairVector", StdVector, ("", ""), "A vector of pairs of strings.")
