"""The standard types of Noetic and Jazzy and the IDL reader, as rosbags ships them."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from functools import cache
from typing import Any

from bridge.messages.definition import Constant, Definition, Field, FieldType, Shape, World
from bridge.messages.errors import MessageTypeError
from bridge.messages.hashes import EMPTY_MEMBER
from bridge.messages.parser import spell

_MODULES = {World.ROS1: "rosbags.typesys.stores.ros1_noetic", World.ROS2: "rosbags.typesys.stores.ros2_jazzy"}
_TIMES = {"builtin_interfaces/msg/Time": "time", "builtin_interfaces/msg/Duration": "duration"}
_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4  # rosbags.interfaces.Nodetype


def find_in_store(name: str, world: World) -> Definition | None:
    """The definition of a standard type of Noetic or Jazzy, None where rosbags has none."""
    store = _store(world)
    key = name if world is World.ROS2 else name.replace("/", "/msg/", 1)
    if world is World.ROS1 and key in _TIMES:
        return None
    return _definition(key, store[key], world) if key in store else None


def store_names(package: str, world: World) -> list[str]:
    """Names of a package's types in the store."""
    names = [key for key in _store(world) if key.startswith(f"{package}/")]
    return names if world is World.ROS2 else [key.replace("/msg/", "/", 1) for key in names]


def parse_idl(text: str, name: str) -> dict[str, Definition]:
    """Read the messages of an ``.idl`` file of ROS 2; those of a service's are its request and response.

    Raises:
        MessageTypeError: the file cannot be read or does not hold ``name``.
    """
    from rosbags.typesys import TypesysError, get_types_from_idl  # slow, and seldom needed

    try:
        types = get_types_from_idl(text)
    except TypesysError as err:
        msg = f"cannot read the IDL definition of {name}: {err}"
        raise MessageTypeError(msg) from None
    found = {key: _definition(key, value, World.ROS2) for key, value in types.items()}
    if name not in found:
        msg = f"the IDL file of {name} defines {', '.join(found) or 'nothing'} instead"
        raise MessageTypeError(msg)
    return found


@cache
def _store(world: World) -> Mapping[str, Any]:
    definitions: Mapping[str, Any] = importlib.import_module(_MODULES[world]).FIELDDEFS
    return definitions


def _definition(key: str, value: Any, world: World) -> Definition:
    constants, fields = value
    name = key if world is World.ROS2 else key.replace("/msg/", "/", 1)
    return Definition(
        name,
        world,
        tuple(Field(f, _type(desc, name, world)) for f, desc in fields if f != EMPTY_MEMBER),
        tuple(Constant(c, base, str(v)) for c, base, v in constants),
    )


def _type(desc: Any, owner: str, world: World) -> FieldType:
    kind, content = int(desc[0]), desc[1]
    if kind in (_ARRAY, _SEQUENCE):
        inner = _type(content[0], owner, world)
        shape = Shape.ARRAY if kind == _ARRAY else Shape.SEQUENCE
        return FieldType(inner.base, shape, content[1], inner.string_bound)
    if kind == _NAME:
        if world is World.ROS1 and content in _TIMES:
            return FieldType(_TIMES[content])
        return FieldType(spell(content, owner, world))
    base, bound = content
    return FieldType({"octet": "byte"}.get(base, base), string_bound=bound)
