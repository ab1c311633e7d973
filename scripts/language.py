"""Measure the language of code and docs: phrases that read as translated, and vague names.

A phrase counts in docstrings, comments, messages and Markdown, and in the comments of configurations, packaging,
JavaScript and C. It hints at a sentence to read again; some are good English, so a limit leaves room for them. A
function or an assignment counts if its name is on a list of words that do not say what they stand for.
`scripts/house.py --check` holds each top-level folder to the limits.
"""

from __future__ import annotations

import ast
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from typing_extensions import override

FOLDERS = ("bridge", "yarp_compat", "navigation", "sim", "tests", "benchmarks", "examples", "scripts")
PAGES, SETTINGS, FOREIGN = "docs", "configs", "JavaScript and C"
"""Labels of the figures: of all Markdown, of comments in `_SETTINGS`, of comments and messages in `_FOREIGN`."""

_SETTINGS = ("configs/**/*.yaml", "configs/**/*.rviz", "packaging/**/*", "pyproject.toml")
_FOREIGN = ("bridge/**/*.js", "bridge/**/*.c")

PHRASES_PER_1000, VAGUE_PERCENT = 4.0, 1.0
FEW_WORDS, FEW_NAMES = 1000, 300
"""Minimum size; the limits do not apply to smaller folders, in which a single phrase or name would exceed them."""

PHRASES = {
    name: re.compile(pattern, re.MULTILINE | re.IGNORECASE)
    for name, pattern in tomllib.loads(Path(__file__).with_name("phrases.toml").read_text(encoding="utf-8")).items()
}

VAGUE_FUNCTION = re.compile(
    "_*(at|came|come|forget|found|go_on|gone|hear|heard|leave|let_go|look|made|of|own|put|rest|said|say|stands|take|tell|told)"
)
VAGUE_VARIABLE = re.compile(
    "_*(asked|came|each|found|gone|heard|here|made|one|own|rest|said|there|told|two|ways?|what|who|why|wish|words?)"
)

_CODE = re.compile(r"```.*?```|`[^`]*`", re.DOTALL)
_DIRECTIVE = re.compile(r"#\s*(noqa|type:|fmt:|ruff|mypy|pragma)")
_STRING_OR_COMMENT = re.compile(
    r"""#[^\n]*|\"{3}(?:\\.|[^\\])*?\"{3}|'{3}(?:\\.|[^\\])*?'{3}|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*'""", re.DOTALL
)
"""Matches the comments of a valid file; it matches strings too, to skip a number sign in them."""

_FOREIGN_TEXT = re.compile(r'"(?:\\.|[^"\\\n])*"|/\*.*?\*/|//[^\n]*', re.DOTALL)
"""Matches strings and comments; not template literals, whose expressions contain names such as those of imports."""

_WORD = re.compile(r"[A-Za-z']+")


@dataclass
class Count:
    """The words and names of some files, and the phrases and vague names among them."""

    words: int = 0
    phrases: Counter[str] = field(default_factory=Counter)
    functions: int = 0
    vague_functions: int = 0
    variables: int = 0
    vague_variables: int = 0

    def __iadd__(self, other: Count) -> Self:
        self.words += other.words
        self.phrases += other.phrases
        self.functions += other.functions
        self.vague_functions += other.vague_functions
        self.variables += other.variables
        self.vague_variables += other.vague_variables
        return self

    @property
    def per_1000(self) -> float:
        """Phrases per 1,000 words."""
        return 1000 * self.phrases.total() / max(self.words, 1)

    def over(self) -> list[str]:
        """Return the limits that are exceeded, each with its figure."""
        exceeded = []
        if self.words >= FEW_WORDS and self.per_1000 > PHRASES_PER_1000:
            exceeded.append(f"{self.per_1000:.1f} phrases per 1,000 words, at most {PHRASES_PER_1000:.0f}")
        for kind, vague, count in (
            ("functions", self.vague_functions, self.functions),
            ("assignments", self.vague_variables, self.variables),
        ):
            if count >= FEW_NAMES and 100 * vague / count > VAGUE_PERCENT:
                exceeded.append(f"{100 * vague / count:.1f} % of {kind} with a vague name, at most {VAGUE_PERCENT:.0f}")
        return exceeded

    @override
    def __str__(self) -> str:
        functions = 100 * self.vague_functions / max(self.functions, 1)
        variables = 100 * self.vague_variables / max(self.variables, 1)
        names = f"functions {functions:.1f} %, assignments {variables:.1f} %"
        return f"{self.per_1000:4.1f} phrases per 1,000 words; vague names: {names}"


