"""The fields of a ROS 1 type that correspond to fields of a ROS 2 type.

Fields correspond by a mapping rule that lists them, or else by name: first equal names, then the legal ROS 2 name of a
ROS 1 field (`legal_fields`), then names that differ only in case (``CameraInfo.D`` is ``d``).
``Header.seq`` needs no counterpart. Fields of only one type get default values; if both types have such fields, the
types do not match, because a field may have been renamed. actionlib's status text (`parts.STATUS_TEXT`) corresponds to
the ``error_msg`` of a ROS 2 action's result, unless a field of the ROS 1 result does; the status text needs no
counterpart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from bridge.messages.definitions.names import legal_fields
from bridge.messages.definitions.parts import STATUS_TEXT
from bridge.messages.definitions.schema import PRIMITIVE_SIZES, TIME_TYPES, Definition, Field, FieldType, Schema, Shape
from bridge.messages.errors import MessageTypeError
from bridge.messages.mapping.rules import FieldRule, Rules

FieldPath = tuple[str, ...]
Fields = tuple[tuple[FieldPath, FieldPath], ...]

_ERROR_MSG = "error_msg"


@dataclass(frozen=True, slots=True)
class Pair:
    """Two message types and the paths of their corresponding fields."""

    ros1: Definition
    ros2: Definition
    fields: Fields


PairTable = Mapping[tuple[str, str], Pair]  # pairs by ROS 1 and ROS 2 name: of the root types and of all nested types


def pair_types(ros1: Schema, ros2: Schema, rules: Rules) -> PairTable:
    """Match two types and their nested types; raises `MessageTypeError`, which names the fields that do not match."""
    table: dict[tuple[str, str], Pair] = {}

    def visit(name1: str, name2: str) -> None:
        if (name1, name2) in table:
            return
        type1, type2 = ros1.sub(name1), ros2.sub(name2)
        rule = rules.fields(name1, name2)
        fields = _by_name(type1.root, type2.root) if rule is None else _by_rule(type1, type2, rule)
        fields = _status_text(type1.root, type2.root, fields) + fields
        table[name1, name2] = Pair(type1.root, type2.root, fields)
        for path1, path2 in fields:
            kind1, kind2 = field_at(type1, path1), field_at(type2, path2)
            assert kind1 is not None
            assert kind2 is not None
            reason = _unlike(kind1, kind2, rules)
            if reason:
                msg = (
                    f"{name1} and {name2} do not match: field {'.'.join(path1)} ({kind1}) and field"
                    f" {'.'.join(path2)} ({kind2}): {reason}"
                )
                raise MessageTypeError(msg, "write a mapping rule that leaves the field out (types.mapping_rules)")
            if kind1.nested and kind2.nested:
                visit(kind1.base, kind2.base)

    visit(ros1.name, ros2.name)
    return table


def left_out(pairs: PairTable, rules: Rules) -> tuple[str, ...]:
    """Return the ROS 1 fields without a counterpart, as ``package/Name.field``, except those that a rule leaves out."""
    missing: list[str] = []
    for pair in pairs.values():
        if rules.fields(pair.ros1.name, pair.ros2.name) is None:
            mapped = {path1[0] for path1, _ in pair.fields}
            missing += [f"{pair.ros1.name}.{name}" for name in _required_fields(pair.ros1) if name not in mapped]
    return tuple(missing)


def _required_fields(ros1: Definition) -> list[str]:
    """Return the fields that need a counterpart: all except ``seq`` of a header and actionlib's status text."""
    needless = {STATUS_TEXT, "seq"} if ros1.name == "std_msgs/Header" else {STATUS_TEXT}
    return [field.name for field in ros1.fields if field.name not in needless]


def _status_text(ros1: Definition, ros2: Definition, fields: Fields) -> Fields:
    """Match actionlib's status text with ``error_msg``, if both exist and no other field matches ``error_msg``."""
    has_text = any(field.name == STATUS_TEXT for field in ros1.fields)
    has_error = Field(_ERROR_MSG, FieldType("string")) in ros2.fields
    pair = (STATUS_TEXT,), (_ERROR_MSG,)
    return (pair,) if has_text and has_error and all(path2 != pair[1] for _, path2 in fields) else ()


