"""The names that public scripts use, by the number of scripts that use them, and the names of the real bindings."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts.yarp_classes import BEGIN, PAGE, Bindings, absent, methods, section
from yarp_compat import check

USED = {
    name: int(count)
    for name, count in (
        line.split()
        for line in (Path(__file__).parent / "data" / "script_names.txt").read_text().splitlines()
        if not line.startswith("#")
    )
}
SCRIPTS = 164


def test_nearly_all_that_scripts_use_is_there() -> None:
    missing = {name: count for name, count in USED.items() if check.lacking(name)[0]}
    share = 1 - sum(missing.values()) / sum(USED.values())
    assert share >= 0.99, missing
    # each use that is missing may be in a script of its own
    assert SCRIPTS - sum(missing.values()) >= 155, missing


@pytest.fixture(scope="module")
def bindings() -> Bindings:
    return Bindings.read()


def test_the_page_says_what_of_the_bindings_is_there(bindings: Bindings) -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert section(bindings) in text[text.index(BEGIN) :], "run scripts/yarp_classes.py"


def test_of_all_that_is_missing_is_said_why(bindings: Bindings) -> None:
    silent = absent(bindings.classes).get("", []) + absent(bindings.functions | bindings.constants).get("", [])
    silent += [f"{name}.{method}" for name, said in methods(bindings).items() for method in said.get("", [])]
    assert silent == []
