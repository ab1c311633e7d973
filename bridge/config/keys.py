"""The model's keys as people read them: type, default and description of each, for the example and the reference."""

from __future__ import annotations

import json
import re
import types
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import annotated_types
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from bridge.config.hints import key_name, model_of


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a section.

    Attributes:
        value: what may be given, in words.
        default: the default as YAML; None where it depends on the machine.
        section: the keys' model where it is a section, or a list of such.
        is_list: whether it is a list.
    """

    name: str
    value: str
    default: str | None
    description: str
    section: type[BaseModel] | None
    is_list: bool


def keys(model: type[BaseModel]) -> Iterator[Key]:
    """The keys of a section's model, in its order."""
    for name, info in model.model_fields.items():
        is_list = typing.get_origin(info.annotation) is tuple
        section = model_of(info.annotation)
        yield Key(
            key_name(name, info),
            _section_text(section, is_list=is_list) if section is not None else _type_text(info),
            _default(info),
            info.description or "",
            section,
            is_list,
        )


def _section_text(section: type[BaseModel], *, is_list: bool) -> str:
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", section.__name__).lower()
    return f"list of {words}s" if is_list else "section"


def _default(info: FieldInfo) -> str | None:
    if info.default is PydanticUndefined:
        return None
    return "[]" if info.default == () else json.dumps(info.default)


def _type_text(info: FieldInfo) -> str:
    text = _annotation_text(info.annotation)
    low = high = pattern = ""
    for constraint in info.metadata:
        match constraint:
            case annotated_types.Ge(ge):
                low = f"from {ge}"
            case annotated_types.Gt(gt):
                low = f"above {gt}"
            case annotated_types.Le(le):
                high = f"up to {le}"
            case _ if getattr(constraint, "pattern", None):
                pattern = f"matching {constraint.pattern}"
    return " ".join(part for part in (text, low, high, pattern) if part)


def _annotation_text(annotation: Any) -> str:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Literal:
        return ", ".join(json.dumps(a) if isinstance(a, bool) else str(a) for a in arguments)
    if origin in {typing.Union, types.UnionType}:
        return " or ".join(_annotation_text(a) for a in arguments if a is not type(None))
    if origin is tuple:
        return f"list of {_annotation_text(arguments[0])}s"
    if origin is dict:
        return "map"
    if origin is typing.Annotated:
        return _annotation_text(arguments[0])
    names = {bool: "true, false", int: "integer", float: "number", str: "text", Path: "path"}
    return names.get(annotation, str(annotation))
