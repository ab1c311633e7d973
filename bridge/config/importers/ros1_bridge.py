"""Converts a parameter file for ros1_bridge (parameter_bridge) into a configuration.

The file is one for ``rosparam load``: lists ``topics``, ``services_1_to_2`` and ``services_2_to_1``. The meaning of the
keys is taken from ros1_bridge's README and ``src/parameter_bridge.cpp`` (https://github.com/ros2/ros1_bridge, master of
2025-05-06): topics are bridged in both directions, ``queue_size`` is ROS 1's (default 100), ``qos`` is for the
publisher on ROS 2. A service is bridged in one direction. In ``services_1_to_2``, clients on ROS 1 call a server on
ROS 2, and the type is ROS 2's; in ``services_2_to_1``, clients on ROS 2 call a server on ROS 1, and the type is ROS
1's. ``package`` is an older spelling of the type's first part.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from bridge.config.document import ConfigError, Document, KeyPath, Problem, key_text, read
from bridge.config.importers.draft import NOT_CARRIED, Draft, RuleDraft, checked, missing, topic_name, type_name
from bridge.config.sections.section import Section

MAX_DEPTH = 100_000

# names, and the numbers of rmw_qos_liveliness_policy_t
_NEUTRAL = ("none", "0", "1", "liveliness_system_default", "liveliness_automatic")
_SERVICES = {"services_1_to_2": ("ros2", "ros1"), "services_2_to_1": ("ros1", "ros2")}
"""The lists of services: the side of the server, and the side of the clients."""

_ROS1_TYPE = re.compile(r"[A-Za-z]\w*/(?:srv/)?[A-Za-z]\w*")
_HEAD = (
    "Only names that the rules list are bridged, as with the parameter_bridge. Each topic is bridged in both"
    " directions, latched if its publisher is; each service from the side of its server. 'qos' applies to Midspan's"
    " publishers on ROS 2."
)
_KNOWN = ("topics", *_SERVICES)


class Span(Section):
    """A duration."""

    secs: int = 0
    nsecs: int = 0


class Ros1BridgeQos(Section):
    """QoS of the publisher on ROS 2."""

    history: Literal["keep_last", "keep_all"] | None = None
    depth: int | None = Field(default=None, ge=0)
    reliability: Literal["reliable", "best_effort"] | None = None
    durability: Literal["volatile", "transient_local"] | None = None
    deadline: Span | None = None
    lifespan: Span | None = None
    liveliness: int | str | None = None
    liveliness_lease_duration: Span | None = None


class Ros1BridgeService(Section):
    """One service."""

    service: str
    type: str
    package: str = ""


class Ros1BridgeTopic(Section):
    """One topic."""

    topic: str
    type: str
    queue_size: int = Field(default=0, ge=0)
    qos: Ros1BridgeQos = Field(default_factory=Ros1BridgeQos)


@dataclass(slots=True)
class _Import:
    document: Document
    notes: list[Problem]
    problems: list[Problem]
    rules: list[RuleDraft]

    def note(self, path: KeyPath, text: str, *, at_key: bool = True) -> Problem:
        return self.document.problem(path, f"{text}; {NOT_CARRIED}", at_key=at_key)


def draft(file: Path, mapping_rules: Sequence[Path] = ()) -> tuple[Draft, list[Problem]]:
    """Return the configuration, and notes on entries without a counterpart; raises `ConfigError` with all mistakes."""
    document = read(file)
    if isinstance(document.data, list) and any(
        isinstance(entry, dict) and "ros1_package_name" in entry for entry in document.data
    ):
        text = "is a list of mapping rules; name the parameter file instead, and this file after --mapping-rules"
        raise ConfigError([Problem(file, 0, 0, "", text)])
    if not isinstance(document.data, dict) or not document.data.keys() & set(_KNOWN):
        raise ConfigError([document.problem((), f"has none of ros1_bridge's lists: {', '.join(_KNOWN)}")])
    job = _Import(document, [], [], [])
    _topics(job)
    _services(job)
    _others(job)
    if job.problems:
        raise ConfigError(job.problems)
    notes = sorted((*job.notes, *(n for r in job.rules for n in r.notes)), key=lambda n: (n.line, n.column))
    sections: dict[str, Any] = {"ros1": {"enabled": True}, "ros2": {"enabled": True}}
    if mapping_rules:
        sections["types"] = {"mapping_rules": [str(path.absolute()) for path in mapping_rules]}
    head = [f"Midspan's configuration, made from ros1_bridge's {file.name} by 'midspan import ros1_bridge'.", _HEAD]
    hint = ["localhost_only: false   # also nodes of other machines, as with ros1_bridge"]
    return Draft(file.stem, head + missing(job.notes), sections, {"ros2": hint}, job.rules), notes


def _topics(job: _Import) -> None:
    entries = job.document.data.get("topics") or []
    if not isinstance(entries, list):
        job.problems.append(job.document.problem(("topics",), "must be a list, each entry with 'topic' and 'type'"))
        return
    seen: dict[str, int] = {}
    for index in range(len(entries)):
        path: KeyPath = ("topics", index)
        try:
            rules = _rules(job, path)
        except ConfigError as err:
            job.problems += err.problems
            continue
        name = rules[0].rule["topic"]
        if name in seen:
            job.notes.append(job.note(path, f"{name} is already listed in line {seen[name]}", at_key=False))
            continue
        seen[name] = job.document.values[path].line
        job.rules += rules


def _rules(job: _Import, path: KeyPath) -> list[RuleDraft]:
    """Return the rule of one topic, and, if a QoS is forced, a second rule, which is for ROS 2 only."""
    document = job.document
    topic, notes = checked(document, path, Ros1BridgeTopic)
    rule: dict[str, Any] = {
        "topic": topic_name(document, (*path, "topic"), topic.topic),
        "type": type_name(document, (*path, "type"), topic.type),
    }
    # A rule has one depth for both sides: ROS 2's depth if it is given, else ROS 1's queue.
    depth = topic.qos.depth or topic.queue_size
    if depth and topic.qos.history != "keep_all":
        rule["depth"] = min(depth, MAX_DEPTH)
    for key in ("deadline", "lifespan", "liveliness", "liveliness_lease_duration"):
        if str(getattr(topic.qos, key)).lower() not in _NEUTRAL:
            notes.append(job.note((*path, "qos", key), f"Midspan's publishers on ROS 2 have no {key}"))
    source = f"{document.file.name}:{document.values[path].line}"
    qos = {key: getattr(topic.qos, key) for key in ("reliability", "durability") if getattr(topic.qos, key) is not None}
    forced = [RuleDraft(f"{source}, on ROS 2", {**rule, "to": "ros2", "qos": qos})] if qos else []
    return [RuleDraft(source, rule, notes), *forced]


def _services(job: _Import) -> None:
    for key, (server, client) in _SERVICES.items():
        entries = job.document.data.get(key) or []
        if not isinstance(entries, list):
            text = "must be a list, each entry with 'service' and 'type'"
            job.problems.append(job.document.problem((key,), text))
            continue
        seen: dict[str, int] = {}
        for index in range(len(entries)):
            path: KeyPath = (key, index)
            try:
                rule = _service_rule(job, path, server, client)
            except ConfigError as err:
                job.problems += err.problems
                continue
            name = rule.rule["topic"]
            if name in seen:
                job.notes.append(job.note(path, f"{name} is already listed in line {seen[name]}", at_key=False))
                continue
            seen[name] = job.document.values[path].line
            job.rules.append(rule)


def _service_rule(job: _Import, path: KeyPath, server: str, client: str) -> RuleDraft:
    """Return the rule of one service, which is bridged from the side of its server only.

    A server on ROS 1 has a ROS 1 type, which other rules may map to any ROS 2 type; so the rule has no type.
    """
    document = job.document
    service, notes = checked(document, path, Ros1BridgeService)
    name = topic_name(document, (*path, "service"), service.service, "service")
    type_ = f"{service.package}/{service.type}" if service.package else service.type
    rule: dict[str, Any] = {"kind": "service", "topic": name}
    if server == "ros2":
        rule["type"] = type_name(document, (*path, "type"), type_, "service")
    elif not _ROS1_TYPE.fullmatch(type_):
        text = f"{type_!r} is not a service type of ROS 1, such as std_srvs/SetBool"
        raise ConfigError([document.problem((*path, "type"), text)])
    source = f"{document.file.name}:{document.values[path].line}, {type_} on {'ROS 1' if server == 'ros1' else 'ROS 2'}"
    return RuleDraft(source, {**rule, "from": server, "to": client}, notes)


def _others(job: _Import) -> None:
    """Add notes on the keys that are not lists of the bridge."""
    for key in job.document.data:
        if key not in _KNOWN:
            text = f"'{key_text((key,))}' is not a list of the parameter_bridge ({', '.join(_KNOWN)})"
            job.notes.append(job.note((key,), text))
