"""The interface of docs/yarp/data.md, asked as a person would, and its octomap."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from yarp_compat.wire import binary
from yarp_compat.wire.profile import Profile

PAGE = Path(__file__).parents[2] / "docs" / "yarp" / "data.md"


def ran(number: int) -> dict[str, Any]:
    """What one of the page's examples leaves behind."""
    code = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[number]
    found: dict[str, Any] = {"__name__": "example"}
    exec(compile(code, str(PAGE), "exec", dont_inherit=True), found)
    return found


def test_the_octomap_is_read() -> None:
    found = ran(0)
    assert found["centers"].tolist() == [pytest.approx([0.05] * 3)]
    assert found["octomap"].search(0.05, 0.05, 0.05) == 1.5


def test_the_example_answers() -> None:
    found = ran(1)
    reply = found["server"].answer(binary.encode(["get_location_RPC", "kitchen"], Profile.YARP3), text=True)
    assert binary.decode(reply, Profile.YARP3) == ["ok", ["map", 1.0, 2.0, 90.0, ""]]
    reply = found["server"].answer(binary.encode(["get_location_RPC", "attic"], Profile.YARP3), text=True)
    assert binary.decode(reply, Profile.YARP3)[0] == "fail"
