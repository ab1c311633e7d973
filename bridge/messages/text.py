"""Writes definitions as text, in the form that ROS 1's connection headers and ROS 2's bags carry."""

from __future__ import annotations

from bridge.messages.definition import Constant, DefaultValue, Definition, Field, Schema, World
from bridge.messages.names import legal_constants

_SEPARATOR = "=" * 80


def own_text(definition: Definition) -> str:
    """The type's own definition: its author's text, else one made from the fields."""
    if definition.text:
        return definition.text
    lines = [_constant(constant, definition.world) for constant in definition.constants]
    lines += [_field(field) for field in definition.fields]
    return "\n".join(lines) + "\n"


def full_text(schema: Schema) -> str:
    """The type's own definition, then each nested type's after a line of ``=`` and ``MSG: package/Name``."""
    parts = [own_text(schema.root)]
    parts += [f"{_SEPARATOR}\nMSG: {_short(n)}\n{own_text(schema.types[n])}" for n in schema.nested_order()]
    return "\n".join(part.rstrip("\n") for part in parts) + "\n"


def ros2_constants(constants: tuple[Constant, ...]) -> tuple[Constant, ...]:
    """ROS 1 constants as ROS 2 allows them: names in upper case, text in quotes, octets not negative."""
    names = legal_constants(constant.name for constant in constants)
    return tuple(_ros2_constant(names[constant.name], constant) for constant in constants)


def _ros2_constant(name: str, constant: Constant) -> Constant:
    if constant.base == "byte":
        return Constant(name, "byte", str(int(constant.text, 0) & 0xFF))
    return Constant(name, constant.base, constant.text)


def _constant(constant: Constant, world: World) -> str:
    if constant.base == "string" and world is World.ROS2 and constant.text[:1] not in ("'", '"'):
        return f"string {constant.name}={_quoted(constant.text)}"
    return f"{constant.base} {constant.name}={constant.text}"


def _field(field: Field) -> str:
    kind = (
        str(field.type).replace(field.type.base, _short(field.type.base), 1) if field.type.nested else str(field.type)
    )
    default = "" if field.default is None else f" {_default(field.default)}"
    return f"{kind} {field.name}{default}"


def _default(value: DefaultValue) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(_default(item) for item in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    return _quoted(value) if isinstance(value, str) else repr(value)


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _short(name: str) -> str:
    return name.replace("/msg/", "/", 1)
