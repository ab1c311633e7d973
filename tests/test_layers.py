"""Imports point one way, as the design's layout says."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BELOW = {
    "config": set[str](),
    "messages": set[str](),
    "interfaces": {"config", "messages"},
    "hub": {"config", "messages", "worker"},
    "routing": {"config", "messages", "hub", "adapters.base"},
    "adapters": {"config", "messages", "interfaces", "hub", "routing", "worker"},
    "daemon": {"config", "messages", "interfaces", "hub", "routing", "adapters", "worker"},
}
"""What each part of ``bridge`` may import beside itself; the command line, the doctor and the demo may import all."""


def imported(file: Path) -> set[str]:
    names = set[str]()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module)
        elif isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
    return {name.removeprefix("bridge.") for name in names if name.startswith("bridge.")}


@pytest.mark.parametrize("part", BELOW)
def test_imports_point_one_way(part: str) -> None:
    allowed = {part, *BELOW[part]}
    wrong = {
        f"{file.relative_to(ROOT)} imports bridge.{name}"
        for file in (ROOT / "bridge" / part).rglob("*.py")
        for name in imported(file)
        if not any(name == good or name.startswith(good + ".") for good in allowed)
    }
    assert not wrong
