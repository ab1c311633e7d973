"""The names that public scripts use, with the number of scripts, and the names of the real bindings."""

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


def test_nearly_all_names_used_by_scripts_exist() -> None:
    missing = {name: count for name, count in USED.items() if check.lacking(name)[0]}
    share = 1 - sum(missing.values()) / sum(USED.values())
    assert share >= 0.99, missing
    # in the worst case, each missing use is in a different script
    assert SCRIPTS - sum(missing.values()) >= 155, missing


@pytest.fixture(scope="module")
def bindings() -> Bindings:
    return Bindings.read()


def test_the_page_lists_the_names_of_the_bindings(bindings: Bindings) -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert section(bindings) in text[text.index(BEGIN) :], "run scripts/yarp_classes.py"


def test_every_missing_name_has_a_reason(bindings: Bindings) -> None:
    unexplained = absent(bindings.classes).get("", []) + absent(bindings.functions | bindings.constants).get("", [])
    unexplained += [f"{name}.{method}" for name, reasons in methods(bindings).items() for method in reasons.get("", [])]
    assert unexplained == []
