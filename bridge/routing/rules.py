"""The compiled rules of the configuration: whether, how and under which name a topic, service or action is bridged."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Literal, NamedTuple

from bridge.config.rules import CommandRule, MadeRule
from bridge.config.sections.routing import QosOverride, RoutingSection, Rule
from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.routing.limits import Priority, default_priority
from bridge.sides import all_networks

_WILDCARD = re.compile(r"\*\*|\*|\?")


@lru_cache(maxsize=4096)
def glob_regex(glob: str) -> re.Pattern[str]:
    """Compile a glob: ``*`` and ``?`` match within one part between slashes, ``**`` across parts; each is a group.

    A trailing ``/**`` also matches the name without it, as in ``/camera/**`` for ``/camera``.
    """
    tail = ""
    if glob.endswith("/**"):
        glob, tail = glob[:-3], r"(?:/(.*))?"
    parts = []
    end = 0
    for match in _WILDCARD.finditer(glob):
        parts.append(re.escape(glob[end : match.start()]))
        parts.append({"**": "(.*)", "*": "([^/]*)", "?": "([^/])"}[match.group()])
        end = match.end()
    parts.append(re.escape(glob[end:]))
    return re.compile("".join(parts) + tail)


def rename_glob(match: re.Match[str], new: str) -> str:
    """Replace the wildcards of a new name, in order, by the text that the glob's wildcards matched."""
    groups = iter([g or "" for g in match.groups()])
    renamed = _WILDCARD.sub(lambda _: next(groups, ""), new)
    return renamed.rstrip("/") or "/"


class NameFilter:
    """Selects the topics whose names match a glob and none of the excluding expressions.

    Args:
        globs: as in rules; globs and names get a leading slash if they lack one.
        exclude: regular expressions, searched anywhere in the name.
    """

    def __init__(self, globs: Iterable[str] = ("/**",), exclude: Iterable[str] = ()) -> None:
        self._globs = {glob: glob_regex(_with_slash(glob)) for glob in globs}
        self._exclude = [re.compile(expression) for expression in exclude]

    def matches(self, name: str) -> bool:
        """Return whether a topic of this name is selected."""
        name = _with_slash(name)
        return any(glob.fullmatch(name) for glob in self._globs.values()) and not any(
            expression.search(name) for expression in self._exclude
        )

    def idle(self, names: Iterable[str]) -> list[str]:
        """Return the globs that match none of these names."""
        known = list(map(_with_slash, names))
        return [glob for glob, regex in self._globs.items() if not any(map(regex.fullmatch, known))]


def _with_slash(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


@functools.cache
def _patterns(side: str, kind: str) -> tuple[tuple[re.Pattern[str], str], ...]:
    network = all_networks().get(side)
    private = () if network is None else network.private_services if kind == "service" else network.private_topics
    return tuple((re.compile(pattern), reason) for pattern, reason in private)


def why_private(side: str, name: str, type_name: str, kind: str = "topic") -> str:
    """Return why a topic or a service is private to its side, "" if it is not; ``type_name``: its ROS 2 type."""
    if kind == "action":
        return ""
    text = type_name if kind == "service" else name
    return next((reason for pattern, reason in _patterns(side, kind) if pattern.fullmatch(text)), "")


ENTRY = "zenoh"
"""The hub as a destination: rules with ``to: zenoh`` apply when a topic enters the hub."""

Kind = Literal["topic", "service", "action"]

COMMAND_SECONDS = 0.5
"""Age in seconds beyond which a command is dropped unless a rule sets another."""

_MOST_DECIDED = 20_000
"""Maximum number of cached decisions."""

_PARAMETERS = frozenset(
    f"rcl_interfaces/srv/{name}"
    for name in (
        "GetParameters", "GetParameterTypes", "ListParameters", "DescribeParameters", "SetParameters",
        "SetParametersAtomically",
    )
)  # fmt: skip
"""Types of the services that each ROS 2 node has for its parameters."""

_EVENT = "rcl_interfaces/msg/ParameterEvent"
_NAMED = "routing.parameters names its node"


@dataclass(frozen=True, slots=True)
class RoutePolicy:
    """The rules' decision on one topic, service or action at one gate.

    Attributes:
        why: the rule or default that decided.
        name: the name beyond the gate.
        cure: the change to the configuration that would allow it; "" if it is allowed or no change would help.
        private: whether it is withheld because it is private to its side.
        settled: whether no rule could change the decision.
        rate: messages per second, None without a limit.
        priority: the priority that the rule sets, else "".
        depth: the depth that the rule sets, else None.
        timeout: age in seconds beyond which a command is dropped.
        stamped: whether velocities are ``TwistStamped`` or ``Twist`` beyond the gate, None for their own type.
    """

    allowed: bool
    why: str
    name: str
    cure: str = ""
    private: bool = False
    settled: bool = False
    rate: float | None = None
    priority: str = ""
    depth: int | None = None
    timeout: float = COMMAND_SECONDS
    stamped: bool | None = None
    qos: QosOverride = field(default_factory=QosOverride)

    def class_of(self, topics: Iterable[str], type_name: str, *, latched: bool) -> Priority:
        """Return the priority class that the rule sets, or else the default for the names, the type and latching.

        ``topics`` are a topic's names: one that a rule renames carries commands if either name implies it.
        """
        if self.priority:
            return Priority(self.priority)
        classes = {default_priority(topic, type_name, latched=latched) for topic in topics}
        return Priority.COMMAND if Priority.COMMAND in classes else classes.pop()

    def override(self, qos: Qos) -> Qos:
        """Return the QoS with the policies that the rule sets."""
        reliability, durability = qos.reliability, qos.durability
        if self.qos.reliability is not None:
            reliability = Reliability[self.qos.reliability.upper()]
        if self.qos.durability is not None:
            durability = Durability[self.qos.durability.upper()]
        depth = qos.depth if self.depth is None else self.depth
        return Qos(reliability, durability, qos.history, depth, qos.deadline_ns, qos.lifespan_ns)


class RuleSet:
    """The rules of a configuration, applied at two gates: from a side into the hub, and from the hub to a side."""

    def __init__(self, section: RoutingSection) -> None:
        self.section = section
        self._patterns = [_pattern(rule) for rule in section.rules]
        self._names = list(_names(section.rules))
        self._commands = {(rule.topic, rule.type) for rule in section.rules if isinstance(rule, CommandRule)}
        self._owners = {rule.node: rule.owner for rule in section.parameters}
        self._decided: dict[tuple[str, ...], RoutePolicy] = {}

    def enter(self, side: str, topic: str, type_name: str, kind: Kind = "topic") -> RoutePolicy:
        """Decide whether a topic, service or action of ``side`` may enter the hub; ``type_name``: its ROS 2 type."""
        return self._once((side, topic, type_name, kind), lambda: self._enter(side, topic, type_name, kind))

    def naming(self, name: str) -> Iterator[tuple[str, Rule, bool]]:
        """Yield each rule's readable name, the rule, and whether its pattern matches, whatever its other conditions."""
        for of, rule, pattern in zip(self._names, self.section.rules, self._patterns, strict=True):
            yield of, rule, pattern is not None and pattern.fullmatch(name) is not None

    def _once(self, question: tuple[str, ...], decide: Callable[[], RoutePolicy]) -> RoutePolicy:
        """Return the decision, which is cached because each pass over a graph asks the same questions."""
        policy = self._decided.get(question)
        if policy is None:
            if len(self._decided) >= _MOST_DECIDED:
                self._decided.clear()
            policy = self._decided[question] = decide()
        return policy

    def _enter(self, side: str, topic: str, type_name: str, kind: Kind) -> RoutePolicy:
        matches = list(self._matches(side, topic, type_name, kind))
        entry = [m for m in matches if m.rule.to in (None, ENTRY)]
        policy = (
            _denial(entry, topic)
            or _permission(entry, topic)
            or self._onward(matches, topic)
            or self._private(side, topic, type_name, kind)
            or self._default(topic)
        )
        return self._classified(policy, topic, type_name)

    def _classified(self, policy: RoutePolicy, topic: str, type_name: str) -> RoutePolicy:
        """Return the policy with the class command if the topic moves the robot, and no rule sets its class."""
        driven = (topic, type_name) in self._commands or (policy.name, type_name) in self._commands
        return replace(policy, priority="command") if driven and policy.allowed and not policy.priority else policy

    def leave(
        self, origin: str, side: str, topic: str, type_name: str, kind: Kind = "topic", *, elsewhere: bool = False
    ) -> RoutePolicy:
        """Decide whether a topic, service or action from the side ``origin`` may leave the hub to ``side``.

        A native hub topic (origin ``zenoh``) has passed no gate yet, so rules without ``to`` apply to it in full, and
        private topics and services are withheld here. Other topics have passed such rules when they entered the hub, so
        that only the rules' denial, priority, depth, timeout and QoS apply again here. ``elsewhere``: another daemon,
        whose rules may differ, let the topic in.
        """
        question = (origin, side, topic, type_name, kind, "elsewhere" if elsewhere else "")

        def decide() -> RoutePolicy:
            policy = self._leave(origin, side, topic, type_name, kind, elsewhere=elsewhere)
            return self._classified(policy, topic, type_name)

        return self._once(question, decide)

    def relay(self, topic: str, type_name: str, kind: Kind = "topic") -> RoutePolicy:
        """Decide whether a topic, service or action is relayed between the hub's own nodes.

        Rules without ``to`` and with ``to: zenoh`` apply. Names stay, and nothing is private among these nodes.
        """
        matches = [m for m in self._matches(ENTRY, topic, type_name, kind) if m.rule.to in (None, ENTRY)]
        policy = _denial(matches, topic) or _permission(matches, topic) or self._default(topic)
        return self._classified(replace(policy, name=topic, stamped=None), topic, type_name)

    def native(self, topic: str, type_name: str) -> list[RoutePolicy]:
        """Return the decisions on a topic of the hub's own programs: first on the hub, then for each side."""
        sides = [side for side in all_networks() if side != ENTRY]
        return [self.enter(ENTRY, topic, type_name), *(self.leave(ENTRY, side, topic, type_name) for side in sides)]

    def native_class(self, topic: str, type_name: str, *, latched: bool) -> Priority:
        """Return the priority class on the hub for such a topic: command if its messages are commands on any side."""
        policies = self.native(topic, type_name)
        classes = [policy.class_of((topic, policy.name), type_name, latched=latched) for policy in policies]
        return Priority.COMMAND if Priority.COMMAND in classes else classes[0]

    def _leave(self, origin: str, side: str, topic: str, type_name: str, kind: Kind, *, elsewhere: bool) -> RoutePolicy:
        matches = list(self._matches(origin, topic, type_name, kind))
        matches_here = [m for m in matches if m.rule.to == side]
        general = [m for m in matches if m.rule.to is None]
        native = origin == ENTRY
        denied = _denial(matches_here + general, topic)
        if denied or matches_here:
            return denied or _permission(matches_here, topic) or self._default(topic, side)
        if general:
            policy = _permission(general, topic) or self._default(topic, side)
            return policy if native else replace(policy, name=topic, rate=None, stamped=None)
        if matches and self.section.default == "deny":
            return RoutePolicy(False, "rules allow it to other sides only", topic, f"add a rule that {_allows(side)}")
        # a rule for another side may have let a private topic in
        passed = not native and (elsewhere or not matches or any(m.rule.to == ENTRY for m in matches))
        private = None if passed else self._private(origin, topic, type_name, kind, side)
        if private is not None and not private.allowed:
            return private
        if self._withheld(side, topic, type_name, kind):
            return self._withhold(topic, "routing.parameters shares parameters", side)
        if self._shares(origin, topic, type_name, kind):
            return RoutePolicy(allowed=True, why=_NAMED, name=topic)
        if native or (elsewhere and self.section.default == "deny"):
            return self._default(topic, side)
        return RoutePolicy(allowed=True, why="allowed at its entry into the hub", name=topic)

    def _matches(self, origin: str, topic: str, type_name: str, kind: Kind) -> Iterator[_Match]:
        for name, rule, pattern in zip(self._names, self.section.rules, self._patterns, strict=True):
            if isinstance(rule, CommandRule) or rule.from_ not in (None, origin) or rule.kind not in (None, kind):
                continue
            if rule.type is not None and not glob_regex(rule.type).fullmatch(type_name):
                continue
            match = None if pattern is None else pattern.fullmatch(topic)
            if pattern is None or match is not None:
                yield _Match(name, rule, match)

    def _onward(self, matches: list[_Match], topic: str) -> RoutePolicy | None:
        if any(not m.rule.deny for m in matches):
            return RoutePolicy(allowed=True, why="a rule lets it leave the hub", name=topic)
        return None

    def _shares(self, origin: str, name: str, type_name: str, kind: Kind) -> bool:
        """Return whether this is a parameter service of a node in ``routing.parameters``, from that node's side."""
        if kind != "service" or type_name not in _PARAMETERS:
            return False
        return self._owners.get(name.rpartition("/")[0]) == ("ros1" if origin == "ros1" else "ros2")

    def _withheld(self, side: str, name: str, type_name: str, kind: Kind) -> bool:
        """Return whether this is a service or event of shared parameters on a side whose nodes have no parameters."""
        network = all_networks().get(side)
        if not self.section.private or (network is not None and network.node_parameters):
            return False
        return type_name == _EVENT or (
            kind == "service" and type_name in _PARAMETERS and name.rpartition("/")[0] in self._owners
        )

    def _private(self, side: str, topic: str, type_name: str, kind: Kind, to: str = ENTRY) -> RoutePolicy | None:
        if self._shares(side, topic, type_name, kind):
            return RoutePolicy(allowed=True, why=_NAMED, name=topic)
        reason = why_private(side, topic, type_name, kind) if self.section.private else ""
        return self._withhold(topic, f"private to its side: {reason}", to) if reason else None

    def _withhold(self, topic: str, why: str, to: str) -> RoutePolicy:
        more = "" if self.section.default == "deny" else ", or set routing.private: false"
        return RoutePolicy(False, why, topic, f"name it in a rule that {_allows(to)}{more}", private=True)

    def _default(self, topic: str, to: str = ENTRY) -> RoutePolicy:
        if self.section.default == "deny":
            cure = f"add a rule that {_allows(to)}, or set routing.default: allow"
            return RoutePolicy(False, "no rule allows it and routing.default is deny", topic, cure)
        return RoutePolicy(allowed=True, why="everything is bridged by default", name=topic)


class _Match(NamedTuple):
    name: str
    rule: Rule
    match: re.Match[str] | None


def _denial(matches: list[_Match], topic: str) -> RoutePolicy | None:
    denying = [m for m in matches if m.rule.deny]
    if not denying:
        return None
    names, changes = (list(dict.fromkeys(texts)) for texts in ((m.name for m in denying), map(_change, denying)))
    reason = f"{_listed(names)} {'deny' if len(names) > 1 else 'denies'} it"
    return RoutePolicy(False, reason, topic, f"{_listed(changes)}; a rule that denies overrides all rules that allow")


def _change(match: _Match) -> str:
    """Return how to change the configuration so that a rule no longer denies."""
    if isinstance(match.rule, MadeRule):
        return f"change {match.rule.of.partition(' (')[0]}, which generates that rule"
    return f"remove or narrow {match.name}"


def _allows(to: str) -> str:
    return "allows it" if to == ENTRY else f"allows it, with 'to: {to}' or without 'to'"


def _listed(items: Sequence[str]) -> str:
    *others, last = items
    return f"{', '.join(others)} and {last}" if others else last


def _permission(matches: list[_Match], topic: str) -> RoutePolicy | None:
    return _by_rule(*matches[0], topic) if matches else None


def _names(rules: Iterable[Rule]) -> Iterator[str]:
    """Yield the readable name of each rule: its number in the file, or the section that generates it."""
    number = 0
    for rule in rules:
        number += not isinstance(rule, MadeRule)
        yield f"the section {rule.of}" if isinstance(rule, MadeRule) else f"rule {number}"


def _pattern(rule: Rule) -> re.Pattern[str] | None:
    if rule.regex is not None:
        return re.compile(rule.regex)
    return None if rule.topic is None else glob_regex(rule.topic)


def _by_rule(of: str, rule: Rule, match: re.Match[str] | None, topic: str) -> RoutePolicy:
    name = topic
    if rule.rename is not None:
        if rule.regex is not None and match is not None:
            name = match.expand(rule.rename)
        elif match is not None:
            name = rename_glob(match, rule.rename)
        else:
            name = rule.rename
    return RoutePolicy(
        allowed=True,
        why=f"{of} allows it",
        name=name,
        rate=rule.rate,
        priority=rule.priority or "",
        depth=rule.depth,
        timeout=0.5 if rule.timeout is None else rule.timeout,
        stamped=rule.stamped,
        qos=rule.qos,
    )
