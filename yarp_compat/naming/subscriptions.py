"""Persistent connections: pairs of ports to connect whenever both are open, directly or through a YARP topic.

They work as in yarpserver 3.12 (``SubscriberOnSql.cpp``): a connection is made when one of its ports announces that it
listens (``announce``) after the other. In the mode ``from``, a connection ends with its source, in ``to`` with its
target.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from yarp_compat.wire.contact import PortContact, is_name

MAX_SUBSCRIPTIONS = 10_000
MAX_TOPICS = 10_000
MAX_CONNECTIONS = 10_000
"""Connections per command: a topic connects all its sources to all its targets."""
MODES = ("", "from", "to")


@dataclass(frozen=True, slots=True)
class WantedConnection:
    """A connection to make, in the subscription's spelling: ``target`` has the carrier (``udp://r``).

    ``force``: connect even if the writing port reports that it is connected, because it may not have noticed yet that
    the previous program of this name has ended.
    """

    source: str
    target: str
    force: bool = False


@dataclass(frozen=True, slots=True)
class PersistentConnection:
    """A persistent connection, with both ends as spelled by the user; ``mode``: when it ends by itself."""

    source: PortContact
    target: PortContact
    mode: str = ""


class Subscriptions:
    """All persistent connections of a name server; ``known`` returns whether a name is a port's, not a topic's."""

    def __init__(self, known: Callable[[str], bool]) -> None:
        self._known = known
        self._all: dict[tuple[str, str], PersistentConnection] = {}
        self._live: set[str] = set()
        self._topics: dict[str, str] = {}

    def add(self, source: str, target: str, mode: str) -> list[WantedConnection] | None:
        """Add a persistent connection; return the connections to make now, None if it is invalid or exceeds a limit."""
        start, end = PortContact.parse(source), PortContact.parse(target)
        if not (is_name(start.name) and is_name(end.name)) or mode not in MODES:
            return None
        key = start.name, end.name
        if key not in self._all and len(self._all) >= MAX_SUBSCRIPTIONS:
            return None
        topics = [contact.name for contact in (start, end) if contact.carrier == "topic"]
        if len({*self._topics, *topics}) > MAX_TOPICS:
            return None
        subscription = PersistentConnection(start, end, mode)
        self._all[key] = subscription
        for topic in topics:
            self._topics.setdefault(topic, "")
        if not topics:
            return self._wanted(subscription)
        if len(topics) == 2:
            return []
        return self._connections_of(start.name if end.carrier == "topic" else end.name)

    def remove(self, source: str, target: str) -> None:
        """Remove a persistent connection; the connection itself stays."""
        self._all.pop((PortContact.parse(source).name, PortContact.parse(target).name), None)

    def on_announced(self, port: str, force: bool = False) -> list[WantedConnection]:
        """Handle the announcement of a port (``force``: its first one); return the connections to make now."""
        self._live.add(port)
        return [replace(connection, force=force) for connection in self._connections_of(port)]

    def on_removed(self, port: str) -> None:
        """Handle the removal of a port that was unregistered or is dead."""
        self._live.discard(port)
        ended = [
            key
            for key, s in self._all.items()
            if (s.mode == "from" and s.source.name == port) or (s.mode == "to" and s.target.name == port)
        ]
        for key in ended:
            del self._all[key]

    def set_topic(self, topic: str, structure: str) -> list[WantedConnection] | None:
        """Make a name a YARP topic; return the connections to make now, None if it is invalid or exceeds the limit."""
        if not is_name(topic) or (topic not in self._topics and len(self._topics) >= MAX_TOPICS):
            return None
        if structure or topic not in self._topics:
            self._topics[topic] = structure
        return [connection for joined in self._joined(topic) for connection in self._wanted(joined)]

    def remove_topic(self, topic: str) -> None:
        """Remove a YARP topic."""
        self._topics.pop(topic, None)

    def topics(self) -> list[str]:
        """Return the names of all YARP topics, oldest first."""
        return list(self._topics)

    def listing(self, port: str = "") -> list[Any]:
        """Return the reply to ``subscribe`` without a target: all persistent connections, or those of one port."""
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
        """Return all connections between listening ports, to make after a restart of the name server."""
        both = [*self._all.values(), *(j for topic in self._topics for j in self._joined(topic))]
        return [w for s in both if self._is_live(s) for w in self._wanted(s)]

    def state(self) -> dict[str, Any]:
        """Return the state, in types that JSON supports."""
        return {
            "subscriptions": [[s.source.target, s.target.target, s.mode] for s in self._all.values()],
            "topics": dict(self._topics),
            "live": sorted(self._live),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore what `state` returned; raises `KeyError`, `TypeError` or `ValueError` if it is invalid."""
        for source, target, mode in state["subscriptions"]:
            start, end = PortContact.parse(str(source)), PortContact.parse(str(target))
            self._all[start.name, end.name] = PersistentConnection(start, end, str(mode))
        self._topics = {str(topic): str(structure) for topic, structure in state["topics"].items()}
        self._live = {str(name) for name in state["live"] if self._known(str(name))}

    def _connections_of(self, port: str) -> list[WantedConnection]:
        direct = [s for s in self._all.values() if port in (s.source.name, s.target.name)]
        # through a topic: from each of its sources to each of its targets
        touched = {end.name for s in direct for end in (s.source, s.target)} & self._topics.keys()
        through = [j for topic in touched for j in self._joined(topic) if port in (j.source.name, j.target.name)]
        return [w for s in [*direct, *through] if self._is_live(s) for w in self._wanted(s)]

    def _is_live(self, s: PersistentConnection) -> bool:
        return s.source.name in self._live and s.target.name in self._live

    def _joined(self, topic: str) -> Iterator[PersistentConnection]:
        sources = [s.source for s in self._all.values() if s.target.name == topic]
        targets = [s.target for s in self._all.values() if s.source.name == topic]
        every = (PersistentConnection(source, target) for source in sources for target in targets)
        return itertools.islice(every, MAX_CONNECTIONS)

    def _wanted(self, s: PersistentConnection) -> list[WantedConnection]:
        source, target = self._known(s.source.name), self._known(s.target.name)
        if (s.mode == "from" and not source) or (s.mode == "to" and not target):
            self._all.pop((s.source.name, s.target.name), None)
        return [WantedConnection(s.source.target, s.target.target)] if source and target else []
