"""Memory of ``bytes`` objects: their addresses, fresh ones to fill, and numba's way to read and write at an address.

CPython keeps the bytes of a ``bytes`` object inside the object, at a fixed distance from its address, which `id` is. So
a message is read in place, and its converted form is written straight into the object that goes out, without a copy.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from bridge.messages.ops import FRAMES, SLOTS

HEAD = bytes.__basicsize__ - 1
"""Distance from a ``bytes`` object's address to its first byte (one byte of the basic size is the closing NUL)."""

_raw_bytes: Any = ctypes.pythonapi.PyBytes_FromStringAndSize
_raw_bytes.restype = ctypes.py_object
_raw_bytes.argtypes = [ctypes.c_char_p, ctypes.c_ssize_t]


_cg: Any = cgutils
_declare: Any = intrinsic


def _intrinsic(function: Callable[..., Any]) -> Callable[..., int]:
    """Declare a function of integers whose machine code is given."""
    made: Callable[..., int] = _declare(function)
    return made


def fresh_bytes(size: int) -> bytes:
    """A ``bytes`` object of at least two bytes that nobody else has, its content undefined.

    Python promises that one made without content may be filled by who made it (C API, PyBytes_FromStringAndSize).
    """
    made: bytes = _raw_bytes(None, size)
    return made


def _check() -> None:
    sample = b"the first byte of a bytes object"
    if ctypes.string_at(id(sample) + HEAD, len(sample)) != sample:
        msg = "the message converters need CPython, whose bytes objects hold their bytes in place"
        raise ImportError(msg)


_check()


def _loader(bits: int) -> Callable[..., int]:
    """An intrinsic that reads an unsigned integer at any address, aligned or not."""

    @_intrinsic
    def load(_context: Any, _address: Any) -> Any:
        def code(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
            value = builder.load(builder.inttoptr(args[0], ir.IntType(bits).as_pointer()))
            value.align = 1
            return value if bits == 64 else builder.zext(value, ir.IntType(64))

        return types.int64(types.int64), code

    return load


def _storer(bits: int) -> Callable[..., int]:
    """An intrinsic that writes the low bits of an integer at any address."""

    @_intrinsic
    def store(_context: Any, _address: Any, _value: Any) -> Any:
        def code(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
            value = args[1] if bits == 64 else builder.trunc(args[1], ir.IntType(bits))
            builder.store(value, builder.inttoptr(args[0], ir.IntType(bits).as_pointer())).align = 1
            return ir.Constant(ir.IntType(64), 0)

        return types.int64(types.int64, types.int64), code

    return store


load8, load32, load64 = _loader(8), _loader(32), _loader(64)
store8, store32, store64 = _storer(8), _storer(32), _storer(64)


@_intrinsic
def move(_context: Any, _target: Any, _source: Any, _size: Any) -> Any:
    """C's memcpy."""

    def code(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        _cg.raw_memcpy(builder, builder.inttoptr(args[0], pointer), builder.inttoptr(args[1], pointer), args[2], 1)
        return ir.Constant(ir.IntType(64), 0)

    return types.int64(types.int64, types.int64, types.int64), code


@_intrinsic
def scratch_space(_context: Any) -> Any:
    """Address of loop counters and slots on this call's own stack."""

    def code(_context: Any, builder: Any, _signature: Any, _args: Any) -> Any:
        space = _cg.alloca_once(builder, ir.ArrayType(ir.IntType(64), FRAMES + SLOTS))
        return builder.ptrtoint(space, ir.IntType(64))

    return types.int64(), code
