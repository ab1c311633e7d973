"""Bottle, Value and Property: nested values, which are looked up by key.

A Bottle is a list of values with text and binary forms, YARP's most common message (`yarp/os/Bottle.h`); a Value is one
of its values with YARP's conversions (`yarp/os/Value.h`, `Storable.h`); a Property maps keys to values (`Property.h`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, overload

from yarp_compat.os.data.property_base import PropertyBase
from yarp_compat.os.data.value_base import ValueBase, deep_copy, integer, plain_of, word_of
from yarp_compat.overriding import override
from yarp_compat.wire import tags
from yarp_compat.wire.accessors import getter
from yarp_compat.wire.binary import decode, decode_prefix, encode, encode_parts
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import dict_of, from_text, plain_text, to_text
from yarp_compat.wire.values import Float32, Group, Int8, Int16, Int64, entries_of, entry_values, merge
from yarp_compat.wire.values import Vocab64 as Word64

_UNITS = {0: "mixed", tags.INT32: "int", tags.VOCAB32: "vocab", 10: "float", tags.STRING: "string", tags.BLOB: "blob"}


class Searchable:
    """The base class of objects with keys and values."""

    def find(self, key: str) -> Value:
        """Return the value after a key; a null value if the key is missing."""
        raise NotImplementedError(f"{type(self).__name__} has no find for {key}")

    def findGroup(self, key: str) -> Bottle:
        """Return the list that begins with a key; a null Bottle if it is missing."""
        raise NotImplementedError(f"{type(self).__name__} has no findGroup for {key}")

    def toString(self) -> str:
        """Return the text form."""
        raise NotImplementedError(f"{type(self).__name__} has no toString")

    @overload
    def check(self, key: str, fallback: str = "", comment: str = "") -> bool: ...
    @overload
    def check(self, key: str, fallback: Value, comment: str = "") -> Value: ...
    def check(self, key: str, fallback: Value | str = "", comment: str = "") -> bool | Value:  # noqa: ARG002
        """Return whether a key exists; with a `Value` as fallback, the key's value, or the fallback if it is missing.

        A text, either as the fallback or as the comment, has no effect.
        """
        if not isinstance(fallback, str):
            value = self.find(key)
            return fallback if value.isNull() else value
        return self._has(key)

    def isNull(self) -> bool:
        """Return whether this represents a missing object."""
        return False

    def toString_c(self) -> str:
        """Return the text form, under the name of YARP's bindings."""
        return self.toString()

    def _has(self, key: str) -> bool:
        return not (self.findGroup(key).isNull() and self.find(key).isNull())

    def __contains__(self, key: object) -> bool:
        return isinstance(key, str) and self._has(key)

    @override
    def __str__(self) -> str:
        return self.toString()


class _Comparable(Searchable):
    def isEqual(self, other: Searchable) -> bool:
        """Return whether both have the same text form."""
        return self.toString() == other.toString()

    def notEqual(self, other: Searchable) -> bool:
        """Return whether the text forms differ."""
        return not self.isEqual(other)


