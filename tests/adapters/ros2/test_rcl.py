"""The functions of rcl and Fast DDS that are called through ctypes."""

from __future__ import annotations

import re
from pathlib import Path

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.graph.origins import ALL_NUMBERS
from bridge.messages.registry import Registry
from tests.adapters.ros2.conftest import RunningEdge


def test_all_functions_have_their_arguments_declared() -> None:
    """Without a declaration, ctypes passes a pointer as a 32-bit int, which crashes only at some addresses."""
    names = set(re.findall(r"_rcl\.(rcl_\w+)\(", Path(rcl.__file__).read_text(encoding="utf-8")))
    assert names
    assert [name for name in sorted(names) if not getattr(rcl._rcl, name).argtypes] == []


def test_the_hosts_prefix_takes_no_number_of_a_participant(registry: Registry, tmp_path: Path) -> None:
    """Otherwise a process that refreshes its neighbors often could not create its participant again."""
    for _ in range(ALL_NUMBERS):
        rcl.host_prefix()
    running = RunningEdge(registry, tmp_path)
    network = running.edge.network()
    running.edge.stop()
    assert network
