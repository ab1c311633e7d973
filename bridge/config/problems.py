"""What is wrong with a document's data for a model, each with its place and what was probably meant."""

from __future__ import annotations

import difflib
import types
import typing
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from bridge.config.document import Document, KeyPath, Problem, key_text
from bridge.config.migrate import COMMAND, REMOVED


def key_name(name: str, info: FieldInfo) -> str:
    """A field's name in the file (``from`` for the field ``from_``)."""
    return info.alias or name


def model_of(annotation: Any) -> type[BaseModel] | None:
    """The section model inside an annotation (``Rule`` in ``tuple[Rule, ...]``), if there is one."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if typing.get_origin(annotation) in {tuple, list, typing.Union, types.UnionType}:
        found = (model_of(argument) for argument in typing.get_args(annotation))
        return next((model for model in found if model is not None), None)
    return None


def all_keys(model: type[BaseModel], path: KeyPath = ()) -> Iterator[KeyPath]:
    """The paths of all keys of a model, lists left out."""
    for name, info in model.model_fields.items():
        key = (*path, key_name(name, info))
        yield key
        inner = model_of(info.annotation)
        if inner is not None:
            yield from all_keys(inner, key)


def _model_at(model: type[BaseModel], path: KeyPath) -> type[BaseModel] | None:
    found: type[BaseModel] | None = model
    for part in path:
        if isinstance(part, int):
            continue
        fields = {key_name(name, info): info for name, info in found.model_fields.items()} if found else {}
        if part not in fields:
            return None
        found = model_of(fields[part].annotation)
    return found


def _unknown_key(model: type[BaseModel], path: KeyPath) -> str:
    name = str(path[-1])
    if path in REMOVED:
        return f"is a key of an older Midspan; '{COMMAND}' brings the file to today's"
    around = _model_at(model, path[:-1])
    names = [key_name(n, info) for n, info in around.model_fields.items()] if around else []
    elsewhere = [key_text(key) for key in all_keys(model) if key[-1] == name]
    near = elsewhere or difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    if near:
        return f"unknown key '{name}'{' here' if elsewhere else ''}; did you mean '{near[0]}'?"
    return f"unknown key '{name}'; known here: {', '.join(sorted(names))}"


def _choice(value: Any, expected: str) -> str:
    choices = [part.strip().strip("'") for part in expected.replace(" or ", ", ").split(",")]
    if isinstance(value, str) and value in ("true", "false") and value.title() in choices:
        return f"{value!r} is a text here; write {value} without quotes"
    near = difflib.get_close_matches(str(value), choices, n=1) if isinstance(value, str) else []
    hint = f"; did you mean '{near[0]}'?" if near else ""
    return f"{_shown(value)} is not one of {', '.join(choices)}{hint}".replace("True", "true").replace("False", "false")


def _shown(value: Any) -> str:
    if isinstance(value, dict | list):
        return "a map" if isinstance(value, dict) else "a list"
    text = "null" if value is None else str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _in_data(data: Any, location: tuple[str | int, ...]) -> KeyPath:
    """The part of pydantic's location that is a path in the data: it also names the arms of unions."""
    path: list[str | int] = []
    for part in location:
        inside = part in data if isinstance(data, dict) else isinstance(data, list) and part in range(len(data))
        if inside:
            data = data[part]
            path.append(part)
    return tuple(path)


def problems(document: Document, model: type[BaseModel], errors: list[Any]) -> list[Problem]:
    """Problems of a file, from `pydantic.ValidationError.errors`; the arms of a union make one problem."""
    found: dict[tuple[KeyPath, bool], list[str]] = {}
    for error in errors:
        unknown = error["type"] == "extra_forbidden"
        path = tuple(error["loc"]) if unknown else _in_data(document.data, error["loc"])
        texts = found.setdefault((path, unknown), [])
        text = _unknown_key(model, path) if unknown else _text(error)
        if text not in texts:
            texts.append(text)
    return [document.problem(path, ", or ".join(texts), at_key=key) for (path, key), texts in found.items()]


def _text(error: Mapping[str, Any]) -> str:
    value, message = error["input"], str(error["msg"])
    match error["type"]:
        case "literal_error":
            return _choice(value, error["ctx"]["expected"])
        case "value_error":
            return message.removeprefix("Value error, ")
        case "missing":
            return f"has no '{error['loc'][-1]}'"
        case "model_type" | "model_attributes_type":
            return f"must be a section with keys, not {_shown(value)}"
        case "string_pattern_mismatch":
            return f"{_shown(value)} does not match {error['ctx']['pattern']}"
        case "dict_type" | "path_type" | "tuple_type":
            kind = {"dict_type": "map", "path_type": "path", "tuple_type": "list"}[error["type"]]
            return f"{_shown(value)} is not a {kind}"
        case _:
            return f"{message[:1].lower()}{message[1:]}, not {_shown(value)}"
