"""What a test file says of its tests, without importing it: whether they are fast, and which run alone."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

MIDDLEWARE = (
    "bridge.hub.session", "bridge.interfaces.builder", "bridge.interfaces.cache", "multiprocessing", "rclpy", "rospy",
    "subprocess", "zenoh",
)  # fmt: skip
DRIVING = ("benchmarks.closedloop.drive", "tests.navigation.robot_goto.scene")
"""Who imports one of these, by itself or by another file of the tests, is not fast: programs, and robots that drive."""

_FOLLOWED = {"benchmarks", "examples", "tests"}
"""Packages whose files tests use; what the product imports is not looked into."""

_IMPORT = re.compile(r"^\s*(?:from (\S+) import (\([^)]*\)|.*)|import (.*))", re.MULTILINE)


def is_fast(file: Path) -> bool:
    """Whether a test file has nothing to do with a middleware or another process, its helpers included."""
    seen: set[Path] = set()
    ahead = [file]
    while ahead:
        here = ahead.pop()
        if here in seen:
            continue
        seen.add(here)
        modules = imports(here)
        if any(f"{module}.".startswith(f"{name}.") for module in modules for name in (*MIDDLEWARE, *DRIVING)):
            return False
        ahead += [path for module in modules for path in _files(module)]
    return True


@functools.cache
def imports(file: Path) -> frozenset[str]:
    """Modules that a file imports anywhere; of ``from a import b`` both ``a`` and ``a.b``, which may be one."""
    found: set[str] = set()
    for package, names, modules in _IMPORT.findall(file.read_text(encoding="utf-8")):
        listed = [words.split()[0] for words in re.sub(r"[()]|#.*", "", names or modules).split(",") if words.split()]
        found |= {package, *(f"{package}.{name}" for name in listed)} if package else set(listed)
    return frozenset(found)


def _files(module: str) -> list[Path]:
    """The file of a module that is followed."""
    if module.partition(".")[0] not in _FOLLOWED:
        return []
    path = ROOT.joinpath(*module.split("."))
    return [file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()]


@functools.cache
def alone(file: Path) -> frozenset[str]:
    """Names of the file's test functions with the marker `alone`, by decorator or for the whole file."""
    text = file.read_text(encoding="utf-8")
    if "mark.alone" not in text:
        return frozenset()
    tree = ast.parse(text)
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    marks = [ast.unparse(node) for node in tree.body if isinstance(node, ast.Assign)]
    if any(text.startswith("pytestmark") and "mark.alone" in text for text in marks):
        return frozenset(function.name for function in functions)
    return frozenset(f.name for f in functions if any("mark.alone" in ast.unparse(d) for d in f.decorator_list))
