"""The examples of docs/yarp/data.md: the octomap, and the interface, whose server answers encoded requests."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from yarp_compat.wire import binary
from yarp_compat.wire.profile import Profile

PAGE = Path(__file__).parents[2] / "docs" / "yarp" / "data.md"


def run_example(number: int) -> dict[str, Any]:
    """Run one of the page's examples, and return its variables."""
    code = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[number]
    namespace: dict[str, Any] = {"__name__": "example"}
    exec(compile(code, str(PAGE), "exec", dont_inherit=True), namespace)
    return namespace


def test_the_octomap_is_read() -> None:
    namespace = run_example(0)
    assert namespace["centers"].tolist() == [pytest.approx([0.05] * 3)]
    assert namespace["octomap"].search(0.05, 0.05, 0.05) == 1.5


def test_the_example_interface_replies() -> None:
    namespace = run_example(1)
    reply = namespace["server"].answer(binary.encode(["get_location_RPC", "kitchen"], Profile.YARP3), text=True)
    assert binary.decode(reply, Profile.YARP3) == ["ok", ["map", 1.0, 2.0, 90.0, ""]]
    reply = namespace["server"].answer(binary.encode(["get_location_RPC", "attic"], Profile.YARP3), text=True)
    assert binary.decode(reply, Profile.YARP3)[0] == "fail"
