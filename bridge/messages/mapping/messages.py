"""Finds the counterparts of ROS 1 and ROS 2 messages, and the conversions of their bytes.

A type that only one world has gets a counterpart with the same fields in the same order; nested types are mapped, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from bridge.messages.definitions.constants import ros1_constants, ros2_constants
from bridge.messages.definitions.library import DefinitionLibrary
from bridge.messages.definitions.names import is_ros1_name, is_ros2_name, legal_fields, legal_type
from bridge.messages.definitions.schema import TIME_TYPES, Definition, Field, FieldType, Schema, World
from bridge.messages.definitions.text import full_text
from bridge.messages.errors import MessageTypeError
from bridge.messages.mapping.fields import has_equal_fields, left_out, pair_types
from bridge.messages.mapping.rules import Rules
from bridge.messages.transcode.conversion import Conversion, SideType, cdr_to_ros1, ros1_to_cdr

Counterpart = Callable[[Schema], Schema]  # returns the other world's schema of a nested type
_TIMES_BACK = {name: base for base, name in TIME_TYPES.items()}


def derive_ros2(ros1: Schema, counterpart: Counterpart, name: str = "") -> Schema:
    """Derive the ROS 2 type for a type that only ROS 1 has; names are made legal in ROS 2."""
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
    """Derive the ROS 1 type for a type that only ROS 2 has; bounds are dropped, but the conversion checks them."""
    package, kind, short = ros2.name.split("/")
    if kind != "msg" and not name:
        raise MessageTypeError(f"{ros2.name} is part of a service or action, for which ROS 1 has no message")
    types: dict[str, Definition] = {}
    fields: list[Field] = []
    for field in ros2.root.fields:
        if field.type.base == "wstring":
            msg = f"{ros2.name} has no counterpart in ROS 1: field {field.name} is a wstring"
            raise MessageTypeError(
                msg, "map it by a rule to a ROS 1 message that leaves the field out (types.mapping_rules)"
            )
        base = _TIMES_BACK.get(field.type.base) or _nested(ros2, field.type, counterpart, types)
        length = field.type.length if field.type.shape.value == "array" else 0
        fields.append(Field(field.name, FieldType(base, field.type.shape, length)))
    root = Definition(name or f"{package}/{short}", World.ROS1, tuple(fields), ros1_constants(ros2.root.constants))
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
    target = counterpart(schema.sub(kind.base))
    types.update({name: target.types[name] for name in (target.name, *target.nested_order())})
    return target.name


def unknown_type(name: str, world: World, wanted: str = "", known: str = "", kind: str = "srv") -> MessageTypeError:
    """Return the error, with its cure, for a message (``msg``), a service or an action that cannot be used."""
    package, kind = name.split("/")[0], "action" if "/action/" in name and kind == "srv" else kind
    if wanted and known:
        hash_name = "md5" if world is World.ROS1 else "hash"
        return MessageTypeError(
            f"{name} has the {hash_name} {wanted} there but {known} here: the definitions differ",
            f"use the same version of {package} on both sides",
        )
    kind_name = {"msg": "type", "srv": "service", "action": "action"}[kind]
    announced = "" if kind == "msg" else ", and no connection announces one"
    return MessageTypeError(
        f"no definition of the {world.value} {kind_name} {name} is known{announced}",
        f"install {package}, or put its .{kind} files into a folder listed in types.folders",
    )


ANY_MD5 = ("", "*")  # md5 values of a ROS 1 endpoint that accepts any definition


class MessageMapping:
    """The registry's messages; the registry holds the lock. Raises `MessageTypeError` for messages it cannot map."""

    def __init__(self, ros1: DefinitionLibrary, ros2: DefinitionLibrary, rules: Rules) -> None:
        self.ros1, self.ros2, self.rules = ros1, ros2, rules
        self._converters: dict[tuple[str, ...], Conversion] = {}
        self._counterparts: dict[tuple[str, str], Schema] = {}
        self._sides: dict[tuple[World, str], tuple[Schema, SideType]] = {}
        ros1.derive, ros2.derive = self._installed_as_ros1, self._installed_as_ros2

    def clear_cache(self) -> None:
        """Clear the cached counterparts, because a new definition may change them."""
        self._counterparts.clear()
        self._sides.clear()

    def side(self, schema: Schema) -> SideType:
        """Return a message type as its side, or the hub, announces it."""
        key = schema.world, schema.name
        known = self._sides.get(key)
        if known is None or known[0] is not schema:
            library = self.ros1 if schema.world is World.ROS1 else self.ros2
            known = self._sides[key] = schema, SideType(schema.name, library.fingerprint(schema), full_text(schema))
        return known[1]

    def conversion(self, source: Schema, target: Schema) -> Conversion:
        """Return the conversion of a type's messages to messages of its counterpart."""
        sides = self.side(source), self.side(target)
        key = (*(side.name for side in sides), *(side.type_id for side in sides))
        if key not in self._converters:
            if source.world is World.ROS1:
                pairs = pair_types(source, target, self.rules)
                convert = ros1_to_cdr(source, target, pairs)
                self._converters[key] = Conversion(*sides, convert, left_out(pairs, self.rules))
            else:
                convert = cdr_to_ros1(source, target, pair_types(target, source, self.rules))
                self._converters[key] = Conversion(*sides, convert)
        return self._converters[key]

    def find_ros1(self, name: str, md5: str = "") -> Schema:
        """Return the ROS 1 message ``name``, derived from ROS 2's if only ROS 2 has it."""
        wanted = "" if md5 in ANY_MD5 else md5
        schema = self.ros1.find(name, wanted, newest=True)
        if schema is not None:
            return schema
        if is_ros1_name(name):
            for candidate in self.rules.ros2_names(name):
                ros2 = self.ros2.find(candidate)
                derived = None if ros2 is None else self.to_ros1(ros2)
                if derived is not None and derived.name == name and wanted in ("", self.ros1.fingerprint(derived)):
                    return derived
        raise unknown_type(name, World.ROS1, wanted, " or ".join(self.ros1.fingerprints(name)), "msg")

    def find_ros2(self, name: str, type_hash: str = "") -> Schema:
        """Return the ROS 2 message ``name``, derived from ROS 1's if only ROS 1 has it."""
        schema = self.ros2.find(name, type_hash)
        if schema is not None:
            return schema
        if is_ros2_name(name):
            for ros1 in self._ros1_variants(name):
                ros2 = self.to_ros2(ros1)
                if ros2.name == name and type_hash in ("", self.ros2.fingerprint(ros2)):
                    return ros2
        raise unknown_type(name, World.ROS2, type_hash, " or ".join(self.ros2.fingerprints(name)), "msg")

    def _installed_as_ros1(self, name: str) -> Schema | None:
        """Derive the ROS 1 message ``name`` from an installed ROS 2 message; None if no message gives this name."""
        for candidate in self.rules.ros2_names(name):
            ros2 = self.ros2.installed(candidate)
            derived = None if ros2 is None else derive_ros1(ros2, self.to_ros1)
            if derived is not None and derived.name == name:
                return derived
        return None

    def _installed_as_ros2(self, name: str) -> Schema | None:
        """Derive the ROS 2 message ``name`` from an installed ROS 1 message; None if no message gives this name."""
        for candidate in self._ros1_names(name):
            ros1 = self.ros1.installed(candidate)
            derived = None if ros1 is None else derive_ros2(ros1, self.to_ros2)
            if derived is not None and derived.name == name:
                return derived
        return None

    def _ros1_variants(self, ros2_name: str) -> Iterator[Schema]:
        """Yield all ROS 1 definitions that may correspond to a ROS 2 name, the likeliest first."""
        for name in self._ros1_names(ros2_name):
            yield from self.ros1.variants(name)

    def _ros1_names(self, ros2_name: str) -> Iterator[str]:
        """Yield the ROS 1 names that may correspond to a ROS 2 name, the likeliest first."""
        names = self.rules.ros1_names(ros2_name)
        yield from names
        for name in self.ros1.names(ros2_name.split("/", 1)[0]):
            if name not in names and legal_type(name) == ros2_name:
                yield name

    def to_ros2(self, ros1: Schema) -> Schema:
        """Return the ROS 2 type for a ROS 1 type: installed, or announced with equal fields, or else derived."""
        key = (ros1.name, self.ros1.fingerprint(ros1))
        if key not in self._counterparts:
            self._counterparts[key] = self._match_ros2(ros1)
        return self._counterparts[key]

    def _match_ros2(self, ros1: Schema) -> Schema:
        names = self.rules.ros2_names(ros1.name)
        for name in names:
            schema = self.ros2.installed(name)
            if schema is not None:
                return schema
        for name in names:
            for announced in self.ros2.variants(name):
                if has_equal_fields(ros1, announced, self.rules):
                    return announced
        return derive_ros2(ros1, self.to_ros2)

    def to_ros1(self, ros2: Schema) -> Schema:
        """Return the ROS 1 type for a ROS 2 type: one that maps back to ``ros2``, the likeliest, or a derived one.

        Announced types come before installed ones.
        """
        key = (ros2.name, self.ros2.fingerprint(ros2))
        if key not in self._counterparts:
            self._counterparts[key] = self._match_ros1(ros2, key[1])
        return self._counterparts[key]

    def _match_ros1(self, ros2: Schema, wanted: str) -> Schema:
        first: Schema | None = None
        for ros1 in self._ros1_variants(ros2.name):
            back = self.to_ros2(ros1)
            if back.name == ros2.name and self.ros2.fingerprint(back) == wanted:
                return ros1
            first = first or ros1
        return first or derive_ros1(ros2, self.to_ros1)

    def derivable(self, package: str) -> Iterator[Schema]:
        """Yield the ROS 2 types of a package that are counterparts of the package's ROS 1 types."""
        for name in self.ros1.names(package):
            ros1 = self.ros1.find(name, newest=True)
            if ros1 is None:
                continue
            try:
                ros2 = self.to_ros2(ros1)
            except MessageTypeError:
                continue
            if ros2.root.package == package:
                yield ros2
