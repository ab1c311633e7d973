"""The examples of docs/yarp/values.md, and its table of texts."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from yarp_compat.wire.text import from_text

PAGE = (Path(__file__).parents[2] / "docs" / "yarp" / "values.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("code", EXAMPLES, ids=range(len(EXAMPLES)))
def test_the_examples_assertions_pass(code: str) -> None:
    assert re.search("^assert ", code, re.MULTILINE), "an example contains assertions"
    exec(compile(code, "docs/yarp/values.md", "exec", dont_inherit=True), {"__name__": "example"})


def test_the_documented_surprising_texts_are_parsed_as_described() -> None:
    """The table's descriptions are correct."""
    rows = re.findall(r"^\| (`.*?`) \|", PAGE.split("## Text")[1].split("Printed")[0], re.MULTILINE)
    parsed = [from_text(text) for row in rows for text in re.findall(r"`([^`]*)`", row)]
    assert parsed == [
        ["hello", "world"], ["1.2.3"], ["1_000"], ["+inf"], [0], [1], [2026], [8], [0.0], [9223372036854775807], [31],
        [False, "b]"], ["'x", "y'"], [], ["abc def"], ["a\nb"],
    ]  # fmt: skip
