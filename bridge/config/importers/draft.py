"""The files of an import: the other bridge's file, and the new configuration with comments on its sources."""

from __future__ import annotations

import copy
import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from bridge.config.document import ConfigError, Document, KeyPath, Problem, key_text
from bridge.config.problems import problems

WIDTH = 116


@dataclass(slots=True)
class RuleDraft:
    """One rule as it is written, with its source (``file:line``), and notes on keys without a counterpart."""

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
        """Return the text of the YAML file."""
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
    """Return a text as comment lines."""
    continuation = f"{indent}#   " if text.startswith("- ") else f"{indent}# "
    return textwrap.wrap(
        text,
        WIDTH,
        initial_indent=f"{indent}# ",
        subsequent_indent=continuation,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _dump(value: Any) -> list[str]:
    text: str = yaml.safe_dump(value, sort_keys=False, default_flow_style=False, allow_unicode=True, width=1000)
    return text.splitlines()


def _short(note: Problem) -> str:
    """Return a note without the folder of its file, which is private to this machine."""
    return str(replace(note, file=Path(note.file.name)))


def missing(notes: Iterable[Problem]) -> list[str]:
    """Return paragraphs that list the entries without a counterpart."""
    lines = [f"- {_short(note)}" for note in notes]
    return ["Entries without a counterpart here:", *lines] if lines else []


NOT_CARRIED = "not carried over"

M = TypeVar("M", bound=BaseModel)

_NAME = re.compile(r"/?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")
_TYPE = re.compile(r"([a-z][a-z0-9_]*)/(?:(msg|srv|action)/)?([A-Z][A-Za-z0-9]*)")
Kind = Literal["topic", "service", "action"]
_TYPES: dict[Kind, tuple[str, str, str]] = {
    "topic": ("msg", "a message", "std_msgs/msg/String"),
    "service": ("srv", "a service", "std_srvs/srv/SetBool"),
    "action": ("action", "an action", "nav2_msgs/action/NavigateToPose"),
}
"""By kind: the middle part of the type's name, words for errors, and an example."""


def checked(document: Document, path: KeyPath, model: type[M]) -> tuple[M, list[Problem]]:
    """Return the part at ``path`` as a model, and notes on unknown keys; raises `ConfigError` for bad values."""
    part = _part(document, path)
    try:
        return model.model_validate(part.data), []
    except ValidationError as err:
        errors = err.errors(include_url=False)
    unknown = [e for e in errors if e["type"] == "extra_forbidden"]
    if len(unknown) < len(errors):
        wrong = [e for e in errors if e not in unknown]
        raise ConfigError(_prefixed(path, problems(part, model, wrong)))
    data = copy.deepcopy(part.data)
    for error in unknown:
        _remove(data, error["loc"])
    notes = [replace(p, text=f"{p.text}; {NOT_CARRIED}") for p in problems(part, model, unknown)]
    return model.model_validate(data), _prefixed(path, notes)


def _part(document: Document, path: KeyPath) -> Document:
    """Return the part of a document at ``path`` as a separate document."""
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


def topic_name(document: Document, path: KeyPath, name: str, kind: Kind = "topic") -> str:
    """Return the absolute name of a topic, service or action; raises `ConfigError` for an invalid name."""
    if not _NAME.fullmatch(name):
        text = f"{name!r} is not a {kind} name: its parts are letters, digits and underscores, separated by slashes"
        raise ConfigError([document.problem(path, text)])
    return name if name.startswith("/") else f"/{name}"


def type_name(document: Document, path: KeyPath, name: str, kind: Kind = "topic") -> str:
    """Return a type of this kind as ROS 2 spells it; raises `ConfigError` for an invalid type."""
    match, (folder, noun, example) = _TYPE.fullmatch(name), _TYPES[kind]
    if match is None or match[2] not in (None, folder):
        raise ConfigError([document.problem(path, f"{name!r} is not {noun} type, such as {example}")])
    return f"{match[1]}/{folder}/{match[3]}"