class Value(ValueBase, _Comparable):
    """A value: int, float, string, vocab (of a word or number), blob, list (by default, empty), dict, or null.

    Conversions never fail: values that cannot be converted become 0, 0.0, False or "".
    """

    def __init__(self, value: Any = (), vocab: bool = False) -> None:
        if isinstance(value, bool):
            value = int(value)  # as in YARP's bindings; inside a list, `True` remains a bool
        self._value = word_of(value) if vocab else plain_of(value)

    @classmethod
    def of(cls, value: Any) -> Value:
        """Wrap a plain value, without copying lists. None is null."""
        instance = object.__new__(cls)
        instance._value = value
        return instance

    @property
    def plain(self) -> Any:
        """The plain Python value; None if null."""
        return self._value

    def asList(self) -> Bottle | None:
        """Return the list itself, as a Bottle that can be changed; None for another type."""
        return Bottle.of(self._value) if isinstance(self._value, list) else None

    def asDict(self) -> Property | None:
        """Return the dict itself, as a Property that can be changed; None for another type."""
        return Property.of(self._value) if isinstance(self._value, dict) else None

    def asSearchable(self) -> Bottle | Property | None:
        """Return the dict or list, like `asDict` and `asList`."""
        return self.asDict() if isinstance(self._value, dict) else self.asList()

    @override
    def find(self, key: str) -> Value:
        inner = self.asSearchable()
        return NULL if inner is None else inner.find(key)

    @override
    def findGroup(self, key: str) -> Bottle:
        inner = self.asSearchable()
        return Bottle.getNullBottle() if inner is None else inner.findGroup(key)

    makeInt8 = staticmethod(lambda x: Value.of(Int8(integer(x, 8))))
    makeInt16 = staticmethod(lambda x: Value.of(Int16(integer(x, 16))))
    makeInt32 = staticmethod(lambda x: Value.of(integer(x, 32)))
    makeInt64 = staticmethod(lambda x: Value.of(Int64(integer(x, 64))))
    makeFloat32 = staticmethod(lambda x: Value.of(Float32(x)))
    makeFloat64 = staticmethod(lambda x: Value.of(float(x)))
    makeString = staticmethod(lambda text: Value.of(str(text)))
    makeVocab32 = staticmethod(lambda *word: Value.of(word_of(*word)))
    makeVocab64 = staticmethod(lambda word: Value.of(Word64(word)))
    makeList = staticmethod(lambda text="": Value.of(from_text(text)))

    @staticmethod
    def makeBlob(data: bytes | bytearray | memoryview, length: int | None = None) -> Value:
        """Return a blob of the first ``length`` bytes, or of all."""
        return Value.of(bytes(data[:length]))

    @staticmethod
    def makeValue(text: str) -> Value:
        """Parse a text with one value. A text with several values becomes a string, an empty text a null value."""
        values = from_text(text)
        return Value.of(text if len(values) > 1 else values[0] if values else None)

    def fromString(self, text: str) -> None:
        """Replace the value by the value in a text; a text with several values becomes a string."""
        self._value = Value.makeValue(text)._value

    def clone(self) -> Value:
        """Return a deep copy."""
        return Value.of(deep_copy(self._value))

    @staticmethod
    def getNullValue() -> Value:
        """Return the null value, which represents a missing value."""
        return NULL

    makeInt, makeDouble, makeVocab = makeInt32, makeFloat64, makeVocab32  # YARP 2's names

    @override
    def __eq__(self, other: object) -> bool:
        return self.isEqual(other) if isinstance(other, Value) else bool(self._value == other)

    @override
    def __repr__(self) -> str:
        return f"Value({self._value!r})"


NULL = Value.of(None)  # represents a missing value


def _add(convert: Callable[[Any], Any], doc: str) -> Callable[[Bottle, Any], None]:
    def add(self: Bottle, value: Any) -> None:
        self._edit().append(convert(value))

    add.__doc__ = doc
    return add


