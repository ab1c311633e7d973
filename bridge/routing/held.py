"""The samples of a hub topic that its route to the side holds until their publishers are classified."""

from __future__ import annotations

from collections.abc import Callable, Collection

from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.graph import HubEndpoint
from bridge.routing.backlog import Backlog
from bridge.routing.limits import MAX_PENDING, QUEUE_BYTES, QUEUE_DEPTH, Priority


class HeldSamples:
    """Samples that a route publishes later, or never; ``dropped`` is called for each that a newer one displaces.

    Attributes:
        unknown: from publishers that the engine has not classified yet.
        latched: latched ones of publishers that may pass later, or of any while there is no lease. They arrive once.
    """

    def __init__(self, dropped: Callable[[], None]) -> None:
        self.unknown = Backlog[HubSample](MAX_PENDING, QUEUE_BYTES, dropped)
        self.latched = Backlog[HubSample](QUEUE_DEPTH[Priority.STATE], QUEUE_BYTES, dropped)

    def add_unknown(self, sample: HubSample) -> None:
        """Hold a sample of a publisher that is not classified, after the older ones."""
        self.unknown.add(sample.gid, sample, len(sample.payload))

    def add_latched(self, sample: HubSample, endpoint: HubEndpoint) -> None:
        """Hold a latched sample; only as many as its publisher ``endpoint`` retains."""
        depth = min(max(endpoint.qos.depth, 1), MAX_PENDING)
        self.latched.keep(sample.gid, sample, len(sample.payload), depth)

    def remove(self, sources: Collection[bytes]) -> None:
        """Remove the samples of some publishers, by GID; they do not count as dropped."""
        for backlog in (self.unknown, self.latched):
            backlog.pop_matching(lambda waiting: waiting.source in sources)
