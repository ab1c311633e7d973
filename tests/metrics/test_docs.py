"""The documentation page lists every metric family."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.metrics.families import FAMILIES, Family

PAGE = (Path(__file__).parents[2] / "docs" / "operate" / "metrics.md").read_text(encoding="utf-8")
_ROUTE = ("side", "direction", "kind", "topic", "type")


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
def test_the_page_documents_each_family(family: Family) -> None:
    of_route = family.labels[:5] == _ROUTE
    labels = [*(["route labels"] if of_route else []), *(f"`{name}`" for name in family.labels[5 if of_route else 0 :])]
    assert f"| `{family.name}` | {family.kind} | {', '.join(labels)} | {family.help} |" in PAGE


def test_the_page_documents_no_other_family() -> None:
    rows = [line for line in PAGE.splitlines() if line.startswith("| `midspan_")]
    assert len(rows) == len(FAMILIES)


def test_counter_names_end_in_total() -> None:
    for family in FAMILIES:
        assert family.name.endswith("_total") == (family.kind == "counter"), family.name
