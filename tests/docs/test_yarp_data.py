"""The interface of docs/yarp/data.md, asked as a person would."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from yarp_compat.wire import binary
from yarp_compat.wire.profile import Profile

PAGE = Path(__file__).parents[2] / "docs" / "yarp" / "data.md"


def test_the_example_answers() -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    found: dict[str, Any] = {"__name__": "example"}
    exec(compile(code, str(PAGE), "exec", dont_inherit=True), found)
    reply = found["server"].answer(binary.encode(["get_location_RPC", "kitchen"], Profile.YARP3), text=True)
    assert binary.decode(reply, Profile.YARP3) == ["ok", ["map", 1.0, 2.0, 90.0, ""]]
    reply = found["server"].answer(binary.encode(["get_location_RPC", "attic"], Profile.YARP3), text=True)
    assert binary.decode(reply, Profile.YARP3)[0] == "fail"
