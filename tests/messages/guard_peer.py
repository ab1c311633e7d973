"""Converts damaged messages that end where readable memory ends, into room that ends where writable memory ends.

A read or a write one byte out of bounds kills this process. Prints how many messages were accepted and refused.
"""

from __future__ import annotations

import ctypes
import mmap
import random
import sys

from bridge.messages.compiler import compile_check, compile_pair
from bridge.messages.json import from_json
from bridge.messages.machine import run
from bridge.messages.ops import DIRTY
from bridge.messages.pairing import pair_types
from bridge.messages.program import Program
from bridge.messages.registry import Registry
from bridge.messages.rules import Rules
from tests.messages.samples import sample

TYPES = [
    "tf2_msgs/msg/TFMessage",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/JointState",
    "diagnostic_msgs/msg/DiagnosticArray",
    "visualization_msgs/msg/MarkerArray",
    "rcl_interfaces/msg/Log",
    "rcl_interfaces/msg/ParameterEvent",
    "std_msgs/msg/Bool",
]
SIZE = 1 << 20
ROUNDS = 400


class Guarded:
    """Memory with a page behind it that nobody may touch."""

    def __init__(self) -> None:
        self._map = mmap.mmap(-1, SIZE + mmap.PAGESIZE)
        self._start = ctypes.addressof(ctypes.c_char.from_buffer(self._map))
        self.end = self._start + SIZE
        libc = ctypes.CDLL(None, use_errno=True)
        assert libc.mprotect(ctypes.c_void_p(self.end), mmap.PAGESIZE, 0) == 0

    def put(self, content: bytes) -> int:
        """Place bytes right before the end; their address."""
        ctypes.memmove(self.end - len(content), content, len(content))
        return self.end - len(content)


def programs(registry: Registry, name: str) -> list[tuple[Program, bytes]]:
    """The three programs of a type, each with a good message."""
    rules = Rules()
    ros2 = registry.schema(name)
    back = registry.hub_to_ros1(name)
    ros1 = registry._find_ros1(back.target.name, back.target.type_id)
    table = pair_types(ros1, ros2, rules)
    cdr = from_json(registry, name, sample(ros2))
    assert back.convert is not None
    return [
        (compile_check(ros2), cdr),
        (compile_pair(ros2, ros1, lambda a, b: [(two, one) for one, two in table[b, a].fields]), cdr),
        (compile_pair(ros1, ros2, lambda a, b: table[a, b].fields), back.convert(cdr)),
    ]


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
