"""Converts a file of domain_bridge into configurations of one daemon for each ROS 2 domain, all on one hub.

The meaning of the keys is taken from domain_bridge's ``doc/design.md``, ``parse_domain_bridge_yaml_config.cpp`` and
``domain_bridge.cpp`` (https://github.com/ros2/domain_bridge, main of 2025-01-09): ``topics`` may have a name several
times, ``reversed`` swaps the domains, ``remap`` is the topic's name in the target domain (in both directions if it is
``bidirectional``), ``~`` is the bridge's name, and a second bridge of the same topic and domains is ignored.
``services`` and ``actions`` have the same keys except ``qos``, and their server is in ``from_domain``.

On the hub, a topic's name begins with the domain that it comes from, as in ``/domain2/chatter``. A name that two
domains use therefore stays two topics, and each daemon's rules list the topics that go to its domain. This is also true
of services and actions.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from bridge.config.document import ConfigError, Document, KeyPath, Problem, read
from bridge.config.importers.draft import NOT_CARRIED, Draft, Kind, RuleDraft, checked, missing, topic_name, type_name
from bridge.config.sections.section import Section

MAX_DEPTH = 100_000

_HEAD = (
    "This daemon joins one domain to the hub, where each name begins with the name of its domain. The daemons run side"
    " by side and find each other at hub.listen; the others join domain"
)
_LISTS: dict[Kind, str] = {"topic": "topics", "service": "services", "action": "actions"}
"""The key of the file under which the entries of each kind are listed."""
_NEUTRAL = (None, "automatic", "system_default")
_KEYS = ("name", "from_domain", "to_domain", "mode", *_LISTS.values())


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
    """One topic, service or action."""

    type: str
    from_domain: int | None = Field(default=None, ge=0, le=232)
    to_domain: int | None = Field(default=None, ge=0, le=232)
    remap: str = ""
    bidirectional: bool = False
    reversed: bool = False
    qos: DomainBridgeQos = Field(default_factory=DomainBridgeQos)


class Top(Section):
    """The file without its topics, services and actions."""

    name: str = "domain_bridge"
    from_domain: int | None = Field(default=None, ge=0, le=232)
    to_domain: int | None = Field(default=None, ge=0, le=232)
    mode: Literal["normal", "compress", "decompress"] = "normal"
    topics: Any = None
    services: Any = None
    actions: Any = None


@dataclass(frozen=True, slots=True)
class _Route:
    """One topic, service or action that is bridged from one domain to another."""

    kind: Kind
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

    def matching(self, topic: str) -> dict[str, Any]:
        """Return the keys with which a rule matches ``topic``, the name on one side; rules for topics need no kind."""
        kind = {} if self.kind == "topic" else {"kind": self.kind}
        return {**kind, "topic": topic, "type": self.type, "from": "ros2"}


@dataclass(slots=True)
class _Import:
    document: Document
    top: Top
    notes: list[Problem]
    problems: list[Problem] = field(default_factory=list)
    notes_by_entry: dict[KeyPath, list[Problem]] = field(default_factory=dict)

    @property
    def node(self) -> str:
        """The bridge's name with the characters that ROS 2 allows."""
        name = re.sub(r"[^A-Za-z0-9_]", "_", self.top.name)
        return name if name[:1].isalpha() else f"bridge_{name}"

    def note(self, path: KeyPath, text: str) -> Problem:
        return self.document.problem(path, f"{text}; {NOT_CARRIED}", at_key=True)


def drafts(file: Path) -> tuple[list[Draft], list[Problem]]:
    """Return a configuration for each domain, and notes on entries without a counterpart.

    Raises `ConfigError` with all mistakes.
    """
    document = read(file, repeating=[(key,) for key in _LISTS.values()])
    if not isinstance(document.data, dict) or not document.data.keys() & set(_KEYS):
        raise ConfigError([document.problem((), f"has none of domain_bridge's keys: {', '.join(_KEYS)}")])
    job = _Import(document, *checked(document, (), Top))
    _remarks(job)
    routes = _without_repeats(job, list(_routes(job)))
    if not routes and not job.problems:
        text = "has no topic, service or action that goes from one domain to another"
        job.problems.append(document.problem(("topics",), text))
    if job.problems:
        raise ConfigError(job.problems)
    domains = sorted({domain for route in routes for domain in (route.origin, route.target)})
    notes = sorted(
        (*job.notes, *(n for ns in job.notes_by_entry.values() for n in ns)), key=lambda n: (n.line, n.column)
    )
    return [_draft(job, domain, domains, routes) for domain in domains], notes


def _remarks(job: _Import) -> None:
    """Note the keys at the top of the file that have no counterpart."""
    if job.top.mode != "normal":
        text = "Midspan leaves messages as they are (zenoh can compress: hub.zenoh, transport/unicast/compression)"
        job.notes.append(job.note(("mode",), text))


def _routes(job: _Import) -> Iterator[_Route]:
    for kind, key in _LISTS.items():
        entries = job.document.data.get(key) or []
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            job.problems.append(job.document.problem((key,), f"must be a map of {kind} names"))
            continue
        for index, entry in enumerate(entries):
            for name in entry:
                try:
                    yield from _entry(job, (key, index, name), name, kind)
                except ConfigError as err:
                    job.problems += err.problems


