"""How the types that YARP's interfaces declare are written: what its generated (thrift) code does with each.

A Python annotation names the type: ``bool``, ``int`` (32 bits), ``float`` (a double), ``str``, ``bytes``, an Enum (of
vocabs where its values are text, else of 32-bit numbers), ``list[...]``, a Portable's class; or ``Annotated`` with one
of the fields below for the rest, such as ``Annotated[int, INT8]``. (`yarpidl_thrift/src/t_yarp_generator.cc`)
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum, IntEnum
from typing import Annotated, Any, get_args, get_origin

from yarp_compat.wire import tags
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer


class Field(ABC):
    """A type of an argument, a result or a structure's field.

    Attributes:
        name: what help calls it.
    """

    name: str

    @abstractmethod
    def write(self, out: Writer, value: Any, *, tagged: bool = True) -> None:
        """Put a value on the wire, with its tag or, in a list that has it, without."""

    @abstractmethod
    def read(self, source: Reader) -> Any:
        """Take a value."""

    @abstractmethod
    def default(self) -> Any:
        """What C++ has where nothing was set."""

    def tag(self, _profile: Profile) -> int:
        """The tag that a list of such values has; 0 where each value has its own."""
        return 0


class Integer(Field):
    """An integer of a tag's size; unsigned ones keep their bits."""

    def __init__(self, bits: int, *, unsigned: bool = False) -> None:
        self._tag = {8: tags.INT8, 16: tags.INT16, 32: tags.INT32, 64: tags.INT64}[bits]
        self._high = 1 << (bits if unsigned else bits - 1)
        self._low = 0 if unsigned else -self._high
        self._wrap = self._high if unsigned else 0
        self.name = f"{'u' if unsigned else 'i'}{bits}"

    def write(self, out: Writer, value: Any, *, tagged: bool = True) -> None:
        """Put it on the wire."""
        if isinstance(value, int) and not self._low <= value < self._high:
            raise WireError(f"{value} is no {self.name}")
        out.integer(value, self._tag, tagged=tagged)

    def read(self, source: Reader) -> int:
        """Take an integer of any size that fits."""
        value = source.integer()
        if value < 0 and self._wrap:
            value += self._wrap
        if not self._low <= value < self._high:
            raise WireError(f"{value} before byte {source.at} is no {self.name}")
        return value

    def default(self) -> int:
        """Zero."""
        return 0

    def tag(self, _profile: Profile) -> int:
        """The tag."""
        return self._tag


class _Float64(Field):
    name = "double"

    def write(self, out: Writer, value: Any, *, tagged: bool = True) -> None:
        out.float64(value, tagged=tagged)

    def read(self, source: Reader) -> float:
        return source.float64()

    def default(self) -> float:
        return 0.0

    def tag(self, profile: Profile) -> int:
        return profile.float64_tag


class _Float32(_Float64):
    name = "float"

    def write(self, out: Writer, value: Any, *, tagged: bool = True) -> None:
        out.float32(value, tagged=tagged)

    def tag(self, profile: Profile) -> int:
        return profile.float32_tag


class _Boolean(Field):
    name = "bool"

    def write(self, out: Writer, value: Any, *, tagged: bool = True) -> None:
        out.boolean(value, tagged=tagged)

    def read(self, source: Reader) -> bool:
        return source.boolean()

    def default(self) -> bool:
        return False

    def tag(self, _profile: Profile) -> int:
        return tags.VOCAB32


class _Text(Field):
    name = "string"

    def write(self, out: Writer, value: Any, *, tagged: bool = True) -> None:
        out.string(value, tagged=tagged)

    def read(self, source: Reader) -> str:
        return source.string()

    def default(self) -> str:
        return ""

    def tag(self, _profile: Profile) -> int:
        return tags.STRING


class _Blob(Field):
    name = "binary"

    def write(self, out: Writer, value: Buffer, *, tagged: bool = True) -> None:
        out.blob(value, tagged=tagged)

    def read(self, source: Reader) -> bytes:
        return bytes(source.blob())

    def default(self) -> bytes:
        return b""

    def tag(self, _profile: Profile) -> int:
        return tags.BLOB


