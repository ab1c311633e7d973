"""The tests that `make test` runs on every side exist under the names by which it selects them."""

from __future__ import annotations

import ast
from pathlib import Path

from tests.contract.conftest import ANY_OS, BASIC, OF_ANY_VARIANT

FOLDER = Path(__file__).parent


def test_selected_tests_exist() -> None:
    files = {file.name: ast.parse(file.read_text(encoding="utf-8")) for file in FOLDER.glob("test_*.py")}
    tests = {part.name for tree in files.values() for part in tree.body if isinstance(part, ast.FunctionDef)}
    assert tests >= BASIC | ANY_OS
    assert files.keys() >= set(OF_ANY_VARIANT)
