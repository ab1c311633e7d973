"""From domain_bridge to Midspan: one daemon for each ROS 2 domain, all on one hub.

What the keys mean was read from domain_bridge's ``doc/design.md``, ``parse_domain_bridge_yaml_config.cpp`` and
``domain_bridge.cpp`` (https://github.com/ros2/domain_bridge, main of 2025-01-09): ``topics`` may have a name several
times, ``reversed`` swaps the domains, ``remap`` names the topic in the domain that it goes to (in both directions where
it is ``bidirectional``), ``~`` stands for the bridge's name, and a second bridge of the same topic and domains is
ignored.

On the hub a topic carries the domain that it comes from in its name, ``/domain2/chatter``. So one name of two domains
stays two topics, and each daemon's rules say what leaves to its domain.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from bridge.config.document import ConfigError, Document, KeyPath, Problem, read
from bridge.config.importers.draft import NOT_CARRIED, Draft, RuleDraft, checked, missing, topic_name, type_name
from bridge.config.sections.section import Section

MAX_DEPTH = 100_000

_HEAD = (
    "One daemon joins one domain to the hub, where each topic's name begins with its domain's. The daemons run side by"
    " side and find each other at hub.listen; others join domain"
)
_NEUTRAL = (None, "automatic", "system_default")
_KEYS = ("name", "from_domain", "to_domain", "mode", "topics")


class DomainBridgeQos(Section):
    """QoS that overrides the publishers'."""

    history: Literal["keep_last", "keep_all"] | None = None
    depth: int | None = Field(default=None, ge=0)
    reliability: Literal["reliable", "best_effort"] | None = None
    durability: Literal["volatile", "transient_local"] | None = None
    deadline: int | Literal["auto"] | None = None
    lifespan: int | Literal["auto"] | None = None
    liveliness: Literal["automatic", "manual_by_topic", "system_default"] | None = None
    liveliness_lease_duration: int | None = None


class DomainBridgeTopic(Section):
    """One topic."""

    type: str
    from_domain: int | None = Field(default=None, ge=0, le=232)
    to_domain: int | None = Field(default=None, ge=0, le=232)
    remap: str = ""
    bidirectional: bool = False
    reversed: bool = False
    qos: DomainBridgeQos = Field(default_factory=DomainBridgeQos)


class Top(Section):
    """The file without its topics."""

    name: str = "domain_bridge"
    from_domain: int | None = Field(default=None, ge=0, le=232)
    to_domain: int | None = Field(default=None, ge=0, le=232)
    mode: Literal["normal", "compress", "decompress"] = "normal"
    topics: Any = None
    services: Any = None
    actions: Any = None


@dataclass(frozen=True, slots=True)
class _Way:
    """One topic's way from one domain to another."""

    topic: str
    type: str
    origin: int
    target: int
    new_name: str
    rule: dict[str, Any]
    path: KeyPath

    @property
    def hub_topic(self) -> str:
        return f"/domain{self.origin}{self.topic}"


@dataclass(slots=True)
class _Import:
    document: Document
    top: Top
    notes: list[Problem]
    problems: list[Problem] = field(default_factory=list)
    by_way: dict[KeyPath, list[Problem]] = field(default_factory=dict)

    @property
    def node(self) -> str:
        """The bridge's name as ROS 2 takes one."""
        name = re.sub(r"[^A-Za-z0-9_]", "_", self.top.name)
        return name if name[:1].isalpha() else f"bridge_{name}"

    def note(self, path: KeyPath, text: str) -> Problem:
        return self.document.problem(path, f"{text}; {NOT_CARRIED}", at_key=True)


def drafts(file: Path) -> tuple[list[Draft], list[Problem]]:
    """A configuration for each domain, and notes on what has no counterpart; raises `ConfigError` with all mistakes."""
    document = read(file, repeating=("topics",))
    if not isinstance(document.data, dict) or not document.data.keys() & set(_KEYS):
        raise ConfigError([document.problem((), f"has none of domain_bridge's keys: {', '.join(_KEYS)}")])
    job = _Import(document, *checked(document, (), Top))
    _remarks(job)
    ways = _once(job, list(_ways(job)))
    if not ways and not job.problems:
        job.problems.append(document.problem(("topics",), "has no topic that goes from one domain to another"))
    if job.problems:
        raise ConfigError(job.problems)
    domains = sorted({domain for way in ways for domain in (way.origin, way.target)})
    notes = sorted((*job.notes, *(n for ns in job.by_way.values() for n in ns)), key=lambda n: (n.line, n.column))
    return [_draft(job, domain, domains, ways) for domain in domains], notes


def _remarks(job: _Import) -> None:
    """What concerns the whole file."""
    if job.top.mode != "normal":
        text = "Midspan leaves messages as they are (zenoh can compress: hub.zenoh, transport/unicast/compression)"
        job.notes.append(job.note(("mode",), text))
    for key in ("services", "actions"):
        if getattr(job.top, key):
            job.notes.append(job.note((key,), f"Midspan carries topics, {key} do not cross"))


