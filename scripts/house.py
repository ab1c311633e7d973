"""Measure the code: files, lines, import cycles, classes with the same name, files on the path of a message, language.

    python scripts/house.py            prints the figures
    python scripts/house.py --check    also prints the violations and fails if there are any: import cycles, large
                                       files, public methods and functions without a docstring, tests without an
                                       assertion, too many phrases and vague names of `scripts/language.py`

In tests, the script counts accesses to private attributes, and lists the tests that neither assert nor call a helper
whose name implies an assertion.

The figures cover the product (`bridge`, `yarp_compat`, `navigation`, `sim`), those for language all folders and the
docs. Imports inside functions and under ``TYPE_CHECKING`` count too, because they hide a cycle without removing it.
"""

from __future__ import annotations

import argparse
import ast
import functools
import gc
import re
import statistics
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from pathlib import Path

from scripts import language

ROOT = Path(__file__).resolve().parents[1]
PRODUCT = ("bridge", "yarp_compat", "navigation", "sim")
SMALL, LARGE = 60, 500
KNOWN_LARGE = {"bridge.tf.history", "navigation.algorithms.voxel_map"}
"""Kernels of one class each, because Cython does not inline functions across files."""

_NAMEDTUPLE = {"_replace", "_asdict", "_fields", "_make", "_field_defaults"}
_ASSERTS = re.compile(r"(^|_)(assert|expect|until|check|raises|fail|warns)(_|$)")
_FUNCTION = (ast.FunctionDef, ast.AsyncFunctionDef)

Graph = Mapping[str, set[str]]


@dataclass(frozen=True)
class File:
    """One module: its dotted name, its lines, and its syntax tree."""

    name: str
    path: Path
    lines: int
    tree: ast.Module


