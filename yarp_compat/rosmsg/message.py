"""ROS messages as Python objects for YARP ports.

The encoding is that of YARP 3.5's generated classes (yarpidl_rosmsg, RosTypeCodeGenYarp.cpp): a list of the fields in
their order, each with its tag, nested messages as lists, and arrays of numbers and strings as typed lists. YARP's
readers reject other layouts; this module also accepts integers of other sizes, and any number for a float.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Any, ClassVar

from yarp_compat.overriding import override
from yarp_compat.rosmsg.definition import PRIMITIVES, TIMES, MessageDefinition, MessageField
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.tags import BLOB, INT8, INT16, INT32, INT64, LIST, STRING

_TAGS = {1: INT8, 2: INT16, 4: INT32, 8: INT64}
_LETTERS = {
    "bool": "B", "int8": "b", "uint8": "B", "byte": "b", "char": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_FLOATS = ("float32", "float64")
_WRONG_VALUE = (TypeError, ValueError, OverflowError, AttributeError, struct.error)


class TickTime:
    """A ROS time or duration: ``sec`` and ``nsec``."""

    __slots__ = ("nsec", "sec")

    def __init__(self, sec: float = 0, nsec: int = 0) -> None:
        whole = math.floor(sec)
        self.sec, self.nsec = divmod(whole * 1_000_000_000 + round((sec - whole) * 1e9) + nsec, 1_000_000_000)

    def to_seconds(self) -> float:
        """Return the time in seconds."""
        return self.sec + self.nsec * 1e-9

    __float__ = to_seconds

    @override
    def __eq__(self, other: object) -> bool:
        return isinstance(other, TickTime) and (self.sec, self.nsec) == (other.sec, other.nsec)

    @override
    def __hash__(self) -> int:
        return hash((self.sec, self.nsec))

    @override
    def __repr__(self) -> str:
        return f"TickTime({self.sec}, {self.nsec})"


class Message(Portable):
    """The base class of the classes made from message definitions; a message's fields are its attributes.

    Example::

        String = yarp.rosmsg.std_msgs.String
        text = String(data="hello")
    """

    _definition: ClassVar[MessageDefinition]
    _nested: ClassVar[Mapping[str, type[Message]]]
    _names: ClassVar[frozenset[str]] = frozenset()

    def __init__(self, **fields: Any) -> None:
        self.clear()
        for name, value in fields.items():
            setattr(self, name, value)

    @override
    def __setattr__(self, name: str, value: Any) -> None:
        if name not in self._names:  # a misspelled field would be published empty
            raise AttributeError(f"{self.TYPE} has no field {name!r}, only {', '.join(sorted(self._names)) or 'none'}")
        self.__dict__[name] = value

    @classmethod
    def typeName(cls) -> str:
        """Return the type's name, such as ``std_msgs/String``."""
        return cls.TYPE

    def clear(self) -> None:
        """Set every field to its default."""
        self.__dict__.update((field.name, self._default(field)) for field in self._definition.fields)

    @override
    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and self.to_wire() == other.to_wire()

    @override
    def __repr__(self) -> str:
        fields = ", ".join(f"{field.name}={getattr(self, field.name)!r}" for field in self._definition.fields)
        return f"{self.TYPE.replace('/', '.')}({fields})"

    def toString(self) -> str:
        """Return the message as the text of a Bottle."""
        return self.to_text()

    toString_c = toString

    @override
    def _write(self, out: ElementWriter) -> None:
        out.begin(len(self._definition.fields))
        for field in self._definition.fields:
            value = getattr(self, field.name)
            try:
                _write_array(out, field, value) if field.is_array else _write_single(out, field, value)
            except _WRONG_VALUE as err:
                if field.is_message and isinstance(err, WireError):
                    raise  # the nested message's error names its field
                kind = f"{field.type}{'[]' * field.is_array}"
                raise WireError(f"{self.TYPE}.{field.name} must be {kind}, not {value!r:.80}: {err}") from None

    @override
    def _read(self, source: ElementReader) -> None:
        count = source.begin()
        if count != len(self._definition.fields):
            raise WireError(f"a {self.TYPE} has {len(self._definition.fields)} fields, but {count} were received")
        values = {}
        for field in self._definition.fields:
            try:
                read = self._read_array if field.is_array else self._read_single
                values[field.name] = read(source, field)
            except WireError as err:
                if field.is_message:
                    raise
                raise type(err)(
                    f"{self.TYPE}.{field.name} must be {field.type}{'[]' * field.is_array}: {err}"
                ) from None
        source.end()
        self.__dict__.update(values)

    @classmethod
    def _default(cls, field: MessageField) -> Any:
        if field.is_array:
            return [cls._single(field) for _ in range(field.length)]
        return cls._single(field)

    @classmethod
    def _single(cls, field: MessageField) -> Any:
        if field.is_message:
            return cls._nested[field.type]()
        if field.type in TIMES:
            return TickTime()
        return {"string": "", "bool": False}.get(field.type, 0.0 if field.type in _FLOATS else 0)

    @classmethod
    def _read_array(cls, source: ElementReader, field: MessageField) -> Any:
        if source.next_tag() == BLOB and PRIMITIVES.get(field.type) == 1:
            values = list(struct.unpack(f"<{len(data := source.blob())}{_LETTERS[field.type]}", data))
        elif field.type in PRIMITIVES:
            values = cls._read_numbers(source, field)
        else:
            values = [cls._read_single(source, field) for _ in range(source.begin())]
            source.end()
        if field.length and len(values) != field.length:
            raise WireError(f"{len(values)} elements, not {field.length}")
        return values

    @classmethod
    def _read_numbers(cls, source: ElementReader, field: MessageField) -> list[Any]:
        tag, count, data = source.numbers()
        if data is None:
            values = [cls._read_single(source, field) for _ in range(count)]
            source.end()
            return values
        if tag == _tag(source.profile, field.type):
            values = list(struct.unpack(f"<{count}{_LETTERS[field.type]}", data))
        else:
            letters = {INT8: "b", INT16: "h", INT32: "i", INT64: "q"}
            letters |= {source.profile.float32_tag: "f", source.profile.float64_tag: "d"}
            values = list(struct.unpack(f"<{count}{letters.get(tag, 'i')}", data))
            if field.type in _FLOATS:
                return [float(number) for number in values]
            if letters.get(tag, "i") in "fd":
                raise WireError(f"floating-point numbers, tag {tag}")
            values = [_integer(field.type, number) for number in values]
        return [bool(number) for number in values] if field.type == "bool" else values

    @classmethod
    def _read_single(cls, source: ElementReader, field: MessageField) -> Any:
        if field.is_message:
            message = cls._nested[field.type]()
            message._read(source)
            return message
        if field.type in TIMES:
            return _read_time(source, field.type)
        if field.type == "string":
            return source.string()
        if field.type in _FLOATS:
            return source.float64()
        number = source.integer()
        return bool(number) if field.type == "bool" else _integer(field.type, number)


