"""The publishers of a route to the side, for latched and for other sources."""

from __future__ import annotations

from collections.abc import Callable, Collection

from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.routing.edge import EdgePublisher
from bridge.routing.rewrites import StaticTransforms

MAX_INVENTED = 64
"""Maximum number of GIDs that one latched source may invent."""

STATIC = "static transforms"
"""The name of the source of merged static transforms."""


class SidePublishers:
    """A route's publishers on the side: ``latched`` retains the last messages of each source, ``volatile`` does not.

    Each is None until a source needs it. Only the engine's loop opens and closes them; any thread may publish.
    ``static`` merges the latched transforms, which remain when their publishers leave; None for other topics.
    """

    def __init__(self, advertise: Callable[[Qos], EdgePublisher]) -> None:
        self._advertise = advertise
        self.latched: EdgePublisher | None = None
        self.volatile: EdgePublisher | None = None
        self.static: StaticTransforms | None = None
        self._invented: dict[bytes, dict[bytes, None]] = {}

    def open_latched(self, depth: int, *, transforms: bool = False) -> None:
        """Open the publisher for latched sources, if it is not open; ``transforms``: for static transforms."""
        if self.latched is None:
            if transforms and self.static is None:
                self.static = StaticTransforms()
            self.latched = self._open(Durability.TRANSIENT_LOCAL, 1 if self.static else depth)

    def open_volatile(self, depth: int, lifespan_ns: int | None = None) -> None:
        """Open the publisher for the other sources, if it is not open; the lifespan is that of a command."""
        if self.volatile is None:
            self.volatile = self._open(Durability.VOLATILE, depth, lifespan_ns)

    def _open(self, durability: Durability, depth: int, lifespan_ns: int | None = None) -> EdgePublisher:
        # Reliable writers match reliable and best-effort readers.
        depth = min(max(depth, 1), 1000)
        return self._advertise(Qos(Reliability.RELIABLE, durability, depth=depth, lifespan_ns=lifespan_ns))

    def add_invented(self, gid: bytes, invented: bytes) -> None:
        """Note that a latched source publishes under an invented GID; see `HubSources.natives`.

        Of a source with more than `MAX_INVENTED`, the messages of the first are dropped.
        """
        names = self._invented.setdefault(gid, {})
        names[invented] = None
        if len(names) > MAX_INVENTED:
            first = next(iter(names))
            del names[first]
            if self.latched is not None and self.static is None:
                self.latched.drop_source(first.hex())

    def drop_source(self, gid: bytes, sources: Collection[bytes] = ()) -> None:
        """Drop the messages that are retained for a source, except static transforms.

        ``sources`` are the GIDs of the other sources: a message that arrives before its publisher is known counts as
        that of another source of the same session.
        """
        invented = self._invented.pop(gid, ())
        if self.latched is not None and self.static is None:
            for name in (gid, *(each for each in invented if each not in sources)):
                self.latched.drop_source(name.hex())

    @property
    def dropped(self) -> int:
        """Number of messages that the slowest subscriber on the side missed."""
        return max((p.dropped for p in (self.latched, self.volatile) if p is not None), default=0)

    def close(self) -> None:
        for publisher in (self.latched, self.volatile):
            if publisher is not None:
                publisher.close()
        self.latched = self.volatile = None
