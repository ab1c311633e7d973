"""Conversions between two versions of one ROS 2 type, such as those of Jazzy and Lyrical.

Fields correspond by name and type, or by a rule (`bridge.messages.mapping.version_rules`). An added field gets its
default value; a removed field is left out. Two versions convert even if they have no field in common.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from threading import RLock
from typing import Any

from bridge.messages.definitions.library import DefinitionLibrary
from bridge.messages.definitions.schema import DefaultValue, Definition, Field, FieldType, Schema, Shape
from bridge.messages.definitions.versions import TypeVersions
from bridge.messages.errors import MessageTypeError
from bridge.messages.mapping.fields import FieldPath, Fields, field_at
from bridge.messages.mapping.retyping import RetypingConverter, effect, obstacle
from bridge.messages.mapping.version_rules import VersionRules
from bridge.messages.transcode.compiler import compile_pair
from bridge.messages.transcode.conversion import Convert, make_vm
from bridge.messages.unchanged import same

NO_HASH = ""
"""Stands for the Humble version, because Humble's endpoints announce no hash."""

_log = logging.getLogger(__name__)

Losses = tuple[tuple[str, ...], tuple[str, ...]]
"""The fields that a conversion between two versions leaves out, and those whose values may be rounded or refused."""

_Key = tuple[str, str, str, str]
"""Type name, hashes of the source and the target version, and part of a service ("" for the whole type)."""

_MAX_CACHED = 10_000


@dataclass(frozen=True, slots=True)
class VersionMatch:
    """The corresponding fields of two versions.

    Attributes:
        fields: the pairs of field paths, by the names of a message and its counterpart.
        target: the target's schema, with the default values from the rules.
        lost: the source's fields without a counterpart, as ``package/kind/Name.field``.
        changed: the source's fields whose values may be rounded or refused, each with the reason.
        retyped: whether any field's counterpart has a different primitive type.
    """

    fields: Mapping[tuple[str, str], Fields]
    target: Schema
    lost: tuple[str, ...]
    changed: tuple[str, ...]
    retyped: bool


def match_versions(source: Schema, target: Schema, rules: VersionRules) -> VersionMatch:
    """Match the fields of two versions of a type and of the messages that they nest."""
    types = dict(target.types)
    table: dict[tuple[str, str], Fields] = {}
    lost: list[str] = []
    changed: list[str] = []
    retyped = False
    waiting = [(source.name, target.name)]
    while waiting:
        names = waiting.pop()
        if names in table:
            continue
        source_part, target_part = source.sub(names[0]), target.sub(names[1])
        fields = _fields(source_part, target_part, rules)
        table[names] = fields
        lost += _unmapped(source_part, source_part.root, {path for path, _ in fields}, ())
        defaults = rules.defaults(*names)
        if defaults:
            types[target_part.name] = _with_defaults(types[target_part.name], defaults)
        for path1, path2 in fields:
            kind1, kind2 = field_at(source_part, path1), field_at(target_part, path2)
            if kind1 is None or kind2 is None:
                continue
            if kind1.nested:
                waiting.append((kind1.base, kind2.base))
            elif kind1.base != kind2.base:
                retyped = True
                text = effect(kind1.base, kind2.base)
                changed += [f"{'.'.join((source_part.name, *path1))} {text}"] if text else []
    return VersionMatch(table, Schema(types[target.name], types), tuple(lost), tuple(changed), retyped)


def _fields(source: Schema, target: Schema, rules: VersionRules) -> Fields:
    """Return the corresponding fields of two messages; rules come before names, because rules are more specific."""
    pairs: list[tuple[FieldPath, FieldPath]] = []
    for name1, name2, _ in rules.fields(source.name, target.name):
        _add(pairs, source, target, (tuple(name1.split(".")), tuple(name2.split("."))), fits_by_rule, rules)
    for other in source.root.fields:
        _add(pairs, source, target, ((other.name,), (other.name,)), _fits, rules)
    order = [other.name for other in source.root.fields]
    return tuple(sorted(pairs, key=lambda pair: order.index(pair[0][0])))


def _unmapped(schema: Schema, definition: Definition, mapped: Collection[FieldPath], at: FieldPath) -> Iterator[str]:
    """Yield the fields of a message that hold data but have no counterpart."""
    for other in definition.fields:
        path, nested = (*at, other.name), schema.of(other.type)
        if path in mapped or (nested is not None and not nested.fields):
            continue
        if nested is not None and any(deeper[: len(path)] == path for deeper in mapped):
            yield from _unmapped(schema, nested, mapped, path)
        else:
            yield ".".join((schema.name, *path))


