"""Runs conversion programs on raw memory, compiled by numba once and kept in its cache on disk.

One interpreter serves every type, so that no type is ever compiled and the first message is as quick as the last. Every
read is checked against the message's end before it is made. Addresses are plain integers: a call costs about 50 ns.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numba

from bridge.messages import ops
from bridge.messages.cache import compiled, entry_point
from bridge.messages.memory import load8, load64, move, scratch_space, store32, store64
from bridge.messages.ops import Fault, Op
from bridge.messages.steps import (
    aligned,
    copy,
    fault,
    flags,
    jit,
    pad,
    read_count,
    read_string,
    write_count,
    write_string,
    zeros,
)

if sys.byteorder != "little":
    msg = "the message converters need a little-endian machine"
    raise ImportError(msg)

Run = Callable[[int, int, int, int], int]

# numba takes plain integers among a module's globals as constants.
_COPY, _BOOL, _SKIP = int(Op.COPY), int(Op.BOOL), int(Op.SKIP)
_STRING, _STRINGS, _SKIP_STRING = int(Op.STRING), int(Op.STRINGS), int(Op.SKIP_STRING)
_SEQUENCE, _BOOLS, _SKIP_SEQUENCE = int(Op.SEQUENCE), int(Op.BOOLS), int(Op.SKIP_SEQUENCE)
_LOOP, _SKIP_LOOP, _REPEAT, _NEXT = int(Op.LOOP), int(Op.SKIP_LOOP), int(Op.REPEAT), int(Op.NEXT)
_MARK, _SEEK, _ZERO, _LITERAL = int(Op.MARK), int(Op.SEEK), int(Op.ZERO), int(Op.LITERAL)
_TRUNCATED, _TRAILING, _ENCAPSULATION = int(Fault.TRUNCATED), int(Fault.TRAILING), int(Fault.ENCAPSULATION)
_TOO_LARGE, _ENDLESS = int(Fault.TOO_LARGE), int(Fault.ENDLESS)
_STEP = 8 * ops.WORDS
_FRAMES = ops.FRAMES
_MAX_MESSAGE, _EMPTY_ELEMENTS, _DIRTY = ops.MAX_MESSAGE, ops.EMPTY_ELEMENTS, ops.DIRTY
_FAULT_BITS, _INSTRUCTION_BITS = ops.FAULT_BITS, ops.INSTRUCTION_BITS


@jit
def _locate(trouble: int, pc: int, head: int) -> int:
    """A fault as the machine gives it: -(byte of the message << 27 | instruction << 5 | fault)."""
    kind = -trouble & ((1 << _FAULT_BITS) - 1)
    byte = head + (-trouble >> _FAULT_BITS)
    return -((((byte << _INSTRUCTION_BITS) | pc) << _FAULT_BITS) | kind)


def _run(program: int, source: int, size: int, target: int) -> int:
    """Run a program over one message. One long function: its state is to stay in the processor's registers.

    Args:
        program: address of the program.
        source: address of the message.
        size: its length in bytes.
        target: address of the room for the converted message, 0 to check the message and measure that room.

    Returns:
        The size of the converted message, with `ops.DIRTY` where the message is not in its normal form; or a fault,
        less than zero.
    """
    kinds = load64(program)
    from_cdr, to_cdr = kinds & 1, kinds >> 1
    head, source_mask, target_mask = 4 * from_cdr, 7 * from_cdr, 7 * to_cdr
    if from_cdr:
        if size < 4 or load8(source) != 0 or load8(source + 1) != 1:
            return _locate(fault(_ENCAPSULATION, 0), 0, 0)
        source += 4
        size -= 4
    if to_cdr and target != 0:
        store32(target, 256)
        target += 4
    scratch = scratch_space()
    i = o = pc = depth = slack = dirty = 0
    fuel = size + _EMPTY_ELEMENTS
    while True:
        at = program + 8 + pc * _STEP
        code, mask, length, bound = load64(at), load64(at + 8), load64(at + 16), load64(at + 24)
        if code in (_COPY, _BOOL, _SKIP):
            i = aligned(i, mask & source_mask)
            if i + length > size:
                return _locate(fault(_TRUNCATED, min(i, size)), pc, head)
            if code != _SKIP:
                o = pad(target, o, mask & target_mask)
                if code == _BOOL:
                    dirty |= flags(source, i, target, o, length)
                    o += length
                else:
                    o = copy(source, i, target, o, length)
            i += length
        elif code in (_STRING, _STRINGS, _SKIP_STRING):
            count = 1
            if code == _STRINGS:
                count, i = read_count(source, i, size, source_mask, bound)
                if i < 0:
                    return _locate(i, pc, head)
                if count * 4 > size - i:
                    return _locate(fault(_TRUNCATED, i - 4), pc, head)
                o = write_count(target, o, target_mask, count)
                bound = length
            for _ in range(count):
                characters, start, i = read_string(source, i, size, source_mask, bound)
                if i < 0:
                    return _locate(i, pc, head)
                if from_cdr and i == start:
                    dirty = 1
                if code != _SKIP_STRING:
                    o = write_string(target, o, target_mask, source + start, characters)
        elif code in (_SEQUENCE, _BOOLS, _SKIP_SEQUENCE):
            count, i = read_count(source, i, size, source_mask, bound)
            if i < 0:
                return _locate(i, pc, head)
            if code != _SKIP_SEQUENCE:
                o = write_count(target, o, target_mask, count)
            if count == 0:
                # rclpy's serialiser takes room for the padding before elements that are not there.
                slack += 4 * (mask == 7)
            else:
                start = i
                i = aligned(i, mask & source_mask)
                if count * length > size - i:
                    return _locate(fault(_TRUNCATED, start - 4), pc, head)
                if code != _SKIP_SEQUENCE:
                    o = pad(target, o, mask & target_mask)
                    if code == _BOOLS:
                        dirty |= flags(source, i, target, o, count)
                        o += count
                    else:
                        o = copy(source, i, target, o, count * length)
                i += count * length
        elif code in (_LOOP, _SKIP_LOOP, _REPEAT):
            count, start = bound, i
            if code != _REPEAT:
                count, i = read_count(source, i, size, source_mask, bound)
                if i < 0:
                    return _locate(i, pc, head)
                start = i - 4
                if code == _LOOP:
                    o = write_count(target, o, target_mask, count)
            if length > 0 and count * length > size - i:
                return _locate(fault(_TRUNCATED, start), pc, head)
            if length == 0:
                fuel -= count
                if fuel < 0:
                    return _locate(fault(_ENDLESS, start), pc, head)
            if count == 0:
                pc = load64(at + 32)
                continue
            store64(scratch + 8 * depth, count)
            depth += 1
        elif code == _NEXT:
            if o > _MAX_MESSAGE:
                return _locate(fault(_TOO_LARGE, i), pc, head)
            left = load64(scratch + 8 * (depth - 1)) - 1
            if left > 0:
                store64(scratch + 8 * (depth - 1), left)
                pc = load64(at + 32)
                continue
            depth -= 1
        elif code == _ZERO:
            o = zeros(target, pad(target, o, mask & target_mask), length)
        elif code == _LITERAL:
            o = pad(target, o, mask & target_mask)
            if target != 0:
                move(target + o, program + load64(at + 32), length)
            o += length
        elif code == _MARK:
            store64(scratch + 8 * (_FRAMES + load64(at + 32)), i)
        elif code == _SEEK:
            i = load64(scratch + 8 * (_FRAMES + load64(at + 32)))
        else:
            break
        pc += 1
    if i != size and (from_cdr == 0 or size - i > 7 + slack):
        return _locate(fault(_TRAILING, i), pc, head)
    if o > _MAX_MESSAGE:
        return _locate(fault(_TOO_LARGE, i), pc, head)
    return (o + 4 * to_cdr) | (_DIRTY * dirty)


def _run_free(program: int, source: int, size: int, target: int) -> int:
    size_or_fault: int = _compiled(program, source, size, target)
    return size_or_fault


_SIGNATURE = numba.int64(numba.int64, numba.int64, numba.int64, numba.int64)
_SOURCES = [Path(__file__).with_name(name) for name in ("machine.py", "memory.py", "ops.py", "steps.py")]

_compiled = compiled(_run, _SIGNATURE, _SOURCES)

run: Run = entry_point(_compiled, _SIGNATURE)
"""The interpreter; holds Python's lock."""

run_free: Run = entry_point(compiled(_run_free, _SIGNATURE, _SOURCES, nogil=True), _SIGNATURE)
"""The interpreter, while other threads run Python: worth it where copying takes longer than handing over the lock."""
