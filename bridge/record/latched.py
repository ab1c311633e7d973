"""The current latched messages, which publishers keep for late joiners, for the start of each file."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from bridge.hub.endpoints.publisher import cache_depth
from bridge.hub.graph import HubGraph
from bridge.modules.hub_topics import TopicKey
from bridge.record.arrivals import RecordedMessage

MAX_BYTES = 128 << 20
"""Maximum bytes of kept messages; the oldest are dropped first."""
MOST_UNKNOWN = 256
"""Maximum publishers that are not in the graph yet, with a kept message each."""


class LatchedState:
    """The last messages of each latched publisher on the hub, as many as its depth. For one thread."""

    def __init__(self, graph: HubGraph) -> None:
        self._graph = graph
        self._kept: dict[tuple[TopicKey, bytes], deque[RecordedMessage]] = {}
        self._plain: set[bytes] = set()
        self._unknown: set[tuple[TopicKey, bytes]] = set()
        self._bytes = 0

    def saw(self, arrival: RecordedMessage) -> None:
        """Keep a recorded message if its publisher is latched."""
        gid = arrival.gid
        if gid in self._plain:
            return
        key = arrival.counts.key, gid
        if key not in self._kept:
            if len(self._unknown) >= MOST_UNKNOWN and self._graph.endpoint(gid) is None:
                return
            self._kept[key] = deque(maxlen=1)
            self._unknown.add(key)
        if key in self._unknown and not self._look_up(key):
            return
        kept = self._kept[key]
        if len(kept) == kept.maxlen:
            self._bytes -= len(kept[0].data)
        kept.append(arrival)
        self._bytes += len(arrival.data)
        while self._bytes > MAX_BYTES:
            self._forget_oldest()

    def _look_up(self, key: tuple[TopicKey, bytes]) -> bool:
        """Whether to keep a publisher's message: it is latched, or unknown, since its message may come first."""
        endpoint = self._graph.endpoint(key[1])
        if endpoint is None:
            return True
        self._unknown.discard(key)
        if endpoint.qos.latched:
            self._kept[key] = deque(self._kept[key], cache_depth(endpoint.qos))
            return True
        self._plain.add(key[1])
        self._drop(key)
        return False

    def _drop(self, key: tuple[TopicKey, bytes]) -> None:
        self._unknown.discard(key)
        self._bytes -= sum(len(arrival.data) for arrival in self._kept.pop(key))

    def _forget_oldest(self) -> None:
        key, kept = min(self._kept.items(), key=lambda item: item[1][0].log_time)
        self._bytes -= len(kept.popleft().data)
        if not kept:
            self._drop(key)

    def all(self) -> Iterator[RecordedMessage]:
        """Return all kept messages by time; drop those of publishers that left the hub."""
        here = {endpoint.gid for endpoint in self._graph.publishers()}
        self._plain &= here
        for key in [key for key in self._kept if key[1] not in here]:
            self._drop(key)
        for key in list(self._unknown):
            self._look_up(key)
        yield from sorted((a for kept in self._kept.values() for a in kept), key=lambda arrival: arrival.log_time)
