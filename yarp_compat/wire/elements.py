"""Reads and writes typed values, element by element: the list headers, tags and blocks of YARP's classes.

The reader is as liberal as YARP's, and limits depth and sizes because of hostile input. Sources of the rules:
`yarp/os/idl/WireReader.cpp`, `WireWriter.cpp`, `yarp/os/Bottle.h`, and captures of YARP 3.9.1, 3.12.3 and 4.0.
"""

from __future__ import annotations

import struct
from typing import Any

from yarp_compat.wire.errors import Incomplete, WireError
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.tags import BLOB, DICT, INT8, INT16, INT32, INT64, LIST, MAX_DEPTH, STRING, VOCAB32, sizes

_INT32 = struct.Struct("<i")
_TWO_INT32 = struct.Struct("<ii")
_INTEGERS = {
    INT8: struct.Struct("<b"), INT16: struct.Struct("<h"), INT32: _INT32, INT64: struct.Struct("<q"), VOCAB32: _INT32,
}  # fmt: skip
_FLOAT32, _FLOAT64 = struct.Struct("<f"), struct.Struct("<d")
_SIZES = {profile: sizes(profile) for profile in Profile}
_TOP = -1  # outside of any list: elements have tags, and their number is unlimited


_REFERENCE = 4096  # blocks of at least this size are not copied
_TAGGED = {
    INT8: struct.Struct("<ib"), INT16: struct.Struct("<ih"), INT32: struct.Struct("<ii"), INT64: struct.Struct("<iq"),
}  # fmt: skip
_TAGGED_FLOAT32, _TAGGED_FLOAT64 = struct.Struct("<if"), struct.Struct("<id")


