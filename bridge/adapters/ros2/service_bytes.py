"""Requests and replies as bytes: the functions that rmw calls in place of a type's own serializers.

rmw has raw topics but no raw services: it hands a C structure to the type support's serializer, and has one filled by
its deserializer. Here the structure is a `Wire`, a place in memory, and the two functions copy bytes from there or to
there. They are machine code (numba) and know nothing of Python: the serializer runs while Fast DDS holds a writer's
lock, and if it waited for Python's lock there, a thread that makes an endpoint could wait for it in turn, for ever.

The functions' forms are those of rosidl_typesupport_fastrtps_cpp/message_type_support.h (Jazzy); of Fast CDR 2.2's
``Cdr`` they use what its header makes public, and the place of its iterators, which is looked for (`_end`).
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import Structure, c_size_t, c_void_p
from pathlib import Path
from typing import Any

import numba
from llvmlite import binding  # type: ignore[import-untyped]
from numba import types

from bridge.messages import memory
from bridge.messages.cache import compiled
from bridge.messages.memory import HEAD, load64, move, store64

ENCAPSULATION = b"\x00\x01\x00\x00"
"""What rmw itself writes before a message: plain CDR, little-endian."""

_KEPT = 64 * 1024
"""Bytes of a buffer that is used again; a larger one is given back after each message."""

_SYMBOLS = {
    "append": "_ZN8eprosima7fastcdr3Cdr15serialize_arrayEPKcm",
    "begin": "_ZN8eprosima7fastcdr3Cdr18get_buffer_pointerEv",
}
_SOURCES = [Path(__file__), Path(memory.__file__)]
_word = types.int64
_external: Any = types.ExternalFunction
_fast_cdr = ctypes.CDLL("libfastcdr.so.2")
_libc = ctypes.CDLL(None)

for _name, _library in [(name, _fast_cdr) for name in _SYMBOLS.values()] + [("realloc", _libc)]:
    binding.add_symbol(_name, ctypes.cast(getattr(_library, _name), c_void_p).value)

_append = _external(_SYMBOLS["append"], _word(_word, _word, _word))
_begin = _external(_SYMBOLS["begin"], _word(_word))
_realloc = _external("realloc", _word(_word, _word))


class Wire(Structure):
    """A message in memory.

    To be sent: ``start`` and ``length`` of what follows the encapsulation header. Taken: the whole message, in memory
    of libc that is grown as it is needed, ``capacity`` bytes of it.
    """

    _fields_ = [("start", c_void_p), ("length", c_size_t), ("capacity", c_size_t)]


def outgoing(payload: bytes) -> Wire:
    """The message for rmw to send; ``payload`` must outlive the call."""
    return Wire(id(payload) + HEAD + len(ENCAPSULATION), len(payload) - len(ENCAPSULATION), 0)


class Incoming:
    """Where rmw puts what it takes; used again and again, by one thread."""

    def __init__(self) -> None:
        self._wire = Wire(None, 0, 0)
        self.pointer = ctypes.addressof(self._wire)

    def payload(self) -> bytes:
        """The message that was taken last."""
        payload = ctypes.string_at(self._wire.start or 0, self._wire.length)
        if self._wire.capacity > _KEPT:
            self.close()
        return payload

    def close(self) -> None:
        """Free the memory."""
        _libc.free(c_void_p(self._wire.start))
        self._wire.start, self._wire.capacity = None, 0


def _serialize(wire: int, cdr: int) -> int:
    """``bool cdr_serialize(const void *, Cdr &)``; the header is written already."""
    _append(cdr, load64(wire), load64(wire + 8))
    return 1


def _size(wire: int) -> int:
    """``uint32_t get_serialized_size(const void *)``, without the header."""
    return load64(wire + 8)


def _deserialize(cdr: int, wire: int) -> int:
    """``bool cdr_deserialize(Cdr &, void *)``: the whole buffer, its header too."""
    begin = _begin(cdr)
    # Cdr ends with three iterators, each the buffer's begin and a position: here, the message's begin, and its end.
    end = 0
    for at in range(0, 256, 8):
        if load64(cdr + at) == begin and load64(cdr + at + 16) == begin and load64(cdr + at + 32) == begin:
            end = load64(cdr + at + 40)
            break
    if end < begin:
        return 0
    length = end - begin
    start = load64(wire)
    if load64(wire + 16) < length:
        start = _realloc(start, length)
        if start == 0:
            return 0
        store64(wire, start)
        store64(wire + 16, length)
    move(start, begin, length)
    store64(wire + 8, length)
    return 1


class Callbacks:
    """Addresses of the compiled functions, made when the first service is."""

    def __init__(self) -> None:
        parts: list[tuple[Callable[..., int], Any]] = [
            (_serialize, types.uint8(_word, _word)),
            (_deserialize, types.uint8(_word, _word)),
            (_size, types.uint32(_word)),
        ]
        self._compiled = [compiled(function, signature, _SOURCES, numba.cfunc) for function, signature in parts]
        self.serialize, self.deserialize, self.size = (int(function.address) for function in self._compiled)
