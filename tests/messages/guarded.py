"""Memory that ends where nobody may read or write, and the conversion programs to be run on it."""

from __future__ import annotations

import ctypes
import mmap

from bridge.messages.compiler import compile_check, compile_pair
from bridge.messages.json import from_json
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


class Guarded:
    """Memory with a page before and a page behind it that nobody may touch."""

    def __init__(self) -> None:
        self._map = mmap.mmap(-1, SIZE + 2 * mmap.PAGESIZE)
        self.start = ctypes.addressof(ctypes.c_char.from_buffer(self._map)) + mmap.PAGESIZE
        self.end = self.start + SIZE
        libc = ctypes.CDLL(None, use_errno=True)
        for page in (self.start - mmap.PAGESIZE, self.end):
            assert libc.mprotect(ctypes.c_void_p(page), mmap.PAGESIZE, 0) == 0

    def put(self, content: bytes) -> int:
        """Place bytes right before the end; their address."""
        ctypes.memmove(self.end - len(content), content, len(content))
        return self.end - len(content)

    def put_first(self, content: bytes) -> int:
        """Place bytes right behind the beginning; their address."""
        ctypes.memmove(self.start, content, len(content))
        return self.start


def programs(registry: Registry, name: str) -> list[tuple[Program, bytes]]:
    """The three programs of a type, each with a good message."""
    rules = Rules()
    ros2 = registry.schema(name)
    back = registry.hub_to_ros1(name)
    ros1 = registry._messages.find_ros1(back.target.name, back.target.type_id)
    table = pair_types(ros1, ros2, rules)
    cdr = from_json(registry, name, sample(ros2))
    assert back.convert is not None
    return [
        (compile_check(ros2), cdr),
        (compile_pair(ros2, ros1, lambda a, b: [(two, one) for one, two in table[b, a].fields]), cdr),
        (compile_pair(ros1, ros2, lambda a, b: table[a, b].fields), back.convert(cdr)),
    ]
