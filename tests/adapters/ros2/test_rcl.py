"""The ctypes declarations of the rcl functions."""

from __future__ import annotations

import re
from pathlib import Path

from bridge.adapters.ros2 import rcl


def test_all_functions_have_their_arguments_declared() -> None:
    """Without a declaration, ctypes passes a pointer as a 32-bit int, which crashes only at some addresses."""
    names = set(re.findall(r"_rcl\.(rcl_\w+)\(", Path(rcl.__file__).read_text(encoding="utf-8")))
    assert names
    assert [name for name in sorted(names) if not getattr(rcl._rcl, name).argtypes] == []
