"""From ros1_bridge's parameter_bridge to Midspan.

The file is what ``rosparam load`` takes: lists ``topics``, ``services_1_to_2`` and ``services_2_to_1``. What each key
means to the bridge was read from its README and ``src/parameter_bridge.cpp``
(https://github.com/ros2/ros1_bridge, master of 2025-05-06): topics cross both ways, ``queue_size`` is ROS 1's (100
where it is not given), ``qos`` holds for the publisher on ROS 2 alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from bridge.config.document import ConfigError, Document, KeyPath, Problem, key_text, read
from bridge.config.importers.draft import NOT_CARRIED, Draft, RuleDraft, checked, missing, topic_name, type_name
from bridge.config.sections.section import Section

MAX_DEPTH = 100_000

# also as numbers of rmw_qos_liveliness_policy_t
_NEUTRAL = ("none", "0", "1", "liveliness_system_default", "liveliness_automatic")
_SERVICES = ("services_1_to_2", "services_2_to_1")
_HEAD = (
    "What the rules do not name does not cross, as with the parameter_bridge. Each topic crosses both ways, latched"
    " where its publisher is. 'qos' holds for what Midspan publishes on ROS 2."
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
    """The configuration, and notes on what has no counterpart; raises `ConfigError` with all mistakes in the file."""
    document = read(file)
    if isinstance(document.data, list) and any(
        isinstance(entry, dict) and "ros1_package_name" in entry for entry in document.data
    ):
        text = "is a list of mapping rules; give the parameter file, and this one with --mapping-rules"
        raise ConfigError([Problem(file, 0, 0, "", text)])
    if not isinstance(document.data, dict) or not document.data.keys() & set(_KNOWN):
        raise ConfigError([document.problem((), f"has none of ros1_bridge's lists: {', '.join(_KNOWN)}")])
    job = _Import(document, [], [], [])
    _topics(job)
    _others(job)
    if job.problems:
        raise ConfigError(job.problems)
    everything = sorted((*job.notes, *(n for r in job.rules for n in r.notes)), key=lambda n: (n.line, n.column))
    sections: dict[str, Any] = {"ros1": {"enabled": True}, "ros2": {"enabled": True}}
    if mapping_rules:
        sections["types"] = {"mapping_rules": [str(path.absolute()) for path in mapping_rules]}
    head = [f"Midspan's configuration, made from ros1_bridge's {file.name} by 'midspan import ros1_bridge'.", _HEAD]
    wide = ["localhost_only: false   # nodes of other machines, which ros1_bridge hears as well"]
    return Draft(file.stem, head + missing(job.notes), sections, {"ros2": wide}, job.rules), everything


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
            job.notes += [job.note(path, f"{name} is there already, in line {seen[name]}", at_key=False)]
            continue
        seen[name] = job.document.values[path].line
        job.rules += rules


def _rules(job: _Import, path: KeyPath) -> list[RuleDraft]:
    """The rule of one topic, and one more where a QoS is forced: on ROS 2 alone, nothing is latched on ROS 1."""
    document = job.document
    topic, notes = checked(document, path, Ros1BridgeTopic)
    rule: dict[str, Any] = {
        "topic": topic_name(document, (*path, "topic"), topic.topic),
        "type": type_name(document, (*path, "type"), topic.type),
    }
    # One number serves both sides here: ROS 2's depth where it is given, else ROS 1's queue.
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


def _others(job: _Import) -> None:
    """Services, and keys that are not the bridge's."""
    for key, value in job.document.data.items():
        if key in _SERVICES:
            entries = value if isinstance(value, list) else [value]
            for index, entry in enumerate(entries):
                name = entry.get("service", "?") if isinstance(entry, dict) else "?"
                path = (key, index) if isinstance(value, list) else (key,)
                text = f"the service {str(name)!r}: Midspan carries topics, services do not cross"
                job.notes.append(job.note(path, text, at_key=False))
        elif key != "topics":
            text = f"'{key_text((key,))}' is not a list of the parameter_bridge ({', '.join(_KNOWN)})"
            job.notes.append(job.note((key,), text))
