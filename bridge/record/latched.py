"""The current latched messages, which publishers store for late joiners, and with which each file starts."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from bridge.client.topics import TopicKey
from bridge.hub.endpoints.sinks import cache_depth
from bridge.hub.graph import HubGraph
from bridge.record.arrivals import RecordedMessage

MAX_BYTES = 128 << 20
"""Maximum size of the stored messages in bytes; the oldest are dropped first."""
MAX_UNKNOWN = 256
"""Maximum number of publishers that are not in the graph yet, each with one stored message."""
MAX_DEPARTED = 256
"""Maximum number of publishers that have left the graph and whose messages stay stored, because they may return."""


class LatchedState:
    """The last messages of each latched publisher on the hub, as many as its depth. Not thread-safe."""

    def __init__(self, graph: HubGraph) -> None:
        self._graph = graph
        self._stored: dict[tuple[TopicKey, bytes], deque[RecordedMessage]] = {}
        self._plain: set[bytes] = set()
        self._unknown: set[tuple[TopicKey, bytes]] = set()
        self._departed: set[tuple[TopicKey, bytes]] = set()  # as of the last call of `all`
        self._bytes = 0

    def add(self, arrival: RecordedMessage) -> None:
        """Store a message if its publisher is latched."""
        gid = arrival.gid
        if gid in self._plain:
            return
        key = arrival.counts.key, gid
        if key not in self._stored:
            if len(self._unknown) >= MAX_UNKNOWN and not self._graph.zid_of(gid):
                return
            self._stored[key] = deque(maxlen=1)
            self._unknown.add(key)
        if key in self._unknown and not self._look_up(key):
            return
        stored = self._stored[key]
        if len(stored) == stored.maxlen:
            self._bytes -= len(stored[0].data)
        stored.append(arrival)
        self._bytes += len(arrival.data)
        while self._bytes > MAX_BYTES:
            self._drop_oldest()

    def _look_up(self, key: tuple[TopicKey, bytes]) -> bool:
        """Return whether to store a publisher's message, because it is latched, or is not in the graph yet."""
        if not self._graph.zid_of(key[1]):  # fast, since a publisher without a token calls this for each message
            return True
        endpoint = self._graph.endpoint(key[1])
        if endpoint is None:
            return True
        self._unknown.discard(key)
        if endpoint.qos.latched:
            self._stored[key] = deque(self._stored[key], cache_depth(endpoint.qos))
            return True
        self._plain.add(key[1])
        self._drop(key)
        return False

    def _drop(self, key: tuple[TopicKey, bytes]) -> None:
        self._unknown.discard(key)
        self._departed.discard(key)
        self._bytes -= sum(len(arrival.data) for arrival in self._stored.pop(key))

    def _drop_oldest(self) -> None:
        key, stored = min(
            self._stored.items(), key=lambda item: (item[0] not in self._departed, item[1][0].log_time)
        )  # fmt: skip
        self._bytes -= len(stored.popleft().data)
        if not stored:
            self._drop(key)

    def all(self) -> Iterator[RecordedMessage]:
        """Yield the messages of all publishers in the graph, oldest first.

        Those of publishers that left the hub stay stored: after a lost link has returned, the hub does not deliver them
        again.
        """
        present = {endpoint.gid for endpoint in self._graph.publishers()}
        self._plain &= present
        for key in [key for key in self._unknown if key[1] not in present]:
            self._drop(key)
        departed = [key for key in self._stored if key[1] not in present]
        for key in departed[:-MAX_DEPARTED]:
            self._drop(key)
        self._departed = set(departed[-MAX_DEPARTED:])
        for key in list(self._unknown):
            self._look_up(key)
        shown = (stored for key, stored in self._stored.items() if key not in self._departed)
        yield from sorted((a for stored in shown for a in stored), key=lambda arrival: arrival.log_time)
