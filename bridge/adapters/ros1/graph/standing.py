"""The graph of the edge: the master's list, and registrations that only a TCP connection still proves.

A connection between two nodes needs no master. If the master is killed, the nodes and their connections stay; a
restarted master lists only nodes that register again, which rospy and roscpp nodes do not. Only the end of a connection
shows that a node has left.

- While the master is unreachable, its last state stays as long as a connection proves any of its registrations.
Publishers and servers whose connections end are probed again, and are unknown if they do not respond
(`bridge.adapters.ros1.graph.probe`).
- A registration that a master no longer lists stays while its connection exists. For a service this holds only after a
restart of the master, because a server that unregisters may leave its connections open.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from bridge.adapters.ros1.graph.state import MasterState, Registration

_UNKNOWN = ("", "*")


@dataclass(frozen=True, slots=True)
class Connections:
    """The registrations of other nodes that a connection proves; for a subscriber, its node and topic."""

    publishers: frozenset[Registration]
    subscribers: frozenset[tuple[str, str]]
    servers: frozenset[Registration]

    def prove(self, state: MasterState) -> bool:
        """Return whether any registration of a state is proven."""
        return bool(
            self.publishers & state.publishers
            or self.servers & state.servers
            or any((link.node, link.topic) in self.subscribers for link in state.subscribers)
        )


class StandingGraph:
    """Derives the graph from the master's states and the current ``connections``. Not thread-safe.

    Attributes:
        state: the graph, None if it is unknown.
        unlisted: whether the graph has registrations that the master does not list.
    """

    def __init__(self, connections: Callable[[], Connections]) -> None:
        self._connections = connections
        self._listed: MasterState | None = None
        self._servers: frozenset[Registration] = frozenset()
        self.state: MasterState | None = None
        self.unlisted = False

    def update(self, listed: MasterState | None) -> MasterState | None:
        """Adopt the master's state, None while it is unreachable; return the graph, the same object if unchanged."""
        before = self.state
        if listed is None:
            proven = before is not None and self._connections().prove(before)
            self.state, self.unlisted = before if proven else None, proven
        elif before is None:
            self.state, self.unlisted = listed, False
        elif listed is not self._listed or self.unlisted:
            self.state = self._merged(listed, before)
        self._listed = listed
        return self.state

    def _merged(self, listed: MasterState, before: MasterState) -> MasterState:
        standing = self._connections()
        moved = {node for node, uri in listed.uris.items() if before.uris.get(node, uri) != uri}
        publishers = before.publishers & standing.publishers
        subscribers = {link for link in before.subscribers if (link.node, link.topic) in standing.subscribers}
        servers = (before.servers if listed.run != before.run else self._servers) & standing.servers
        self._servers = frozenset(s for s in servers - listed.servers if s.node not in moved)
        lost = frozenset(
            link for link in (publishers - listed.publishers) | (subscribers - listed.subscribers)
            if link.node not in moved
        )  # fmt: skip
        self.unlisted = bool(lost or self._servers)
        if not self.unlisted:
            return listed
        types = {t: before.types[t] for t in {k.topic for k in lost} & before.types.keys()}
        merged = replace(
            listed,
            publishers=listed.publishers | (lost & publishers),
            subscribers=listed.subscribers | (lost & subscribers),
            servers=listed.servers | self._servers,
            types={**listed.types, **{t: kind for t, kind in types.items() if listed.types.get(t, "") in _UNKNOWN}},
            uris={**{k.node: k.uri for k in lost}, **listed.uris},
        )
        return before if merged == before else merged