class Choice(Field):
    """An enumeration: of vocabs where its values are text, else of 32-bit numbers.

    Args:
        kind: its class; the first of its members is what nothing set.
        vocab: numbers are written with the tag of a vocab, as YARP does for some.
    """

    def __init__(self, kind: type[Enum], *, vocab: bool = False) -> None:
        self._kind = kind
        self._words = not issubclass(kind, IntEnum)
        self._tag = tags.VOCAB32 if vocab or self._words else tags.INT32
        self.name = kind.__name__

    def write(self, out: Writer, value: Any, *, tagged: bool = True) -> None:
        """Put it on the wire."""
        try:
            member = self._kind(value)
        except ValueError:
            raise WireError(f"{value!r} is no {self.name}") from None
        if self._words:
            out.vocab(member.value, tagged=tagged)
        elif tagged and self._tag == tags.VOCAB32:
            out.block(b"\x09\0\0\0")
            out.integer(member.value, tagged=False)
        else:
            out.integer(member.value, tagged=tagged)

    def read(self, source: Reader) -> Enum:
        """Take a vocab or a word, or a number."""
        value = source.word() if self._words else source.integer()
        if value == "":  # the vocab 0, which C++ has where nothing was set: beside an outcome that is not ok
            return self.default()
        try:
            return self._kind(value)
        except ValueError:
            choices = ", ".join(str(member.value) for member in self._kind)
            raise WireError(f"{value!r} before byte {source.at} is no {self.name}: those are {choices}") from None

    def default(self) -> Enum:
        """The first member."""
        return next(iter(self._kind))

    def tag(self, _profile: Profile) -> int:
        """The tag."""
        return self._tag


class ListOf(Field):
    """A list of values of one type."""

    def __init__(self, element: Field) -> None:
        self._element = element
        self.name = f"list<{element.name}>"

    def write(self, out: Writer, value: Any, *, tagged: bool = True) -> None:  # noqa: ARG002
        """Put it on the wire; a list's header is its tag."""
        tag = self._element.tag(out.profile)
        out.begin(len(value), tag)
        for element in value:
            self._element.write(out, element, tagged=not tag)

    def read(self, source: Reader) -> list[Any]:
        """Take a list, whose elements may have a tag each or all one."""
        count = source.begin()
        values = [self._element.read(source) for _ in range(count)]
        source.end()
        return values

    def default(self) -> list[Any]:
        """An empty list."""
        return []


class Nested(Field):
    """A value of a class of its own."""

    def __init__(self, kind: type[Portable]) -> None:
        self.kind = kind
        self.name = kind.__name__

    def write(self, out: Writer, value: Any, *, tagged: bool = True) -> None:  # noqa: ARG002
        """Put it on the wire; its list's header is its tag."""
        if not isinstance(value, self.kind):
            raise WireError(f"{value!r:.60} is no {self.name}")
        value._write(out)

    def read(self, source: Reader) -> Portable:
        """Take one."""
        value = self.kind()
        value._read(source)
        return value

    def default(self) -> Portable:
        """A new one."""
        return self.kind()


BOOLEAN, INT32, FLOAT64, TEXT, BLOB = _Boolean(), Integer(32), _Float64(), _Text(), _Blob()
INT8, INT16, INT64 = Integer(8), Integer(16), Integer(64)
UINT8, UINT16, UINT32 = Integer(8, unsigned=True), Integer(16, unsigned=True), Integer(32, unsigned=True)
FLOAT32 = _Float32()

_PLAIN: dict[Any, Field] = {bool: BOOLEAN, int: INT32, float: FLOAT64, str: TEXT, bytes: BLOB}


def field_of(annotation: Any) -> Field:
    """The field that an annotation names.

    Raises:
        TypeError: it names none.
    """
    origin = get_origin(annotation)
    if origin is Annotated:
        fields = [extra for extra in get_args(annotation)[1:] if isinstance(extra, Field)]
        return fields[0] if fields else field_of(get_args(annotation)[0])
    if origin is list:
        return ListOf(field_of(get_args(annotation)[0]))
    if annotation in _PLAIN:
        return _PLAIN[annotation]
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return Choice(annotation)
    if isinstance(annotation, type) and issubclass(annotation, Portable):
        return Nested(annotation)
    msg = f"{annotation!r} is no type of YARP's interfaces"
    raise TypeError(msg)
