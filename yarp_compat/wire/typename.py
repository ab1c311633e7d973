"""The type names of messages, as YARP's ports announce them (`yarp/os/Type.h`)."""

from __future__ import annotations

from typing import Any

from yarp_compat.overriding import override
from yarp_compat.wire.accessors import getter


class Type:
    """A type of data, such as ``yarp/image``, with ``properties``. Without a name it is any type."""

    def __init__(self, name: str = "", name_on_wire: str = "") -> None:
        self._name = name
        self._on_wire = name_on_wire
        self.properties: dict[str, Any] = {}

    @classmethod
    def byName(cls, name: str, name_on_wire: str = "") -> Type:
        """Return the type with a name, and optionally a name in other software."""
        return cls(name, name_on_wire)

    @classmethod
    def byNameOnWire(cls, name_on_wire: str) -> Type:
        """Return the type with only a name in other software."""
        return cls("", name_on_wire)

    @classmethod
    def anon(cls) -> Type:
        """Return the type without a name."""
        return cls()

    getName = getter("_name", str, "The name in YARP.")
    getNameOnWire = getter("_on_wire", str, "The name in other software.")

    def hasName(self) -> bool:
        """Return whether the type has a name."""
        return bool(self._name)

    isValid = hasName

    def addProperty(self, key: str, value: Any) -> Type:
        """Set a property, and return this type."""
        self.properties[key] = value
        return self

    def toString(self) -> str:
        """Return both names; ``null`` without a name."""
        return f"{self._name}:{self._on_wire}" if self._on_wire else self._name or "null"

    toString_c = toString
    __str__ = toString

    @override
    def __eq__(self, other: object) -> bool:
        return isinstance(other, Type) and (self._name, self._on_wire) == (other._name, other._on_wire)

    @override
    def __hash__(self) -> int:
        return hash((self._name, self._on_wire))
