"""Message definitions as bags store them: in the encodings that rosbags, rosbag2 and Foxglove parse.

Encodings (https://mcap.dev/spec/registry): ``ros2msg`` is the full ``.msg`` text. ``ros2idl`` is IDL, where each type
follows a line of ``=`` and ``IDL: package/kind/Name``.

Facts about rosbags 0.11 (typesys/msg.py and store.py, highlevel/anyreader.py):

- In ``ros2msg`` it reads each name without ``/msg/`` or ``/action/`` as a message, so a type of a service, such as
  ``my_robot/srv/Ask_Event``, can only be decoded from ``ros2idl``.
- It completes a field's type without a slash, ``Point``, with package and kind of the type that has the field, even if
  that gives ``pkg/action/Point``.
- It hashes ``char`` with a separate type id, whereas rosidl hashes a ``.msg`` file's ``char`` as ``uint8``.
- It refuses a whole ``.db3`` if the hash of one stored definition differs from the type's hash.

rosbag2 stores the text of the ``.srv`` file as the definition of a service event (rosbag2_cpp,
local_message_definition_source.cpp).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

from bridge.messages.definitions.hashes import EMPTY_MEMBER
from bridge.messages.definitions.names import is_ros2_name, split_part
from bridge.messages.definitions.parts import CONTENTS, generated_parts
from bridge.messages.definitions.schema import Definition, Schema, Shape, World
from bridge.messages.definitions.text import closure, full_text, own_text, parse_full, split_parts
from bridge.messages.errors import MessageTypeError

MSG, IDL = "ros2msg", "ros2idl"
_LINE = "=" * 80
_IDL_START = f"{_LINE}\nIDL: "
_CACHED = 500
"""Maximum number of cached definitions, which are not parsed again; thousands of topics may share a type."""

LARGEST = 256 << 10
"""Maximum characters of a definition that rosbags' parser gets; it parses some 150,000 characters per second."""

_IDL_NAMES = {
    "bool": "boolean", "byte": "octet", "char": "uint8", "float32": "float", "float64": "double",
}  # fmt: skip
"""Primitives that rosidl spells differently in IDL (rosidl_adapter, msg/__init__.py)."""


class StoredDefinition(NamedTuple):
    """A definition as a file has it; ``encoding`` and ``text`` are empty if no definition is known."""

    encoding: str = ""
    text: str = ""


@lru_cache(maxsize=_CACHED)
def stored_definition(type_name: str, definition: str) -> StoredDefinition:
    """Return a full definition in the encoding that other readers decode; empty if they would refuse the whole file."""
    if not definition:
        return StoredDefinition()
    try:
        schema = full_schema(type_name, definition)
    except MessageTypeError:
        return StoredDefinition(MSG, definition) if _rosbags_types(type_name, definition) else StoredDefinition()
    if any("/srv/" in name for name in schema.types):
        return StoredDefinition(IDL, _idl_text(schema))
    return StoredDefinition(MSG, full_text(without_char(schema)))


@lru_cache(maxsize=_CACHED)
def hashed_definition(type_name: str, definition: str, type_hash: str) -> str:
    """Return the text of a definition from which rosbags computes ``type_hash``, "" if it computes another hash."""
    from rosbags.typesys import Stores, get_typestore

    for text in (definition, stored_definition(type_name, definition).text):
        store = get_typestore(Stores.EMPTY)
        with suppress(Exception):  # a type that rosbags does not support ends in a KeyError
            store.register(_rosbags_types(type_name, text))
            if store.hash_rihs01(type_name) == type_hash:
                return text
    return ""


def _rosbags_types(type_name: str, text: str) -> Any:
    """Return the types of a definition as rosbags parses them; empty if rosbags cannot parse it."""
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    if len(text) > LARGEST:
        return {}
    types: dict[str, Any] = {}
    with suppress(Exception):  # its parser raises more than its own error for bad input
        if not text.startswith(_IDL_START):
            return get_types_from_msg(text, type_name)
        for section in text.split(f"{_LINE}\n")[1:]:
            body = re.sub(r"(?m)^\s*#.*$", "", section.partition("\n")[2])  # rosbags does not parse #include
            types.update(get_types_from_idl(body))
        return types
    return {}


@lru_cache(maxsize=_CACHED)
def full_schema(type_name: str, definition: str) -> Schema:
    """Parse a full definition of a ROS 2 type; raises `MessageTypeError` if it is invalid or incomplete."""
    types = parse_full(definition, type_name, World.ROS2)
    return closure(types[type_name], types)


