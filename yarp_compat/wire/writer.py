"""Writes a typed value element by element: the list headers, tags and blocks that YARP's own classes put on the wire.

Sources of the layout: `yarp/os/idl/WireWriter.cpp`, `yarp/os/Bottle.h`, and captures of YARP 3.9.1, 3.12.3 and 4.0.
"""

from __future__ import annotations

import struct
from typing import Any

from yarp_compat.wire.errors import WireError
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.tags import INT8, INT16, INT32, INT64, LIST

_REFERENCE = 4096
"""Blocks from this many bytes on are passed on uncopied."""
_INT32 = struct.Struct("<i")
_TWO_INT32 = struct.Struct("<ii")
_TAGGED = {
    INT8: struct.Struct("<ib"), INT16: struct.Struct("<ih"), INT32: struct.Struct("<ii"), INT64: struct.Struct("<iq"),
}  # fmt: skip
_UNTAGGED = {INT8: struct.Struct("<b"), INT16: struct.Struct("<h"), INT32: _INT32, INT64: struct.Struct("<q")}
_TAGGED_FLOAT64, _FLOAT64 = struct.Struct("<id"), struct.Struct("<d")
_TAGGED_FLOAT32, _FLOAT32 = struct.Struct("<if"), struct.Struct("<f")


class Writer:
    """Collects the bytes of one payload.

    Args:
        profile: whose tags are written.
        generation: how a call's outcome is written; by default as the newest release of the profile does.
    """

    __slots__ = ("_done", "_tail", "generation", "profile")

    def __init__(self, profile: Profile, generation: Generation | None = None) -> None:
        self.profile = profile
        self.generation = Generation.newest(profile) if generation is None else generation
        self._done: list[Buffer] = []
        self._tail = bytearray()

    @property
    def writer(self) -> Writer:
        """Itself: a connection to write to is one that has a writer."""
        return self

    def begin(self, count: int, tag: int = 0) -> None:
        """Open a list.

        Args:
            count: elements that follow.
            tag: the elements' tag, where all have the same and so do not repeat it.
        """
        self._tail += _TWO_INT32.pack(LIST | tag, count)

    def integer(self, value: int, tag: int = INT32, *, tagged: bool = True) -> None:
        """An integer of a tag's size; one that is unsigned keeps its bits.

        Raises:
            WireError: it is no integer or does not fit.
        """
        try:
            size = _UNTAGGED[tag].size
            if value > 0 and value >> (8 * size - 1) == 1:
                value -= 1 << 8 * size
            self._tail += _TAGGED[tag].pack(tag, value) if tagged else _UNTAGGED[tag].pack(value)
        except (struct.error, TypeError) as error:
            msg = f"{value!r} is no integer of {8 * _UNTAGGED[tag].size} bits"
            raise WireError(msg) from error

    def float64(self, value: float, *, tagged: bool = True) -> None:
        """A float of eight bytes."""
        try:
            if tagged:
                self._tail += _TAGGED_FLOAT64.pack(self.profile.float64_tag, value)
            else:
                self._tail += _FLOAT64.pack(value)
        except (struct.error, OverflowError) as error:
            raise WireError(f"{value!r} is no number") from error

    def float32(self, value: float, *, tagged: bool = True) -> None:
        """A float of four bytes."""
        try:
            if tagged:
                self._tail += _TAGGED_FLOAT32.pack(self.profile.float32_tag, value)
            else:
                self._tail += _FLOAT32.pack(value)
        except (struct.error, OverflowError) as error:
            raise WireError(f"{value!r} is no float of four bytes") from error

    def boolean(self, value: object, *, tagged: bool = True) -> None:
        """A truth as generated code writes it: ``[ok]`` or ``[fail]``."""
        self.vocab("ok" if value else "fail", tagged=tagged)

    def vocab(self, word: str, *, tagged: bool = True) -> None:
        """A word of up to four characters.

        Raises:
            WireError: it is longer, or not of one-byte characters.
        """
        try:
            encoded = word.encode("latin-1")
        except (UnicodeEncodeError, AttributeError):
            encoded = b"none!"
        if len(encoded) > 4:
            raise WireError(f"{word!r} is no vocab: it has up to four one-byte characters")
        if tagged:
            self._tail += b"\x09\0\0\0"
        self._tail += encoded.ljust(4, b"\0")

    def string(self, text: str, *, tagged: bool = True) -> None:
        """A text in UTF-8; surrogate escapes become the bytes they stand for."""
        try:
            encoded = text.encode("utf-8", "surrogateescape")
        except (UnicodeEncodeError, AttributeError) as error:
            raise WireError(f"{text!r:.60} is no text that can be written") from error
        if tagged:
            self._tail += b"\x04\0\0\0"
        self._tail += _INT32.pack(len(encoded))
        self._tail += encoded

    def blob(self, data: Buffer, *, tagged: bool = True) -> None:
        """Bytes with their count."""
        if tagged:
            self._tail += b"\x0c\0\0\0"
        self._tail += _INT32.pack(memoryview(data).nbytes)
        self.block(data)

    def raw(self, layout: struct.Struct, *values: Any) -> None:
        """Numbers in a fixed layout, with the tags among them that they have.

        Raises:
            WireError: a number does not fit.
        """
        try:
            self._tail += layout.pack(*values)
        except struct.error as error:
            raise WireError(f"{values} do not fit {layout.format!r}: {error}") from error

    def block(self, data: Buffer) -> None:
        """Bytes as they are; large ones are passed on uncopied, so they must stay as they are until they are sent."""
        if memoryview(data).nbytes < _REFERENCE:
            self._tail += data
            return
        if self._tail:
            self._done.append(self._tail)
            self._tail = bytearray()
        self._done.append(data)

    def buffers(self) -> list[Buffer]:
        """What was written, in pieces."""
        return [*self._done, self._tail] if self._tail or not self._done else list(self._done)

    def payload(self) -> bytes:
        """What was written, in one piece."""
        return b"".join((*self._done, self._tail)) if self._done else bytes(self._tail)
