"""``DVector`` and its kin: C++'s ``std::vector`` as the bindings give it, which in Python is a list."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, ClassVar, Self


class StdVector(list[Any]):
    """A list that is made by its length too, ``DVector(6)``, and has the methods that C++ has."""

    ZERO: ClassVar[Any] = None

    def __init__(self, content: int | Iterable[Any] = (), value: Any = None) -> None:
        super().__init__(self._fillers(content, value) if isinstance(content, int) else content)

    def _fillers(self, count: int, value: Any) -> list[Any]:
        """So many of a value, or of what stands where none was given."""
        return [self.ZERO if value is None else value] * count

    def size(self) -> int:
        """The number of them."""
        return len(self)

    capacity = size

    def empty(self) -> bool:
        """Whether it is empty."""
        return not self

    def push_back(self, value: Any) -> None:
        """Add one at the end."""
        self.append(value)

    def pop_back(self) -> None:
        """Remove the last; raises `IndexError` where there is none."""
        self.pop()

    def front(self) -> Any:
        """The first; raises `IndexError` where there is none."""
        return self[0]

    def back(self) -> Any:
        """The last; raises `IndexError` where there is none."""
        return self[-1]

    def resize(self, size: int, value: Any = None) -> None:
        """Make it this long."""
        del self[size:]
        self.extend(self._fillers(size - len(self), value))

    def assign(self, size: int, value: Any) -> None:
        """Become so many of one value."""
        self[:] = [value] * size

    def reserve(self, size: int) -> None:
        """Nothing to do: memory comes when it is needed."""

    def swap(self, other: Self) -> None:
        """Exchange all with another."""
        self[:], other[:] = list(other), list(self)

    def iterator(self) -> Iterator[Any]:
        """An iterator over them."""
        return iter(self)


def _class(name: str, base: type[StdVector], zero: Any, doc: str) -> type[StdVector]:
    return type(name, (base,), {"ZERO": zero, "__doc__": doc, "__module__": __name__})


DVector = _class("DVector", StdVector, 0.0, "Of numbers.")
IVector = _class("IVector", StdVector, 0, "Of whole numbers.")
ShortVector = _class("ShortVector", IVector, 0, "Of whole numbers from -32768 to 32767.")
BVector = _class("BVector", StdVector, False, "Of truths.")
SVector = _class("SVector", StdVector, "", "Of texts.")
SPairVector = _class("SPairVector", StdVector, ("", ""), "Of pairs of texts.")
