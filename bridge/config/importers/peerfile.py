"""Reading another program's YAML file: what is wrong is refused, what neither it nor Midspan knows is noted."""

from __future__ import annotations

import copy
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from bridge.config import hints
from bridge.config.document import Document, KeyPath, key_text
from bridge.config.problems import ConfigError, Problem

NOT_CARRIED = "not carried over"

M = TypeVar("M", bound=BaseModel)

_NAME = re.compile(r"/?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")
_TYPE = re.compile(r"([a-z][a-z0-9_]*)/(?:(?:msg|srv|action)/)?([A-Z][A-Za-z0-9]*)")


def checked(document: Document, path: KeyPath, model: type[M]) -> tuple[M, list[Problem]]:
    """The part of a file at ``path`` as a model, and notes on the keys that the model does not have.

    Raises:
        ConfigError: values are missing or of the wrong kind.
    """
    part = _part(document, path)
    try:
        return model.model_validate(part.data), []
    except ValidationError as err:
        errors = err.errors(include_url=False)
    unknown = [e for e in errors if e["type"] == "extra_forbidden"]
    if len(unknown) < len(errors):
        wrong = [e for e in errors if e not in unknown]
        raise ConfigError(_prefixed(path, hints.problems(part, model, wrong)))
    rest = copy.deepcopy(part.data)
    for error in unknown:
        _remove(rest, error["loc"])
    notes = [replace(p, text=f"{p.text}; {NOT_CARRIED}") for p in hints.problems(part, model, unknown)]
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
        text = f"{name!r} is no topic name: letters, digits and underscores make its parts, and slashes part them"
        raise ConfigError([document.problem(path, text)])
    return name if name.startswith("/") else f"/{name}"


def type_name(document: Document, path: KeyPath, name: str) -> str:
    """A message type as ROS 2 spells it; raises `ConfigError` where it is none."""
    match = _TYPE.fullmatch(name)
    if match is None or "/srv/" in name or "/action/" in name:
        raise ConfigError(
            [document.problem(path, f"{name!r} is no message type; give for example std_msgs/msg/String")]
        )
    return f"{match[1]}/msg/{match[2]}"
