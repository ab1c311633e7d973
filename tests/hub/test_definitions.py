"""Definitions of message types in the answers of workers."""

from __future__ import annotations

import pytest

from bridge.hub.control import WorkerAnswer
from bridge.hub.definitions import MAX_DEFINITION, definition_among


@pytest.mark.parametrize("definition", ["int32 a # \ud800\n", "#" * (MAX_DEFINITION + 1), 5])
def test_definitions_that_are_no_text_are_skipped(definition: object) -> None:
    answers = [
        WorkerAnswer("robot1", name, {"hash": "h", "definition": text})
        for name, text in (("ros1", definition), ("ros2", "int32 a\n"))
    ]
    assert definition_among(answers, "h") == "int32 a\n"
    assert definition_among(answers[:1]) is None
