"""The two fingerprints of a message type: ROS 1's md5 and ROS 2's RIHS01.

The md5 covers the constants, then the fields, with the md5 of each nested type in place of its name, as in
``genmsg.gentools.compute_md5_text``. RIHS01 is the SHA-256 of the type description in JSON (REP 2011;
``rosidl_generator_type_description``).
"""

from __future__ import annotations

import hashlib
import json
from typing import Any

from bridge.messages.definitions.schema import Field, Schema, Shape

EMPTY_MEMBER = "structure_needs_at_least_one_member"
"""Name of the one-byte field that ROS 2 gives to a message without fields."""

EMPTY_MD5 = hashlib.md5(b"", usedforsecurity=False).hexdigest()
"""The md5 of every ROS 1 message without fields and constants, and of every service of two such messages."""

_TYPE_IDS = {
    "int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9, "float32": 10,
    "float64": 11, "char": 3, "bool": 15, "byte": 16, "string": 17, "wstring": 18,
}  # fmt: skip # rosidl_adapter turns a .msg's char into IDL's uint8
_BOUNDED_IDS = {"string": 21, "wstring": 22}
_SHAPE_STEP = {Shape.SINGLE: 0, Shape.ARRAY: 48, Shape.SEQUENCE: 144}
_BOUNDED_SEQUENCE_STEP = 96


def md5_sum(*schemas: Schema) -> str:
    """Return the md5 of a ROS 1 type, in hex; or of the service with a given request and response, over both texts."""
    if len(schemas) != 1:
        return _md5("".join(_md5_text(schema) for schema in schemas))
    (schema,) = schemas
    if "md5" not in schema.fingerprints:
        schema.fingerprints["md5"] = _md5(_md5_text(schema))
    return schema.fingerprints["md5"]


def _md5_text(schema: Schema) -> str:
    """Return the text that the md5 of a ROS 1 type covers."""
    sums: dict[str, str] = {}

    def text(name: str) -> str:
        definition = schema.types[name]
        lines = [f"{c.base} {c.name}={c.text}" for c in definition.constants]
        lines += [f"{md5(f.type.base)} {f.name}" if f.type.nested else f"{f.type} {f.name}" for f in definition.fields]
        return "\n".join(lines)

    def md5(name: str) -> str:
        if name not in sums:
            sums[name] = _md5(text(name))
        return sums[name]

    return text(schema.name)


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()


def rihs01(schema: Schema) -> str:
    """Return the RIHS01 hash of a ROS 2 type, ``RIHS01_<64 hex>``."""
    if "rihs01" not in schema.fingerprints:
        schema.fingerprints["rihs01"] = _rihs01(schema)
    return schema.fingerprints["rihs01"]


def _rihs01(schema: Schema) -> str:
    nested = sorted(schema.nested_order())
    description = {
        "type_description": _describe(schema, schema.name),
        "referenced_type_descriptions": [_describe(schema, name) for name in nested],
    }
    return f"RIHS01_{hashlib.sha256(json.dumps(description).encode()).hexdigest()}"


def _describe(schema: Schema, name: str) -> dict[str, Any]:
    fields = [_describe_field(field) for field in schema.types[name].fields]
    return {"type_name": name, "fields": fields or [_field_json(EMPTY_MEMBER, _TYPE_IDS["uint8"], 0, 0, "")]}


def _describe_field(field: Field) -> dict[str, Any]:
    kind = field.type
    step = _BOUNDED_SEQUENCE_STEP if kind.shape is Shape.SEQUENCE and kind.length else _SHAPE_STEP[kind.shape]
    if kind.nested:
        number = 1
    elif kind.string_bound:
        number = _BOUNDED_IDS[kind.base]
    else:
        number = _TYPE_IDS[kind.base]
    return _field_json(field.name, step + number, kind.length, kind.string_bound, kind.base if kind.nested else "")


def _field_json(name: str, type_id: int, capacity: int, string_capacity: int, nested: str) -> dict[str, Any]:
    kind = {"type_id": type_id, "capacity": capacity, "string_capacity": string_capacity, "nested_type_name": nested}
    return {"name": name, "type": kind}
