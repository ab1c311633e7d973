"""Runs conversion programs over messages: bytes in, bytes out. A kernel, see `bridge.kernels`.

One interpreter serves every type, so that no type needs compiling and the first message is as fast as the last. The
program runs twice over each message: first without a target, to check the message and measure its converted form, and
then into a buffer of the measured size. Every read is checked against the message's end, and every write against the
buffer's, since a message in memory that another process shares may change between the two. `opcodes` in
`bridge.messages.transcode` has already verified that the program uses only its own memory.

``i`` and ``o`` are positions in the message and in its converted form. ``in_mask`` (of the message) and ``out_mask``
(of its converted form) are 7 for CDR, and 0 for the ROS 1 serialization, which has no alignment. In compiled code
messages are pointers; in uncompiled code they are bytes, and an access out of bounds raises IndexError.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import cython

from bridge.messages.transcode import opcodes
from bridge.messages.transcode.opcodes import MessageFault, Op, verify

if cython.compiled:
    from cython.cimports.cpython.bytes import PyBytes_AsString, PyBytes_FromStringAndSize
    from cython.cimports.libc.string import memcpy, memset

if sys.byteorder != "little":
    raise ImportError("the message converters need a little-endian machine")

_LARGE = cython.declare(cython.longlong, 64 << 10)
"""Messages of at least this size in bytes are converted without the GIL. For smaller messages, releasing the GIL costs
more than the conversion, because getting it back may take the 5 ms for which a busy thread keeps it."""

# C variables, which are read without the GIL
_COPY = cython.declare(cython.longlong, Op.COPY)
_BOOL = cython.declare(cython.longlong, Op.BOOL)
_STRING = cython.declare(cython.longlong, Op.STRING)
_SEQUENCE = cython.declare(cython.longlong, Op.SEQUENCE)
_BOOLS = cython.declare(cython.longlong, Op.BOOLS)
_STRINGS = cython.declare(cython.longlong, Op.STRINGS)
_LOOP = cython.declare(cython.longlong, Op.LOOP)
_SKIP = cython.declare(cython.longlong, Op.SKIP)
_SKIP_STRING = cython.declare(cython.longlong, Op.SKIP_STRING)
_SKIP_SEQUENCE = cython.declare(cython.longlong, Op.SKIP_SEQUENCE)
_SKIP_LOOP = cython.declare(cython.longlong, Op.SKIP_LOOP)
_REPEAT = cython.declare(cython.longlong, Op.REPEAT)
_NEXT = cython.declare(cython.longlong, Op.NEXT)
_MARK = cython.declare(cython.longlong, Op.MARK)
_SEEK = cython.declare(cython.longlong, Op.SEEK)
_ZERO = cython.declare(cython.longlong, Op.ZERO)
_LITERAL = cython.declare(cython.longlong, Op.LITERAL)
_TRUNCATED = cython.declare(cython.longlong, MessageFault.TRUNCATED)
_TOO_MANY = cython.declare(cython.longlong, MessageFault.TOO_MANY)
_TOO_LONG = cython.declare(cython.longlong, MessageFault.TOO_LONG)
_NO_NUL = cython.declare(cython.longlong, MessageFault.NO_NUL)
_TRAILING = cython.declare(cython.longlong, MessageFault.TRAILING)
_ENCAPSULATION = cython.declare(cython.longlong, MessageFault.ENCAPSULATION)
_TOO_LARGE = cython.declare(cython.longlong, MessageFault.TOO_LARGE)
_ENDLESS = cython.declare(cython.longlong, MessageFault.ENDLESS)
_FAULT_BITS = cython.declare(cython.longlong, opcodes.FAULT_BITS)
_INSTRUCTION_BITS = cython.declare(cython.longlong, opcodes.INSTRUCTION_BITS)
_MAX_MESSAGE = cython.declare(cython.longlong, opcodes.MAX_MESSAGE)
_EMPTY_ELEMENTS = cython.declare(cython.longlong, opcodes.EMPTY_ELEMENTS)
_DIRTY = cython.declare(cython.longlong, opcodes.DIRTY)


def _within(memory: bytes | bytearray, at: int, size: int) -> None:
    """Check the bounds of an access in uncompiled code: Python truncates slices, and accepts negative indexes."""
    if at < 0 or at + size > len(memory):
        raise IndexError(f"bytes {at} to {at + size} of {len(memory)}")


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _load8(source: cython.p_const_uchar, i: cython.longlong) -> cython.longlong:
    if not cython.compiled:
        _within(source, i, 1)
    return source[i]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _load32(source: cython.p_const_uchar, i: cython.longlong) -> cython.longlong:
    if not cython.compiled:
        _within(source, i, 4)
    high: cython.longlong = source[i + 3]
    return source[i] | (source[i + 1] << 8) | (source[i + 2] << 16) | (high << 24)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _store8(target: cython.p_uchar, o: cython.longlong, value: cython.longlong) -> cython.void:
    if not cython.compiled:
        _within(target, o, 1)
    target[o] = value


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _store32(target: cython.p_uchar, o: cython.longlong, value: cython.longlong) -> cython.void:
    if not cython.compiled:
        _within(target, o, 4)
    target[o] = value & 255
    target[o + 1] = (value >> 8) & 255
    target[o + 2] = (value >> 16) & 255
    target[o + 3] = (value >> 24) & 255


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _copy(
    source: cython.p_const_uchar, i: cython.longlong, target: cython.p_uchar, o: cython.longlong, size: cython.longlong
) -> cython.void:
    if cython.compiled:
        memcpy(target + o, source + i, size)
    else:
        _within(source, i, size)
        _within(target, o, size)
        target[o : o + size] = source[i : i + size]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _clear(target: cython.p_uchar, o: cython.longlong, size: cython.longlong) -> cython.void:
    if cython.compiled:
        memset(target + o, 0, size)
    else:
        _within(target, o, size)
        target[o : o + size] = bytes(size)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _fault(kind: cython.longlong, byte: cython.longlong, pc: cython.longlong) -> cython.longlong:
    """Return the code of a fault: -(byte of the message << 27 | instruction << 5 | fault)."""
    return -((((byte << _INSTRUCTION_BITS) | pc) << _FAULT_BITS) | kind)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _aligned(at: cython.longlong, mask: cython.longlong) -> cython.longlong:
    """Return the next aligned position; CDR aligns relative to the end of its 4-byte header."""
    return at + ((4 - at) & mask)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _pad(target: cython.p_uchar, o: cython.longlong, mask: cython.longlong, write: cython.bint) -> cython.longlong:
    """Zero the padding, and return the next aligned position."""
    end: cython.longlong = _aligned(o, mask)
    if write:
        while o < end:
            _store8(target, o, 0)
            o += 1
    return end


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _flags(
    source: cython.p_const_uchar,
    i: cython.longlong,
    target: cython.p_uchar,
    o: cython.longlong,
    count: cython.longlong,
    write: cython.bint,
) -> cython.longlong:
    """Copy bools, normalized to 0 or 1; return 1 if any had another value."""
    odd: cython.longlong = 0
    k: cython.longlong
    for k in range(count):
        odd |= _load8(source, i + k) > 1
        if write:
            _store8(target, o + k, _load8(source, i + k) != 0)
    return odd


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _read_count(
    source: cython.p_const_uchar, i: cython.longlong, size: cython.longlong, bound: cython.longlong
) -> cython.longlong:
    """Return the number of elements that follow; a negative result is a fault, at ``i`` or at the message's end."""
    if i + 4 > size:
        return -_TRUNCATED
    count: cython.longlong = _load32(source, i)
    return -_TOO_MANY if bound != 0 and count > bound else count


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _write_count(
    target: cython.p_uchar, o: cython.longlong, mask: cython.longlong, count: cython.longlong, write: cython.bint
) -> cython.longlong:
    """Write the number of elements that follow; return the next position."""
    o = _pad(target, o, mask & 3, write)
    if write:
        _store32(target, o, count)
    return o + 4


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _read_string(
    source: cython.p_const_uchar,
    i: cython.longlong,
    size: cython.longlong,
    from_cdr: cython.longlong,
    bound: cython.longlong,
) -> cython.longlong:
    """Return the length of the string whose length field is at ``i``; a negative result is a fault."""
    if i + 4 > size:
        return -_TRUNCATED
    length: cython.longlong = _load32(source, i)
    if i + 4 + length > size:
        return -_TRUNCATED
    if from_cdr and length > 0:
        length -= 1
        if _load8(source, i + 4 + length) != 0:
            return -_NO_NUL
    return -_TOO_LONG if bound != 0 and length > bound else length


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _write_string(
    source: cython.p_const_uchar,
    i: cython.longlong,
    target: cython.p_uchar,
    o: cython.longlong,
    mask: cython.longlong,
    length: cython.longlong,
    write: cython.bint,
) -> cython.longlong:
    """Write a string whose characters are at ``i``; return the next position."""
    nul: cython.longlong = mask & 1
    o = _write_count(target, o, mask, length + nul, write)
    if write:
        _copy(source, i, target, o, length)
        if nul:
            _store8(target, o + length, 0)
    return o + length + nul


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _run(
    words: cython.p_const_longlong,  # flags, then five words for each instruction
    literals: cython.p_const_uchar,  # constant bytes that the program writes
    source: cython.p_const_uchar,  # the message
    size: cython.longlong,  # its length in bytes
    target: cython.p_uchar,  # buffer for the converted message
    room: cython.longlong,  # its length in bytes; 0: the message is checked and the size measured
) -> cython.longlong:
    """Run a program over one message. This is one long function, so that its state stays in the processor's registers.

    Returns:
        The size of the converted message, with `opcodes.DIRTY` set if the message is not in its normal form; or the
        negative code of a fault.
    """
    counters = cython.declare(cython.longlong[32])  # opcodes.FRAMES
    marks = cython.declare(cython.longlong[224])  # opcodes.SLOTS
    from_cdr: cython.longlong = words[0] & 1
    to_cdr: cython.longlong = words[0] >> 1
    in_mask: cython.longlong = 7 * from_cdr
    out_mask: cython.longlong = 7 * to_cdr
    i: cython.longlong = 4 * from_cdr
    o: cython.longlong = 4 * to_cdr
    write: cython.bint = room > 0
    most: cython.longlong = room if write else _MAX_MESSAGE + o
    fuel: cython.longlong = size - i + _EMPTY_ELEMENTS
    pc: cython.longlong = 0
    depth: cython.longlong = 0
    slack: cython.longlong = 0
    dirty: cython.longlong = 0
    cython.declare(at=cython.longlong, code=cython.longlong, mask=cython.longlong, length=cython.longlong)
    cython.declare(bound=cython.longlong, count=cython.longlong, start=cython.longlong, characters=cython.longlong)
    if from_cdr and (size < 4 or _load8(source, 0) != 0 or _load8(source, 1) != 1):
        return _fault(_ENCAPSULATION, 0, 0)
    if o > most:
        return _fault(_TOO_LARGE, 0, 0)
    if to_cdr and write:
        _store32(target, 0, 256)
    while True:
        at = 1 + 5 * pc
        code, mask, length, bound = words[at], words[at + 1], words[at + 2], words[at + 3]
        if code in (_COPY, _BOOL, _SKIP):
            i = _aligned(i, mask & in_mask)
            if i + length > size:
                return _fault(_TRUNCATED, min(i, size), pc)
            if code != _SKIP:
                if _aligned(o, mask & out_mask) + length > most:
                    return _fault(_TOO_LARGE, i, pc)
                o = _pad(target, o, mask & out_mask, write)
                if code == _BOOL:
                    dirty |= _flags(source, i, target, o, length, write)
                elif write:
                    _copy(source, i, target, o, length)
                o += length
            i += length
        elif code in (_STRING, _STRINGS, _SKIP_STRING):
            count = 1
            if code == _STRINGS:
                i = _aligned(i, in_mask & 3)
                count = _read_count(source, i, size, bound)
                if count < 0:
                    return _fault(-count, min(i, size), pc)
                i += 4
                if count * 4 > size - i:
                    return _fault(_TRUNCATED, i - 4, pc)
                if _aligned(o, out_mask & 3) + 4 > most:
                    return _fault(_TOO_LARGE, i, pc)
                o = _write_count(target, o, out_mask, count, write)
                bound = length
            for _ in range(count):
                i = _aligned(i, in_mask & 3)
                characters = _read_string(source, i, size, from_cdr, bound)
                if characters < 0:
                    at = i + 3 + _load32(source, i) if characters == -_NO_NUL else min(i, size)
                    return _fault(-characters, at, pc)
                start = i + 4
                i = start + _load32(source, i)
                dirty |= from_cdr * (i == start)
                if code != _SKIP_STRING:
                    if _aligned(o, out_mask & 3) + 4 + characters + to_cdr > most:
                        return _fault(_TOO_LARGE, min(i, size), pc)
                    o = _write_string(source, start, target, o, out_mask, characters, write)
        elif code in (_SEQUENCE, _BOOLS, _SKIP_SEQUENCE):
            i = _aligned(i, in_mask & 3)
            count = _read_count(source, i, size, bound)
            if count < 0:
                return _fault(-count, min(i, size), pc)
            start = i
            i += 4
            if code != _SKIP_SEQUENCE:
                if _aligned(o, out_mask & 3) + 4 > most:
                    return _fault(_TOO_LARGE, i, pc)
                o = _write_count(target, o, out_mask, count, write)
            if count == 0:
                slack += 4 * (mask == 7)  # rclpy adds padding before the elements even if there are none
            else:
                i = _aligned(i, mask & in_mask)
                if count * length > size - i:
                    return _fault(_TRUNCATED, start, pc)
                if code != _SKIP_SEQUENCE:
                    if _aligned(o, mask & out_mask) + count * length > most:
                        return _fault(_TOO_LARGE, i, pc)
                    o = _pad(target, o, mask & out_mask, write)
                    if code == _BOOLS:
                        dirty |= _flags(source, i, target, o, count, write)
                    elif write:
                        _copy(source, i, target, o, count * length)
                    o += count * length
                i += count * length
        elif code in (_LOOP, _SKIP_LOOP, _REPEAT):
            count = bound
            start = i
            if code != _REPEAT:
                start = i = _aligned(i, in_mask & 3)
                count = _read_count(source, i, size, bound)
                if count < 0:
                    return _fault(-count, min(i, size), pc)
                i += 4
                if code == _LOOP:
                    if _aligned(o, out_mask & 3) + 4 > most:
                        return _fault(_TOO_LARGE, i, pc)
                    o = _write_count(target, o, out_mask, count, write)
            if length > 0 and count * length > size - i:
                return _fault(_TRUNCATED, start, pc)
            if length == 0:
                fuel -= count
                if fuel < 0:
                    return _fault(_ENDLESS, start, pc)
            if count == 0:
                pc = words[at + 4]
                continue
            counters[depth] = count
            depth += 1
        elif code == _NEXT:
            counters[depth - 1] -= 1
            if counters[depth - 1] > 0:
                pc = words[at + 4]
                continue
            depth -= 1
        elif code in (_ZERO, _LITERAL):
            if _aligned(o, mask & out_mask) + length > most:
                return _fault(_TOO_LARGE, i, pc)
            o = _pad(target, o, mask & out_mask, write)
            if write and code == _ZERO:
                _clear(target, o, length)
            elif write:
                _copy(literals, words[at + 4], target, o, length)
            o += length
        elif code == _MARK:
            marks[words[at + 4]] = i
        elif code == _SEEK:
            i = marks[words[at + 4]]
        else:
            break
        pc += 1
    if i != size and (from_cdr == 0 or size - i > 7 + slack):
        return _fault(_TRAILING, i, pc)
    return o | (_DIRTY * dirty)


