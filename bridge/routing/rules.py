"""The configuration's rules, compiled: may this topic, service or action cross, under which name and how."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

from bridge.config.mix import MadeRule
from bridge.config.sections.routing import QosOverride, RoutingSection, Rule
from bridge.hub.qos import Durability, Qos, Reliability
from bridge.routing.patterns import glob_regex, rename_glob
from bridge.routing.private import why_private

ENTRY = "zenoh"
"""The hub as a destination: rules with ``to: zenoh`` hold where a topic enters the hub."""

Kind = Literal["topic", "service", "action"]

_MOST_DECIDED = 20_000
"""Decisions that are kept at most."""

_PARAMETERS, _EVENT = "rcl_interfaces/srv/", "rcl_interfaces/msg/ParameterEvent"
_WITH_NODES = frozenset({"ros2", "zenoh_ros2dds"})
"""Sides on which nodes have parameters of their own."""


@dataclass(frozen=True, slots=True)
class Decision:
    """What the rules say of one topic, service or action at one gate.

    Attributes:
        allowed: whether it crosses.
        why: the rule or default that decided, for people.
        private: whether it was kept back as private to its side.
        settled: whether no rule could change it.
        name: the name beyond the gate.
        rate: messages a second at most, None without a limit.
        priority: class forced by the rule, "" for the topic's own.
        depth: queue length forced by the rule, None for the class's own.
        timeout: seconds after which a command is too old.
        qos: forced QoS.
    """

    allowed: bool
    why: str
    name: str
    private: bool = False
    settled: bool = False
    rate: float | None = None
    priority: str = ""
    depth: int | None = None
    timeout: float = 0.5
    qos: QosOverride = field(default_factory=QosOverride)

    def override(self, qos: Qos) -> Qos:
        """The QoS with what the rule forces."""
        reliability, durability = qos.reliability, qos.durability
        if self.qos.reliability is not None:
            reliability = Reliability[self.qos.reliability.upper()]
        if self.qos.durability is not None:
            durability = Durability[self.qos.durability.upper()]
        depth = qos.depth if self.depth is None else self.depth
        return Qos(reliability, durability, qos.history, depth, qos.deadline_ns, qos.lifespan_ns)


class RuleSet:
    """The rules of a configuration.

    A topic, service or action passes two gates: from its side into the hub, and from there to a side.
    """

    def __init__(self, section: RoutingSection) -> None:
        self.section = section
        self._patterns = [_pattern(rule) for rule in section.rules]
        self._names = list(_names(section.rules))
        self._nodes = frozenset(rule.node for rule in section.parameters)
        self._decided: dict[tuple[str, ...], Decision] = {}

    def enter(self, side: str, topic: str, type_name: str, kind: Kind = "topic") -> Decision:
        """May a topic, service or action of ``side`` enter the hub? ``type_name`` is the type's ROS 2 name."""
        return self._once((side, topic, type_name, kind), lambda: self._enter(side, topic, type_name, kind))

    def _once(self, question: tuple[str, ...], decide: Callable[[], Decision]) -> Decision:
        """What was decided before; each look at a graph asks the same of all that is on it."""
        decision = self._decided.get(question)
        if decision is None:
            if len(self._decided) >= _MOST_DECIDED:
                self._decided.clear()
            decision = self._decided[question] = decide()
        return decision

    def _enter(self, side: str, topic: str, type_name: str, kind: Kind) -> Decision:
        matches = list(self._matches(side, topic, type_name, kind))
        entry = [m for m in matches if m.rule.to in (None, ENTRY)]
        return (
            _denied(entry, topic)
            or _allowed(entry, topic)
            or self._onward(matches, topic)
            or self._private(side, topic, type_name, kind)
            or self._default(topic)
        )

    def leave(
        self, origin: str, side: str, topic: str, type_name: str, kind: Kind = "topic", *, elsewhere: bool = False
    ) -> Decision:
        """May what came from the side ``origin`` leave the hub to ``side``?

        A native hub topic (origin ``zenoh``) has passed no gate yet, so that rules without ``to`` hold for it whole;
        for others such rules were applied at their entry, and only deny, class and QoS hold here too. ``elsewhere``:
        another daemon let it in, whose rules are not these.
        """
        question = (origin, side, topic, type_name, kind, "elsewhere" if elsewhere else "")
        return self._once(question, lambda: self._leave(origin, side, topic, type_name, kind, elsewhere=elsewhere))

    def _leave(self, origin: str, side: str, topic: str, type_name: str, kind: Kind, *, elsewhere: bool) -> Decision:
        matches = list(self._matches(origin, topic, type_name, kind))
        here = [m for m in matches if m.rule.to == side]
        general = [m for m in matches if m.rule.to is None]
        native = origin == ENTRY
        denied = _denied(here + general, topic)
        if denied or here:
            return denied or _allowed(here, topic) or self._default(topic)
        if general:
            decision = _allowed(general, topic) or self._default(topic)
            return decision if native else replace(decision, name=topic, rate=None)
        if matches and self.section.default == "deny":
            return Decision(allowed=False, why="rules allow it to other sides only", name=topic)
        if native:
            return self._private(origin, topic, type_name, kind) or self._default(topic)
        if elsewhere and self.section.default == "deny":
            return self._default(topic)
        told = type_name == _EVENT or self._shares(topic, type_name, kind)
        if self.section.private and side not in _WITH_NODES and told:
            return Decision(allowed=False, why="parameters are told by routing.parameters", name=topic, private=True)
        return Decision(allowed=True, why="allowed where it entered the hub", name=topic)

    def _matches(self, origin: str, topic: str, type_name: str, kind: Kind) -> Iterator[_Match]:
        for name, rule, pattern in zip(self._names, self.section.rules, self._patterns, strict=True):
            if rule.from_ not in (None, origin) or rule.kind not in (None, kind):
                continue
            if rule.type is not None and not glob_regex(rule.type).fullmatch(type_name):
                continue
            match = None if pattern is None else pattern.fullmatch(topic)
            if pattern is None or match is not None:
                yield _Match(name, rule, match)

    def _onward(self, matches: list[_Match], topic: str) -> Decision | None:
        if any(not m.rule.deny for m in matches):
            return Decision(allowed=True, why="a rule lets it leave the hub", name=topic)
        return None

    def _shares(self, name: str, type_name: str, kind: Kind) -> bool:
        """Whether it is a parameter service of a node whose parameters are shared."""
        return kind == "service" and type_name.startswith(_PARAMETERS) and name.rpartition("/")[0] in self._nodes

    def _private(self, side: str, topic: str, type_name: str, kind: Kind) -> Decision | None:
        if self._shares(topic, type_name, kind):
            return Decision(allowed=True, why="routing.parameters names its node", name=topic)
        why = why_private(side, topic, type_name, kind) if self.section.private else ""
        return Decision(allowed=False, why=f"private to its side: {why}", name=topic, private=True) if why else None

    def _default(self, topic: str) -> Decision:
        if self.section.default == "deny":
            return Decision(allowed=False, why="no rule allows it and routing.default is deny", name=topic)
        return Decision(allowed=True, why="everything crosses by default", name=topic)


