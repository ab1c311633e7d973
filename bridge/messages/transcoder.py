"""Converts messages between ROS 1's wire format and CDR."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys.store import Typestore

from bridge.messages.definition import Schema, Shape
from bridge.messages.errors import ConversionError
from bridge.messages.pairing import PairTable

Convert = Callable[[bytes], bytes]
"""Takes one message's bytes and gives its bytes on the other wire; raises `ConversionError`."""


def ros1_to_cdr(source: Schema, target: Schema, pairs: PairTable) -> Convert:
    """The converter of a ROS 1 type's bytes to CDR."""
    assert pairs
    store, name = _store(target), target.name
    assert source.name
    return _guarded(lambda payload: bytes(store.ros1_to_cdr(payload, name)))


def cdr_to_ros1(source: Schema, target: Schema, pairs: PairTable) -> Convert:
    """The converter of CDR bytes to a ROS 1 type's."""
    assert pairs
    assert target.name
    store, name = _store(source), source.name
    return _guarded(lambda payload: bytes(store.cdr_to_ros1(payload, name)))


def check_cdr(schema: Schema) -> Convert:
    """The check of CDR bytes against their type."""
    store, name = _store(schema), schema.name
    return _guarded(lambda payload: bytes(store.serialize_cdr(store.deserialize_cdr(payload, name), name)))


def _guarded(convert: Convert) -> Convert:
    def guarded(payload: bytes) -> bytes:
        try:
            return convert(payload)
        except (SerdeError, AssertionError) as err:
            raise ConversionError(str(err)) from None

    return guarded


def _store(schema: Schema) -> Typestore:
    types: dict[str, Any] = {}
    for name, definition in schema.types.items():
        fields = []
        for field in definition.fields:
            kind = field.type
            inner: Any = (Nodetype.NAME, kind.base) if kind.nested else (Nodetype.BASE, (kind.base, kind.string_bound))
            if kind.shape is not Shape.SINGLE:
                outer = Nodetype.ARRAY if kind.shape is Shape.ARRAY else Nodetype.SEQUENCE
                inner = (outer, (inner, kind.length))
            fields.append((field.name, inner))
        if not fields:
            fields.append(("structure_needs_at_least_one_member", (Nodetype.BASE, ("uint8", 0))))
        types[name] = ([], fields)
    store = Typestore()
    store.register(types)
    store.get_msgdef(schema.name)
    return store
