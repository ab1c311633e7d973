"""Makes the counterpart of a type that one world alone has: same fields in the same order, nested types mapped."""

from __future__ import annotations

from collections.abc import Callable

from bridge.messages.definition import TIME_TYPES, Constant, Definition, Field, FieldType, Schema, World
from bridge.messages.errors import MessageTypeError
from bridge.messages.names import legal_fields, legal_type
from bridge.messages.text import ros2_constants

Counterpart = Callable[[Schema], Schema]
"""Gives the other world's schema of a nested type."""

_TIMES_BACK = {name: base for base, name in TIME_TYPES.items()}


def derive_ros2(ros1: Schema, counterpart: Counterpart, name: str = "") -> Schema:
    """The ROS 2 type for a type that only ROS 1 has; names are made legal as ROS 2 wants them.

    Args:
        ros1: the type.
        counterpart: for the types that it nests.
        name: ROS 2's name, "" for that of a message.
    """
    names = legal_fields(field.name for field in ros1.root.fields)
    types: dict[str, Definition] = {}

    def base(kind: FieldType) -> str:
        if kind.base in TIME_TYPES:
            name = TIME_TYPES[kind.base]
            types[name] = _TIME_DEFINITIONS[name]
            return name
        return _nested(ros1, kind, counterpart, types)

    fields = tuple(
        Field(names[field.name], FieldType(base(field.type), field.type.shape, field.type.length))
        for field in ros1.root.fields
    )
    root = Definition(name or legal_type(ros1.name), World.ROS2, fields, ros2_constants(ros1.root.constants))
    return Schema(root, {**types, root.name: root})


def derive_ros1(ros2: Schema, counterpart: Counterpart, name: str = "") -> Schema:
    """The ROS 1 type for a type that only ROS 2 has; bounds are dropped, and checked when messages are converted.

    Args:
        ros2: the type.
        counterpart: for the types that it nests.
        name: ROS 1's name, "" for that of a message.

    Raises:
        MessageTypeError: ROS 1 cannot say it.
    """
    package, kind, short = ros2.name.split("/")
    if kind != "msg" and not name:
        msg = f"{ros2.name} is part of a service or action, for which ROS 1 has no message"
        raise MessageTypeError(msg)
    types: dict[str, Definition] = {}
    fields: list[Field] = []
    for field in ros2.root.fields:
        if field.type.base == "wstring":
            msg = f"{ros2.name} cannot be said in ROS 1: field {field.name} is a wstring"
            raise MessageTypeError(
                msg, "map it by a rule to a ROS 1 message that leaves the field out (types.mapping_rules)"
            )
        base = _TIMES_BACK.get(field.type.base) or _nested(ros2, field.type, counterpart, types)
        length = field.type.length if field.type.shape.value == "array" else 0
        fields.append(Field(field.name, FieldType(base, field.type.shape, length)))
    constants = tuple(_ros1_constant(c) for c in ros2.root.constants if c.base != "wstring")
    root = Definition(name or f"{package}/{short}", World.ROS1, tuple(fields), constants)
    return Schema(root, {**types, root.name: root})


_TIME_DEFINITIONS = {
    name: Definition(
        name, World.ROS2, (Field("sec", FieldType("int32")), Field("nanosec", FieldType("uint32"))), text=text
    )
    for name, text in {
        "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
        "builtin_interfaces/msg/Duration": "int32 sec\nuint32 nanosec\n",
    }.items()
}


def _nested(schema: Schema, kind: FieldType, counterpart: Counterpart, types: dict[str, Definition]) -> str:
    if not kind.nested:
        return kind.base
    found = counterpart(schema.sub(kind.base))
    types.update({name: found.types[name] for name in (found.name, *found.nested_order())})
    return found.name


def _ros1_constant(constant: Constant) -> Constant:
    text = constant.text
    if constant.base == "string" and text[:1] in ("'", '"') and text[-1:] == text[:1]:
        text = text[1:-1]
    if constant.base == "byte" and int(text, 0) > 127:
        text = str(int(text, 0) - 256)
    return Constant(constant.name, constant.base, text)
