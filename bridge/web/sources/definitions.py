"""Message definitions as JSON, from which pages build input fields."""

from __future__ import annotations

from typing import Any

from bridge.client.types import Types, ros2_spelling
from bridge.messages.definitions.schema import Constant, Definition, Field, Schema

KINDS = ("topic", "service")


def definition(types: Types, type_name: str, kind: str = "topic") -> dict[str, Any]:
    """Return the value of the verb ``definition``; see the protocol. Raises `ClientError` if the type is unknown."""
    if kind == "service":
        name = ros2_spelling(type_name, "srv")
        types.prepare_service(name, "")
        request, response = types.registry.service_schemas(name)
        types_ = {**_types(response), **_types(request)}
        return {"type": name, "root": request.name, "response": response.name, "types": types_}
    name = types.name(type_name)
    types.hash_of(name)
    schema = types.registry.schema(name)
    return {"type": name, "root": schema.name, "types": _types(schema)}


def _types(schema: Schema) -> dict[str, Any]:
    types = {name: _definition(definition_) for name, definition_ in schema.types.items()}
    return {**types, schema.name: _definition(schema.root)}


def _definition(definition_: Definition) -> dict[str, Any]:
    return {
        "fields": [_field(field) for field in definition_.fields],
        "constants": [_constant(constant) for constant in definition_.constants],
    }


def _field(field: Field) -> dict[str, Any]:
    kind = field.type
    about = {"name": field.name, "base": kind.base, "shape": kind.shape.value, "length": kind.length}
    return {**about, "bound": kind.string_bound, "default": field.default}


def _constant(constant: Constant) -> dict[str, Any]:
    return {"name": constant.name, "base": constant.base, "value": _value(constant.base, constant.text)}


def _value(base: str, text: str) -> bool | int | float | str:
    try:
        if base == "bool":
            return text.strip().lower() in ("true", "1")
        if base.startswith("float"):
            return float(text)
        if "string" not in base:
            return int(text, 0)
    except ValueError:
        return text
    return text