def _add(
    pairs: list[tuple[FieldPath, FieldPath]],
    source: Schema,
    target: Schema,
    paths: tuple[FieldPath, FieldPath],
    fits: Callable[[FieldType, FieldType, VersionRules], bool],
    rules: VersionRules,
) -> None:
    """Add a pair of fields, if both exist with fitting types and neither has a counterpart yet."""
    kind1, kind2 = field_at(source, paths[0]), field_at(target, paths[1])
    if kind1 is None or kind2 is None or not fits(kind1, kind2, rules):
        return
    if not any(overlap(paths[0], other1) or overlap(paths[1], other2) for other1, other2 in pairs):
        pairs.append(paths)


def overlap(first: FieldPath, second: FieldPath) -> bool:
    """Whether two paths are equal, or one leads to a field within the other."""
    length = min(len(first), len(second))
    return first[:length] == second[:length]


def _fits(source: FieldType, target: FieldType, rules: VersionRules) -> bool:
    """Whether the values of field ``source`` fit field ``target`` without a rule about the two fields."""
    if source.shape is not target.shape or (source.shape is Shape.ARRAY and source.length != target.length):
        return False
    return rules.replace(source.base, target.base)


def fits_by_rule(source: FieldType, target: FieldType, rules: VersionRules) -> bool:
    """Whether the values of field ``source`` fit field ``target`` if a rule pairs the two fields."""
    return _fits(source, target, rules) or not obstacle(source, target)


def _with_defaults(definition: Definition, defaults: Mapping[str, DefaultValue]) -> Definition:
    fields = (replace(other, default=defaults.get(other.name, other.default)) for other in definition.fields)
    return replace(definition, fields=tuple(fields))


def version_converter(source: Schema, target: Schema, rules: VersionRules) -> Convert:
    """Return the converter of one version's CDR to the other's; `same` if the bytes do not differ."""
    match = match_versions(source, target, rules)
    if match.retyped:
        return RetypingConverter(source, match.target, match.fields).convert
    if _same_layout(source, target, match):
        return same
    return make_vm(compile_pair(source, match.target, lambda old, new: match.fields[old, new])).convert


def _same_layout(source: Schema, target: Schema, match: VersionMatch) -> bool:
    """Whether all fields correspond in the same order, with the same bounds."""
    for (name1, name2), fields in match.fields.items():
        source_fields, target_fields = source.types[name1].fields, target.types[name2].fields
        if not len(fields) == len(source_fields) == len(target_fields):
            return False
        for (path1, path2), field1, field2 in zip(fields, source_fields, target_fields, strict=True):
            if path1 != (field1.name,) or path2 != (field2.name,) or _bounds(field1) != _bounds(field2):
                return False
    return True


def _bounds(field: Field) -> tuple[int, int]:
    return field.type.length, field.type.string_bound


