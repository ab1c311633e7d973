"""Blocks a planner's velocities while the gateway requires the robot to stand still.

The gateway publishes true on ``/navigation/hold`` (``std_msgs/Bool``, latched) for a stop or pause that the planner has
not confirmed. The worker of the planner's side then blocks the velocities at their entry into the hub, so that they
reach no other side and no module. Velocities of a planner that is a node of the hub have no entry: each worker blocks
them at its exit from the hub and in its relay (`bridge.routing.relay`). A worker that starts while a gateway runs
blocks them until it receives this topic.
"""

from __future__ import annotations

import threading
from collections.abc import Collection
from typing import Any

from bridge.config.sections.navigation import HOLD, HOLD_TYPE, NavigationSection
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.node import Hub
from bridge.hub.wire.qos import LATCHED

_DATA = 4
"""Offset of the value, after the encapsulation header of CDR."""
_MOST = 100
"""Maximum number of gateways whose last value is stored."""


def held_topics(section: NavigationSection, side: str) -> frozenset[str]:
    """Return the hub's velocity topics on which planners of a side publish."""
    return frozenset(section.velocity for planner in section.others.values() if planner.side == side)


class Hold:
    """Follows the requests of gateways to hold velocities.

    Attributes:
        topics: the hub's topics whose messages from the side may be held; the set may change.
        native: the same for messages from the hub's own nodes.
        held: whether a gateway holds them now.
    """

    def __init__(self, hub: Hub, topics: Collection[str], native: Collection[str] = ()) -> None:
        self.topics, self.native = topics, native
        self.held = False
        self._graph = hub.graph
        self._requests: dict[bytes, bool] = {}
        self._present: dict[bytes, str] = {}  # the gateways on the graph, by GID, with their sessions (zid)
        self._departed: dict[bytes, None] = {}  # the newest gateways that have left after their first message
        self._lock = threading.Lock()
        self._subscription = hub.subscription(HOLD, HOLD_TYPE, "*", LATCHED, self._received)
        self._unwatch = hub.graph.watch(self._on_graph_change)
        self._refresh()

    def blocks(self, topic: str) -> bool:
        """Return whether messages of the side may not enter the hub on a topic now. Fast enough for each message."""
        return self.held and topic in self.topics

    def blocks_native(self, topic: str) -> bool:
        """Return whether messages of the hub's own nodes on a topic may not pass now. Fast enough for each message."""
        return self.held and topic in self.native

    def _received(self, sample: HubSample) -> None:
        data = sample.data()
        with self._lock:
            self._requests[sample.gid] = len(data) <= _DATA or bool(data[_DATA])
            _limit(self._requests)
        self._refresh()

    def _on_graph_change(self) -> None:
        """Follow the gateways; request the message of one that has returned, since it was already received once.

        The subscription passes on no message twice. So without the request, a gateway whose link was restored would
        count as holding until its next change.
        """
        self._refresh()
        with self._lock:
            returned = {gid: self._present[gid] for gid in self._departed.keys() & self._present.keys()}
            for gid in returned:
                del self._departed[gid]
        for gid, zid in returned.items():
            self._subscription.request_again(gid, zid, lambda: None)

    def _refresh(self) -> None:
        """Update ``held``: a gateway counts as holding until its first message, and no longer after it has left."""
        with self._lock:  # includes reading the graph: an older state must not be applied last
            present = {publisher.gid: publisher.zid for publisher in self._graph.publishers(HOLD)}
            for departed in self._present.keys() - present.keys():
                # a gateway's message may arrive before the graph lists it
                if self._requests.pop(departed, None) is not None:
                    self._departed[departed] = None
                    _limit(self._departed)
            self._present = present
            self.held = any(self._requests.get(gid, True) for gid in present)

    def close(self) -> None:
        self._unwatch()
        self._subscription.close()


def _limit(gateways: dict[bytes, Any]) -> None:
    """Remove the oldest gateways beyond the maximum."""
    while len(gateways) > _MOST:
        del gateways[next(iter(gateways))]
