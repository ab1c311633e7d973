"""A YAML file as plain data that knows the line and column of each of its keys and values.

Only what JSON has is taken: maps with text keys, lists, text, numbers, true, false and null (YAML 1.2, so ``yes`` is
text). Tags, merge keys, dates, a second document and a key given twice are refused; size and depth are bounded.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from bridge.config.problems import ConfigError, Problem

KeyPath = tuple[str | int, ...]

MAX_BYTES = 1 << 20
MAX_VALUES = 100_000  # aliases can make a small file a huge document
MAX_DEPTH = 50

_TAG = "tag:yaml.org,2002:"


class Place(NamedTuple):
    """Line and column, counted from 1."""

    line: int
    column: int


@dataclass(slots=True)
class Document:
    """A file's data, and where each part of it stands."""

    file: Path
    data: Any = None
    keys: dict[KeyPath, Place] = field(default_factory=dict)
    values: dict[KeyPath, Place] = field(default_factory=dict)

    def problem(self, path: KeyPath, text: str, *, at_key: bool = False) -> Problem:
        """A problem with the part at ``path``, or with the nearest part around it that the file has."""
        places = self.keys if at_key else self.values
        known = path
        while known and known not in places:
            known = known[:-1]
        place = places.get(known, Place(0, 0))
        return Problem(self.file, place.line, place.column, key_text(path), text)


def key_text(path: KeyPath) -> str:
    """A key path as people write it: ``routing.rules[2].topic``."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def read(file: Path, *, repeating: KeyPath | None = None) -> Document:
    """Read a file.

    Args:
        file: the file.
        repeating: path of a map whose keys may be given several times, as some programs allow; it becomes a list of
            maps with one key each.

    Raises:
        ConfigError: it cannot be read, is too large or is not the YAML that is allowed here.
    """
    return parse(file, _text(file), repeating=repeating)


def _text(file: Path) -> str:
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


def parse(file: Path, text: str, *, repeating: KeyPath | None = None) -> Document:
    """Parse a file's text; see `read`."""
    yaml = YAML(typ="safe", pure=True)
    yaml.composer.warn_double_anchors = False  # YAML 1.2 allows it; ruamel.yaml would write to stderr
    try:
        root = yaml.compose(io.StringIO(text))
    except MarkedYAMLError as err:
        mark = err.problem_mark or err.context_mark
        place = Place(mark.line + 1, mark.column + 1) if mark is not None else Place(0, 0)
        what = " ".join(part for part in (err.context, err.problem) if part)
        raise ConfigError([Problem(file, *place, "", f"not valid YAML: {what}")]) from err
    except (YAMLError, RecursionError) as err:
        what = "nested too deeply" if isinstance(err, RecursionError) else str(err).splitlines()[0]
        raise ConfigError([Problem(file, 0, 0, "", f"not valid YAML: {what}")]) from err
    document = Document(file)
    reader = _Reader(yaml, document, repeating)
    if root is not None:
        document.data = reader.value(root, ())
    if reader.problems:
        raise ConfigError(reader.problems)
    return document


class _Reader:
    """Turns nodes into data, and gathers the problems on the way."""

    def __init__(self, yaml: YAML, document: Document, repeating: KeyPath | None) -> None:
        self._construct = yaml.constructor.construct_object
        self._document = document
        self._repeating = repeating
        self._count = 0
        self.problems: list[Problem] = []

    def value(self, node: Node, path: KeyPath) -> Any:
        document = self._document
        document.values[path] = Place(node.start_mark.line + 1, node.start_mark.column + 1)
        self._count += 1
        if self._count > MAX_VALUES or len(path) > MAX_DEPTH:
            problem = document.problem(
                path, "the document is too large or nested too deeply (or an alias holds itself)"
            )
            raise ConfigError([problem])
        match node:
            case MappingNode() if path == self._repeating:
                return [self._single(pair, (*path, index)) for index, pair in enumerate(node.value)]
            case MappingNode():
                return {name: self.value(child, (*path, name)) for name, child in self._items(node.value, path)}
            case SequenceNode():
                return [self.value(child, (*path, index)) for index, child in enumerate(node.value)]
            case ScalarNode():
                return self._scalar(node, path)
            case _:
                raise AssertionError(node)  # ruamel.yaml composes no other kind

    def _single(self, pair: tuple[Node, Node], path: KeyPath) -> dict[str, Any]:
        """One key of a map that may have it several times."""
        self._document.values[path] = Place(pair[0].start_mark.line + 1, pair[0].start_mark.column + 1)
        return {name: self.value(child, (*path, name)) for name, child in self._items([pair], path)}

    def _items(self, pairs: list[tuple[Node, Node]], path: KeyPath) -> Iterator[tuple[str, Node]]:
        seen: dict[str, int] = {}
        for key, child in pairs:
            line, column = key.start_mark.line + 1, key.start_mark.column + 1
            if not isinstance(key, ScalarNode) or key.tag == f"{_TAG}merge":
                what = "merge keys (<<) are not supported" if isinstance(key, ScalarNode) else "a key must be text"
                self.problems.append(Problem(self._document.file, line, column, key_text(path), what))
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
        except (ValueError, YAMLError):
            self.problems.append(self._document.problem(path, f"{node.value!r} is not a valid {kind}"))
            return None