class ElementReader:
    """A position (``at``) in a payload with the tags of a profile.

    Every method reads the next element, and raises `WireError` if the element has another type and `Incomplete` if the
    bytes end early. A call's outcome is read in the format of ``generation``, by default the profile's newest. ``left``
    is the number of elements left in the list, negative outside of any list; ``unit`` is the tag that all elements of
    the list share, or 0.
    """

    __slots__ = ("_outer", "at", "data", "generation", "left", "profile", "unit")

    def __init__(self, data: Buffer, profile: Profile, generation: Generation | None = None, at: int = 0) -> None:
        view = memoryview(data)
        self.data = view if view.format == "B" and view.ndim == 1 else view.cast("B")
        self.profile = profile
        self.generation = Generation.newest(profile) if generation is None else generation
        self.at = at
        self.unit, self.left = 0, _TOP
        self._outer: list[tuple[int, int]] = []

    @property
    def reader(self) -> ElementReader:
        """This object, so that values can be read from it as from a connection."""
        return self

    @property
    def pending(self) -> int:
        """The number of bytes left."""
        return len(self.data) - self.at

    def begin(self) -> int:
        """Enter a list, which is the next element; return its number of elements."""
        if self.unit:
            raise WireError(f"expected an element of tag {self.unit} at byte {self.at}, not a list")
        if len(self._outer) >= MAX_DEPTH:
            raise WireError(f"lists are nested deeper than {MAX_DEPTH} at byte {self.at}")
        at = self.at
        code, count = self.raw(_TWO_INT32)
        if not code & LIST or code & DICT:
            raise WireError(f"expected a list at byte {at}, found tag {code}")
        if count < 0:
            raise WireError(f"a list of {count} elements at byte {at}")
        if count > len(self.data) - self.at:
            raise Incomplete(f"a list of {count} elements at byte {at}, but {self.pending} bytes are left")
        self._count()
        self._outer.append((self.unit, self.left))
        self.unit, self.left = code & ~LIST, count
        return int(count)

    def end(self) -> None:
        """Leave the list; raises `WireError` if elements are left in it."""
        if self.left:
            raise WireError(f"{self.left} elements too many in the list that ends before byte {self.at}")
        self.unit, self.left = self._outer.pop()

    def leave(self) -> None:
        """Leave the list, even if elements are left in it."""
        self.unit, self.left = self._outer.pop()

    def finish(self) -> None:
        """Raise `WireError` if bytes are left."""
        if self.pending:
            raise WireError(f"{self.pending} bytes after the end, at byte {self.at}")

    def next_tag(self) -> int:
        """Return the tag of the next element without reading it."""
        return self.unit or int(self._look(_INT32, self.at)[0])

    def integer(self) -> int:
        """Read an integer of any size, or the number of a vocab."""
        tag = self._tag()
        layout = _INTEGERS.get(tag)
        if layout is None:
            raise self._wrong("an integer", tag)
        return int(self.raw(layout)[0])

    def float64(self) -> float:
        """Read a number of any type."""
        tag = self._tag()
        if tag == self.profile.float64_tag:
            return float(self.raw(_FLOAT64)[0])
        if tag == self.profile.float32_tag:
            return float(self.raw(_FLOAT32)[0])
        layout = _INTEGERS.get(tag)
        if layout is None or tag == VOCAB32:
            raise self._wrong("a number", tag)
        return float(self.raw(layout)[0])

    def boolean(self) -> bool:
        """Read an int of four bytes or a vocab as a bool: true except for 0 and ``[fail]``."""
        tag = self._tag()
        if tag not in (INT32, VOCAB32):
            raise self._wrong("a bool", tag)
        return bytes(self.block(4)) not in (b"\0\0\0\0", b"fail")

    def word(self) -> str:
        """Read a vocab or a string: people who type a call use either."""
        tag = self._tag()
        if tag == VOCAB32:
            return bytes(self.block(4)).rstrip(b"\0").decode("latin-1")
        if tag == STRING:
            return self._text()
        raise self._wrong("a word", tag)

    def blob(self) -> memoryview:
        """Read a blob, without a copy."""
        tag = self._tag()
        if tag != BLOB:
            raise self._wrong("a blob", tag)
        return self.block(self._size("a blob"))

    string = word

    def element(self) -> int:
        """Return the position of the next element; the caller decodes it and sets ``at`` to its end."""
        self._count()
        return self.at

    def raw(self, layout: struct.Struct) -> tuple[Any, ...]:
        """Read numbers in a fixed layout."""
        values = self._look(layout, self.at)
        self.at += layout.size
        return values

    def untagged(self, layout: struct.Struct) -> tuple[Any, ...]:
        """Read an element in a fixed layout without a tag."""
        self._count()
        return self.raw(layout)

    def block(self, size: int) -> memoryview:
        """Read raw bytes, without a copy."""
        at, end = self.at, self.at + size
        if end > len(self.data):
            raise Incomplete(f"{size} bytes expected at byte {at}, but {self.pending} are left")
        self.at = end
        return self.data[at:end]

    def numbers(self) -> tuple[int, int, memoryview | None]:
        """Read the tag, count and bytes of a list of numbers; for another list, which stays open, bytes is None."""
        count = self.begin()
        tag = self.unit
        size = _SIZES[self.profile].get(tag)
        if size is None:
            return tag, count, None
        data = self.block(size * count)
        self.leave()
        return tag, count, data

    def _tag(self) -> int:
        if not self.left:
            raise WireError(f"the list ends before byte {self.at}, but one more element was expected")
        self._count()
        return self.unit or int(self.raw(_INT32)[0])

    def _count(self) -> None:
        if not self.left:
            raise WireError(f"the list ends before byte {self.at}, but one more element was expected")
        if self.left > 0:
            self.left -= 1

    def _size(self, what: str) -> int:
        at = self.at
        size = int(self.raw(_INT32)[0])
        if size < 0:
            raise WireError(f"{what} of {size} bytes at byte {at}")
        return size

    def _text(self) -> str:
        return str(self.block(self._size("a string")), "utf-8", "surrogateescape")

    def _look(self, layout: struct.Struct, at: int) -> tuple[Any, ...]:
        try:
            return layout.unpack_from(self.data, at)
        except struct.error as error:
            raise Incomplete(f"{layout.size} bytes expected at byte {at}, but {self.pending} are left") from error

    def _wrong(self, what: str, tag: int) -> WireError:
        return WireError(f"expected {what} before byte {self.at}, found tag {tag}")


