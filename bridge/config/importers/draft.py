"""A configuration that an import makes, with the comments that say where each part comes from and what is missing."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from bridge.config.problems import Problem

WIDTH = 116


@dataclass(slots=True)
class RuleDraft:
    """One rule, with its comments.

    Attributes:
        source: where it comes from, ``file:line``.
        rule: its keys and values as in the file.
        notes: what of its source has no counterpart here.
    """

    source: str
    rule: dict[str, Any]
    notes: list[Problem] = field(default_factory=list)


@dataclass(slots=True)
class Draft:
    """One configuration.

    Attributes:
        name: of the file, where several are written.
        head: paragraphs of comment at its top.
        sections: all but the rules.
        hints: commented-out lines, by the section that they belong to.
        rules: the rules; what they do not name does not cross.
    """

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
