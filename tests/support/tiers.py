"""Classifies test files without importing them: whether their tests are fast, and which have the marker `alone`."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

MIDDLEWARE = (
    "bridge.hub.node", "bridge.hub.session", "bridge.interfaces.builder", "bridge.interfaces.cache", "multiprocessing",
    "rclpy", "rospy", "subprocess", "zenoh",
)  # fmt: skip
DRIVING = ("benchmarks.closedloop.drive", "tests.peers.navigation.scene")
"""Test files that import one of these or of `MIDDLEWARE`, directly or indirectly, are not fast."""

_FOLLOWED = {"benchmarks", "examples", "tests"}
"""Packages whose imports are followed; the product's imports are not."""

_IMPORT = re.compile(r"^\s*(?:from (\S+) import (\([^)]*\)|.*)|import (.*))", re.MULTILINE)


def is_fast(file: Path) -> bool:
    """Return whether a test file and its helpers use no middleware, no other process and no simulated drive."""
    seen: set[Path] = set()
    ahead = [file]
    while ahead:
        current = ahead.pop()
        if current in seen:
            continue
        seen.add(current)
        modules = imports(current)
        if any(f"{module}.".startswith(f"{name}.") for module in modules for name in (*MIDDLEWARE, *DRIVING)):
            return False
        ahead += [path for module in modules for path in _files(module)]
    return True


@functools.cache
def imports(file: Path) -> frozenset[str]:
    """Return the modules that a file imports anywhere; for ``from a import b``, both ``a`` and ``a.b``."""
    result: set[str] = set()
    for package, names, modules in _IMPORT.findall(file.read_text(encoding="utf-8")):
        listed = [entry.split()[0] for entry in re.sub(r"[()]|#.*", "", names or modules).split(",") if entry.split()]
        result |= {package, *(f"{package}.{name}" for name in listed)} if package else set(listed)
    return frozenset(result)


def _files(module: str) -> list[Path]:
    """Return the file of a module, if the module's imports are followed."""
    if module.partition(".")[0] not in _FOLLOWED:
        return []
    path = ROOT.joinpath(*module.split("."))
    return [file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()]


@functools.cache
def has_long_tests(file: Path) -> bool:
    """Return whether a file has tests with the marker `long`."""
    return "mark.long" in file.read_text(encoding="utf-8")


@functools.cache
def alone(file: Path) -> frozenset[str]:
    """Return the file's test functions with the marker `alone`, set by a decorator or for the whole file."""
    text = file.read_text(encoding="utf-8")
    if "mark.alone" not in text:
        return frozenset()
    tree = ast.parse(text)
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    marks = [ast.unparse(node) for node in tree.body if isinstance(node, ast.Assign)]
    if any(text.startswith("pytestmark") and "mark.alone" in text for text in marks):
        return frozenset(function.name for function in functions)
    return frozenset(f.name for f in functions if any("mark.alone" in ast.unparse(d) for d in f.decorator_list))