class ElementWriter:
    """A buffer for a payload; outcomes have the format of ``generation``, by default the profile's newest."""

    __slots__ = ("_done", "_tail", "generation", "profile")

    def __init__(self, profile: Profile, generation: Generation | None = None) -> None:
        self.profile = profile
        self.generation = Generation.newest(profile) if generation is None else generation
        self._done: list[Buffer] = []
        self._tail = bytearray()

    @property
    def writer(self) -> ElementWriter:
        """This object, so that values can be written to it as to a connection."""
        return self

    def begin(self, count: int, tag: int = 0) -> None:
        """Begin a list of ``count`` elements; if all have the same ``tag``, it is not repeated for each."""
        self._tail += _TWO_INT32.pack(LIST | tag, count)

    def integer(self, value: int, tag: int = INT32, *, tagged: bool = True) -> None:
        """Write an integer in its tag's size, unsigned ones as the same bits; raises `WireError` if it is too large."""
        try:
            size = _INTEGERS[tag].size
            if value > 0 and value >> (8 * size - 1) == 1:
                value -= 1 << 8 * size
            self._tail += _TAGGED[tag].pack(tag, value) if tagged else _INTEGERS[tag].pack(value)
        except (struct.error, TypeError) as error:
            raise WireError(f"{value!r} is not an integer of {8 * _INTEGERS[tag].size} bits") from error

    def float64(self, value: float, *, tagged: bool = True) -> None:
        """Write a float of eight bytes."""
        try:
            if tagged:
                self._tail += _TAGGED_FLOAT64.pack(self.profile.float64_tag, value)
            else:
                self._tail += _FLOAT64.pack(value)
        except (struct.error, OverflowError) as error:
            raise WireError(f"{value!r} is not a number") from error

    def float32(self, value: float, *, tagged: bool = True) -> None:
        """Write a float of four bytes."""
        try:
            if tagged:
                self._tail += _TAGGED_FLOAT32.pack(self.profile.float32_tag, value)
            else:
                self._tail += _FLOAT32.pack(value)
        except (struct.error, OverflowError) as error:
            raise WireError(f"{value!r} is not a float of four bytes") from error

    def boolean(self, value: object, *, tagged: bool = True) -> None:
        """Write a bool as YARP's generated code does: ``[ok]`` or ``[fail]``."""
        self.vocab("ok" if value else "fail", tagged=tagged)

    def vocab(self, word: str, *, tagged: bool = True) -> None:
        """Write a word of up to four one-byte characters; raises `WireError` for other words."""
        try:
            encoded = word.encode("latin-1")
        except (UnicodeEncodeError, AttributeError):
            encoded = b"none!"
        if len(encoded) > 4:
            raise WireError(f"{word!r} is not a vocab of up to four one-byte characters")
        if tagged:
            self._tail += b"\x09\0\0\0"
        self._tail += encoded.ljust(4, b"\0")

    def string(self, text: str, *, tagged: bool = True) -> None:
        """Write a text as UTF-8; surrogate escapes become their original bytes."""
        try:
            encoded = text.encode("utf-8", "surrogateescape")
        except (UnicodeEncodeError, AttributeError) as error:
            raise WireError(f"cannot encode {text!r:.60} as text") from error
        if tagged:
            self._tail += b"\x04\0\0\0"
        self._tail += _INT32.pack(len(encoded))
        self._tail += encoded

    def blob(self, data: Buffer, *, tagged: bool = True) -> None:
        """Write a blob."""
        if tagged:
            self._tail += b"\x0c\0\0\0"
        self._tail += _INT32.pack(memoryview(data).nbytes)
        self.block(data)

    def raw(self, layout: struct.Struct, *values: Any) -> None:
        """Write numbers and tags in a fixed layout; raises `WireError` if a value does not fit."""
        try:
            self._tail += layout.pack(*values)
        except struct.error as error:
            raise WireError(f"{values} do not fit {layout.format!r}: {error}") from error

    def block(self, data: Buffer) -> None:
        """Write raw bytes; large blocks are not copied, so they must not change until they are sent."""
        if memoryview(data).nbytes < _REFERENCE:
            self._tail += data
            return
        if self._tail:
            self._done.append(self._tail)
            self._tail = bytearray()
        self._done.append(data)

    def buffers(self) -> list[Buffer]:
        """Return the written bytes, in pieces."""
        return [*self._done, self._tail] if self._tail or not self._done else list(self._done)

    def payload(self) -> bytes:
        """Return the written bytes, in one piece."""
        return b"".join((*self._done, self._tail)) if self._done else bytes(self._tail)
