"""The name of what crosses a port, as YARP's ports announce it (`yarp/os/Type.h`)."""

from __future__ import annotations

from typing import Any

from yarp_compat.wire.accessors import getter


class Type:
    """A kind of data: ``yarp/image``; ``properties`` tell more of it. Without a name it is any kind."""

    def __init__(self, name: str = "", name_on_wire: str = "") -> None:
        self._name = name
        self._on_wire = name_on_wire
        self.properties: dict[str, Any] = {}

    @classmethod
    def byName(cls, name: str, name_on_wire: str = "") -> Type:
        """The kind of a name, and of the name that other software has for it."""
        return cls(name, name_on_wire)

    @classmethod
    def byNameOnWire(cls, name_on_wire: str) -> Type:
        """The kind of which only other software's name is known."""
        return cls("", name_on_wire)

    @classmethod
    def anon(cls) -> Type:
        """Any kind."""
        return cls()

    getName = getter("_name", str, "YARP's name of it.")
    getNameOnWire = getter("_on_wire", str, "Other software's name of it.")

    def hasName(self) -> bool:
        """Whether it has a name."""
        return bool(self._name)

    isValid = hasName

    def addProperty(self, key: str, value: Any) -> Type:
        """Tell more of it."""
        self.properties[key] = value
        return self

    def toString(self) -> str:
        """Both names; ``null`` for any kind."""
        return f"{self._name}:{self._on_wire}" if self._on_wire else self._name or "null"

    toString_c = toString
    __str__ = toString

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Type) and (self._name, self._on_wire) == (other._name, other._on_wire)

    def __hash__(self) -> int:
        return hash((self._name, self._on_wire))