@functools.cache
def read(root: Path) -> dict[str, File]:
    """Return the product's modules by dotted name; a package has the name of its folder."""
    files = {}
    for path in sorted(path for part in PRODUCT for path in (root / part).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        name = ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")
        files[name] = File(name, path, text.count("\n"), ast.parse(text))
    return files


def imports(files: Mapping[str, File]) -> Graph:
    """Return which module imports which. ``from package import name`` imports the module that defines the name."""
    return {name: {to for to in _imports(file, files) if to != name} for name, file in files.items()}


def _imports(file: File, files: Mapping[str, File]) -> Iterable[str]:
    for node in language.walk(file.tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in files)
        elif isinstance(node, ast.ImportFrom) and node.module in files:
            yield from (_defines(str(node.module), alias.name, files) for alias in node.names)


def _defines(module: str, name: str, files: Mapping[str, File]) -> str:
    """Resolve a name through the re-exports of packages."""
    if f"{module}.{name}" in files:
        return f"{module}.{name}"
    if files[module].path.name != "__init__.py":
        return module
    for node in files[module].tree.body:
        if isinstance(node, ast.ImportFrom) and node.module in files:
            for alias in node.names:
                if (alias.asname or alias.name) == name:
                    return _defines(str(node.module), alias.name, files)
    return module


def cycles(graph: Graph) -> list[list[str]]:
    """Return the groups of nodes that reach each other (Tarjan's strongly connected components of two and more)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    groups: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for to in graph.get(node, ()):
            if to not in index:
                visit(to)
                low[node] = min(low[node], low[to])
            elif to in stack:
                low[node] = min(low[node], index[to])
        if low[node] == index[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                groups.append(sorted(group))

    sys.setrecursionlimit(max(sys.getrecursionlimit(), 10_000))
    for node in graph:
        if node not in index:
            visit(node)
    return sorted(groups)


def packages(files: Mapping[str, File], graph: Graph) -> Graph:
    """Return imports among packages of the second level (``bridge.hub``); a file on that level counts as a package."""

    def package(name: str) -> str:
        short = ".".join(name.split(".")[:2])
        return short if files[short].path.name == "__init__.py" else name

    graph_of_packages = defaultdict[str, set[str]](set)
    for name, others in graph.items():
        graph_of_packages[package(name)] |= {package(to) for to in others} - {package(name)}
    return graph_of_packages


def package_cycles(files: Mapping[str, File], graph: Graph) -> list[list[str]]:
    """Return the cycles that include a package; `cycles` reports the cycles among files."""
    return [
        group
        for group in cycles(packages(files, graph))
        if any(len(n.split(".")) == 2 and files[n].path.name == "__init__.py" for n in group)
    ]


def shared_classes(files: Mapping[str, File]) -> dict[str, list[str]]:
    """Return the names of public top-level classes that several files define, with these files."""
    modules = defaultdict[str, list[str]](list)
    for name, file in files.items():
        for node in file.tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                modules[node.name].append(name)
    return {name: places for name, places in sorted(modules.items()) if len(places) > 1}


def undocumented(file: File) -> list[str]:
    """Return the public methods and functions without a docstring (D102, D103).

    None is required if the name suffices: for `override` methods, properties, methods named close, open, start,
    stop or clear, and the functions that register and run a verb.
    """
    if re.search("^# ruff: noqa:.*D102", file.path.read_text(encoding="utf-8"), re.MULTILINE):
        return []
    functions = [("", node) for node in file.tree.body if isinstance(node, _FUNCTION)]
    return [
        f"{file.path}:{node.lineno}: {name}{node.name} needs a docstring"
        for name, node in (*functions, *_methods(file.tree.body))
        if not re.match("_|(close|open|start|stop|clear)$" if name else "_|(register|run)(_|$)", node.name)
        and not any(
            re.search("override|overload|setter|property", ast.unparse(decorator)) for decorator in node.decorator_list
        )
        and ast.get_docstring(node) is None
    ]


def _methods(body: Iterable[ast.stmt]) -> Iterable[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Yield the methods of public classes, each with the name of its class and a dot."""
    for part in body:
        if isinstance(part, ast.ClassDef) and not part.name.startswith("_"):
            yield from ((f"{part.name}.", node) for node in part.body if isinstance(node, _FUNCTION))
            yield from _methods(part.body)


def private_accesses(root: Path) -> int:
    """Count the tests' accesses to names with a leading underscore, except on ``self``."""
    return sum(_is_private(node) for _, tree in _tests(root) for node in language.walk(tree))


def _is_private(node: ast.AST) -> bool:
    if isinstance(node, ast.ImportFrom):
        return any(re.match("_[^_]", alias.name) for alias in node.names)
    if not isinstance(node, ast.Attribute) or not re.match("_[^_]", node.attr) or node.attr in _NAMEDTUPLE:
        return False
    return ast.unparse(node.value) not in ("self", "cls", "super()")


def assertless(root: Path) -> list[str]:
    """Return the tests that cannot fail: without an assert, and without a call whose name implies one."""
    return [
        f"{path.relative_to(root)}:{test.lineno} {test.name}"
        for path, tree in _tests(root)
        for test in [*tree.body, *(node for part in tree.body if isinstance(part, ast.ClassDef) for node in part.body)]
        if isinstance(test, ast.FunctionDef) and test.name.startswith("test_") and not _can_fail(test)
    ]


def _can_fail(test: ast.FunctionDef) -> bool:
    return any(map(_asserts, language.walk(test)))


def _asserts(node: ast.AST) -> bool:
    if isinstance(node, ast.Call):
        called = node.func
        name = called.attr if isinstance(called, ast.Attribute) else called.id if isinstance(called, ast.Name) else ""
        return _ASSERTS.search(name) is not None
    return isinstance(node, ast.Assert)


@functools.cache
def _tests(root: Path) -> list[tuple[Path, ast.Module]]:
    return [(path, ast.parse(path.read_text(encoding="utf-8"))) for path in sorted((root / "tests").rglob("*.py"))]


def described_paths(root: Path) -> dict[str, int]:
    """Return the paths that ARCHITECTURE.md describes, each with its number of files."""
    paths = dict[str, int]()
    page = root / "ARCHITECTURE.md"
    content = page.read_text(encoding="utf-8")
    for title, text in re.findall(r"^## (The path of [^\n]*)\n((?:(?!^## ).*\n?)*)", content, re.MULTILINE):
        paths[title] = len(set(re.findall(r"^\| *\d+ *\| *`([\w/]+\.py)`", text, re.MULTILINE)))
    return paths


def report(files: Mapping[str, File]) -> None:
    """Print the figures."""
    graph = imports(files)
    lines = [file.lines for file in files.values()]
    shared = shared_classes(files)
    print(f"product files            {len(lines)}")
    print(f"product lines            {sum(lines)}")
    print(f"median lines             {statistics.median(lines):.0f}")
    print(f"files under {SMALL} lines     {sum(count < SMALL for count in lines)}")
    print(f"files over {LARGE} lines     {sum(count > LARGE for count in lines)}")
    print(f"cycles among files      {len(cycles(graph))}")
    print(f"cycles among packages   {len(package_cycles(files, graph))}")
    print(f"classes that share names {len(shared)}")
    for name, places in sorted(shared.items(), key=lambda item: -len(item[1]))[:20]:
        print(f"    {name}: {', '.join(places)}")
    for title, count in described_paths(ROOT).items():
        print(f"{title}: {count} files")
    print(f"tests: private accesses  {private_accesses(ROOT)}")
    print(f"tests without an assert  {len(assertless(ROOT))}")
    for folder, counts in language.measure(ROOT).items():
        print(f"{folder:24} {language.total(counts.values())}")


def wrong(files: Mapping[str, File], known_large: AbstractSet[str] = KNOWN_LARGE) -> list[str]:
    """Return all violations of the limits."""
    graph = imports(files)
    violations = [f"cycle among files: {' '.join(group)}" for group in cycles(graph)]
    violations += [f"cycle among packages: {' '.join(group)}" for group in package_cycles(files, graph)]
    large = {file.name: file for file in files.values() if file.lines > LARGE}
    violations += [f"{f.path}: {f.lines} lines, at most {LARGE}" for f in large.values() if f.name not in known_large]
    violations += [
        f"{name} is not a large file; remove it from KNOWN_LARGE" for name in sorted(known_large - large.keys())
    ]
    return violations + [method for file in files.values() for method in undocumented(file)]


def main() -> int:
    """Print the figures; with ``--check``, also the violations."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--check", action="store_true", help="fail if there is a violation")
    check = parser.parse_args().check
    gc.disable()  # the collector would visit millions of nodes of syntax trees, again and again
    files = read(ROOT)
    report(files)
    if not check:
        return 0
    violations = wrong(files) + [f"{test} asserts nothing" for test in assertless(ROOT)]
    violations += language.wrong(language.measure(ROOT), ROOT)
    print("\n".join(violations), end="\n" if violations else "")
    return 1 if violations else 0


if __name__ == "__main__":
    raise SystemExit(main())
