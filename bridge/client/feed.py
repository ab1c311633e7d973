"""The received messages of one topic: a queue of all of them, or the newest one."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from bridge.client.errors import ClientError
from bridge.client.graph import absolute, all_topics, ask_decisions, unknown
from bridge.client.session import Client
from bridge.client.topics import TopicFollower, TopicKey
from bridge.client.types import Types
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.graph import origin_side
from bridge.hub.wire.qos import LATCHED, Durability, Qos
from bridge.messages.errors import ConversionError
from bridge.text import side_name

MAX_QUEUED = 10_000
MAX_QUEUED_BYTES = 64 * 1024 * 1024
TAP_SECONDS = 10
"""Duration of a tap in seconds; a tap is renewed after a third of this time."""

_REFRESH_SECONDS = 0.5
_TAP_QOS = Qos(durability=Durability.TRANSIENT_LOCAL, depth=100)


class Arrival(NamedTuple):
    """One received message.

    ``sample`` is None without payloads; ``source_time_ns`` is the source's system time, if known; ``arrived`` is
    monotonic seconds.
    """

    sample: HubSample | None
    size: int
    type_name: str
    type_hash: str
    source_time_ns: int | None
    arrived: float
    side: str


class TopicFeed:
    """Receives one topic from the hub, or through a tap of a side's worker; without ``payloads`` only the arrivals.

    ``option`` is the command's option that waits for the topic, for errors.
    """

    def __init__(
        self, client: Client, topic: str, side: str | None = None, *, payloads: bool = True, option: str = "--timeout"
    ) -> None:
        self.topic = absolute(topic)
        self.overrun = 0
        self._client, self._side, self._payloads, self._option = client, side, payloads, option
        self._follower = TopicFollower(client.hub, self._on_sample)
        self._taps: set[str] = set()
        self._tap_due = 0.0
        self._names = [self.topic]
        self._queue: deque[Arrival] = deque()
        self._bytes = 0
        self._arrived = threading.Condition()

    @property
    def lost(self) -> int:
        """Number of lost messages, by the publishers' sequence numbers."""
        return self._follower.lost

    def open(self, seconds: float) -> None:
        """Find the topic, waiting up to ``seconds`` for it; raises `ClientError` if it cannot be received."""
        end = time.monotonic() + seconds
        self._client.ask("status", timeout=1.0)
        self._client.settle()
        self._learn_names()
        while True:
            self.refresh()
            if troubles := self._follower.troubles:
                raise ClientError("; ".join(troubles))
            if self._follower:
                return
            if time.monotonic() >= end:
                raise ClientError(self._why_not())
            time.sleep(min(_REFRESH_SECONDS, max(0.0, end - time.monotonic())))

    def refresh(self) -> None:
        """Subscribe to new publishers, and renew the taps."""
        publishers = (end for name in self._names for end in self._client.publishers(name))
        self._follower.follow(e for e in publishers if not e.own and self._side in (None, origin_side(e)))
        if self._taps or not self._follower:
            self._tap()

    def next(self, until: float) -> Arrival | None:
        """Return the next message, None if none arrives by ``until`` (monotonic seconds)."""
        while True:
            wait = min(until - time.monotonic(), _REFRESH_SECONDS)
            with self._arrived:
                if self._queue or (wait > 0 and self._arrived.wait_for(lambda: bool(self._queue), wait)):
                    arrival = self._queue.popleft()
                    self._bytes -= arrival.size if self._payloads else 0
                    return arrival
            if time.monotonic() >= until:
                return None
            self.refresh()

    def on_sample(self, sample: HubSample, type_name: str, type_hash: str, side: str) -> None:
        """Queue a received message; called on a zenoh thread."""
        kept = sample if self._payloads else None
        time_ns = sample.source_time_ns or None
        arrival = Arrival(kept, len(sample.payload), type_name, type_hash, time_ns, time.monotonic(), side)
        with self._arrived:
            self._queue.append(arrival)
            self._bytes += arrival.size if self._payloads else 0
            while len(self._queue) > MAX_QUEUED or (self._bytes > MAX_QUEUED_BYTES and len(self._queue) > 1):
                self._bytes -= self._queue.popleft().size if self._payloads else 0
                self.overrun += 1
            self._arrived.notify()

    def close(self) -> None:
        """Unsubscribe; the taps expire by themselves."""
        self._follower.close()

    def _learn_names(self) -> None:
        """Find the topic's names on the hub from its name on the sides."""
        for decision in ask_decisions(self._client, self.topic):
            if decision.decision == "bridged" and decision.hub_topic not in self._names:
                self._names.append(decision.hub_topic)

    def _on_sample(self, key: TopicKey, sample: HubSample) -> None:
        origin = self._client.hub.graph.origin_of(sample.zid)
        side = "zenoh" if origin is None else origin.side
        if self._side in (None, side):
            self.on_sample(sample, key.type_name, key.type_hash, side)

    def _tap(self) -> None:
        if time.monotonic() < self._tap_due:
            return
        self._tap_due = time.monotonic() + TAP_SECONDS / 3
        for answer in self._client.ask("tap", {"topic": self.topic, "seconds": TAP_SECONDS}):
            value = answer.value if isinstance(answer.value, dict) else {}
            topic, type_name, type_hash = (str(value.get(name, "")) for name in ("topic", "type", "hash"))
            if topic and self._side in (None, answer.worker):
                self._taps.add(topic)
                # the tap may have latched messages; a latched subscription also receives volatile ones
                self._follower.topic(TopicKey(topic, type_name, type_hash)).subscribe(_TAP_QOS)

    def _why_not(self) -> str:
        decisions = ask_decisions(self._client, self.topic)
        if not decisions:
            return unknown("topic", self.topic, all_topics(self._client))
        reasons = "; ".join(f"{side_name(d.worker)}: {d.decision}: {d.why}" for d in decisions)
        return f"no messages of {self.topic} can be received now ({reasons}); wait for it with {self._option} SECONDS"


