"""``DVector`` and its kin: C++'s ``std::vector`` as the bindings give it, which in Python is a list."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar


class StdVector(list[Any]):
    """A list that is made by its length too, ``DVector(6)``, and has the methods that C++ has."""

    ZERO: ClassVar[Any] = None

    def __init__(self, content: int | Iterable[Any] = (), value: Any = None) -> None:
        filler = self.ZERO if value is None else value
        super().__init__([filler] * content if isinstance(content, int) else content)

    def size(self) -> int:
        """The number of them."""
        return len(self)

    def empty(self) -> bool:
        """Whether it is empty."""
        return not self

    def push_back(self, value: Any) -> None:
        """Add one at the end."""
        self.append(value)

    def resize(self, size: int, value: Any = None) -> None:
        """Make it this long."""
        del self[size:]
        self.extend([self.ZERO if value is None else value] * (size - len(self)))


class DVector(StdVector):
    """Of numbers."""

    ZERO = 0.0


class IVector(StdVector):
    """Of whole numbers."""

    ZERO = 0


class ShortVector(IVector):
    """Of whole numbers from -32768 to 32767."""


class BVector(StdVector):
    """Of truths."""

    ZERO = False


class SVector(StdVector):
    """Of texts."""

    ZERO = ""
