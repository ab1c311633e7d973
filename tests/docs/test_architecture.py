"""Every path and name in ARCHITECTURE.md exists, and its ways are no longer than they are meant to be."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from scripts import house

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
WORDS = sorted(set(re.findall(r"`([^`\s<>]+)`", PAGE)))
PATHS = [word for word in WORDS if "/" in word and not word.startswith("/")]
NAMES = [word for word in WORDS if re.fullmatch(r"[A-Z]\w*(\.\w+)?", word)]


@pytest.mark.parametrize("path", PATHS)
def test_paths_exist(path: str) -> None:
    assert (ROOT / path).exists()


@pytest.fixture(scope="module")
def classes() -> dict[str, set[str]]:
    """The page's classes by name, each with its methods; only files that have one are parsed."""
    kinds = "|".join({name.partition(".")[0] for name in NAMES})
    found: dict[str, set[str]] = {}
    for package in house.PRODUCT:
        for path in (ROOT / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if not re.search(rf"^\s*class ({kinds})\b", text, re.MULTILINE):
                continue
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, ast.ClassDef):
                    methods = {part.name for part in node.body if isinstance(part, ast.FunctionDef)}
                    found[node.name] = found.get(node.name, set()) | methods
    return found


@pytest.mark.parametrize("name", NAMES)
def test_names_exist(name: str, classes: dict[str, set[str]]) -> None:
    kind, _, method = name.partition(".")
    assert kind in classes
    assert not method or method in classes[kind]


def test_functions_that_are_called_exist() -> None:
    assert "def pack_attachment" in (ROOT / "bridge/hub/wire/keys.py").read_text(encoding="utf-8")


def test_there_are_paths_and_names() -> None:
    assert len(PATHS) > 40
    assert len(NAMES) > 10


def test_a_scans_way_is_short() -> None:
    assert 0 < house.ways(ROOT)["The way of a message"] <= 9


def test_a_goals_way_is_short() -> None:
    assert 0 < house.ways(ROOT)["The way of a goal"] <= 14
