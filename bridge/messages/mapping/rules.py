"""ros1_bridge's mapping rules: which packages, messages, services and fields of ROS 1 and ROS 2 are counterparts.

The files are those of ros1_bridge (https://github.com/ros2/ros1_bridge/blob/master/doc/index.rst): a YAML list of
mappings. A rule with ``fields_1_to_2`` maps only these fields; a path such as ``header.stamp`` names a nested field.
Rules for actions, which ros1_bridge lacks, are written the same way: ``ros1_action_name``, ``ros2_action_name``, and
``goal_fields_1_to_2``, ``result_fields_1_to_2``, ``feedback_fields_1_to_2``. The same files may contain rules about
versions of ROS 2 types (`bridge.messages.mapping.version_rules`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bridge.messages.definitions.names import legal_type, ros1_candidates, ros2_candidates, split_part
from bridge.messages.errors import MessageTypeError

Fields = Mapping[str, str]  # ROS 1 path to ROS 2 path
_PARTS = {
    "message": {"": "fields_1_to_2"},
    "service": {part: f"{part.lower()}_fields_1_to_2" for part in ("Request", "Response")},
    "action": {part: f"{part.lower()}_fields_1_to_2" for part in ("Goal", "Result", "Feedback")},
}
"""For each kind of rule, the parts whose fields it may map, with the key for each part."""

_KINDS = {"message": "msg", "service": "srv", "action": "action"}
_KEYS = {
    "ros1_package_name",
    "ros2_package_name",
    "enable_foreign_mappings",
    *(f"{side}_{part}_name" for side in ("ros1", "ros2") for part in _PARTS),
    *(key for parts in _PARTS.values() for key in parts.values()),
}


@dataclass(frozen=True, slots=True)
class MappingRule:
    """Two packages, messages, services or actions that are counterparts."""

    ros1_package: str
    ros2_package: str
    ros1: str = ""  #: with ``ros2``, the short names; "" if the rule maps whole packages
    ros2: str = ""
    kind: str = ""  #: ``msg``, ``srv`` or ``action`` as in ROS 2's names; "" if the rule maps whole packages
    # by part ("" for a message, ``Request``, ``Goal`` ...), for the parts whose fields are not matched by name
    fields: Mapping[str, Fields] = field(default_factory=dict)
    origin: str = "built in"  #: file and entry, for error messages


@dataclass(frozen=True, slots=True)
class FieldRule:
    """The corresponding fields of two types; all other fields have no counterpart."""

    fields: Fields
    origin: str


_TIME_FIELDS = {"": {"data.secs": "sec", "data.nsecs": "nanosec"}}
_LOG_FIELDS = {
    "": {"header.stamp": "stamp"} | {name: name for name in ("level", "name", "msg", "file", "function", "line")}
}
_MOVE_BASE_FIELDS = {
    "Goal": {"target_pose": "pose"},
    "Result": dict[str, str](),
    "Feedback": {"base_position": "current_pose"},
}
_GRID_MAP_FIELDS = {
    "": {"info.header": "header"}
    | {f"info.{name}": f"info.{name}" for name in ("resolution", "length_x", "length_y", "pose")}
    | {name: name for name in ("layers", "basic_layers", "data", "outer_start_index", "inner_start_index")}
}
BUILT_IN = (
    MappingRule("std_msgs", "builtin_interfaces", "Time", "Time", "msg", _TIME_FIELDS),
    MappingRule("std_msgs", "builtin_interfaces", "Duration", "Duration", "msg", _TIME_FIELDS),
    MappingRule("tf", "tf2_msgs", "tfMessage", "TFMessage", "msg", {"": {"transforms": "transforms"}}),
    MappingRule("rosgraph_msgs", "rcl_interfaces", "Log", "Log", "msg", _LOG_FIELDS),
    MappingRule("grid_map_msgs", "grid_map_msgs", "GridMap", "GridMap", "msg", _GRID_MAP_FIELDS),
    # example_interfaces' own rule
    MappingRule("roscpp_tutorials", "example_interfaces", "TwoInts", "AddTwoInts", "srv"),
    MappingRule("move_base_msgs", "nav2_msgs", "MoveBase", "NavigateToPose", "action", _MOVE_BASE_FIELDS),
)


class Rules:
    """All rules, the configuration's before the built-in ones."""

    def __init__(self, files: Iterable[Path] = ()) -> None:
        loaded = [rule for file in files for rule in load_rules(file)]
        # rules of messages are more specific than rules of whole packages
        self._given = sorted(loaded, key=lambda rule: not rule.ros1)
        self._fields: dict[tuple[str, str], FieldRule] = {}
        for rule in (*self._given, *BUILT_IN):
            for part, fields in rule.fields.items():
                self._fields.setdefault(_part_names(rule, part), FieldRule(fields, rule.origin))

    def ros2_names(self, ros1_name: str, kind: str = "msg") -> list[str]:
        """Return the likely ROS 2 names for a ROS 1 message, service (``srv``) or ``action``, the likeliest first."""
        package, name = ros1_name.split("/")
        ruled = [
            f"{rule.ros2_package}/{kind}/{rule.ros2 or name}"
            for rule in (*self._given, *BUILT_IN)
            if rule.ros1_package == package and (rule.kind, rule.ros1) in (("", ""), (kind, name))
        ]
        return list(dict.fromkeys([*ruled, *ros2_candidates(ros1_name, kind)]))

    def ros1_names(self, ros2_name: str) -> list[str]:
        """Return the likely ROS 1 names for a ROS 2 message, service or action, the likeliest first."""
        return list(
            dict.fromkeys(
                [*_ruled_ros1(ros2_name, self._given), *ros1_candidates(ros2_name), *_ruled_ros1(ros2_name, BUILT_IN)]
            )
        )

    def stand_for_each_other(self, ros1_name: str, ros2_name: str) -> bool:
        """Whether two messages are a pair by name or by rule; goals, results and feedback are if their actions are.

        An example is ``move_base_msgs/MoveBaseGoal`` and ``nav2_msgs/action/NavigateToPose_Goal``.
        """
        kind = ros2_name.split("/")[1]
        if kind == "action":
            ros2_name, part = split_part(ros2_name)
            if not ros1_name.endswith(part):
                return False
            ros1_name = ros1_name.removesuffix(part)
        return (
            ros2_name in self.ros2_names(ros1_name, kind)
            or ros1_name in self.ros1_names(ros2_name)
            or legal_type(ros1_name, kind) == ros2_name
        )

    def fields(self, ros1_name: str, ros2_name: str) -> FieldRule | None:
        """Return the rule that lists the fields of the pair; None if the fields are matched by name."""
        return self._fields.get((ros1_name, ros2_name))