@lru_cache(maxsize=_CACHED)
def full_definition(type_name: str, encoding: str, text: str) -> str:
    """Return the definition that a bag stores for a ROS 2 type as full ``.msg`` text, "" if it cannot be parsed.

    If the text is that of a ``.srv`` or ``.action`` file, the result defines the part of it that ``type_name`` names.
    """
    if encoding == IDL:
        return _text_of_idl(type_name, text)
    if encoding != MSG:
        return ""
    if not is_ros2_name(type_name) or "/msg/" in type_name:
        return text
    package, kind, _ = type_name.split("/")
    base = split_part(type_name)[0]
    # Midspan up to 0.1.0 stored the names of parts without their kind: ``pkg/Ask_Event`` for ``pkg/srv/Ask_Event``
    text = re.sub(rf"(?m)^((?:MSG: )?{package})/({base.rpartition('/')[2]}_\w+)", rf"\1/{kind}/\2", text)
    sections = split_parts(text)
    return text if len(sections) == 1 else _part_of_file(type_name, base, CONTENTS[kind], sections)


def _part_of_file(type_name: str, base: str, contents: tuple[str, ...], sections: list[str]) -> str:
    """Return the definition of a part of a service or action, from its file's sections."""
    if len(sections) != len(contents):
        return ""
    try:
        types = generated_parts(base, World.ROS2)
        for content, section in zip(contents, sections, strict=True):
            types |= parse_full(section, f"{base}_{content}", World.ROS2)
    except MessageTypeError:
        return ""
    if type_name not in types:
        return ""
    nested = (f"{_LINE}\nMSG: {name}\n{own_text(types[name])}" for name in types if name != type_name)
    return "".join((own_text(types[type_name]), *nested))


def without_char(schema: Schema) -> Schema:
    """Return the same types with ``uint8`` for ``char``, which ROS 2 serializes and hashes alike.

    The original text is also replaced by generated text if it has a name such as ``pkg/msg/Name``, because ``.msg``
    files have ``pkg/Name``, and if it is that of a part of an action, in which rosbags would read ``Name`` as
    ``pkg/action/Name``.
    """
    types = {name: _plain(definition) for name, definition in schema.types.items()}
    return Schema(types[schema.name], types)


def _plain(definition: Definition) -> Definition:
    fields = tuple(
        replace(field, type=replace(field.type, base="uint8")) if field.type.base == "char" else field
        for field in definition.fields
    )
    if fields == definition.fields and "/msg/" not in definition.text and "/action/" not in definition.name:
        return definition
    return replace(definition, fields=fields, text="")


def _idl_text(schema: Schema) -> str:
    """Return a type and all types that it nests in IDL, without constants and default values."""
    return "".join(
        f"{_LINE}\nIDL: {name}\n{_idl(schema.types[name])}" for name in (schema.name, *schema.nested_order())
    )


def _idl(definition: Definition) -> str:
    package, kind, name = definition.name.split("/")
    lines = [f"      {_idl_field(field.name, field.type)};\n" for field in definition.fields]
    members = "".join(lines) or f"      uint8 {EMPTY_MEMBER};\n"
    return f"module {package} {{\n  module {kind} {{\n    struct {name} {{\n{members}    }};\n  }};\n}};\n"


def _idl_field(name: str, kind: Any) -> str:
    base = kind.base.replace("/", "::") if kind.nested else _IDL_NAMES.get(kind.base, kind.base)
    if kind.string_bound:
        base = f"{base}<{kind.string_bound}>"
    match kind.shape:
        case Shape.SINGLE:
            return f"{base} {name}"
        case Shape.ARRAY:
            return f"{base} {name}[{kind.length}]"
        case _:
            bound = f", {kind.length}" if kind.length else ""
            return f"sequence<{base}{bound}> {name}"


def _text_of_idl(type_name: str, text: str) -> str:
    """Return the ``.msg`` text of types in IDL, "" if rosbags cannot parse them or the type is missing."""
    types = _rosbags_types(type_name, text if text.startswith(_IDL_START) else f"{_IDL_START}{type_name}\n{text}")
    if type_name not in types:
        return ""
    constants, fields = types.pop(type_name)
    nested = (f"{_LINE}\nMSG: {name.replace('/msg/', '/')}\n{''.join(_msg_lines(*types[name]))}" for name in types)
    return "".join((*_msg_lines(constants, fields), *nested)) or "\n"  # the text of an empty message


def _msg_lines(constants: Any, fields: Any) -> Iterator[str]:
    for name, base, value in constants:
        yield f"{base} {name}={repr(value) if isinstance(value, str) else value}\n"
    for name, kind in fields:
        if name != EMPTY_MEMBER:
            yield f"{_msg_type(kind)} {name}\n"


def _msg_type(kind: Any) -> str:
    """Return a field's type from the description of rosbags (interfaces/typing.py)."""
    from rosbags.interfaces import Nodetype

    node, about = kind
    if node == Nodetype.BASE:
        base, bound = about
        return f"{base}<={bound}" if bound else str(base)
    if node == Nodetype.NAME:
        return str(about).replace("/msg/", "/")
    inner, count = about
    length = "" if not count else str(count) if node == Nodetype.ARRAY else f"<={count}"
    return f"{_msg_type(inner)}[{length}]"
