"""Reads a YAML file as plain data, with the line and column of each key and value.

Only JSON's kinds of data are accepted: maps with text keys, lists, text, numbers, true, false and null (YAML 1.2, so
``yes`` and dates are text). Tags of other kinds, merge keys, a second document and a key given twice are refused; size
and depth are bounded.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from typing_extensions import override
from yaml.constructor import ConstructorError
from yaml.events import AliasEvent
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake in a file.

    Line and column count from 1; line 0 means that the problem has no place in the file. ``key`` is a path such as
    ``routing.rules[2].topic``, "" for the whole file; ``text`` has the problem and its cure.
    """

    file: Path
    line: int
    column: int
    key: str
    text: str

    @override
    def __str__(self) -> str:
        place = f"{self.file}:{self.line}:{self.column}" if self.line else str(self.file)
        return f"{place}: {self.key}: {self.text}" if self.key else f"{place}: {self.text}"


class ConfigError(Exception):
    """A configuration cannot be used; holds all of its problems, in the file's order."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(sorted(problems, key=lambda p: (str(p.file), p.line, p.column)))
        super().__init__("\n".join(str(p) for p in self.problems))


KeyPath = tuple[str | int, ...]

MAX_BYTES = 1 << 20
MAX_VALUES = 100_000  # aliases can make a small file a huge document
MAX_DEPTH = 50

_TAG = "tag:yaml.org,2002:"


class Yaml12Loader(yaml.SafeLoader):
    """PyYAML's safe loader with the core schema of YAML 1.2: ``yes`` and ``12:30`` are text, ``010`` is ten."""

    yaml_implicit_resolvers = {}  # noqa: RUF012 - as the base class has it

    @override
    def compose_node(self, parent: Node | None, index: int) -> Node | None:
        """Compose a node; an anchor may be used again for another node, as in YAML 1.2."""
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if not isinstance(event, AliasEvent):
            self.anchors.pop(event.anchor, None)
        node: Node | None = super().compose_node(parent, index)
        return node

    @override
    def construct_mapping(self, node: MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Construct a map; raises `ConstructorError` if a key is given twice."""
        seen = set[str]()
        for key in (key for key, _ in node.value if isinstance(key, ScalarNode)):
            if key.value in seen:
                raise ConstructorError(None, None, f"the key {key.value!r} is given twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def core_bool(self, node: ScalarNode) -> bool:
        """Parse ``true`` or ``false``; raises `KeyError`."""
        return {"true": True, "false": False}[node.value.lower()]

    def core_int(self, node: ScalarNode) -> int:
        """Parse a decimal, hexadecimal, octal or binary number; raises `ValueError`."""
        text = node.value.replace("_", "")
        return int(text, 0 if re.match(r"[-+]?0[xob]", text) else 10)

    def core_float(self, node: ScalarNode) -> float:
        """Parse a number, infinity or not-a-number; raises `ValueError`."""
        return float(re.sub(r"\.(?=inf|nan)", "", node.value.replace("_", "").lower()))


for _kind, _pattern, _first in (
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("int", r"[-+]?(0b[01_]+|0o[0-7_]+|0x[0-9a-fA-F_]+|[0-9_]*[0-9][0-9_]*)", "-+0123456789"),
    (
        "float",
        (
            r"[-+]?([0-9][0-9_]*)\.[0-9_]*([eE][-+]?[0-9]+)?|[-+]?[0-9][0-9_]*[eE][-+]?[0-9]+"
            r"|[-+]?\.[0-9_]+([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
        ),
        "-+0123456789.",
    ),
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("merge", r"<<", "<"),
):
    Yaml12Loader.add_implicit_resolver(f"{_TAG}{_kind}", re.compile(f"(?:{_pattern})$"), list(_first))
for _kind in ("bool", "int", "float"):
    Yaml12Loader.add_constructor(f"{_TAG}{_kind}", getattr(Yaml12Loader, f"core_{_kind}"))


class Place(NamedTuple):
    """Line and column, counted from 1."""

    line: int
    column: int


@dataclass(slots=True)
class Document:
    """A file's data, and the place of each part in the file."""

    file: Path
    data: Any = None
    keys: dict[KeyPath, Place] = field(default_factory=dict)
    values: dict[KeyPath, Place] = field(default_factory=dict)

    def problem(self, path: KeyPath, text: str, *, at_key: bool = False) -> Problem:
        """Return a problem at ``path``, placed at the nearest enclosing part if the file has no such part."""
        places = self.keys if at_key else self.values
        known = path
        while known and known not in places:
            known = known[:-1]
        place = places.get(known, Place(0, 0))
        return Problem(self.file, place.line, place.column, key_text(path), text)


def key_text(path: KeyPath) -> str:
    """Return a key path as text: ``routing.rules[2].topic``."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def read(file: Path, *, repeating: Collection[KeyPath] = ()) -> Document:
    """Read a file; raises `ConfigError` if it is unreadable or too large, or is not YAML as this module accepts it.

    The keys of the maps at ``repeating`` may occur several times; such a map becomes a list of maps with one key each.
    """
    return parse(file, text_of(file), repeating=repeating)


def text_of(file: Path) -> str:
    """Return a file's text; raises `ConfigError` as `read` does."""
    try:
        if not file.is_file():
            reason = "is not a file" if file.exists() else "no such file"
            raise ConfigError([Problem(file, 0, 0, "", reason)])
        with file.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except OSError as err:
        raise ConfigError([Problem(file, 0, 0, "", f"cannot be read: {err.strerror}")]) from err
    if len(raw) > MAX_BYTES:
        raise ConfigError([Problem(file, 0, 0, "", f"is larger than {MAX_BYTES} bytes")])
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        before = raw[: err.start].decode("utf-8", "replace")
        line = before.count("\n") + 1
        column = len(before) - before.rfind("\n")
        raise ConfigError([Problem(file, line, column, "", f"is not UTF-8: byte 0x{raw[err.start]:02x}")]) from err


def parse(file: Path, text: str, *, repeating: Collection[KeyPath] = ()) -> Document:
    """Parse a file's text; see `read`."""
    try:
        loader = Yaml12Loader(text)
        root = loader.get_single_node()
    except yaml.MarkedYAMLError as err:
        mark = err.problem_mark or err.context_mark
        place = Place(mark.line + 1, mark.column + 1) if mark is not None else Place(0, 0)
        fault = " ".join(part for part in (err.context, err.problem) if part)
        raise ConfigError([Problem(file, *place, "", f"not valid YAML: {fault}")]) from err
    except (yaml.YAMLError, RecursionError) as err:
        fault = "nested too deeply" if isinstance(err, RecursionError) else str(err).splitlines()[0]
        raise ConfigError([Problem(file, 0, 0, "", f"not valid YAML: {fault}")]) from err
    document = Document(file)
    reader = _Reader(loader, document, repeating)
    if root is not None:
        document.data = reader.value(root, ())
    if reader.problems:
        raise ConfigError(reader.problems)
    return document


class _Reader:
    """Turns nodes into data, and collects the problems."""

    def __init__(self, loader: Yaml12Loader, document: Document, repeating: Collection[KeyPath]) -> None:
        self._construct = loader.construct_object
        self._document = document
        self._repeating = repeating
        self._count = 0
        self.problems: list[Problem] = []

    def value(self, node: Node, path: KeyPath) -> Any:
        document = self._document
        document.values[path] = Place(node.start_mark.line + 1, node.start_mark.column + 1)
        self._count += 1
        if self._count > MAX_VALUES or len(path) > MAX_DEPTH:
            problem = document.problem(path, "the document is too large or nested too deeply (or contains itself)")
            raise ConfigError([problem])
        match node:
            case MappingNode() if path in self._repeating:
                return [self._single(pair, (*path, index)) for index, pair in enumerate(node.value)]
            case MappingNode():
                return {name: self.value(child, (*path, name)) for name, child in self._items(node.value, path)}
            case SequenceNode():
                return [self.value(child, (*path, index)) for index, child in enumerate(node.value)]
            case ScalarNode():
                return self._scalar(node, path)
            case _:
                raise AssertionError(node)  # YAML has no other kind

    def _single(self, pair: tuple[Node, Node], path: KeyPath) -> dict[str, Any]:
        """Return one entry of a map that may have the same key several times."""
        self._document.values[path] = Place(pair[0].start_mark.line + 1, pair[0].start_mark.column + 1)
        return {name: self.value(child, (*path, name)) for name, child in self._items([pair], path)}

    def _items(self, pairs: list[tuple[Node, Node]], path: KeyPath) -> Iterator[tuple[str, Node]]:
        seen: dict[str, int] = {}
        for key, child in pairs:
            line, column = key.start_mark.line + 1, key.start_mark.column + 1
            if not isinstance(key, ScalarNode) or key.tag == f"{_TAG}merge":
                fault = "merge keys (<<) are not supported" if isinstance(key, ScalarNode) else "a key must be text"
                self.problems.append(Problem(self._document.file, line, column, key_text(path), fault))
                continue
            name = key.value
            if name in seen:
                text = f"given twice (first in line {seen[name]}); keep one"
                self.problems.append(Problem(self._document.file, line, column, key_text((*path, name)), text))
                continue
            seen[name] = line
            self._document.keys[*path, name] = Place(line, column)
            yield name, child

    def _scalar(self, node: ScalarNode, path: KeyPath) -> Any:
        kind = str(node.tag).removeprefix(_TAG)
        if kind not in {"str", "int", "float", "bool", "null"}:
            if kind == "timestamp":
                return node.value
            self.problems.append(self._document.problem(path, f"the tag {node.tag} is not supported; give plain data"))
            return None
        try:
            return self._construct(node)
        except (KeyError, ValueError, yaml.YAMLError):
            self.problems.append(self._document.problem(path, f"{node.value!r} is not a valid {kind}"))
            return None