def _part_names(rule: MappingRule, part: str) -> tuple[str, str]:
    """Return the ROS 1 and ROS 2 names of a rule's part: of its message, request, goal ..."""
    middle = "srv/" if rule.kind == "srv" else ""
    short1 = f"{rule.ros1}_{part}" if rule.kind == "srv" else f"{rule.ros1}{part}"
    short2 = f"{rule.ros2}_{part}" if part else rule.ros2
    return f"{rule.ros1_package}/{middle}{short1}", f"{rule.ros2_package}/{rule.kind}/{short2}"


def _ruled_ros1(ros2_name: str, rules: Iterable[MappingRule]) -> list[str]:
    package, kind, name = ros2_name.split("/")
    if kind != "msg" and split_part(ros2_name)[1]:
        return []
    return [
        f"{rule.ros1_package}/{rule.ros1 or name}"
        for rule in rules
        if rule.ros2_package == package and (rule.kind, rule.ros2) in (("", ""), (kind, name))
    ]


def load_rules(file: Path) -> list[MappingRule]:
    """Read the mapping rules of one file; raises `MessageTypeError`, which names the file and the wrong entry."""
    return [_rule(entry, origin) for origin, entry in read_entries(file) if not is_version_entry(entry)]


def read_entries(file: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the entries of a rule file, each with its origin; raises `MessageTypeError` if it is not a rule file."""
    import yaml  # most configurations have no rule file

    try:
        entries = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, RecursionError, ValueError, yaml.YAMLError) as err:
        raise MessageTypeError(f"cannot read the mapping rules {file}: {err}") from None
    if entries is None:
        return
    if not isinstance(entries, list):
        msg = f"the mapping rules {file} are not a list of entries"
        raise MessageTypeError(msg, "write each rule as a list item, as ros1_bridge's documentation shows")
    for number, entry in enumerate(entries, 1):
        origin = f"{file}, entry {number}"
        if not isinstance(entry, dict):
            raise MessageTypeError(f"{origin}: not a mapping of keys to values")
        yield origin, entry


def is_version_entry(entry: Mapping[str, Any]) -> bool:
    """Whether an entry is a rule about the versions of a type (`bridge.messages.mapping.version_rules`)."""
    return "message" in entry or "messages" in entry


def _rule(entry: Mapping[str, Any], origin: str) -> MappingRule:
    unknown = sorted(str(key) for key in entry.keys() - _KEYS)
    if unknown:
        raise MessageTypeError(f"{origin}: unknown key {unknown[0]!r}", f"known keys: {', '.join(sorted(_KEYS))}")
    packages = _text(entry, "ros1_package_name", origin), _text(entry, "ros2_package_name", origin)
    if not all(packages):
        raise MessageTypeError(f"{origin}: needs ros1_package_name and ros2_package_name")
    named = {prefix: _both(entry, f"ros1_{prefix}_name", f"ros2_{prefix}_name", origin) for prefix in _PARTS}
    meant = [prefix for prefix, names in named.items() if any(names)]
    if len(meant) > 1:
        raise MessageTypeError(f"{origin}: names both {meant[0]}s and {meant[1]}s; write two entries")
    prefix = meant[0] if meant else ""
    fields: dict[str, Fields] = {}
    for other, parts in _PARTS.items():
        for part, key in parts.items():
            value = _fields(entry, key, origin)
            if value is None:
                continue
            if other != prefix:
                raise MessageTypeError(f"{origin}: {key} needs ros1_{other}_name and ros2_{other}_name")
            fields[part] = value
    names = named[prefix] if prefix else ("", "")
    return MappingRule(*packages, *names, _KINDS.get(prefix, ""), fields, origin)


def _both(entry: Mapping[str, Any], first: str, second: str, origin: str) -> tuple[str, str]:
    pair = _text(entry, first, origin), _text(entry, second, origin)
    if any(pair) and not all(pair):
        raise MessageTypeError(f"{origin}: {first} and {second} go together")
    return pair


def _text(entry: Mapping[str, Any], key: str, origin: str) -> str:
    value = entry.get(key, "")
    if not isinstance(value, str):
        raise MessageTypeError(f"{origin}: {key} is not text but {value!r}")
    return value


def _fields(entry: Mapping[str, Any], key: str, origin: str) -> Fields | None:
    value = entry.get(key)
    if value is None:
        return None
    if not isinstance(value, dict) or not all(isinstance(x, str) for pair in value.items() for x in pair):
        raise MessageTypeError(f"{origin}: {key} is not a mapping of field names to field names")
    return dict(value)
