"""Persistent connections: which ports are to be connected whenever both are there, directly or through a YARP topic.

Meaning and listing as in yarpserver 3.12 (``SubscriberOnSql.cpp``): a connection is wanted when one of its ports says
that it listens (``announce``) and the other did so before. Mode ``from`` ends with its source, ``to`` with its target.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from yarp_compat.wire.contact import PortContact, is_name

MAX_SUBSCRIPTIONS = 10_000
MAX_TOPICS = 10_000
MAX_WISHES = 10_000
"""Connections that one command may ask for: through a topic they are all its sources times all its targets."""
MODES = ("", "from", "to")


@dataclass(frozen=True, slots=True)
class WantedConnection:
    """A connection to be made, in the subscription's spelling: ``target`` has the carrier (``udp://r``).

    ``anew``: even if the writing port believes that it is connected: that was to a former program of this name, of
    whose end it need not know before it writes.
    """

    source: str
    target: str
    anew: bool = False


@dataclass(frozen=True, slots=True)
class PersistentConnection:
    """One persistent connection, both ends as they were spelled, and when it ends by itself."""

    source: PortContact
    target: PortContact
    mode: str = ""


class Subscriptions:
    """All persistent connections of a name server; ``known`` says whether a name is a port's (a ``topic`` is none)."""

    def __init__(self, known: Callable[[str], bool]) -> None:
        self._known = known
        self._all: dict[tuple[str, str], PersistentConnection] = {}
        self._live: set[str] = set()
        self._topics: dict[str, str] = {}

    def add(self, source: str, target: str, mode: str) -> list[WantedConnection] | None:
        """Take a persistent connection; None where it cannot be, else the connections that this wants now."""
        one, two = PortContact.parse(source), PortContact.parse(target)
        if not (is_name(one.name) and is_name(two.name)) or mode not in MODES:
            return None
        key = one.name, two.name
        if key not in self._all and len(self._all) >= MAX_SUBSCRIPTIONS:
            return None
        topics = [end.name for end in (one, two) if end.carrier == "topic"]
        if len({*self._topics, *topics}) > MAX_TOPICS:
            return None
        subscription = PersistentConnection(one, two, mode)
        self._all[key] = subscription
        for topic in topics:
            self._topics.setdefault(topic, "")
        if not topics:
            return self._wanted(subscription)
        if len(topics) == 2:
            return []
        return self._hookup(one.name if two.carrier == "topic" else two.name)

    def remove(self, source: str, target: str) -> None:
        """Forget a persistent connection; the connection itself stays."""
        self._all.pop((PortContact.parse(source).name, PortContact.parse(target).name), None)

    def welcome(self, port: str, anew: bool = False) -> list[WantedConnection]:
        """A port says that it listens (``anew``: for the first time); returns the connections that are wanted now."""
        self._live.add(port)
        return [replace(wish, anew=anew) for wish in self._hookup(port)]

    def gone(self, port: str) -> None:
        """A port was unregistered, or is dead."""
        self._live.discard(port)
        ended = [
            key
            for key, s in self._all.items()
            if (s.mode == "from" and s.source.name == port) or (s.mode == "to" and s.target.name == port)
        ]
        for key in ended:
            del self._all[key]

    def set_topic(self, topic: str, structure: str) -> list[WantedConnection] | None:
        """Make a name a YARP topic; None where it cannot be, else the connections that this wants now."""
        if not is_name(topic) or (topic not in self._topics and len(self._topics) >= MAX_TOPICS):
            return None
        if structure or topic not in self._topics:
            self._topics[topic] = structure
        return [wish for joined in self._joined(topic) for wish in self._wanted(joined)]

    def remove_topic(self, topic: str) -> None:
        """A name is no YARP topic any more."""
        self._topics.pop(topic, None)

    def topics(self) -> list[str]:
        """The names of all YARP topics, oldest first."""
        return list(self._topics)

    def listing(self, port: str = "") -> list[Any]:
        """The answer to ``subscribe`` without a target: all persistent connections, or those of one port."""
        shown: list[Any] = ["subscriptions"]
        for (source, target), s in sorted(self._all.items()):
            if port and port not in (source, target):
                continue
            line: list[Any] = ["subscription", ["src", s.source.target], ["dest", s.target.target]]
            if s.mode:
                line.append(["mode", s.mode])
            if source in self._topics or target in self._topics:
                line.append(["topic", int(source in self._topics), int(target in self._topics)])
            shown.append(line)
        return shown

    def wanted(self) -> list[WantedConnection]:
        """Every connection that is wanted between ports that listen, as after a restart of the name server."""
        both = [*self._all.values(), *(j for topic in self._topics for j in self._joined(topic))]
        return [w for s in both if self._is_live(s) for w in self._wanted(s)]

    def state(self) -> dict[str, Any]:
        """All that it remembers, for a file."""
        return {
            "subscriptions": [[s.source.target, s.target.target, s.mode] for s in self._all.values()],
            "topics": dict(self._topics),
            "live": sorted(self._live),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Remember what `state` gave; raises `KeyError`, `TypeError` or `ValueError` for anything else."""
        for source, target, mode in state["subscriptions"]:
            one, two = PortContact.parse(str(source)), PortContact.parse(str(target))
            self._all[one.name, two.name] = PersistentConnection(one, two, str(mode))
        self._topics = {str(topic): str(structure) for topic, structure in state["topics"].items()}
        self._live = {str(name) for name in state["live"] if self._known(str(name))}

    def _hookup(self, port: str) -> list[WantedConnection]:
        direct = [s for s in self._all.values() if port in (s.source.name, s.target.name)]
        # what goes through a topic: every source of it to every target of it
        touched = {end.name for s in direct for end in (s.source, s.target)} & self._topics.keys()
        through = [j for topic in touched for j in self._joined(topic) if port in (j.source.name, j.target.name)]
        return [w for s in [*direct, *through] if self._is_live(s) for w in self._wanted(s)]

    def _is_live(self, s: PersistentConnection) -> bool:
        return s.source.name in self._live and s.target.name in self._live

    def _joined(self, topic: str) -> Iterator[PersistentConnection]:
        sources = [s.source for s in self._all.values() if s.target.name == topic]
        targets = [s.target for s in self._all.values() if s.source.name == topic]
        every = (PersistentConnection(source, target) for source in sources for target in targets)
        return itertools.islice(every, MAX_WISHES)

    def _wanted(self, s: PersistentConnection) -> list[WantedConnection]:
        source, target = self._known(s.source.name), self._known(s.target.name)
        if (s.mode == "from" and not source) or (s.mode == "to" and not target):
            self._all.pop((s.source.name, s.target.name), None)
        return [WantedConnection(s.source.target, s.target.target)] if source and target else []
