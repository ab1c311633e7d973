"""ros1_bridge's mapping rules: which packages, messages and fields of ROS 1 and ROS 2 stand for each other.

The files are those of ros1_bridge (https://github.com/ros2/ros1_bridge/blob/master/doc/index.rst): a YAML list of
mappings. A rule with ``fields_1_to_2`` maps these fields alone; a path such as ``header.stamp`` names a nested field.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from bridge.messages.errors import MessageTypeError
from bridge.messages.names import legal_type, ros1_candidates, ros2_candidates

_KEYS = {
    "ros1_package_name",
    "ros2_package_name",
    "ros1_message_name",
    "ros2_message_name",
    "fields_1_to_2",
    "ros1_service_name",
    "ros2_service_name",
    "request_fields_1_to_2",
    "response_fields_1_to_2",
    "enable_foreign_mappings",
}


@dataclass(frozen=True, slots=True)
class MessageRule:
    """Two packages, or two messages, that stand for each other.

    Attributes:
        ros1_message: with ``ros2_message``, the messages' short names; "" where the rule speaks of whole packages.
        fields: ROS 1 path to ROS 2 path; None where fields are matched by name.
        origin: file and entry, for error messages.
    """

    ros1_package: str
    ros2_package: str
    ros1_message: str = ""
    ros2_message: str = ""
    fields: Mapping[str, str] | None = None
    origin: str = "built in"


@dataclass(frozen=True, slots=True)
class ServiceRule:
    """Two services that stand for each other."""

    ros1_package: str
    ros2_package: str
    ros1_service: str
    ros2_service: str
    request_fields: Mapping[str, str] | None
    response_fields: Mapping[str, str] | None
    origin: str


_TIME_FIELDS = {"data.secs": "sec", "data.nsecs": "nanosec"}
_LOG_FIELDS = {
    "header.stamp": "stamp",
    "level": "level",
    "name": "name",
    "msg": "msg",
    "file": "file",
    "function": "function",
    "line": "line",
}
BUILT_IN = (
    MessageRule("std_msgs", "builtin_interfaces", "Time", "Time", _TIME_FIELDS),
    MessageRule("std_msgs", "builtin_interfaces", "Duration", "Duration", _TIME_FIELDS),
    MessageRule("tf", "tf2_msgs", "tfMessage", "TFMessage", {"transforms": "transforms"}),
    MessageRule("rosgraph_msgs", "rcl_interfaces", "Log", "Log", _LOG_FIELDS),
)


class Rules:
    """All rules, the configuration's before the built-in ones."""

    def __init__(self, files: Iterable[Path] = ()) -> None:
        loaded = [rule for file in files for rule in load_rules(file)]
        self.services = tuple(rule for rule in loaded if isinstance(rule, ServiceRule))
        # Rules of messages say more than rules of whole packages.
        self._given = sorted((r for r in loaded if isinstance(r, MessageRule)), key=lambda rule: not rule.ros1_message)

    def ros2_names(self, ros1_name: str) -> list[str]:
        """ROS 2 names that may stand for a ROS 1 type, the likeliest first."""
        package, name = ros1_name.split("/")
        ruled = [
            f"{rule.ros2_package}/msg/{rule.ros2_message or name}"
            for rule in (*self._given, *BUILT_IN)
            if rule.ros1_package == package and rule.ros1_message in ("", name)
        ]
        return list(dict.fromkeys([*ruled, *ros2_candidates(ros1_name)]))

    def ros1_names(self, ros2_name: str) -> list[str]:
        """ROS 1 names that may stand for a ROS 2 type, the likeliest first."""
        return list(
            dict.fromkeys(
                [*_ruled_ros1(ros2_name, self._given), *ros1_candidates(ros2_name), *_ruled_ros1(ros2_name, BUILT_IN)]
            )
        )

    def stand_for_each_other(self, ros1_name: str, ros2_name: str) -> bool:
        """Whether the two types are a pair by name or by rule."""
        return (
            ros2_name in self.ros2_names(ros1_name)
            or ros1_name in self.ros1_names(ros2_name)
            or legal_type(ros1_name) == ros2_name
        )

    def fields(self, ros1_name: str, ros2_name: str) -> MessageRule | None:
        """The rule that lists the fields of the pair, None where fields are matched by name."""
        for rule in (*self._given, *BUILT_IN):
            if rule.fields is None:
                continue
            if (f"{rule.ros1_package}/{rule.ros1_message}", f"{rule.ros2_package}/msg/{rule.ros2_message}") == (
                ros1_name,
                ros2_name,
            ):
                return rule
        return None


def _ruled_ros1(ros2_name: str, rules: Iterable[MessageRule]) -> list[str]:
    package, kind, name = ros2_name.split("/")
    return [
        f"{rule.ros1_package}/{rule.ros1_message or name}"
        for rule in rules
        if kind == "msg" and rule.ros2_package == package and rule.ros2_message in ("", name)
    ]


def load_rules(file: Path) -> list[MessageRule | ServiceRule]:
    """Read one mapping-rule file.

    Raises:
        MessageTypeError: naming the file and the entry that is wrong.
    """
    try:
        entries = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, RecursionError, ValueError, yaml.YAMLError) as err:
        msg = f"cannot read the mapping rules {file}: {err}"
        raise MessageTypeError(msg) from None
    if entries is None:
        return []
    if not isinstance(entries, list):
        msg = f"the mapping rules {file} are not a list of entries"
        raise MessageTypeError(msg, "write each rule as a list item, as ros1_bridge's documentation shows")
    return [_rule(entry, f"{file}, entry {number}") for number, entry in enumerate(entries, 1)]


def _rule(entry: Any, origin: str) -> MessageRule | ServiceRule:
    if not isinstance(entry, dict):
        raise MessageTypeError(f"{origin}: not a mapping of keys to values")
    unknown = sorted(str(key) for key in entry.keys() - _KEYS)
    if unknown:
        raise MessageTypeError(f"{origin}: unknown key {unknown[0]!r}", f"known keys: {', '.join(sorted(_KEYS))}")
    packages = _text(entry, "ros1_package_name", origin), _text(entry, "ros2_package_name", origin)
    if not all(packages):
        raise MessageTypeError(f"{origin}: needs ros1_package_name and ros2_package_name")
    services = _both(entry, "ros1_service_name", "ros2_service_name", origin)
    messages = _both(entry, "ros1_message_name", "ros2_message_name", origin)
    if any(services):
        if any(messages):
            raise MessageTypeError(f"{origin}: speaks of messages and of services; write two entries")
        request, response = (_fields(entry, f"{part}_fields_1_to_2", origin) for part in ("request", "response"))
        return ServiceRule(*packages, *services, request, response, origin)
    fields = _fields(entry, "fields_1_to_2", origin)
    if fields is not None and not any(messages):
        raise MessageTypeError(f"{origin}: fields_1_to_2 needs ros1_message_name and ros2_message_name")
    return MessageRule(*packages, *messages, fields, origin)


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


def _fields(entry: Mapping[str, Any], key: str, origin: str) -> Mapping[str, str] | None:
    value = entry.get(key)
    if value is None:
        return None
    if not isinstance(value, dict) or not all(isinstance(x, str) for pair in value.items() for x in pair):
        raise MessageTypeError(f"{origin}: {key} is not a mapping of field names to field names")
    return dict(value)
