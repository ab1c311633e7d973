"""Field types of the YARP interfaces, encoded like the code that YARP generates from thrift files.

A Python annotation names the type: ``bool``, ``int`` (32 bits), ``float`` (a double), ``str``, ``bytes``, ``IntEnum``
(sent as vocabs if it is a `VocabEnum`, otherwise as 32-bit numbers), ``list[...]``, a subclass of `Portable`; or
``Annotated`` with one of the fields below, such as ``Annotated[int, INT8]``.
(`yarpidl_thrift/src/t_yarp_generator.cc`)
"""

# ruff: noqa: D102 - the base class documents the methods

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import IntEnum
from functools import cache
from typing import Annotated, Any, Self, get_args, get_origin, get_type_hints

from yarp_compat.overriding import override
from yarp_compat.wire import tags
from yarp_compat.wire.binary import decode
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import to_text


class FieldCodec(ABC):
    """The codec of an argument, a result or a structure's field; ``name`` is its type in help texts.

    ``default`` returns C++'s initial value; ``tag`` returns the tag that all elements of a list of this type share in a
    profile, or 0 if each element has its own tag.
    """

    def __init__(self, name: str, default: Callable[[], Any], tag: Callable[[Profile], int] = lambda _: 0) -> None:
        self.name, self.default, self.tag = name, default, tag

    @abstractmethod
    def write(self, out: ElementWriter, value: Any, *, tagged: bool = True) -> None:
        """Write a value; ``tagged=False`` omits its tag, because the header of the list has it."""

    @abstractmethod
    def read(self, source: ElementReader) -> Any:
        """Read a value."""


class Integer(FieldCodec):
    """An integer in its tag's size; an unsigned one is sent as the signed integer with the same bits."""

    def __init__(self, bits: int, *, unsigned: bool = False) -> None:
        self._tag = {8: tags.INT8, 16: tags.INT16, 32: tags.INT32, 64: tags.INT64}[bits]
        self._high = 1 << (bits if unsigned else bits - 1)
        self._low = 0 if unsigned else -self._high
        self._wrap = self._high if unsigned else 0
        super().__init__(f"{'u' if unsigned else 'i'}{bits}", int, lambda _: self._tag)

    @override
    def write(self, out: ElementWriter, value: Any, *, tagged: bool = True) -> None:
        if isinstance(value, int) and not self._low <= value < self._high:
            raise WireError(f"{value} is not an {self.name}")
        out.integer(value, self._tag, tagged=tagged)

    @override
    def read(self, source: ElementReader) -> int:
        value = source.integer()
        if value < 0 and self._wrap:
            value += self._wrap
        if not self._low <= value < self._high:
            raise WireError(f"{value} before byte {source.at} is not an {self.name}")
        return value


class _Plain(FieldCodec):
    """A type with its own methods in `ElementWriter` and `ElementReader`."""

    def __init__(
        self, name: str, write: Callable[..., None], read: Callable[[ElementReader], Any], default: Any,
        tag: Callable[[Profile], int],
    ) -> None:  # fmt: skip
        super().__init__(name, lambda: default, tag)
        self._write, self._read = write, read

    @override
    def write(self, out: ElementWriter, value: Any, *, tagged: bool = True) -> None:
        self._write(out, value, tagged=tagged)

    @override
    def read(self, source: ElementReader) -> Any:
        return self._read(source)


class VocabEnum(IntEnum):
    """An enumeration of vocabs: members are declared by their text, and have the vocab's number as value, as in C++."""

    text: str

    def __new__(cls, text: str) -> Self:
        number = int.from_bytes(text.encode().ljust(4, b"\0"), "little")
        member = int.__new__(cls, number)
        member._value_, member.text = number, text
        return member

    @classmethod
    @override
    def _missing_(cls, value: object) -> Self | None:
        return next((member for member in cls if member.text == value), None)


class Choice(FieldCodec):
    """An enumeration: of vocabs, or of 32-bit numbers.

    The first member of ``kind`` is the default. With ``vocab``, numbers have the tag of a vocab, as in some YARP types.
    """

    def __init__(self, kind: type[IntEnum], *, vocab: bool = False) -> None:
        self._kind = kind
        self._is_text = issubclass(kind, VocabEnum)
        self._tag = tags.VOCAB32 if vocab or self._is_text else tags.INT32
        super().__init__(kind.__name__, lambda: next(iter(kind)), lambda _: self._tag)

    @override
    def write(self, out: ElementWriter, value: Any, *, tagged: bool = True) -> None:
        try:
            member = self._kind(value)
        except ValueError:
            raise WireError(f"{value!r} is not a {self.name}") from None
        if isinstance(member, VocabEnum):
            out.vocab(member.text, tagged=tagged)
        elif tagged and self._tag == tags.VOCAB32:
            out.block(b"\x09\0\0\0")
            out.integer(member.value, tagged=False)
        else:
            out.integer(member.value, tagged=tagged)

    @override
    def read(self, source: ElementReader) -> IntEnum:
        value: Any = source.word() if self._is_text else source.integer()
        if value == "":  # the vocab 0, C++'s initial value, which servers send with a failed outcome
            return next(iter(self._kind))
        try:
            return self._kind(value)
        except ValueError:
            choices = ", ".join(str(getattr(member, "text", member.value)) for member in self._kind)
            raise WireError(f"{value!r} before byte {source.at} is not a {self.name}; expected {choices}") from None


