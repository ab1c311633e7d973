"""What Bottle, Property and Value have in common: values that are found by a key (`yarp/os/Searchable.h`)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, overload

if TYPE_CHECKING:
    from yarp_compat.os.bottle import Bottle
    from yarp_compat.os.value import Value


class Searchable(ABC):
    """Something with keys and values."""

    @abstractmethod
    def find(self, key: str) -> Value:
        """The value after a key; a null value where there is none."""

    @abstractmethod
    def findGroup(self, key: str) -> Bottle:
        """The list that begins with a key; a null Bottle where there is none."""

    @abstractmethod
    def toString(self) -> str:
        """The text form."""

    @overload
    def check(self, key: str, fallback: str = "", comment: str = "") -> bool: ...
    @overload
    def check(self, key: str, fallback: Value, comment: str = "") -> Value: ...
    def check(self, key: str, fallback: Value | str = "", comment: str = "") -> bool | Value:  # noqa: ARG002
        """Whether there is a key; with a fallback: its value, or the fallback. A comment is for the reader only."""
        if not isinstance(fallback, str):
            found = self.find(key)
            return fallback if found.isNull() else found
        return self._has(key)

    def isNull(self) -> bool:
        """Whether it stands for something that was not found."""
        return False

    def toString_c(self) -> str:
        """The text form, by the name that YARP's bindings give it."""
        return self.toString()

    def _has(self, key: str) -> bool:
        return not (self.findGroup(key).isNull() and self.find(key).isNull())

    def __contains__(self, key: object) -> bool:
        return isinstance(key, str) and self._has(key)

    def __str__(self) -> str:
        return self.toString()
