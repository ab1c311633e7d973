"""Texts, configuration files and command lines as YARP 3.12.3 parsed and printed them.

A short program wrote `data/yarp-3.12.3.json` with YARP's `Bottle` and `Property`, from random input: texts with their
printed form and bytes, files and command lines with the resulting Property.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from yarp_compat.os.data.bottle import Bottle, Property
from yarp_compat.wire.profile import Profile

DATA: dict[str, list[Any]] = json.loads((Path(__file__).parents[1] / "data" / "yarp-3.12.3.json").read_text())


def test_bottles_are_parsed_and_printed_as_in_yarp() -> None:
    wrong = []
    for text, printed, wire in DATA["texts"]:
        bottle = Bottle(text)
        parsed = bottle.toString(), bottle.to_bytes(Profile.YARP3).hex()
        if parsed != (printed, wire) or (Bottle.from_bytes(bytes.fromhex(wire)) != bottle and "nan" not in printed):
            wrong.append((text, parsed, (printed, wire)))
    assert wrong == []
    assert len(DATA["texts"]) == 260


@pytest.mark.parametrize("kind", ["files", "commands"])
def test_files_and_commands_are_parsed_as_by_real_yarp(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("Y1V", "/val")
    wrong = []
    for given, printed in DATA[kind]:
        parsed = Property()
        if kind == "files":
            parsed.fromConfig(given)
        else:
            parsed.fromCommand(given)
        if parsed.toString() != printed:
            wrong.append((given, parsed.toString(), printed))
    assert wrong == []
    assert len(DATA[kind]) >= 40