def of_texts(texts: Iterable[str]) -> Count:
    """Count the words and phrases of texts."""
    count = Count()
    for text in texts:
        count.words += len(_WORD.findall(text))
        for name, pattern in PHRASES.items():
            count.phrases[name] += len(pattern.findall(text))
    return count


def of_source(source: str) -> Count:
    """Count the prose and the names of a Python file."""
    return of_tree(source, ast.parse(source))


def of_tree(source: str, tree: ast.Module) -> Count:
    """Count the prose and the names of a parsed Python file."""
    nodes = list(walk(tree))
    count = of_texts([*_strings(nodes), *_comments(source)])
    for node in nodes:
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            count.functions += 1
            count.vague_functions += VAGUE_FUNCTION.fullmatch(node.name) is not None
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            count.variables += 1
            count.vague_variables += VAGUE_VARIABLE.fullmatch(node.id) is not None
    return count


def walk(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield all nodes like `ast.walk`, in another order and in a third of the time."""
    stack = [tree]
    while stack:
        node = stack.pop()
        yield node
        for name in node._fields:
            value = getattr(node, name, None)
            if isinstance(value, list):
                stack += [item for item in value if isinstance(item, ast.AST)]
            elif isinstance(value, ast.AST):
                stack.append(value)


def _strings(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Yield docstrings, and strings of several words."""
    alone = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    for node in nodes:
        if not isinstance(node, ast.Constant) or not isinstance(node.value, str):
            continue
        if id(node) in alone or _is_text(node.value):
            yield node.value


def _is_text(string: str) -> bool:
    return " " in string and len(string) > 15


def _comments(source: str) -> Iterator[str]:
    for text in _STRING_OR_COMMENT.findall(source):
        if text.startswith("#") and not _DIRECTIVE.match(text):
            yield text


def _files(root: Path, folder: str) -> dict[Path, Count]:
    """Count each file of a folder, except this one, which lists the phrases."""
    if folder == PAGES:
        pages = _matching(root, ("*.md", *(f"{place}/**/*.md" for place in (PAGES, "packaging", *FOLDERS))))
        return {page: of_texts([_CODE.sub(" ", text)]) for page, text in pages.items()}
    if folder == SETTINGS:
        return {path: of_texts(_comments(text)) for path, text in _matching(root, _SETTINGS).items()}
    if folder == FOREIGN:
        return {path: of_texts(_foreign(text)) for path, text in _matching(root, _FOREIGN).items()}
    sources = sorted(path for path in (root / folder).rglob("*.py") if path.name != Path(__file__).name)
    return {source: of_source(source.read_text(encoding="utf-8")) for source in sources}


def _matching(root: Path, patterns: Iterable[str]) -> dict[Path, str]:
    """Return the text of each file that matches a pattern."""
    paths = sorted(path for pattern in patterns for path in root.glob(pattern) if path.is_file())
    return {path: path.read_text(encoding="utf-8") for path in paths}


def _foreign(source: str) -> Iterator[str]:
    """Yield the comments of a JavaScript or C file, and its strings of several words."""
    for text in _FOREIGN_TEXT.findall(source):
        if text.startswith("/") or _is_text(text):
            yield text


def measure(root: Path) -> dict[str, dict[Path, Count]]:
    """Count each file of each top-level folder, the Markdown pages, and the comments of other files."""
    return {folder: _files(root, folder) for folder in (*FOLDERS, PAGES, SETTINGS, FOREIGN)}


def total(counts: Iterable[Count]) -> Count:
    """Return the sum of the counts."""
    result = Count()
    for count in counts:
        result += count
    return result


def wrong(measured: dict[str, dict[Path, Count]], root: Path) -> list[str]:
    """Return the folders above a limit, each with the files that have the most phrases and vague names."""
    lines = []
    for folder, files in measured.items():
        for excess in total(files.values()).over():
            worst = sorted(files, key=lambda path: -_weight(files[path]))[:5]
            names = ", ".join(str(path.relative_to(root)) for path in worst)
            lines.append(f"{folder}: {excess}; edit the sentences or names, first in {names}")
    return lines


def _weight(count: Count) -> int:
    return count.phrases.total() + count.vague_functions + count.vague_variables