class Bottle(Portable, _Comparable):
    """A list of values.

    In YARP's style: ``b.addString("x"); b.addFloat64(1.5); b.get(1).asFloat64()``. In Python's: ``b = Bottle(["x",
    1.5])``, ``b[1]``, ``for value in b``, with plain values (`yarp_compat.wire.values`). The argument is the text form,
    another Bottle, or plain values, which are copied.
    """

    def __init__(self, content: str | Bottle | Iterable[Any] = ()) -> None:
        self._values: list[Any] = from_text(content) if isinstance(content, str) else [plain_of(v) for v in content]
        self._null: bool = isinstance(content, Bottle) and content.isNull()
        self._fixed: bool = False

    @classmethod
    def of(cls, values: list[Any]) -> Bottle:
        """Wrap a list of plain values, without a copy."""
        bottle = object.__new__(cls)
        bottle._values, bottle._null, bottle._fixed = values, False, False
        return bottle

    @property
    def plain(self) -> list[Any]:
        """The list of plain values itself."""
        return self._values

    @staticmethod
    def getNullBottle() -> Bottle:
        """Return the Bottle that represents a missing list; it cannot be changed."""
        return _NULL

    isNull = getter("_null", bool, "Whether this represents a missing list.")

    addInt8 = _add(lambda x: Int8(integer(x, 8)), "Add an int of one byte.")
    addInt16 = _add(lambda x: Int16(integer(x, 16)), "Add an int of two bytes.")
    addInt32 = _add(lambda x: integer(x, 32), "Add an int of four bytes.")
    addInt64 = _add(lambda x: Int64(integer(x, 64)), "Add an int of eight bytes.")
    addFloat32 = _add(Float32, "Add a float of four bytes.")
    addFloat64 = _add(float, "Add a float of eight bytes.")
    addVocab64 = _add(Word64, "Add a vocab of eight bytes, which YARP 3 lacks.")
    add = _add(plain_of, "Add a Value, or any plain value.")

    def addString(self, text: str) -> None:
        """Add a string."""
        if not isinstance(text, str):
            raise TypeError(f"expected a str, not {text!r}")
        self._edit().append(str(text))

    def addVocab32(self, word: str | int, *rest: str) -> None:
        """Add a vocab of four bytes, given as a word, a number, or single characters."""
        self._edit().append(word_of(word, *rest))

    def addList(self) -> Bottle:
        """Add an empty list, and return it to be filled."""
        inner: list[Any] = []
        self._edit().append(inner)
        return Bottle.of(inner)

    def addDict(self) -> Property:
        """Add an empty dict, and return it to be filled."""
        inner: dict[str, Any] = {}
        self._edit().append(inner)
        return Property.of(inner)

    def append(self, other: Bottle | Iterable[Any]) -> None:
        """Append copies of all values of another Bottle."""
        self._edit().extend([plain_of(value) for value in other])

    def copy(self, other: Bottle, first: int = 0, len: int | None = None) -> None:  # noqa: A002 - YARP's name
        """Replace the content by a copy of another Bottle, or of ``len`` of its values from ``first`` on."""
        self._edit()
        self._null = other._null
        self._values[:] = [deep_copy(value) for value in other._values[first : None if len is None else first + len]]

    def clear(self) -> None:
        self._edit().clear()

    def pop(self) -> Value:
        """Remove the last value and return it; null if the Bottle is empty."""
        return Value.of(self._edit().pop()) if self._values else NULL

    def size(self) -> int:
        """Return the number of values."""
        return len(self._values)

    def get(self, index: int) -> Value:
        """Return the value at an index; null if out of range."""
        return Value.of(self._values[index]) if 0 <= index < len(self._values) else NULL

    @override
    def find(self, key: str) -> Value:
        """Return a key's value: the second value of the list that begins with the key, or the value after the key."""
        at = self._index(key)
        value = self._values[at] if at >= 0 else None
        return Bottle.of(value).get(1) if isinstance(value, list) else self.get(at + 1) if at >= 0 else NULL

    @override
    def findGroup(self, key: str) -> Bottle:
        at = self._index(key)
        value = self._values[at] if at >= 0 else None
        return Bottle.of(value) if isinstance(value, list) else _NULL

    def _index(self, key: str) -> int:
        """Return the index of a key, or of the list that begins with it; -1 if it is missing."""
        for at, value in enumerate(self._values):
            if _text((value[0] if value else None) if isinstance(value, list) else value) == key:
                return at
        return -1

    def tail(self) -> Bottle:
        """Return a new Bottle with all values except the first."""
        tail = Bottle(self._values[1:])
        tail._null = self._null
        return tail

    @override
    def toString(self) -> str:
        return to_text(self._values)

    def fromString(self, text: str) -> None:
        """Replace the content by the values of a text."""
        self._edit()[:] = from_text(text)

    def toBinary(self, profile: Profile = Profile.YARP3) -> bytes:
        """Return the bytes that ports send."""
        return encode(self._values, profile)

    def fromBinary(self, data: Buffer, length: int | None = None, profile: Profile | None = None) -> None:
        """Replace the content by decoded bytes; raises `WireError` if they are not a Bottle."""
        self.from_wire(memoryview(data)[:length], profile)

    @override
    def to_wire(self, profile: Profile = Profile.YARP3, generation: Generation | None = None) -> list[Buffer]:
        """Return the bytes in pieces, without copies of large blobs."""
        return encode_parts(self._values, profile)

    @override
    def to_bytes(self, profile: Profile = Profile.YARP3, generation: Generation | None = None) -> bytes:
        return encode(self._values, profile)

    @override
    def from_wire(self, data: Buffer, profile: Profile | None = None) -> None:
        """Replace the content by a whole payload; raises `WireError`, and changes nothing, if it is not a Bottle."""
        self._edit()[:] = decode(data, profile)

    @override
    def to_values(self) -> list[Any]:
        return [deep_copy(value) for value in self._values]

    @override
    def from_values(self, values: Iterable[Any]) -> None:
        self._edit()[:] = [plain_of(value) for value in values]

    to_text = toString

    @override
    def from_text(self, line: str) -> None:
        self.fromString(line)

    @override
    def _write(self, out: ElementWriter) -> None:
        for part in encode_parts(self._values, out.profile):
            out.block(part)

    @override
    def _read(self, source: ElementReader) -> None:
        self._edit()[:], source.at = decode_prefix(source.data, source.profile, source.element())

    def getSpecialization(self) -> int:
        """Return YARP 3's tag that all values share; 0 if types differ, a value is a list, or the Bottle is empty."""
        return int.from_bytes(encode(self._values, Profile.YARP3)[:4], "little") & tags.UNIT

    @staticmethod
    def describeBottleCode(code: int) -> str:
        """Return a description of a tag."""
        unit = _UNITS.get(code & ~(tags.LIST | tags.DICT), "unknown")
        return f"list of {unit}" if code & tags.LIST else f"dict of {unit}" if code & tags.DICT else unit

    def setReadOnly(self, readOnly: bool) -> None:
        """Forbid changes, or allow them again."""
        self._fixed = readOnly

    def hasChanged(self) -> None:
        """Do nothing: values are encoded on demand."""

    onCommencement = hasChanged

    # YARP 2's names, which early releases of YARP 3 still had
    addInt, addDouble, addVocab = addInt32, addFloat64, addVocab32

    def __len__(self) -> int:
        return len(self._values)

    def __iter__(self) -> Iterator[Any]:
        return iter(self._values)

    def __getitem__(self, index: int | slice) -> Any:
        return self._values[index]

    def __setitem__(self, index: int, value: Any) -> None:
        self._edit()[index] = plain_of(value)

    def __delitem__(self, index: int | slice) -> None:
        del self._edit()[index]

    @override
    def __eq__(self, other: object) -> bool:
        return self._values == (other._values if isinstance(other, Bottle) else other)

    def __bool__(self) -> bool:
        return not self._null

    @override
    def __repr__(self) -> str:
        return f"Bottle({self.toString()!r})"

    def _edit(self) -> list[Any]:
        if self._fixed:
            raise RuntimeError("this Bottle cannot be changed: it is read-only, or represents a missing list")
        self._null = False
        return self._values