class _Match(NamedTuple):
    name: str
    rule: Rule
    match: re.Match[str] | None


def _denied(matches: list[_Match], topic: str) -> Decision | None:
    for name, rule, _ in matches:
        if rule.deny:
            return Decision(allowed=False, why=f"{name} denies it", name=topic)
    return None


def _allowed(matches: list[_Match], topic: str) -> Decision | None:
    return _by_rule(*matches[0], topic) if matches else None


def _names(rules: Iterable[Rule]) -> Iterator[str]:
    """What people call each rule: its number in the file, or what it follows from."""
    number = 0
    for rule in rules:
        number += not isinstance(rule, MadeRule)
        yield f"the section {rule.of}" if isinstance(rule, MadeRule) else f"rule {number}"


def _pattern(rule: Rule) -> re.Pattern[str] | None:
    if rule.regex is not None:
        return re.compile(rule.regex)
    return None if rule.topic is None else glob_regex(rule.topic)


def _by_rule(of: str, rule: Rule, match: re.Match[str] | None, topic: str) -> Decision:
    name = topic
    if rule.rename is not None:
        if rule.regex is not None and match is not None:
            name = match.expand(rule.rename)
        elif match is not None:
            name = rename_glob(match, rule.rename)
        else:
            name = rule.rename
    return Decision(
        allowed=True,
        why=f"{of} allows it",
        name=name,
        rate=rule.rate,
        priority=rule.priority or "",
        depth=rule.depth,
        timeout=0.5 if rule.timeout is None else rule.timeout,
        qos=rule.qos,
    )
