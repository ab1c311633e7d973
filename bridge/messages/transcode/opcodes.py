"""The small instruction set that message conversion runs on, and the check of a program before it runs.

One instruction is `WORDS` 64-bit words: code, mask, size, bound, link. ``mask`` is alignment less one; it counts only
on the side that is CDR. What each word means to an instruction stands at the instruction.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

WORDS = 5
FRAMES = 32  # how deep loops may nest
SLOTS = 224  # how many read positions one program can keep
SOURCE_CDR = 1
TARGET_CDR = 2


class Op(IntEnum):
    """Instructions. The first group reads and writes, the second only reads, the third only writes."""

    COPY = 0  #: ``size`` bytes as they are
    BOOL = 1  #: ``size`` bytes, each made 0 or 1
    STRING = 2  #: a string of at most ``bound`` bytes (0: any)
    SEQUENCE = 3  #: a count of at most ``bound`` and as many elements of ``size`` bytes
    BOOLS = 4  #: a count of at most ``bound`` and as many bytes, each made 0 or 1
    STRINGS = 5  #: a count of at most ``bound`` and as many strings of at most ``size`` bytes
    LOOP = 6
    """A count of at most ``bound``, then the body; elements take at least ``size`` bytes; ``link`` is past the end."""

    SKIP = 7  #: ``size`` bytes
    SKIP_STRING = 8
    SKIP_SEQUENCE = 9  #: a count and as many elements of ``size`` bytes
    SKIP_LOOP = 10  #: as LOOP
    REPEAT = 11  #: the body ``bound`` times; elements take at least ``size`` bytes (-1: they read nothing)
    NEXT = 12  #: end of a body that begins at ``link``
    MARK = 13  #: remember the read position in slot ``link``
    SEEK = 14  #: go on reading at slot ``link``

    ZERO = 15  #: ``size`` zero bytes
    LITERAL = 16  #: ``size`` bytes that stand among the program's literals at byte ``link``

    END = 17


class MessageFault(IntEnum):
    """Why the bytes of a message were refused."""

    TRUNCATED = 1
    TOO_MANY = 2
    TOO_LONG = 3
    NO_NUL = 4
    TRAILING = 5
    ENCAPSULATION = 6
    TOO_LARGE = 7
    ENDLESS = 8


FAULT_BITS = 5
INSTRUCTION_BITS = 22
MAX_INSTRUCTIONS = 20_000

MAX_MESSAGE = 1 << 30  # largest message that is made, in bytes
EMPTY_ELEMENTS = 65_536  # elements without any bytes that a message may hold beyond its own length
DIRTY = 1 << 62
"""Set in a measured size where a valid message is not in its normal form: bools other than 0 and 1, strings without
their NUL."""


MAX_STEP = 1 << 30  # most bytes that one instruction moves for one element; times any count it still fits 64 bits
_MAX_COUNT = (1 << 32) - 1
_LOOPS = (Op.LOOP, Op.SKIP_LOOP, Op.REPEAT)


def verify(words: bytes, literals: bytes) -> None:
    """Refuse a program (flags, `WORDS` words for each instruction; its literals) that could leave its own memory.

    The virtual machine checks each access to a message's bytes; this is about all else that it indexes: the
    instructions, the loops' counters, the kept positions, the literals. Raises `ValueError`.
    """
    flags, *rest = memoryview(words).cast("q")
    steps = [rest[at : at + WORDS] for at in range(0, len(rest), WORDS)]
    whole = 0 < len(steps) <= 1 << INSTRUCTION_BITS and len(steps[-1]) == WORDS and steps[-1][0] == Op.END
    if not whole or not 0 <= flags <= SOURCE_CDR | TARGET_CDR:
        raise ValueError("the program has no flags, no end, or too many steps")
    loops: list[int] = []
    kept: list[set[int]] = [set()]  # slots that are surely filled, within each loop
    for number, step in enumerate(steps):
        if not _sound(step, last=number == len(steps) - 1, literals=len(literals)):
            raise ValueError(f"step {number} of the program has bad numbers: {step}")
        code, link = step[0], step[4]
        if code in _LOOPS:
            loops.append(number)
            kept.append(set())
        elif code == Op.NEXT:
            if not loops or link != loops[-1] + 1 or steps[loops.pop()][4] != number + 1:
                raise ValueError(f"step {number} of the program ends no loop")
            kept.pop()
        elif code == Op.MARK:
            kept[-1].add(link)
        elif code == Op.SEEK and not any(link in slots for slots in kept):
            raise ValueError(f"step {number} of the program seeks slot {link}, which may be empty")
        if len(loops) > FRAMES:
            raise ValueError(f"step {number} of the program is more than {FRAMES} loops deep")
    if loops:
        raise ValueError(f"the loop at step {loops[-1]} of the program does not end")


def _sound(step: Sequence[int], *, last: bool, literals: int) -> bool:
    """Whether an instruction's numbers are in their ranges."""
    code, mask, size, bound, link = step
    if mask not in (0, 1, 3, 7) or not 0 <= bound <= _MAX_COUNT or not -(code == Op.REPEAT) <= size <= MAX_STEP:
        return False
    match code:
        case Op.END:
            return last
        case Op.BOOLS:
            return size == 1
        case Op.MARK | Op.SEEK:
            return 0 <= link < SLOTS
        case Op.LITERAL:
            return 0 <= link <= literals - size
    return 0 <= code < Op.END