class ReleaseConversions:
    """The conversions between all versions of ROS 2 types. Safe to use from any thread."""

    def __init__(self, ros2: DefinitionLibrary, versions: TypeVersions, rules: VersionRules, lock: RLock) -> None:
        self._ros2, self._versions, self._rules, self._lock = ros2, versions, rules, lock
        self._converters: dict[_Key, Convert | None] = {}
        self._losses: dict[_Key, Losses] = {}
        self._here: dict[tuple[str, str], str] = {}
        self._hashes: dict[str, Collection[str]] = {}
        self._own: dict[str, str] = {}
        self._parts: dict[str, Mapping[tuple[str, str], str]] = {}

    def hashes(self, type_name: str) -> Collection[str]:
        """Return the hashes of all known versions of a type or service, including the installed version."""
        known = self._hashes.get(type_name)
        if known is None:
            with self._lock:
                try:
                    known = dict.fromkeys([*self._versions.of(type_name), *self._installed_hash(type_name)])
                except MessageTypeError:
                    known = ()
                _store(self._hashes, type_name, known)
        return known

    def varies(self, type_name: str) -> bool:
        """Return whether a type or service has several known versions."""
        return len(self.hashes(type_name)) > 1 or self.here(type_name, NO_HASH) != NO_HASH

    def here_hash(self, type_name: str) -> str:
        """Return the hash of this machine's version of a type or service; "" if it is not installed."""
        known = self._own.get(type_name)
        if known is None:
            with self._lock:
                try:
                    known = next(iter(self._installed_hash(type_name)), "")
                except MessageTypeError:
                    known = ""
                _store(self._own, type_name, known)
        return known

    def service_hash(self, service: str, request: str, response: str = "") -> str:
        """Return the hash of the version of a service whose request and response have these hashes.

        A ``response`` of "" matches any response. Returns "" if no version matches, or several do.
        """
        parts = self._service_parts(service)
        if response:
            return parts.get((request, response), "")
        found = {version for (first, _), version in parts.items() if first == request}
        return found.pop() if len(found) == 1 else ""

    def has_request(self, service: str, request: str) -> bool:
        """Return whether the request of any version of a service has this hash."""
        return any(first == request for first, _ in self._service_parts(service))

    def _service_parts(self, service: str) -> Mapping[tuple[str, str], str]:
        """Return the versions of a service by the hashes of request and response."""
        parts = self._parts.get(service)
        if parts is None:
            parts = {}
            with self._lock:
                for version in self.hashes(service):
                    schema = self._schema(service, version)
                    names = (f"{service}_Request", f"{service}_Response")
                    if schema is not None and all(name in schema.types for name in names):
                        request, response = (self._ros2.fingerprint(schema.sub(name)) for name in names)
                        parts[request, response] = version
                _store(self._parts, service, parts)
        return parts

    def here(self, type_name: str, type_hash: str) -> str:
        """Return the installed version's hash if the version ``type_hash`` can be converted, else ``type_hash``."""
        known = self._here.get((type_name, type_hash))
        if known is None:
            with self._lock:
                known = self._find_here(type_name, type_hash)
                _store(self._here, (type_name, type_hash), known)
        return known

    def converter(self, type_name: str, source: str, target: str, part: str = "") -> Convert | None:
        """Return the converter between two versions, given by their hashes; None if either is unknown or unusable.

        ``part`` is ``Request`` or ``Response`` of a service. The converter raises `ConversionError`; it is `same` if
        either version is Humble's (`NO_HASH`), Humble's equals Jazzy's, and the other version is Jazzy's or unknown.
        """
        key = type_name, source, target, part
        with self._lock:
            if key not in self._converters:
                _store(self._converters, key, self._make(key))
            return self._converters[key]

    def losses(self, type_name: str, source: str, target: str, part: str = "") -> Losses:
        """Return the fields that are left out or changed between two versions; none if either is unknown."""
        key = type_name, source, target, part
        with self._lock:
            if key not in self._losses:
                pair = self._pair(key) if self.converter(*key) is not None else None
                match = None if pair is None else match_versions(*pair, self._rules)
                _store(self._losses, key, ((), ()) if match is None else (match.lost, match.changed))
            return self._losses[key]

    def release(self, type_name: str, type_hash: str) -> str:
        """Return the first release or folder that has this version ("humble" for `NO_HASH`); "" if none has it."""
        with self._lock:
            if type_hash == NO_HASH:
                return "humble"
            known = self._versions.of(type_name).get(type_hash)
            return "" if known is None else known[0]

    def _find_here(self, type_name: str, type_hash: str) -> str:
        try:
            installed = self._installed_hash(type_name)
        except MessageTypeError:
            return type_hash
        if not installed or self.converter(type_name, type_hash, installed[0]) is None:
            return type_hash
        hashless = type_hash == NO_HASH and self._versions.hashless(type_name) is None
        return type_hash if hashless else installed[0]

    def _make(self, key: _Key) -> Convert | None:
        try:
            pair = self._pair(key)
            if pair is not None:
                return version_converter(*pair, self._rules)
            return same if NO_HASH in key[1:3] and self._versions.hashless(key[0]) is None else None
        except MessageTypeError:
            return None
        except Exception:  # one type must not end a worker; the result is cached, so this is logged once
            _log.exception("%s: its versions %s and %s cannot be compared", key[0], key[1], key[2])
            return None

    def _pair(self, key: _Key) -> tuple[Schema, Schema] | None:
        """Return the two versions of a type, or of a service's request or response; None if either is unknown."""
        type_name, source, target, part = key
        old, new = self._schema(type_name, source), self._schema(type_name, target)
        if old is None or new is None:
            return None
        name = f"{type_name}_{part}" if part else type_name
        return (old.sub(name), new.sub(name)) if name in old.types and name in new.types else None

    def _schema(self, type_name: str, type_hash: str) -> Schema | None:
        if type_hash == NO_HASH:
            return self._versions.hashless(type_name) or self._versions.jazzy(type_name)
        known = self._versions.of(type_name).get(type_hash)
        if known is not None:
            return known[1]
        return self._ros2.installed(type_name) if type_hash in self._installed_hash(type_name) else None

    def _installed_hash(self, type_name: str) -> list[str]:
        schema = self._ros2.installed(type_name)
        return [] if schema is None else [self._ros2.fingerprint(schema)]


def _store(cache: dict[Any, Any], key: object, value: object) -> None:
    if len(cache) >= _MAX_CACHED:
        cache.clear()
    cache[key] = value