def _text(value: Any) -> str:
    return value if type(value) is str else "" if value is None else plain_text(value)


_NULL = Bottle()
_NULL._null = _NULL._fixed = True


class Property(PropertyBase, Searchable):
    """A mapping of keys to values.

    In YARP's style: ``p.put("rate", 10); p.find("rate").asInt32()``. In Python's: ``p["rate"]``, ``dict(p)``, with
    plain values, as in a dict of `yarp_compat.wire.values`. The argument is the text form, another Property, or a
    mapping of plain values, which is copied.
    """

    def __init__(self, content: str | Property | Mapping[str, Any] = "") -> None:
        self._entries: dict[str, Any] = (
            dict_of(from_text(content)) if isinstance(content, str) else plain_of(dict(content.items()))
        )

    @classmethod
    def of(cls, entries: dict[str, Any]) -> Property:
        """Wrap a dict of plain values, without a copy."""
        instance = object.__new__(cls)
        instance._entries = entries
        return instance

    @property
    def plain(self) -> dict[str, Any]:
        """The dict of plain values itself."""
        return self._entries

    def addGroup(self, key: str) -> Property:
        """Add an empty group under a key, and return it to be filled."""
        group = Group()
        merge(self._entries, {key: group})
        return Property.of(group)

    @override
    def find(self, key: str) -> Value:
        """Return the value under a key; null if the key is missing."""
        values = entry_values(self._entries.get(key, ()))
        return Value.of(values[0]) if values else NULL

    @override
    def findGroup(self, key: str) -> Bottle:
        """Return a new Bottle with the key and its values; a null Bottle if the key is missing."""
        if key not in self._entries:
            return Bottle.getNullBottle()
        stored = next(k for k in self._entries if k == key)  # a str subclass may mark a number
        return Bottle.of(*entries_of({stored: self._entries[key]}))

    @override
    def __eq__(self, other: object) -> bool:
        return self.toString() == other.toString() if isinstance(other, Property) else self._entries == other

    @override
    def __repr__(self) -> str:
        return f"Property({self.toString()!r})"

    @override
    def _has(self, key: str) -> bool:
        return key in self._entries
