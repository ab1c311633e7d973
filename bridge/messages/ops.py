"""The small instruction set that message conversion runs on.

One instruction is `WORDS` 64-bit words: code, mask, size, bound, link. ``mask`` is alignment less one; it counts only
on the side that is CDR. What each word means to an instruction stands at the instruction.
"""

from __future__ import annotations

from enum import IntEnum

WORDS = 5
FRAMES = 32
"""How deep loops may nest."""

SLOTS = 224
"""How many read positions one program can keep."""

SOURCE_CDR = 1
TARGET_CDR = 2


class Op(IntEnum):
    """Instructions. The first group reads and writes, the second only reads, the third only writes."""

    COPY = 0
    """``size`` bytes as they are."""
    BOOL = 1
    """``size`` bytes, each made 0 or 1."""
    STRING = 2
    """A string of at most ``bound`` bytes (0: any)."""
    SEQUENCE = 3
    """A count of at most ``bound`` and as many elements of ``size`` bytes."""
    BOOLS = 4
    """A count of at most ``bound`` and as many bytes, each made 0 or 1."""
    STRINGS = 5
    """A count of at most ``bound`` and as many strings of at most ``size`` bytes."""
    LOOP = 6
    """A count of at most ``bound``, then the body; elements take at least ``size`` bytes; ``link`` is past the end."""

    SKIP = 7
    """``size`` bytes."""
    SKIP_STRING = 8
    SKIP_SEQUENCE = 9
    """A count and as many elements of ``size`` bytes."""
    SKIP_LOOP = 10
    """As LOOP."""
    REPEAT = 11
    """The body ``bound`` times; elements take at least ``size`` bytes (-1: they read nothing)."""
    NEXT = 12
    """End of a body that begins at ``link``."""
    MARK = 13
    """Remember the read position in slot ``link``."""
    SEEK = 14
    """Go on reading at slot ``link``."""

    ZERO = 15
    """``size`` zero bytes."""
    LITERAL = 16
    """``size`` bytes that stand in the program's memory at byte ``link``."""

    END = 17


class Fault(IntEnum):
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

MAX_MESSAGE = 1 << 30
"""Largest message that is made, in bytes."""

EMPTY_ELEMENTS = 65_536
"""Elements without any bytes that a message may hold beyond its own length."""

DIRTY = 1 << 62
"""Set in a measured size where a valid message is not in its normal form: bools other than 0 and 1, strings without
their NUL."""