class LatestMessage:
    """The newest message of a latched topic; ``on_message`` is called with each message on a zenoh thread.

    Without ``on_message``, a message is decoded only when it is read, because large ones such as maps take long.

    Attributes:
        count: the number of messages that have arrived.
    """

    def __init__(
        self, client: Client, types: Types, topic: str, type_name: str,
        on_message: Callable[[dict[str, Any]], None] | None = None,
    ) -> None:  # fmt: skip
        self.count = 0
        self._types, self._type, self._on_message = types, type_name, on_message
        self._hash = types.hash_of(type_name)
        self._arrived = threading.Condition()
        self._data = b""
        self._end = client.hub.subscription(topic, type_name, self._hash, LATCHED, self._on_sample)

    def _on_sample(self, sample: HubSample) -> None:
        data = sample.data()
        if self._on_message is not None:
            try:
                message = self._decode(data)
            except (ClientError, ConversionError):
                return
            self._on_message(message)
        with self._arrived:
            self._data, self.count = data, self.count + 1
            self._arrived.notify_all()

    def _decode(self, data: bytes) -> dict[str, Any]:
        return self._types.decode(self._type, self._hash, data)

    def newer(self, count: int, seconds: float) -> bool:
        """Wait for a message after the ``count``-th one; return whether it has arrived in time."""
        with self._arrived:
            return self._arrived.wait_for(lambda: self.count > count, seconds)

    def read(self) -> dict[str, Any] | None:
        """Return the newest message, None before the first; raises `ClientError` or `ConversionError` if invalid."""
        return self._decode(self._data) if self._data else None

    def wait(self, seconds: float) -> dict[str, Any] | None:
        """Return the newest message; None if no message arrives in time, or the newest one is invalid."""
        self.newer(0, seconds)
        try:
            return self.read()
        except (ClientError, ConversionError):
            return None

    def close(self) -> None:
        self._end.close()


def latest_message(client: Client, types: Types, topic: str, type_name: str, seconds: float) -> dict[str, Any] | None:
    """Return the newest message of a latched topic, None if it does not arrive in time."""
    latest = LatestMessage(client, types, topic, type_name)
    try:
        return latest.wait(seconds)
    finally:
        latest.close()
