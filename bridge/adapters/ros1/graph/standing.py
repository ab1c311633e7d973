"""The graph that the edge shows: the master's list, and what it lost although a TCP connection proves it.

A connection between two nodes needs no master. If the master is killed, the nodes and their connections stay; if it is
restarted, it lists only nodes that register again, which those of rospy and roscpp do not. Only a connection that ends
shows that a node is gone.

- While the master is away, its last state stays as long as any connection of it stands. Publishers and servers whose
  connections end are asked again, and are unknown if they do not answer (`bridge.adapters.ros1.graph.probe`).
- A registration that a master no longer lists stays while its own connection stands. Of a service this holds only for
  a restarted master: a server that unregisters may leave its connections open.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from bridge.adapters.ros1.graph.state import MasterState, Registration

_UNKNOWN = ("", "*")


@dataclass(frozen=True, slots=True)
class Connections:
    """The registrations of other nodes that a connection proves; subscribers are named by node and topic."""

    publishers: frozenset[Registration]
    subscribers: frozenset[tuple[str, str]]
    servers: frozenset[Registration]

    def prove(self, state: MasterState) -> bool:
        """Whether any registration of a state is proven."""
        return bool(
            self.publishers & state.publishers
            or self.servers & state.servers
            or any((link.node, link.topic) in self.subscribers for link in state.subscribers)
        )


class StandingGraph:
    """Derives the graph from the master's states; ``connections`` returns those that stand now. On one thread.

    Attributes:
        state: the graph, None if nothing is known to be there.
        unlisted: whether it has more than the master lists now.
    """

    def __init__(self, connections: Callable[[], Connections]) -> None:
        self._connections = connections
        self._listed: MasterState | None = None
        self._servers: frozenset[Registration] = frozenset()
        self.state: MasterState | None = None
        self.unlisted = False

    def update(self, listed: MasterState | None) -> MasterState | None:
        """Adopt the master's state, None while it is away; returns the graph, the same object if it did not change."""
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
