"""Texts, configuration files and command lines as a real YARP 3.12.3 understood and printed them.

`data/yarp-3.12.3.json` was written by a program of a few lines over its `Bottle` and `Property`, with random input:
texts with what they printed as and their bytes, files and command lines with the Property that came of them.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from yarp_compat.os.data.bottle import Bottle, Property
from yarp_compat.wire.profile import Profile

DATA: dict[str, list[Any]] = json.loads((Path(__file__).parents[1] / "data" / "yarp-3.12.3.json").read_text())


def test_texts() -> None:
    wrong = []
    for text, printed, wire in DATA["texts"]:
        bottle = Bottle(text)
        found = bottle.toString(), bottle.to_bytes(Profile.YARP3).hex()
        if found != (printed, wire) or (Bottle.from_bytes(bytes.fromhex(wire)) != bottle and "nan" not in printed):
            wrong.append((text, found, (printed, wire)))
    assert wrong == []
    assert len(DATA["texts"]) == 260


@pytest.mark.parametrize("kind", ["files", "commands"])
def test_files_and_commands(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("Y1V", "/val")
    wrong = []
    for given, printed in DATA[kind]:
        found = Property()
        if kind == "files":
            found.fromConfig(given)
        else:
            found.fromCommand(given)
        if found.toString() != printed:
            wrong.append((given, found.toString(), printed))
    assert wrong == []
    assert len(DATA[kind]) >= 40
