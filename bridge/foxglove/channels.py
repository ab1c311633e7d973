"""The hub's topics as channels, announced with their definitions; one is subscribed on the hub only while watched."""

from __future__ import annotations

from threading import Lock
from typing import Any

from bridge.client.topics import HubTopic, HubTopics, TopicKey
from bridge.foxglove.server import FoxgloveServer
from bridge.foxglove.status import ChannelStatus
from bridge.hub.endpoints.subscription import HubSample
from bridge.routing.counters import Counters
from bridge.status import RefusedRoute

MOST_CACHED = 64 << 20
"""Maximum bytes of latched messages that are cached for one topic while it is watched."""
MOST_PUBLISHERS = 256
"""Maximum number of latched publishers of one topic whose newest message is cached."""
MOST_EARLY = 4
"""Maximum number of one topic's publishers whose newest message is cached before the graph lists them."""


class TopicChannel:
    """One topic, offered to clients. `on_sample` runs on zenoh's threads, everything else on the worker's.

    Attributes:
        counters: messages passed to the SDK, and drops.
    """

    def __init__(self, topic: HubTopic, channel: Any) -> None:
        self.topic, self.channel = topic, channel
        self.counters = Counters()
        self.subscribed = False
        self._lock = Lock()
        self._latched = self._volatile = frozenset[bytes]()
        self._cached: dict[bytes, tuple[bytes, int]] = {}
        self._early: dict[bytes, tuple[bytes, int]] = {}
        self._size = 0

    def follow(self, topic: HubTopic) -> None:
        """Update the set of publishers."""
        self.topic = topic
        latched = frozenset(end.gid for end in topic.publishers if end.qos.latched)
        with self._lock:
            self._latched = latched
            self._volatile = frozenset(end.gid for end in topic.publishers) - latched
            for gid in self._cached.keys() - latched:
                self._drop(gid)
            for gid in [gid for gid in self._early if gid in latched or gid in self._volatile]:
                data, at = self._early.pop(gid)
                if gid in latched:
                    self._cache(gid, data, at)

    def on_sample(self, sample: HubSample) -> None:
        """Pass a message to the SDK, which copies it without blocking."""
        data, at = sample.data(), sample.source_time_ns
        self.counters.crossed(len(data))
        if sample.gid not in self._volatile:
            with self._lock:
                if sample.gid in self._latched:
                    self._cache(sample.gid, data, at)
                elif sample.gid not in self._volatile:
                    self._cache_early(sample.gid, data, at)
        self.channel.log(data, at or None)

    def resend_latched(self) -> None:
        """Send each latched publisher's newest message again for a late client; the SDK sends it to all watchers."""
        with self._lock:  # a newer message is cached before it is sent, and so follows the cached ones
            for data, at in self._cached.values():
                self.channel.log(data, at or None)

    def clear(self) -> None:
        """Clear the cache, because no client watches."""
        with self._lock:
            self._cached.clear()
            self._early.clear()
            self._size = 0

    def _cache(self, gid: bytes, data: bytes, at: int) -> None:
        self._drop(gid)
        if len(self._cached) < MOST_PUBLISHERS and self._size + len(data) <= MOST_CACHED:
            self._cached[gid] = data, at
            self._size += len(data)

    def _cache_early(self, gid: bytes, data: bytes, at: int) -> None:
        """Cache a message whose publisher the graph does not list yet: a latched one may send only this message."""
        self._early.pop(gid, None)
        self._early[gid] = data, at
        if len(self._early) > MOST_EARLY:
            del self._early[next(iter(self._early))]

    def _drop(self, gid: bytes) -> None:
        self._size -= len(self._cached.pop(gid, (b"", 0))[0])


class Channels:
    """All channels. Used only on the worker's thread."""

    def __init__(self, server: FoxgloveServer, topics: HubTopics) -> None:
        self._server, self._topics = server, topics
        self._channels: dict[str, TopicChannel] = {}
        self._refused: dict[TopicKey, str] = {}
        self._undefined = False

    def refresh(self) -> None:
        """Announce new topics, and withdraw those that have disappeared."""
        topics = self._topics.refresh()
        for name, channel in list(self._channels.items()):
            topic = topics.get(channel.topic.key)
            if topic is None:
                self._close(name)
            else:
                channel.follow(topic)
        self._refused, self._undefined = {}, False
        for key, topic in sorted(topics.items()):
            shown = self._channels.get(key.topic)
            if shown is None:
                self._open(topic)
            elif shown.topic.key != key:
                other = shown.topic.key
                version = f" in another version ({other.type_hash})" if other.type_name == key.type_name else ""
                reason = f"its name is offered with the type {other.type_name}{version}; the app allows one per name"
                self._refused[key] = reason

    def watch(self, watched: set[int], late: set[int]) -> None:
        """Subscribe to the channels in ``watched`` and no others.

        Latched messages are sent again on the channels in ``late``, which have a new watcher.
        """
        for channel in self._channels.values():
            number = channel.channel.id()
            if number in watched:
                if channel.subscribed and number in late:
                    channel.resend_latched()
                elif not channel.subscribed:
                    channel.subscribed = True
                    self._topics.subscribe(channel.topic, channel.on_sample)
            elif channel.subscribed:
                self._unsubscribe(channel)

    def _open(self, topic: HubTopic) -> None:
        key = topic.key
        definition = self._topics.definitions.find(key.type_name, key.type_hash)
        if definition is None:
            self._refused[key], self._undefined = "its definition is unknown, and is requested from the workers", True
            return
        self._refused.pop(key, None)
        about = {"side": ", ".join(topic.sides), "latched": str(topic.latched).lower(), "hash": key.type_hash}
        channel = TopicChannel(topic, self._server.channel(key.topic, key.type_name, definition, about))
        channel.follow(topic)
        self._channels[key.topic] = channel

    def _close(self, name: str) -> None:
        channel = self._channels.pop(name)
        self._unsubscribe(channel)
        channel.channel.close()

    def _unsubscribe(self, channel: TopicChannel) -> None:
        channel.subscribed = False
        self._topics.unsubscribe(channel.topic.key)
        channel.clear()

    def tick(self) -> None:
        """Update rates and losses, and retry topics whose definition was requested."""
        ends = {subscription.key: subscription for subscription in self._topics.subscribed()}
        for channel in self._channels.values():
            channel.counters.tick()
            if (end := ends.get(channel.topic.key)) is not None:
                channel.counters.missed(end.lost, lambda: "lost on the hub's links")
                channel.counters.drops["bad"] = end.refused
        if self._undefined:
            self.refresh()

    @property
    def count(self) -> int:
        """Number of announced topics."""
        return len(self._channels)

    @property
    def watched(self) -> int:
        """Number of topics that are subscribed for clients."""
        return sum(channel.subscribed for channel in self._channels.values())

    def status(self) -> list[ChannelStatus]:
        """Return the watched topics, for the status document."""
        watched = sorted((name, channel) for name, channel in self._channels.items() if channel.subscribed)
        return [
            ChannelStatus(topic=name, type=shown.topic.key.type_name, end="subscription", **shown.counters.as_dict())
            for name, shown in watched
        ]

    def refused(self) -> list[RefusedRoute]:
        """Return the topics that cannot be offered, for the status document."""
        return [
            RefusedRoute(topic=key.topic, type=key.type_name, reason=reason, cure="")
            for key, reason in sorted(self._refused.items())
        ]

    def close(self) -> None:
        for name in list(self._channels):
            self._close(name)
