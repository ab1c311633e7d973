"""The instruction set of conversion programs, and the check of a program before it runs.

One instruction is `WORDS` 64-bit words: code, mask, size, bound, link. ``mask`` is the alignment minus one, and applies
only if the message that is read or written is CDR. The other words are described at each instruction.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

WORDS = 5
FRAMES = 32  # maximum nesting depth of loops
SLOTS = 224  # maximum number of read positions that one program can store
SOURCE_CDR = 1
TARGET_CDR = 2


class Op(IntEnum):
    """Instructions. The first group reads and writes, the second only reads, the third only writes."""

    COPY = 0  #: ``size`` bytes as they are
    BOOL = 1  #: ``size`` bytes, each normalized to 0 or 1
    STRING = 2  #: a string of at most ``bound`` bytes (0: any)
    SEQUENCE = 3  #: a count of at most ``bound`` and as many elements of ``size`` bytes
    BOOLS = 4  #: a count of at most ``bound`` and as many bytes, each normalized to 0 or 1
    STRINGS = 5  #: a count of at most ``bound`` and as many strings of at most ``size`` bytes
    LOOP = 6
    """A count of at most ``bound``, then the body for each element, which has at least ``size`` bytes; ``link`` is the
    instruction after the loop."""

    SKIP = 7  #: ``size`` bytes
    SKIP_STRING = 8
    SKIP_SEQUENCE = 9  #: a count and as many elements of ``size`` bytes
    SKIP_LOOP = 10  #: like LOOP, but the count is not written
    REPEAT = 11  #: like LOOP with ``bound`` elements and no count; ``size`` is -1 if they read nothing
    NEXT = 12  #: end of a body that begins at ``link``
    MARK = 13  #: store the read position in slot ``link``
    SEEK = 14  #: continue reading at the position in slot ``link``

    ZERO = 15  #: ``size`` zero bytes
    LITERAL = 16  #: ``size`` bytes of the program's literals, from byte ``link`` on

    END = 17


class MessageFault(IntEnum):
    """Why a message was refused."""

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

MAX_MESSAGE = 1 << 30  # maximum size of a converted message, in bytes
EMPTY_ELEMENTS = 65_536  # a message may have at most this number of zero-size elements, plus its length in bytes
DIRTY = 1 << 62
"""Set in a measured size if a valid message is not in its normal form: it has bools other than 0 and 1, or empty
strings without their NUL."""


MAX_STEP = 1 << 30  # maximum bytes that an instruction moves for one element; times any count, this fits in 64 bits
_MAX_COUNT = (1 << 32) - 1
_LOOPS = (Op.LOOP, Op.SKIP_LOOP, Op.REPEAT)


def verify(words: bytes, literals: bytes) -> None:
    """Refuse a program (flags, `WORDS` words for each instruction; its literals) that could access other memory.

    The virtual machine checks each access to a message's bytes. This function checks all else that the machine indexes:
    the instructions, the loop counters, the stored read positions and the literals. Raises `ValueError`.
    """
    flags, *rest = memoryview(words).cast("q")
    steps = [rest[at : at + WORDS] for at in range(0, len(rest), WORDS)]
    whole = 0 < len(steps) <= 1 << INSTRUCTION_BITS and len(steps[-1]) == WORDS and steps[-1][0] == Op.END
    if not whole or not 0 <= flags <= SOURCE_CDR | TARGET_CDR:
        raise ValueError("the program has no flags, no end, or too many steps")
    loops: list[int] = []
    filled: list[set[int]] = [set()]  # slots that are certainly filled, by loop
    for number, step in enumerate(steps):
        if not _sound(step, last=number == len(steps) - 1, literals=len(literals)):
            raise ValueError(f"step {number} of the program has invalid numbers: {step}")
        code, link = step[0], step[4]
        if code in _LOOPS:
            loops.append(number)
            filled.append(set())
        elif code == Op.NEXT:
            if not loops or link != loops[-1] + 1 or steps[loops.pop()][4] != number + 1:
                raise ValueError(f"step {number} of the program ends no loop")
            filled.pop()
        elif code == Op.MARK:
            filled[-1].add(link)
        elif code == Op.SEEK and not any(link in slots for slots in filled):
            raise ValueError(f"step {number} of the program seeks slot {link}, which may be empty")
        if len(loops) > FRAMES:
            raise ValueError(f"step {number} of the program is more than {FRAMES} loops deep")
    if loops:
        raise ValueError(f"the loop at step {loops[-1]} of the program does not end")


def _sound(step: Sequence[int], *, last: bool, literals: int) -> bool:
    """Whether the words of an instruction are in their ranges."""
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