def has_equal_fields(ros1: Schema, ros2: Schema, rules: Rules) -> bool:
    """Whether two types and their nested types match, with a counterpart for every field of types without a rule."""
    try:
        pairs = pair_types(ros1, ros2, rules)
    except MessageTypeError:
        return False
    for pair in pairs.values():
        mapped = {path2 for _, path2 in pair.fields}
        if rules.fields(pair.ros1.name, pair.ros2.name) is None and not (
            len(mapped) == len(_required_fields(pair.ros1)) == len(pair.ros2.fields)
        ):
            return False
    return True


def field_at(schema: Schema, path: FieldPath) -> FieldType | None:
    """Return the type of the field at a path such as ``("header", "stamp")``; None if the field does not exist."""
    definition: Definition | None = schema.root
    kind: FieldType | None = None
    for step in path:
        if definition is None or (kind is not None and kind.shape is not Shape.SINGLE):
            return None
        kind = next((field.type for field in definition.fields if field.name == step), None)
        if kind is None:
            return None
        definition = schema.of(kind)
    return kind


def _by_rule(ros1: Schema, ros2: Schema, rule: FieldRule) -> Fields:
    pairs = [(tuple(name1.split(".")), tuple(name2.split("."))) for name1, name2 in rule.fields.items()]
    for path1, path2 in pairs:
        for schema, path in ((ros1, path1), (ros2, path2)):
            if field_at(schema, path) is None:
                msg = f"{rule.origin}: {schema.name} has no field {'.'.join(path)}"
                raise MessageTypeError(msg, f"its fields: {', '.join(f.name for f in schema.root.fields) or 'none'}")
    targets = [path2 for _, path2 in pairs]
    for target in targets:
        if any(other is not target and other[: len(target)] == target for other in targets):
            raise MessageTypeError(f"{rule.origin}: {'.'.join(target)} of {ros2.name} is mapped twice")
    return tuple(pairs)


def _by_name(ros1: Definition, ros2: Definition) -> Fields:
    exact = {field.name: field.name for field in ros2.fields}
    lower = {field.name.lower(): field.name for field in ros2.fields}
    legal = legal_fields(field.name for field in ros1.fields)
    pairs: list[tuple[FieldPath, FieldPath]] = []
    only1: list[str] = []
    taken = {field.name for field in ros1.fields if field.name in exact}
    for field in ros1.fields:
        candidates = exact.get(legal[field.name]), lower.get(field.name.lower())
        name = exact.get(field.name) or next((name for name in candidates if name and name not in taken), None)
        if name is None:
            only1.append(field.name)
        else:
            taken.add(name)
            pairs.append(((field.name,), (name,)))
    only1 = [name for name in only1 if name in _required_fields(ros1)]
    only2 = [field.name for field in ros2.fields if field.name not in taken]
    if only1 and only2:
        msg = (
            f"{ros1.name} and {ros2.name} do not match: only the first has {', '.join(only1)}, only the second"
            f" {', '.join(only2)}"
        )
        raise MessageTypeError(msg, "list the fields that correspond in a mapping rule (types.mapping_rules)")
    return tuple(pairs)


def _unlike(ros1: FieldType, ros2: FieldType, rules: Rules) -> str:
    """Return the reason why a ROS 1 field cannot correspond to a ROS 2 field; "" if it can."""
    if ros1.shape is not ros2.shape:
        return f"one is {_a(ros1.shape)}, the other {_a(ros2.shape)}"
    if ros1.shape is Shape.ARRAY and ros1.length != ros2.length:
        return "the arrays differ in length"
    if ros1.base in TIME_TYPES:
        return "" if TIME_TYPES[ros1.base] == ros2.base else f"{ros1.base} corresponds to {TIME_TYPES[ros1.base]} only"
    if ros1.nested and ros2.nested:
        if rules.stand_for_each_other(ros1.base, ros2.base):
            return ""
        return "the two message types are not counterparts"
    if ros2.base == "wstring":
        return "ROS 1 has no wstring"
    if ros1.base == ros2.base or _same_bits(ros1.base, ros2.base):
        return ""
    return "the two types differ"


def _same_bits(ros1: str, ros2: str) -> bool:
    """Whether two primitives are integers of the same size; a byte is an int8 in ROS 1 and an octet in ROS 2."""
    sizes = PRIMITIVE_SIZES.get(ros1), PRIMITIVE_SIZES.get(ros2)
    floats = any(base.startswith("float") or base == "bool" for base in (ros1, ros2))
    return sizes[0] is not None and sizes[0] == sizes[1] and not floats


def _a(shape: Shape) -> str:
    return {Shape.SINGLE: "a single value", Shape.ARRAY: "an array", Shape.SEQUENCE: "a sequence"}[shape]
