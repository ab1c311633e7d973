"""Keeps a planner's velocities from the base while the gateway wants the robot to stand, whatever the planner does.

The gateway says so on ``/navigation/hold`` (``std_msgs/Bool``, latched): a stop or a pause that the planner has not
confirmed. The worker of the planner's side obeys it where the velocities enter the hub, so they reach no other side,
and no module. A worker that comes up while the gateway is there carries none before it has heard it.
"""

from __future__ import annotations

import threading
from collections.abc import Collection

from bridge.config.sections.navigation import HOLD, HOLD_TYPE, NavigationSection
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.session import Hub
from bridge.hub.wire.qos import LATCHED

_DATA = 4
"""Where the value stands: behind the encapsulation header of CDR."""
_MOST = 100
"""Gateways of which it is remembered what they said."""


def held_topics(section: NavigationSection, side: str) -> frozenset[str]:
    """The hub's topics of velocities that planners of a side command on."""
    return frozenset(section.velocity for planner in section.others.values() if planner.side == side)


class Hold:
    """Follows the holds that gateways ask for; ``topics`` of the hub are held, and may change.

    ``held``: nothing of those topics may enter the hub now. It is quick enough to be asked for each message.
    """

    def __init__(self, hub: Hub, topics: Collection[str]) -> None:
        self.topics = topics
        self.held = False
        self._graph = hub.graph
        self._said: dict[bytes, bool] = {}
        self._there: set[bytes] = set()
        self._lock = threading.Lock()
        self._unwatch = hub.graph.watch(self._look)
        self._subscription = hub.subscription(HOLD, HOLD_TYPE, "*", LATCHED, self._received)
        self._look()

    def _received(self, sample: HubSample) -> None:
        data = sample.data()
        with self._lock:
            self._said[sample.gid] = len(data) <= _DATA or bool(data[_DATA])
            while len(self._said) > _MOST:
                del self._said[next(iter(self._said))]
        self._look()

    def _look(self) -> None:
        """A gateway that has said nothing yet counts as holding; one that has gone does not."""
        there = {publisher.gid for publisher in self._graph.publishers(HOLD)}
        with self._lock:
            for gone in self._there - there:  # what a gateway says may come before the graph knows it
                self._said.pop(gone, None)
            self._there = there
            self.held = any(self._said.get(gid, True) for gid in there)

    def close(self) -> None:
        """Stop following the gateways."""
        self._unwatch()
        self._subscription.close()