def _ways(job: _Import) -> Iterator[_Way]:
    entries = job.document.data.get("topics") or []
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        job.problems.append(job.document.problem(("topics",), "must be a map of topic names"))
        return
    for index, entry in enumerate(entries):
        for name in entry:
            try:
                yield from _entry(job, ("topics", index, name), name)
            except ConfigError as err:
                job.problems += err.problems


def _entry(job: _Import, path: KeyPath, name: str) -> Iterator[_Way]:
    """The ways of one entry of ``topics``: one, or two where it is bidirectional."""
    entry, notes = checked(job.document, path, DomainBridgeTopic)
    topic = topic_name(job.document, path, _expanded(job, name))
    new_name = topic_name(job.document, (*path, "remap"), _expanded(job, entry.remap)) if entry.remap else topic
    type_ = type_name(job.document, (*path, "type"), entry.type)
    first, second = (_domain(job, path, entry, key) for key in ("from_domain", "to_domain"))
    if first == second:
        raise ConfigError([job.document.problem(path, f"goes from domain {first} to itself; give two domains")])
    if entry.reversed:
        first, second = second, first
    for key in ("deadline", "lifespan", "liveliness", "liveliness_lease_duration"):
        value = getattr(entry.qos, key)
        if value not in _NEUTRAL and not (isinstance(value, int) and value < 0):  # below 0: for ever
            notes.append(job.note((*path, "qos", key), f"Midspan's publishers on ROS 2 have no {key}"))
    job.by_way[path] = notes
    rule = _options(entry.qos)
    yield _Way(topic, type_, first, second, new_name, rule, path)
    if entry.bidirectional:
        yield _Way(topic, type_, second, first, new_name, rule, path)


def _expanded(job: _Import, name: str) -> str:
    return re.sub(r"^~(?=/|$)", f"/{job.node}", name)


def _domain(job: _Import, path: KeyPath, entry: DomainBridgeTopic, key: str) -> int:
    own, general = getattr(entry, key), getattr(job.top, key)
    domain: int | None = general if own is None else own
    if domain is None:
        raise ConfigError([job.document.problem(path, f"has no {key}; give it here or at the file's top", at_key=True)])
    return domain


def _options(qos: DomainBridgeQos) -> dict[str, Any]:
    rule: dict[str, Any] = {}
    if qos.depth and qos.history != "keep_all":
        rule["depth"] = min(qos.depth, MAX_DEPTH)
    forced = {key: getattr(qos, key) for key in ("reliability", "durability") if getattr(qos, key) is not None}
    return {**rule, "qos": forced} if forced else rule


def _once(job: _Import, ways: list[_Way]) -> list[_Way]:
    """The ways without those that would take a topic to the same domain a second time."""
    kept: dict[tuple[str, str, int, int], _Way] = {}
    for way in ways:
        first = kept.setdefault((way.topic, way.type, way.origin, way.target), way)
        if first is not way:
            line = job.document.keys[first.path].line
            text = f"{way.topic} goes from domain {way.origin} to {way.target} already, by line {line}"
            job.notes.append(job.note(way.path, text))
    return list(kept.values())


def _draft(job: _Import, domain: int, domains: list[int], ways: list[_Way]) -> Draft:
    file = job.document.file
    bridge = job.node
    these = ", ".join(str(other) for other in domains if other != domain)
    head = [
        f"Midspan's configuration for ROS 2 domain {domain}, made from {file.name} by 'midspan import domain_bridge'.",
        f"{_HEAD} {these}.",
    ]
    sections = {
        "name": f"{bridge}_{domain}"[:63],
        "ros1": {"enabled": False},
        "ros2": {"domain": domain, "node": f"{bridge}_{domain}"},
    }
    wide = ["localhost_only: false   # nodes of other machines, which domain_bridge hears as well"]
    rules = [*_entering(job, domain, ways), *_leaving(job, domain, ways)]
    return Draft(f"{bridge}_domain{domain}", head + missing(job.notes), sections, {"ros2": wide}, rules)


def _entering(job: _Import, domain: int, ways: list[_Way]) -> Iterator[RuleDraft]:
    """What goes from the domain to the hub, once however many domains it goes to."""
    seen: set[tuple[str, str]] = set()
    for way in ways:
        if way.origin == domain and (way.topic, way.type) not in seen:
            seen.add((way.topic, way.type))
            rule = {"topic": way.topic, "type": way.type, "from": "ros2", "to": "zenoh", "rename": way.hub_topic}
            yield RuleDraft(_source(job, way), rule)


def _leaving(job: _Import, domain: int, ways: list[_Way]) -> Iterator[RuleDraft]:
    """What goes from the hub to the domain."""
    for way in ways:
        if way.target == domain:
            rule = {"topic": way.hub_topic, "type": way.type, "from": "ros2", "to": "ros2", "rename": way.new_name}
            yield RuleDraft(_source(job, way), {**rule, **way.rule}, job.by_way[way.path])


def _source(job: _Import, way: _Way) -> str:
    place = job.document.keys[way.path].line
    return f"{job.document.file.name}:{place}, domain {way.origin} to {way.target}"
