"""Rules for types whose versions differ: renamed, moved or retyped fields, and default values of added fields.

The built-in rules are in JSON (``releases/fields.json``), because every worker reads them and should not load a YAML
parser for them. The configuration's files (``types.mapping_rules``) have entries of the same form next to those of
ros1_bridge. Fields with the same name and type need no rule. A rule applies in both directions, between all versions
that have its fields; several entries may be about one message.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from bridge.messages.definitions.names import is_ros2_name
from bridge.messages.definitions.schema import DefaultValue
from bridge.messages.definitions.versions import RELEASES_FOLDER
from bridge.messages.errors import MessageTypeError
from bridge.messages.mapping.rules import is_version_entry, read_entries

_KEYS = ("message", "messages", "fields", "defaults")
_PAIR = 2


@dataclass(frozen=True, slots=True)
class VersionRule:
    """The fields that correspond although their names or types differ, and default values of added fields.

    Attributes:
        older: name of the message in the older version.
        newer: its name in the newer version, usually the same.
        fields: paths in the newer version by the paths in the older version.
        defaults: default values of fields that only the newer version has.
        origin: file and entry, for errors.
    """

    older: str
    newer: str
    fields: Mapping[str, str] = field(default_factory=dict)
    defaults: Mapping[str, DefaultValue] = field(default_factory=dict)
    origin: str = "built in"


class VersionRules:
    """All version rules: those of the given files before the built-in ones."""

    def __init__(self, files: Iterable[Path] = ()) -> None:
        self.given = tuple(rule for file in files for rule in load_version_rules(file))
        self._by_names: dict[tuple[str, str], list[VersionRule]] = {}
        for rule in (*self.given, *built_in()):
            self._by_names.setdefault((rule.older, rule.newer), []).append(rule)

    def fields(self, source: str, target: str) -> Iterator[tuple[str, str, VersionRule]]:
        """Yield the paths of corresponding fields in two versions, in order of precedence."""
        for rule in self._by_names.get((source, target), ()):
            yield from ((path1, path2, rule) for path1, path2 in rule.fields.items())
        for rule in self._by_names.get((target, source), ()):
            yield from ((path2, path1, rule) for path1, path2 in rule.fields.items())

    def defaults(self, source: str, target: str) -> Mapping[str, DefaultValue]:
        """Return the default values of the fields that only the target has."""
        values: dict[str, DefaultValue] = {}
        for rule in reversed(self._by_names.get((source, target), ())):
            values.update(rule.defaults)
        return values

    def replace(self, first: str, second: str) -> bool:
        """Whether two messages may replace each other as the type of a field."""
        return first == second or (first, second) in self._by_names or (second, first) in self._by_names


@cache
def built_in() -> tuple[VersionRule, ...]:
    """Return the rules of ROS 2's releases."""
    entries = json.loads((RELEASES_FOLDER / "fields.json").read_text(encoding="utf-8"))
    return tuple(_rule(entry, "built in") for entry in entries)


def load_version_rules(file: Path) -> list[VersionRule]:
    """Read the version rules in a file; raises `MessageTypeError`, which names the file and the entry."""
    return [_rule(entry, origin) for origin, entry in read_entries(file) if is_version_entry(entry)]


def _rule(entry: Mapping[str, Any], origin: str) -> VersionRule:
    if unknown := [key for key in entry if key not in _KEYS]:
        raise MessageTypeError(
            f"{origin}: unknown key {unknown[0]!r} in a version rule", f"the keys are {', '.join(_KEYS)}"
        )
    if "messages" in entry and "message" in entry:
        raise MessageTypeError(f"{origin}: has both message and messages", "keep one of them")
    key = "messages" if "messages" in entry else "message"
    names = entry[key] if key == "messages" else [entry[key]] * _PAIR
    if not isinstance(names, list) or len(names) != _PAIR or not all(_is_message(name) for name in names):
        raise MessageTypeError(
            f"{origin}: {key} is {entry[key]!r}",
            "write message: package/msg/Name, or two such names in messages; the parts of services and actions are"
            " package/srv/Name_Request, ..._Response, package/action/Name_Goal, ..._Result and ..._Feedback",
        )
    fields, defaults = entry.get("fields", {}), entry.get("defaults", {})
    if not isinstance(fields, dict) or not all(
        isinstance(path, str) and path for pair in fields.items() for path in pair
    ):
        raise MessageTypeError(f"{origin}: fields is not a mapping of older field names to newer ones")
    if not isinstance(defaults, dict) or not all(_is_default(*pair) for pair in defaults.items()):
        raise MessageTypeError(f"{origin}: defaults is not a mapping of field names to numbers, texts or lists of them")
    twice = sorted({path for path in fields.values() if list(fields.values()).count(path) > 1})
    if twice:
        olds = " and ".join(old for old, new in fields.items() if new == twice[0])
        raise MessageTypeError(f"{origin}: both {olds} become {twice[0]}", "keep one of them")
    values = {name: tuple(value) if isinstance(value, list) else value for name, value in defaults.items()}
    return VersionRule(names[0], names[1], dict(fields), values, origin)


def _is_message(name: object) -> bool:
    return isinstance(name, str) and is_ros2_name(name) and (name.split("/")[1] == "msg" or "_" in name.split("/")[2])


def _is_default(name: object, value: object) -> bool:
    values = value if isinstance(value, list) else [value]
    return isinstance(name, str) and all(isinstance(one, bool | int | float | str) for one in values)