def make_class(definition: MessageDefinition, nested: Mapping[str, type[Message]]) -> type[Message]:
    """Make the class of a message type from the classes of its nested types."""
    fields = ", ".join(f"{field.type}{'[]' * field.is_array} {field.name}" for field in definition.fields)
    body: dict[str, Any] = {name: value for name, value in definition.constants.items() if not hasattr(Message, name)}
    body |= {
        "__doc__": f"{definition.name}: {fields}",
        "__module__": f"{__package__}.{definition.name.split('/')[0]}",
        "TYPE": definition.name,
        "_definition": definition,
        "_nested": dict(nested),
        "_names": frozenset(field.name for field in definition.fields),
    }
    return type(definition.name.split("/")[1], (Message,), body)


def _write_array(out: ElementWriter, field: MessageField, value: Any) -> None:
    if field.length and len(value) != field.length:
        raise ValueError(f"{len(value)} elements, not {field.length}")
    if field.is_message or field.type in TIMES:
        out.begin(len(value))
        for element in value:
            _write_single(out, field, element)
    elif field.type == "string":
        out.begin(len(value), STRING)
        for element in value:
            out.string(element, tagged=False)
    else:
        out.begin(len(value), _tag(out.profile, field.type))
        out.block(_packed(field.type, value))


def _packed(type_name: str, value: Any) -> Buffer:
    letter = _LETTERS[type_name]
    if isinstance(value, (bytes, bytearray)) and PRIMITIVES[type_name] == 1:
        return value
    if hasattr(value, "astype"):  # a numpy array, without a dependency on numpy
        kind = ("f" if type_name in _FLOATS else "u" if letter.isupper() else "i") + str(PRIMITIVES[type_name])
        array = value.astype(f"<{kind}", order="C", copy=False).reshape(-1)
        return memoryview(array).cast("B")
    return struct.pack(f"<{len(value)}{letter}", *value)


def _write_single(out: ElementWriter, field: MessageField, value: Any) -> None:
    if field.is_message:
        value._write(out)
    elif field.type in TIMES:
        time = value if isinstance(value, TickTime) else TickTime(value)
        out.begin(2)
        out.integer(time.sec)
        out.integer(time.nsec)
    elif field.type == "string":
        out.string(value)
    elif field.type == "float64":
        out.float64(value)
    elif field.type == "float32":
        out.float32(value)
    else:
        out.integer(_integer(field.type, int(value)), _TAGS[PRIMITIVES[field.type]])


def _read_time(source: ElementReader, type_name: str) -> TickTime:
    if not source.next_tag() & LIST:
        return TickTime(source.float64())
    source.begin()
    sec, nsec = source.integer(), source.integer()
    source.end()
    return TickTime(sec & 0xFFFFFFFF if type_name == "time" else sec, nsec)


def _tag(profile: Profile, type_name: str) -> int:
    if type_name in _FLOATS:
        return profile.float64_tag if type_name == "float64" else profile.float32_tag
    return _TAGS[PRIMITIVES[type_name]]


def _integer(type_name: str, value: int) -> int:
    """Return a number in its type's range; a negative one for an unsigned type has the same bits as the result."""
    bits = 8 * PRIMITIVES[type_name]
    unsigned = _LETTERS[type_name].isupper()
    least = 0 if unsigned else -(1 << bits - 1)
    if unsigned and -(1 << bits - 1) <= value < 0:
        value += 1 << bits
    if not least <= value < least + (1 << bits):
        raise WireError(f"{value} does not fit {type_name}")
    return value
