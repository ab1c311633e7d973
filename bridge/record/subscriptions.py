"""The subscriptions of a recording: which topics of the hub it receives, and their counts."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from functools import partial

from bridge.client.topics import HubTopic, HubTopics, TopicKey
from bridge.clock import SYSTEM_CLOCK
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from bridge.record.arrivals import ArrivalQueue, RecordedMessage, TopicCounts
from bridge.record.selection import Selection, tapped

_log = logging.getLogger("midspan.record")

GONE_SECONDS = 10.0
"""Seconds for which a topic without publishers stays subscribed, because its last messages may arrive later."""

MAX_TOPICS = 10_000


class RecordedTopics:
    """Subscribes to selected topics, and queues their messages. Safe to use from any thread.

    Attributes:
        topics: the topics on the hub.
        counts: the counts of each topic that was subscribed to.
        subscribes: whether the selected topics are subscribed to.
    """

    def __init__(
        self, hub: Hub, registry: Registry, selection: Selection, queue: ArrivalQueue, changed: Callable[[], None]
    ) -> None:
        self.topics = HubTopics(hub, registry, changed, taps=True)
        self.counts: dict[TopicKey, TopicCounts] = {}
        self.subscribes = False
        self._selection, self._queue = selection, queue
        self._lock = threading.Lock()
        self._gone: dict[TopicKey, float] = {}
        self._lost = self._refused = 0

    def start(self) -> None:
        self.subscribes = True
        self.refresh()

    def pause(self) -> None:
        """Unsubscribe from all topics."""
        with self._lock:
            self.subscribes = False
            for topic in self.topics.subscribed():
                self._unsubscribe(topic.key)

    def close(self) -> None:
        """Unsubscribe from all topics permanently."""
        with self._lock:
            self.subscribes = False
            self.topics.close()

    def refresh(self) -> dict[TopicKey, HubTopic]:
        """Subscribe to new selected topics, drop those that left the hub, and return all topics on the hub."""
        with self._lock:
            topics = self.topics.refresh()
            if not self.subscribes:
                return topics
            subscribed = {end.key for end in self.topics.subscribed()}
            for key, topic in topics.items():
                if key not in subscribed and self._selection.includes(topic):
                    self._subscribe(topic)
            now = time.monotonic()
            self._gone = {key: self._gone.get(key, now) for key in subscribed - topics.keys()}
            for key in [key for key, since in self._gone.items() if now - since > GONE_SECONDS]:
                del self._gone[key]
                self._unsubscribe(key)
            return topics

    def _subscribe(self, topic: HubTopic) -> None:
        key = topic.key
        counts = self.counts.get(key)
        if counts is None:
            if len(self.counts) >= MAX_TOPICS:
                _log.warning("%s is not recorded: the limit of %d topics is reached", key.topic, MAX_TOPICS)
                return
            counts = self.counts[key] = TopicCounts(tapped(key.topic)[1], key)
        self.topics.definitions.find(*key[1:])  # requests a definition from other nodes early
        end = self.topics.subscribe(topic, partial(self._on_sample, counts))
        if end.trouble:
            _log.warning("%s is not recorded: %s", key.topic, end.trouble)

    def _unsubscribe(self, key: TopicKey) -> None:
        end = self.topics.unsubscribe(key)
        if end is not None:
            self._lost += end.lost
            self._refused += end.refused

    def _on_sample(self, counts: TopicCounts, sample: HubSample) -> None:
        """Queue a message; runs on a thread of zenoh."""
        steady, offset, _error = SYSTEM_CLOCK.read()
        now = steady + offset
        origin = self.topics.origin(sample)
        if not self._selection.origin(origin):
            return
        if not self._queue.has_room(len(sample.payload)):
            counts.dropped["queue"] += 1
            return
        sent = sample.source_time_ns if sample.source_time_ns > 0 else now
        # a copy, because waiting messages would fill the sender's shared memory
        self._queue.put(RecordedMessage(counts, sample.gid, origin, sample.sequence, now, sent, offset, sample.data()))

    def lost(self) -> dict[str, int]:
        """Return the number of messages that were lost or refused on the hub, by reason, without zeros."""
        subscriptions = self.topics.subscribed()
        lost = self._lost + sum(item.lost for item in subscriptions)
        refused = self._refused + sum(item.refused for item in subscriptions)
        return {reason: count for reason, count in (("lost", lost), ("refused", refused)) if count}