@cython.cfunc
def _words(program: bytes) -> cython.p_const_longlong:
    return (
        cython.cast(cython.p_const_longlong, PyBytes_AsString(program))
        if cython.compiled
        else memoryview(program).cast("q")
    )


@cython.final
@cython.cclass
class VirtualMachine:
    """A conversion program that any thread may run; raises `ValueError` if it could access memory other than its own.

    Args:
        words: 64-bit words: flags, then five for each instruction.
        literals: constant bytes that the program writes.
        refuse: returns the error for the code of a fault.
    """

    _words: bytes
    _literals: bytes
    _refuse: Callable[[int], Exception]

    def __init__(self, words: bytes, literals: bytes, refuse: Callable[[int], Exception]) -> None:
        verify(words, literals)
        self._words, self._literals, self._refuse = words, literals, refuse

    def convert(self, payload: bytes | bytearray | memoryview) -> bytes:
        """Return the converted message; raises `bridge.messages.errors.ConversionError`."""
        message: bytes = payload if type(payload) is bytes else bytes(payload)
        return self._write(message, self._measure(message) & ~_DIRTY)

    def check(self, payload: bytes | bytearray | memoryview) -> bytes:
        """Return the message in its normal form (the same object if nothing changes); raises like `convert`."""
        message: bytes = payload if type(payload) is bytes else bytes(payload)
        size: cython.longlong = self._measure(message)
        if size == len(message):
            return message
        # a message that is not dirty differs from its normal form only by the slack after it
        return self._write(message, size & ~_DIRTY) if size & _DIRTY else message[:size]

    @property
    def program(self) -> tuple[int, int, bytes, bytes] | None:
        """For C code: the address of `_run`, `opcodes.DIRTY`, and the first two arguments; None in uncompiled code."""
        if not cython.compiled:
            return None
        return cython.cast(cython.size_t, cython.cast(cython.p_void, _run)), _DIRTY, self._words, self._literals

    @cython.cfunc
    def _measure(self, message: bytes) -> cython.longlong:
        """Check a message; return the size of its converted form, with `opcodes.DIRTY` set if the message is dirty."""
        size: cython.longlong = _run(_words(self._words), self._literals, message, len(message), cython.NULL, 0)
        if size < 0:
            raise self._refuse(size)
        return size

    @cython.cfunc
    def _write(self, message: bytes, size: cython.longlong) -> bytes:
        """Convert a checked message into ``size`` bytes."""
        program: cython.p_const_longlong = _words(self._words)
        literals: cython.p_const_uchar = self._literals
        source: cython.p_const_uchar = message
        length: cython.longlong = len(message)
        written: cython.longlong
        if cython.compiled:
            result = PyBytes_FromStringAndSize(cython.NULL, size)
            target: cython.p_uchar = cython.cast(cython.p_uchar, PyBytes_AsString(result))
        else:
            result = target = bytearray(size)
        if length < _LARGE:
            written = _run(program, literals, source, length, target, size)
        else:
            with cython.nogil:
                written = _run(program, literals, source, length, target, size)
        if written & ~_DIRTY != size:
            wrote: object = written & ~_DIRTY if written >= 0 else "more"
            raise SystemError(f"a conversion measured as {size} bytes wrote {wrote} bytes")
        return result if cython.compiled else bytes(result)
