"""Converts damaged messages that end where readable memory ends, into room that ends where writable memory ends.

A read or a write one byte out of bounds kills this process. Prints how many messages were accepted and refused.
"""

from __future__ import annotations

import random
import sys

from bridge.messages.machine import run
from bridge.messages.ops import DIRTY
from bridge.messages.registry import Registry
from tests.messages.guarded import SIZE, TYPES, Guarded, programs

ROUNDS = 400


def damaged(good: bytes, dice: random.Random) -> bytes:
    """The message, cut short or with some words changed."""
    content = bytearray(good)
    for _ in range(dice.randint(0, 3)):
        if len(content) >= 4:
            at = dice.randrange(len(content) - 3)
            word = dice.choice([0, 1, 2, dice.randrange(64), dice.randrange(2**32), 2**32 - 1, 2**31])
            content[at : at + 4] = word.to_bytes(4, "little")
    return bytes(content[: dice.randint(0, len(content))] if dice.random() < 0.5 else content)


def main() -> None:
    dice = random.Random(int(sys.argv[1]))
    source, target = Guarded(), Guarded()
    registry = Registry()
    accepted = refused = 0
    for name in TYPES:
        for program, good in programs(registry, name):
            memory = program.assemble()
            for _ in range(ROUNDS):
                message = damaged(good, dice)
                size = run(memory.ctypes.data, source.put(message), len(message), 0)
                if size < 0:
                    refused += 1
                    continue
                accepted += 1
                size &= ~DIRTY
                if size <= SIZE:
                    written = run(memory.ctypes.data, source.put(message), len(message), target.end - size)
                    assert written & ~DIRTY == size
    print(accepted, refused)


main()
