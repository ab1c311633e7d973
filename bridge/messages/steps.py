"""What the instructions of a conversion program do, one function for each kind; compiled into the machine.

``i`` and ``o`` are positions in the source and the target, counted from behind the encapsulation header, from which CDR
counts its alignment. ``source_mask`` and ``target_mask`` are 7 where that side is CDR and 0 where it is ROS 1's format,
which knows no alignment. A target of 0 means that the message is only checked and measured.

Functions give the new positions; a position below zero is a fault: -(byte << FAULT_BITS | fault).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

from bridge.messages.memory import load8, load32, move, store8, store32
from bridge.messages.ops import FAULT_BITS, Fault

F = TypeVar("F", bound=Callable[..., Any])

_TRUNCATED, _TOO_MANY, _TOO_LONG = int(Fault.TRUNCATED), int(Fault.TOO_MANY), int(Fault.TOO_LONG)
_NO_NUL = int(Fault.NO_NUL)
_BITS = FAULT_BITS
_njit: Any = numba.njit


def jit(function: F) -> F:
    """Compile a function that only compiled functions call."""
    made: F = _njit(function)
    return made


@jit
def fault(kind: int, at: int) -> int:
    """A position that stands for a fault at byte ``at``."""
    return -((at << _BITS) | kind)


@jit
def aligned(at: int, mask: int) -> int:
    """The next position that is a multiple of ``mask + 1``."""
    return (at + mask) & ~mask


@jit
def pad(target: int, at: int, mask: int) -> int:
    """The next aligned position; what lies between is zeroed."""
    end = (at + mask) & ~mask
    if target != 0:
        while at < end:
            store8(target + at, 0)
            at += 1
    return end


@jit
def zeros(target: int, at: int, size: int) -> int:
    """Write zero bytes; the position behind them."""
    if target != 0:
        for k in range(size):
            store8(target + at + k, 0)
    return at + size


@jit
def copy(source: int, i: int, target: int, o: int, size: int) -> int:
    """Copy plain bytes; the position behind them in the target."""
    if target != 0:
        move(target + o, source + i, size)
    return o + size


@jit
def flags(source: int, i: int, target: int, o: int, count: int) -> int:
    """Copy bools, each made 0 or 1; 1 where one was something else."""
    odd = 0
    for k in range(count):
        value = load8(source + i + k)
        if value > 1:
            odd = 1
        if target != 0:
            store8(target + o + k, value != 0)
    return odd


@jit
def read_count(source: int, i: int, size: int, source_mask: int, bound: int) -> tuple[int, int]:
    """Read how many elements follow; the count and the position behind it."""
    i = aligned(i, source_mask & 3)
    if i + 4 > size:
        return 0, fault(_TRUNCATED, min(i, size))
    count = load32(source + i)
    if bound != 0 and count > bound:
        return 0, fault(_TOO_MANY, i)
    return count, i + 4


@jit
def write_count(target: int, o: int, target_mask: int, count: int) -> int:
    """Write how many elements follow; the position behind."""
    o = pad(target, o, target_mask & 3)
    if target != 0:
        store32(target + o, count)
    return o + 4


@jit
def read_string(source: int, i: int, size: int, source_mask: int, bound: int) -> tuple[int, int, int]:
    """Read a string's head: length without NUL, position of its first byte, position behind it."""
    i = aligned(i, source_mask & 3)
    if i + 4 > size:
        return 0, i, fault(_TRUNCATED, min(i, size))
    length = load32(source + i)
    start = i + 4
    end = start + length
    if end > size:
        return 0, i, fault(_TRUNCATED, i)
    if source_mask != 0 and length > 0:
        length -= 1
        if load8(source + start + length) != 0:
            return 0, i, fault(_NO_NUL, start + length)
    if bound != 0 and length > bound:
        return 0, i, fault(_TOO_LONG, i)
    return length, start, end


@jit
def write_string(target: int, o: int, target_mask: int, characters: int, length: int) -> int:
    """Write a string whose characters stand at an address; the position behind it."""
    nul = 1 if target_mask != 0 else 0
    o = pad(target, o, target_mask & 3)
    if target != 0:
        store32(target + o, length + nul)
        move(target + o + 4, characters, length)
        if nul:
            store8(target + o + 4 + length, 0)
    return o + 4 + length + nul
