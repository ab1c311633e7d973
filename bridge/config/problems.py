"""Describes where a document's data does not fit a model: each problem with its place and what was probably meant."""

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
    """Return a field's name in the file (``from`` for the field ``from_``)."""
    return info.alias or name


def model_of(annotation: Any) -> type[BaseModel] | None:
    """Return the section model inside an annotation (``Rule`` in ``tuple[Rule, ...]``), or None."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if typing.get_origin(annotation) in {tuple, list, typing.Union, types.UnionType}:
        models = (model_of(argument) for argument in typing.get_args(annotation))
        return next((model for model in models if model is not None), None)
    return None


def all_keys(model: type[BaseModel], path: KeyPath = ()) -> Iterator[KeyPath]:
    """Yield the paths of all keys of a model, without the indexes of lists."""
    for name, info in model.model_fields.items():
        key = (*path, key_name(name, info))
        yield key
        inner = model_of(info.annotation)
        if inner is not None:
            yield from all_keys(inner, key)


def _model_at(model: type[BaseModel], path: KeyPath) -> type[BaseModel] | None:
    current: type[BaseModel] | None = model
    for part in path:
        if isinstance(part, int):
            continue
        fields = {key_name(name, info): info for name, info in current.model_fields.items()} if current else {}
        if part not in fields:
            return None
        current = model_of(fields[part].annotation)
    return current


def _field_at(model: type[BaseModel], path: KeyPath) -> FieldInfo | None:
    """Return the field with the value at ``path``, which may be an item of a list; None in a map with free keys."""
    names = [part for part in path if not isinstance(part, int)]
    section = _model_at(model, tuple(names[:-1])) if names else None
    fields = section.model_fields.items() if section else ()
    return next((info for name, info in fields if key_name(name, info) == names[-1]), None)


def _unknown_key(model: type[BaseModel], path: KeyPath) -> str:
    name = str(path[-1])
    if path in REMOVED:
        return f"is a key of an older Midspan; '{COMMAND}' updates the file"
    section = _model_at(model, path[:-1])
    names = [key_name(n, info) for n, info in section.model_fields.items()] if section else []
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
    return f"{_short(value)} is not one of {', '.join(choices)}{hint}".replace("True", "true").replace("False", "false")


def _short(value: Any) -> str:
    if isinstance(value, dict | list):
        return "a map" if isinstance(value, dict) else "a list"
    text = "null" if value is None else str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _in_data(data: Any, location: tuple[str | int, ...]) -> KeyPath:
    """Return the part of an error's location that is a path in the data, without the arms of unions."""
    path: list[str | int] = []
    for part in location:
        inside = part in data if isinstance(data, dict) else isinstance(data, list) and part in range(len(data))
        if inside:
            data = data[part]
            path.append(part)
    return tuple(path)


def problems(document: Document, model: type[BaseModel], errors: list[Any]) -> list[Problem]:
    """Return a file's problems from `pydantic.ValidationError.errors`; the arms of a union become one problem."""
    messages: dict[tuple[KeyPath, bool], list[str]] = {}
    lengths = _fixed_lengths(errors)
    for error in errors:
        unknown = error["type"] == "extra_forbidden"
        path = tuple(error["loc"]) if unknown else _in_data(document.data, error["loc"])
        texts = messages.setdefault((path, unknown), [])
        if unknown:
            text = _unknown_key(model, path)
        else:
            text = _wrong_length(error, lengths, _field_at(model, path)) or _text(error)
        if text not in texts:
            texts.append(text)
    return [document.problem(path, ", or ".join(texts), at_key=key) for (path, key), texts in messages.items()]


def _fixed_lengths(errors: list[Any]) -> dict[KeyPath, int]:
    """Return the required length of each list that is too short; pydantic reports each missing value."""
    lengths: dict[KeyPath, int] = {}
    for error in errors:
        *path, last = error["loc"] or ("",)
        if error["type"] == "missing" and isinstance(last, int):
            lengths[tuple(path)] = max(last + 1, lengths.get(tuple(path), 0))
    return lengths


def _wrong_length(error: Mapping[str, Any], lengths: Mapping[KeyPath, int], field: FieldInfo | None) -> str:
    """Describe a list that has too few or too many values; return "" for another error."""
    value, context = error["input"], error.get("ctx", {})
    match error["type"]:
        case "missing" if isinstance(error["loc"][-1], int):
            bound, least = lengths[tuple(error["loc"][:-1])], "exactly"
        case "too_short":
            bound, least = context["min_length"], "at least"
        case "too_long":
            bound, least = context["max_length"], "at most"
        case _:
            return ""
    if field is not None and bound in _exact_lengths(field):
        least = "exactly"
    count = context.get("actual_length") or len(value)
    meaning = field.description if field is not None and field.description else ""
    meaning = f": {meaning.split('; empty:')[0].rstrip('.')}" if least == "exactly" and meaning else ""
    return f"has {_values(count)}, and needs {least} {bound}{meaning}"


def _values(count: int) -> str:
    return "no values" if count == 0 else "1 value" if count == 1 else f"{count} values"


def _exact_lengths(field: FieldInfo) -> set[int]:
    """Return the lengths of fixed-length lists in a field's type, and the only length that its limits allow, if any."""
    limits = [getattr(constraint, name, None) for name in ("min_length", "max_length") for constraint in field.metadata]
    known = [limit for limit in limits if limit is not None]
    return _tuple_lengths(field.annotation) | ({known[0]} if len(known) == 2 and known[0] == known[1] else set())


def _tuple_lengths(annotation: Any) -> set[int]:
    arguments = typing.get_args(annotation)
    fixed = typing.get_origin(annotation) is tuple and Ellipsis not in arguments
    return ({len(arguments)} if fixed else set()).union(*map(_tuple_lengths, arguments))


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
            return f"must be a section with keys, not {_short(value)}"
        case "string_pattern_mismatch":
            return f"{_short(value)} does not match {error['ctx']['pattern']}"
        case "dict_type" | "path_type" | "tuple_type":
            kind = {"dict_type": "map", "path_type": "path", "tuple_type": "list"}[error["type"]]
            return f"{_short(value)} is not a {kind}"
        case _:
            return f"{message[:1].lower()}{message[1:]}, not {_short(value)}"
