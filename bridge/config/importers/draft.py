"""Files of an import: the peer's that is read, and the configuration that is made, with comments on its sources."""

from __future__ import annotations

import copy
import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from bridge.config.document import ConfigError, Document, KeyPath, Problem, key_text
from bridge.config.problems import problems

WIDTH = 116


@dataclass(slots=True)
class RuleDraft:
    """One rule as in the file, with its source (``file:line``), and notes on what has no counterpart here."""

    source: str
    rule: dict[str, Any]
    notes: list[Problem] = field(default_factory=list)


@dataclass(slots=True)
class Draft:
    """One configuration: paragraphs of comment at its top, sections, commented-out lines by section, and rules."""

    name: str
    head: list[str]
    sections: dict[str, Any]
    hints: dict[str, list[str]] = field(default_factory=dict)
    rules: list[RuleDraft] = field(default_factory=list)

    def text(self) -> str:
        """The YAML file."""
        return "\n".join(self._lines()) + "\n"

    def _lines(self) -> Iterator[str]:
        for number, paragraph in enumerate(self.head):
            if number:
                yield "#"
            yield from comment(paragraph)
        for name, value in self.sections.items():
            yield ""
            yield from _dump({name: value})
            yield from (line for text in self.hints.get(name, ()) for line in comment(text, "  "))
        yield ""
        yield "routing:"
        yield "  default: deny"
        yield "  rules:" if self.rules else "  rules: []"
        for entry in self.rules:
            yield f"    # {entry.source}"
            for note in entry.notes:
                yield from comment(_short(note), "    ")
            yield from (f"    {line}" for line in _dump([entry.rule]))


def comment(text: str, indent: str = "") -> list[str]:
    """A text as lines of comment."""
    rest = f"{indent}#   " if text.startswith("- ") else f"{indent}# "
    return textwrap.wrap(
        text,
        WIDTH,
        initial_indent=f"{indent}# ",
        subsequent_indent=rest,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _dump(value: Any) -> list[str]:
    text: str = yaml.safe_dump(value, sort_keys=False, default_flow_style=False, allow_unicode=True, width=1000)
    return text.splitlines()


def _short(note: Problem) -> str:
    """A note without its file's folder, which is nobody else's."""
    return str(replace(note, file=Path(note.file.name)))


def missing(notes: Iterable[Problem]) -> list[str]:
    """Paragraphs that list what is not carried over."""
    lines = [f"- {_short(note)}" for note in notes]
    return ["What has no counterpart here:", *lines] if lines else []


NOT_CARRIED = "not carried over"

M = TypeVar("M", bound=BaseModel)

_NAME = re.compile(r"/?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")
_TYPE = re.compile(r"([a-z][a-z0-9_]*)/(?:(?:msg|srv|action)/)?([A-Z][A-Za-z0-9]*)")


def checked(document: Document, path: KeyPath, model: type[M]) -> tuple[M, list[Problem]]:
    """The part at ``path`` as a model, and notes on keys that it does not have; raises `ConfigError` for bad values."""
    part = _part(document, path)
    try:
        return model.model_validate(part.data), []
    except ValidationError as err:
        errors = err.errors(include_url=False)
    unknown = [e for e in errors if e["type"] == "extra_forbidden"]
    if len(unknown) < len(errors):
        wrong = [e for e in errors if e not in unknown]
        raise ConfigError(_prefixed(path, problems(part, model, wrong)))
    rest = copy.deepcopy(part.data)
    for error in unknown:
        _remove(rest, error["loc"])
    notes = [replace(p, text=f"{p.text}; {NOT_CARRIED}") for p in problems(part, model, unknown)]
    return model.model_validate(rest), _prefixed(path, notes)


def _part(document: Document, path: KeyPath) -> Document:
    """A part of a document as one of its own."""
    data = document.data
    for key in path:
        data = data[key]
    length = len(path)
    keys, values = (
        {known[length:]: place for known, place in places.items() if known[:length] == path}
        for places in (document.keys, document.values)
    )
    return Document(document.file, data, keys, values)


def _prefixed(path: KeyPath, problems: Sequence[Problem]) -> list[Problem]:
    before = key_text(path)
    return [replace(p, key=".".join(filter(None, (before, p.key)))) for p in problems]


def _remove(data: Any, location: tuple[str | int, ...]) -> None:
    for key in location[:-1]:
        data = data[key]
    del data[location[-1]]


def topic_name(document: Document, path: KeyPath, name: str) -> str:
    """A topic's absolute name; raises `ConfigError` where it is none."""
    if not _NAME.fullmatch(name):
        text = f"{name!r} is not a topic name: letters, digits and underscores make its parts, and slashes part them"
        raise ConfigError([document.problem(path, text)])
    return name if name.startswith("/") else f"/{name}"


def type_name(document: Document, path: KeyPath, name: str) -> str:
    """A message type as ROS 2 spells it; raises `ConfigError` where it is none."""
    match = _TYPE.fullmatch(name)
    if match is None or "/srv/" in name or "/action/" in name:
        raise ConfigError([document.problem(path, f"{name!r} is not a message type, such as std_msgs/msg/String")])
    return f"{match[1]}/msg/{match[2]}"
