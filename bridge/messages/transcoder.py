"""Converters from bytes to bytes: a program, and the machine that runs it.

The converters are warm when they are made: the machine is loaded with the first of them, from numba's cache on disk.
"""

from __future__ import annotations

from collections.abc import Callable

from bridge.messages.compiler import compile_check, compile_pair
from bridge.messages.definition import Schema, World
from bridge.messages.errors import ConversionError
from bridge.messages.ops import DIRTY, FAULT_BITS, INSTRUCTION_BITS, MAX_MESSAGE, Fault
from bridge.messages.pairing import PairTable
from bridge.messages.program import Program

Convert = Callable[[bytes], bytes]
"""Takes one message's bytes and gives its bytes on the other wire; raises `ConversionError`."""

LARGE = 64 << 10
"""Messages from this size on are converted while other threads run Python. Below, giving the interpreter's lock away
costs more than the conversion, up to the 5 ms for which a busy thread keeps it."""

_ZEROED = 2048
"""Below this size zeroed memory is had quicker than raw memory."""

_REASONS = {
    Fault.TRUNCATED: "the message ends before the field does, or its length is wrong",
    Fault.TOO_MANY: "more elements than its type allows",
    Fault.TOO_LONG: "the string is longer than its type allows",
    Fault.NO_NUL: "the string has no closing NUL",
    Fault.TRAILING: "bytes are left over behind the last field",
    Fault.ENCAPSULATION: "no little-endian CDR: the message does not begin with 00 01",
    Fault.TOO_LARGE: f"the converted message would be larger than {MAX_MESSAGE} bytes",
    Fault.ENDLESS: "more empty elements than any message holds",
}


def ros1_to_cdr(source: Schema, target: Schema, pairs: PairTable) -> Convert:
    """The converter of a ROS 1 type's bytes to CDR."""
    return _converter(compile_pair(source, target, lambda one, two: pairs[one, two].fields))


def cdr_to_ros1(source: Schema, target: Schema, pairs: PairTable) -> Convert:
    """The converter of CDR bytes to a ROS 1 type's."""
    return _converter(
        compile_pair(source, target, lambda one, two: [(path2, path1) for path1, path2 in pairs[two, one].fields])
    )


def check_cdr(schema: Schema) -> Convert:
    """The check of CDR bytes against their type; the same bytes come back where nothing is to be mended."""
    # numba takes a quarter of a second to import, which who only looks at types need not pay.
    from bridge.messages.machine import run
    from bridge.messages.memory import HEAD

    assert schema.world is World.ROS2
    program = compile_check(schema)
    memory = program.assemble()
    address = memory.ctypes.data
    rewrite = _converter(program)

    def check(payload: bytes, memory: object = memory) -> bytes:  # noqa: ARG001  keeps the program's memory alive
        if type(payload) is not bytes:
            payload = bytes(payload)
        size = run(address, id(payload) + HEAD, len(payload), 0)
        if size == len(payload):
            return payload
        if size < 0:
            raise _error(program, size)
        # Behind the message is only slack; the layout before it is the same.
        return rewrite(payload) if size & DIRTY else payload[:size]

    return check


def _converter(program: Program) -> Convert:
    from bridge.messages.machine import run, run_free
    from bridge.messages.memory import HEAD, fresh_bytes

    memory = program.assemble()
    address = memory.ctypes.data

    def convert(payload: bytes, memory: object = memory) -> bytes:  # noqa: ARG001  keeps the program's memory alive
        if type(payload) is not bytes:
            payload = bytes(payload)
        source = id(payload) + HEAD
        length = len(payload)
        size = run(address, source, length, 0)
        if size < 0:
            raise _error(program, size)
        size &= ~DIRTY
        if size < _ZEROED:
            if size < 2:
                return _tiny(address, source, length, size)
            out = bytes(size)
        else:
            out = fresh_bytes(size)
        if length < LARGE:
            run(address, source, length, id(out) + HEAD)
        else:
            run_free(address, source, length, id(out) + HEAD)
        return out

    def _tiny(address: int, source: int, length: int, size: int) -> bytes:
        """Messages of one byte or none: Python may share such objects, so they are not written in place."""
        room = bytes(8)
        run(address, source, length, id(room) + HEAD)
        return room[:size]

    return convert


def _error(program: Program, fault: int) -> ConversionError:
    number = (-fault >> FAULT_BITS) & ((1 << INSTRUCTION_BITS) - 1)
    byte = -fault >> (FAULT_BITS + INSTRUCTION_BITS)
    reason = Fault(-fault & ((1 << FAULT_BITS) - 1))
    field = program.field_of(number)
    where = f"field {field}, byte {byte}" if field and reason is not Fault.ENCAPSULATION else f"byte {byte}"
    return ConversionError(f"bad {program.name} message: {_REASONS[reason]} ({where})")