def _entry(job: _Import, path: KeyPath, name: str, kind: Kind) -> Iterator[_Route]:
    """Yield the routes of one entry: two if it is bidirectional, else one."""
    entry, notes = checked(job.document, path, DomainBridgeTopic)
    topic = topic_name(job.document, path, _expand(job, name), kind)
    new_name = topic_name(job.document, (*path, "remap"), _expand(job, entry.remap), kind) if entry.remap else topic
    type_ = type_name(job.document, (*path, "type"), entry.type, kind)
    first, second = (_domain(job, path, entry, key) for key in ("from_domain", "to_domain"))
    if first == second:
        raise ConfigError([job.document.problem(path, f"goes from domain {first} to itself; give two domains")])
    if entry.reversed:
        first, second = second, first
    rule: dict[str, Any] = {}
    if kind == "topic":
        notes += _without_counterpart(job, path, entry.qos)
        rule = _options(entry.qos)
    elif entry.qos != DomainBridgeQos():
        notes.append(job.note((*path, "qos"), "a rule's depth and QoS are for topics only"))
    job.notes_by_entry[path] = notes
    yield _Route(kind, topic, type_, first, second, new_name, rule, path)
    if entry.bidirectional:
        yield _Route(kind, topic, type_, second, first, new_name, rule, path)


def _without_counterpart(job: _Import, path: KeyPath, qos: DomainBridgeQos) -> Iterator[Problem]:
    """Yield notes on the QoS policies that Midspan's publishers do not have."""
    for key in ("deadline", "lifespan", "liveliness", "liveliness_lease_duration"):
        value = getattr(qos, key)
        if value not in _NEUTRAL and not (isinstance(value, int) and value < 0):  # below 0: infinite
            yield job.note((*path, "qos", key), f"Midspan's publishers on ROS 2 have no {key}")


def _expand(job: _Import, name: str) -> str:
    return re.sub(r"^~(?=/|$)", f"/{job.node}", name)


def _domain(job: _Import, path: KeyPath, entry: DomainBridgeTopic, key: str) -> int:
    specific, general = getattr(entry, key), getattr(job.top, key)
    domain: int | None = general if specific is None else specific
    if domain is None:
        raise ConfigError([job.document.problem(path, f"has no {key}; give it here or at the file's top", at_key=True)])
    return domain


def _options(qos: DomainBridgeQos) -> dict[str, Any]:
    rule: dict[str, Any] = {}
    if qos.depth and qos.history != "keep_all":
        rule["depth"] = min(qos.depth, MAX_DEPTH)
    forced = {key: getattr(qos, key) for key in ("reliability", "durability") if getattr(qos, key) is not None}
    return {**rule, "qos": forced} if forced else rule


def _without_repeats(job: _Import, routes: list[_Route]) -> list[_Route]:
    """Return the routes; if several bridge the same topic between the same domains, return only the first of them."""
    kept: dict[tuple[str, str, str, int, int], _Route] = {}
    for route in routes:
        first = kept.setdefault((route.kind, route.topic, route.type, route.origin, route.target), route)
        if first is not route:
            line = job.document.keys[first.path].line
            text = f"line {line} already bridges {route.topic} from domain {route.origin} to {route.target}"
            job.notes.append(job.note(route.path, text))
    return list(kept.values())


def _draft(job: _Import, domain: int, domains: list[int], routes: list[_Route]) -> Draft:
    file = job.document.file
    bridge = job.node
    other_domains = ", ".join(str(other) for other in domains if other != domain)
    head = [
        f"Midspan's configuration for ROS 2 domain {domain}, made from {file.name} by 'midspan import domain_bridge'.",
        f"{_HEAD} {other_domains}.",
    ]
    sections = {
        "name": f"{bridge}_{domain}"[:63],
        "ros1": {"enabled": False},
        "ros2": {"domain": domain, "node": f"{bridge}_{domain}"},
    }
    hint = ["localhost_only: false   # also nodes of other machines, as with domain_bridge"]
    rules = [*_rules_to_hub(job, domain, routes), *_rules_to_domain(job, domain, routes)]
    return Draft(f"{bridge}_domain{domain}", head + missing(job.notes), sections, {"ros2": hint}, rules)


def _rules_to_hub(job: _Import, domain: int, routes: list[_Route]) -> Iterator[RuleDraft]:
    """Yield the rules from the domain to the hub, one for each name, even if the name goes to several domains."""
    seen: set[tuple[str, str, str]] = set()
    for route in routes:
        if route.origin == domain and (route.kind, route.topic, route.type) not in seen:
            seen.add((route.kind, route.topic, route.type))
            yield RuleDraft(
                _source(job, route), {**route.matching(route.topic), "to": "zenoh", "rename": route.hub_topic}
            )


def _rules_to_domain(job: _Import, domain: int, routes: list[_Route]) -> Iterator[RuleDraft]:
    """Yield the rules from the hub to the domain."""
    for route in routes:
        if route.target == domain:
            rule = {**route.matching(route.hub_topic), "to": "ros2", "rename": route.new_name, **route.rule}
            yield RuleDraft(_source(job, route), rule, job.notes_by_entry[route.path])


def _source(job: _Import, route: _Route) -> str:
    line = job.document.keys[route.path].line
    return f"{job.document.file.name}:{line}, domain {route.origin} to {route.target}"
