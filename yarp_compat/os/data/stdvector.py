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


def _class(name: str, base: type[StdVector], zero: Any, doc: str) -> type[StdVector]:
    return type(name, (base,), {"ZERO": zero, "__doc__": doc, "__module__": __name__})


DVector = _class("DVector", StdVector, 0.0, "Of numbers.")
IVector = _class("IVector", StdVector, 0, "Of whole numbers.")
ShortVector = _class("ShortVector", IVector, 0, "Of whole numbers from -32768 to 32767.")
BVector = _class("BVector", StdVector, False, "Of truths.")
SVector = _class("SVector", StdVector, "", "Of texts.")