class ListOf(FieldCodec):
    """A list of values of one type."""

    def __init__(self, element: FieldCodec) -> None:
        super().__init__(f"list<{element.name}>", list)
        self.element = element

    @override
    def write(self, out: ElementWriter, value: Any, *, tagged: bool = True) -> None:
        tag = self.element.tag(out.profile)
        out.begin(len(value), tag)
        for element in value:
            self.element.write(out, element, tagged=not tag)

    @override
    def read(self, source: ElementReader) -> list[Any]:
        count = source.begin()
        values = [self.element.read(source) for _ in range(count)]
        source.end()
        return values


class Nested(FieldCodec):
    """A value of a subclass of `Portable`."""

    def __init__(self, kind: type[Portable]) -> None:
        super().__init__(kind.__name__, kind)
        self.kind = kind

    @override
    def write(self, out: ElementWriter, value: Any, *, tagged: bool = True) -> None:
        if not isinstance(value, self.kind):
            raise WireError(f"{value!r:.60} is not a {self.name}")
        value._write(out)

    @override
    def read(self, source: ElementReader) -> Portable:
        value = self.kind()
        value._read(source)
        return value


BOOLEAN = _Plain("bool", ElementWriter.boolean, ElementReader.boolean, False, lambda _: tags.VOCAB32)
FLOAT64 = _Plain("double", ElementWriter.float64, ElementReader.float64, 0.0, lambda profile: profile.float64_tag)
FLOAT32 = _Plain("float", ElementWriter.float32, ElementReader.float64, 0.0, lambda profile: profile.float32_tag)
TEXT = _Plain("string", ElementWriter.string, ElementReader.string, "", lambda _: tags.STRING)
BLOB = _Plain("binary", ElementWriter.blob, lambda source: bytes(source.blob()), b"", lambda _: tags.BLOB)
INT8, INT16, INT32, INT64 = (Integer(bits) for bits in (8, 16, 32, 64))
UINT8, UINT16, UINT32 = (Integer(bits, unsigned=True) for bits in (8, 16, 32))

_PLAIN: dict[Any, FieldCodec] = {bool: BOOLEAN, int: INT32, float: FLOAT64, str: TEXT, bytes: BLOB}


def field_of(annotation: Any) -> FieldCodec:
    """Return the codec of an annotation; raises `TypeError` for unsupported annotations."""
    origin = get_origin(annotation)
    if origin is Annotated:
        fields = [extra for extra in get_args(annotation)[1:] if isinstance(extra, FieldCodec)]
        return fields[0] if fields else field_of(get_args(annotation)[0])
    if origin is list:
        return ListOf(field_of(get_args(annotation)[0]))
    if annotation in _PLAIN:
        return _PLAIN[annotation]
    if isinstance(annotation, type) and issubclass(annotation, IntEnum):
        return Choice(annotation)
    if isinstance(annotation, type) and issubclass(annotation, Portable):
        return Nested(annotation)
    raise TypeError(f"{annotation!r} is not a type of the YARP interfaces")


class Structure(Portable):
    """A dataclass that is sent as its annotated fields, see :mod:`yarp_compat.dev.fields`."""

    @override
    def _write(self, out: ElementWriter) -> None:
        fields = fields_of(type(self))  # type: ignore[arg-type] # for mypy an object's __hash__ is the class's
        out.begin(len(fields))
        name = ""
        try:
            for name, field in fields:
                field.write(out, getattr(self, name))
        except WireError as error:
            raise type(error)(f"{type(self).__name__}.{name}: {error}") from None

    @override
    def _read(self, source: ElementReader) -> None:
        fields = fields_of(type(self))  # type: ignore[arg-type] # for mypy an object's __hash__ is the class's
        count = source.begin()
        if count != len(fields):
            raise WireError(f"a {type(self).__name__} has {len(fields)} fields, not {count}")
        values = {}
        name = ""
        try:
            for name, field in fields:
                values[name] = field.read(source)
        except WireError as error:
            raise type(error)(f"{type(self).__name__}.{name}: {error}") from None
        source.end()
        for name, value in values.items():
            setattr(self, name, value)


class Generated(Structure):
    """A structure whose C++ class YARP generates; as there, `toString` returns the text of a Bottle."""

    def toString(self) -> str:
        """Return the fields as the text of a Bottle."""
        return to_text(decode(self.to_bytes(Profile.YARP3), Profile.YARP3))

    def toString_c(self) -> str:
        """Return `toString`; the YARP bindings use this name."""
        return self.toString()


@cache
def fields_of(kind: type[Structure]) -> tuple[tuple[str, FieldCodec], ...]:
    """Return a structure's fields in order: name and codec."""
    hints = get_type_hints(kind, include_extras=True)
    fields = dataclasses.fields(kind)  # type: ignore[arg-type] # structures are dataclasses
    return tuple((field.name, field_of(hints[field.name])) for field in fields)
