"""Lists all topics of the hub, and receives messages of selected topics as bytes, for recorders and viewers.

`HubTopics` lists the topics with all their publishers, and subscribes to some of them. It passes on the received CDR,
with the sequence number, source time and publisher from the attachment, and builds no message objects.

Callbacks run on zenoh's threads. The caller has to queue messages, and to bound the queue.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from threading import Event, Lock
from typing import TYPE_CHECKING, NamedTuple

from bridge.client.types import learn
from bridge.concurrency import SerialExecutor
from bridge.hub.endpoints.subscription import HubSample, HubSubscription
from bridge.hub.errors import HubError
from bridge.hub.graph import HubEndpoint, origin_side
from bridge.hub.graph.tokens import TAPS, Origin
from bridge.hub.node import Hub
from bridge.hub.wire.keys import NO_HASH
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.definitions.text import full_text
from bridge.messages.errors import MessageTypeError
from bridge.routing.limits import combined_qos

if TYPE_CHECKING:
    from bridge.messages.registry import Registry

_log = logging.getLogger(__name__)

ASK_AGAIN_SECONDS = 10.0
"""Seconds after which the workers are asked again for a definition that none of them had."""

_LATCHED_DEPTH = 1000
"""The most samples that are requested from each latched publisher."""

_MAX_SEEN = 4096
_MAX_RANGES = 64
_MAX_QUERIES = 10_000


class TopicKey(NamedTuple):
    """The identity of a topic: one name may have several types, and a type several versions."""

    topic: str
    type_name: str
    """In ROS 2's form, ``std_msgs/msg/String``."""
    type_hash: str


@dataclass(frozen=True, slots=True)
class HubTopic:
    """A topic that is published on the hub.

    Attributes:
        publishers: all except those of this session, in order of their appearance; at least one.
    """

    key: TopicKey
    publishers: tuple[HubEndpoint, ...]

    @property
    def sides(self) -> tuple[str, ...]:
        """The sides of its publishers, sorted; ``zenoh`` for native participants of the hub."""
        return tuple(sorted({origin_side(publisher) for publisher in self.publishers}))

    @property
    def latched(self) -> bool:
        """Whether a publisher stores messages for late joiners."""
        return any(publisher.qos.latched for publisher in self.publishers)


def published(endpoints: Iterable[HubEndpoint], *, taps: bool = False) -> dict[TopicKey, HubTopic]:
    """Return the topics of these publishers, without this session's own, and without those of still unknown origin.

    Args:
        endpoints: publishers on the hub.
        taps: include topics of a side that its worker shows on request (`bridge.hub.graph.tokens.TAPS`).
    """
    # a pending endpoint is announced again once its origin is known
    known = (end for end in endpoints if not (end.own or end.pending) and (taps or not end.topic.startswith(TAPS)))
    return {key: HubTopic(key, tuple(publishers)) for key, publishers in _by_key(known).items()}


def _by_key(endpoints: Iterable[HubEndpoint]) -> dict[TopicKey, list[HubEndpoint]]:
    groups: dict[TopicKey, list[HubEndpoint]] = {}
    for endpoint in endpoints:
        groups.setdefault(TopicKey(endpoint.topic, endpoint.type_name, endpoint.type_hash), []).append(endpoint)
    return groups


class SubscribedTopic:
    """A subscribed topic, created by `HubTopics.subscribe` and renewed by `HubTopics.refresh`.

    If a publisher stores messages for late joiners, these are received as well, each once. Messages of one publisher
    are in order, except that stored ones may follow newer ones if a latched publisher joins volatile ones.

    Attributes:
        key: the topic.
        trouble: why the subscription failed, "" if it did not.
    """

    def __init__(self, hub: Hub, key: TopicKey, on_sample: Callable[[HubSample], None]) -> None:
        self.key, self.trouble = key, ""
        self._hub, self._on_sample = hub, on_sample
        self._lock, self._renewing = Lock(), Lock()
        self._seen: dict[bytes, list[list[int]]] = {}  # ranges of sequence numbers, by publisher
        self._subscriptions: list[HubSubscription] = []
        self._latched = False
        self._closed = False
        self._lost = self._refused = 0

    @property
    def lost(self) -> int:
        """The number of messages that never arrived, by the publishers' sequence numbers."""
        return self._lost + sum(subscription.lost for subscription in self._subscriptions)

    @property
    def refused(self) -> int:
        """The number of refused messages: too large, or without a valid attachment of rmw_zenoh."""
        return self._refused + sum(subscription.refused for subscription in self._subscriptions)

    def renew(self, publishers: Iterable[HubEndpoint]) -> None:
        """Subscribe with the QoS that these publishers need; see `subscribe`."""
        self.subscribe(combined_qos([publisher.qos for publisher in publishers]))

    def subscribe(self, qos: Qos) -> None:
        """Subscribe with a QoS; an existing subscription is replaced only if it is volatile and ``qos`` is latched."""
        with self._renewing:
            self._subscribe(qos)

    def _subscribe(self, qos: Qos) -> None:
        if self._closed or (self._subscriptions and (self._latched or not qos.latched)):
            return
        # a subscription that is latched from the start has no predecessor, and thus no duplicates
        on_sample = self._on_sample if qos.latched and not self._subscriptions else self._on_possible_duplicate
        if qos.latched:
            qos = Qos(qos.reliability, Durability.TRANSIENT_LOCAL, depth=_LATCHED_DEPTH)
        try:
            subscription = self._hub.subscription(*self.key, qos, on_sample, exact=True)
        except HubError as err:
            self.trouble = str(err)
            return
        before, self._subscriptions, self._latched, self.trouble = self._subscriptions, [subscription], qos.latched, ""
        self._close(before)  # only now, so that no message is missed; `_is_new` filters the duplicates

    def _on_possible_duplicate(self, sample: HubSample) -> None:
        if self._is_new(sample):
            self._on_sample(sample)

    def _is_new(self, sample: HubSample) -> bool:
        with self._lock:
            is_new = _add(self._seen.setdefault(sample.gid, []), sample.sequence)
            if len(self._seen) > _MAX_SEEN:
                del self._seen[next(iter(self._seen))]
        return is_new

    def close(self) -> None:
        """Unsubscribe. Safe to call twice."""
        with self._renewing:
            self._closed = True
            self._close(self._subscriptions)
            self._subscriptions = []

    def _close(self, subscriptions: list[HubSubscription]) -> None:
        for subscription in subscriptions:
            subscription.close()
            self._lost += subscription.lost
            self._refused += subscription.refused


def _add(ranges: list[list[int]], number: int) -> bool:
    """Add a number to ascending ranges (first and last number); return False if one of them contains it.

    With more than `_MAX_RANGES`, the numbers between the two lowest ranges count as added.
    """
    at = len(ranges)
    while at and ranges[at - 1][0] > number:
        at -= 1
    if at and number <= ranges[at - 1][1]:
        return False
    ranges.insert(at, [number, number])
    for right in (at + 1, at):
        if 0 < right < len(ranges) and ranges[right][0] == ranges[right - 1][1] + 1:
            ranges[right - 1][1] = ranges.pop(right)[1]
    if len(ranges) > _MAX_RANGES:
        ranges[0][1] = ranges.pop(1)[1]
    return True


class TopicFollower:
    """Subscriptions to some topics; a new type of a topic is subscribed when its first publisher appears.

    Used by one thread; ``on_sample`` receives each message with its topic on zenoh's threads.
    """

    def __init__(self, hub: Hub, on_sample: Callable[[TopicKey, HubSample], None]) -> None:
        self._hub, self._on_sample = hub, on_sample
        self._subscribed: dict[TopicKey, SubscribedTopic] = {}
        self._lost = 0  # messages lost by subscriptions that are closed

    def __bool__(self) -> bool:
        return bool(self._subscribed)

    @property
    def lost(self) -> int:
        """Number of lost messages, by the publishers' sequence numbers."""
        return self._lost + sum(topic.lost for topic in self._subscribed.values())

    @property
    def troubles(self) -> list[str]:
        """Why subscriptions failed."""
        return [topic.trouble for topic in self._subscribed.values() if topic.trouble]

    def topic(self, key: TopicKey) -> SubscribedTopic:
        """Return the subscription to one type of a topic, which is created if necessary."""
        if key not in self._subscribed:
            self._subscribed[key] = SubscribedTopic(self._hub, key, partial(self._on_sample, key))
        return self._subscribed[key]

    def follow(self, publishers: Iterable[HubEndpoint], *, leave: bool = False) -> None:
        """Subscribe to these publishers; with ``leave``, unsubscribe from types that none of them publishes."""
        groups = _by_key(publishers)
        # a subscription with a hash also receives from publishers without one
        covered = {key._replace(type_hash=NO_HASH) for key in groups if key.type_hash != NO_HASH}
        for key in groups.keys() - covered:
            self.topic(key).renew(groups[key])
        self._unsubscribe(covered | (self._subscribed.keys() - groups.keys() if leave else set()))

    def close(self) -> None:
        """Unsubscribe from all topics."""
        self._unsubscribe(set(self._subscribed))

    def _unsubscribe(self, keys: set[TopicKey]) -> None:
        for key in self._subscribed.keys() & keys:
            topic = self._subscribed.pop(key)
            topic.close()
            self._lost += topic.lost


@dataclass(slots=True)
class _Query:
    """A query for a definition; ``since`` in monotonic seconds."""

    since: float
    answered: Event = field(default_factory=Event)


class Definitions:
    """Full definitions of types by name and hash: of installed types, and of types that the workers know.

    Safe to use from any thread. Its own thread queries the workers.
    """

    def __init__(self, hub: Hub, registry: Registry) -> None:
        self._hub, self._registry = hub, registry
        self._executor = SerialExecutor("hub-definitions")
        self._lock = Lock()
        self._definitions: dict[tuple[str, str], str] = {}
        self._queries: dict[tuple[str, str], _Query] = {}

    def find(self, type_name: str, type_hash: str, seconds: float = 0.0) -> str | None:
        """Return a type's definition, followed by those of its nested types (the form of ``ros2msg``).

        Args:
            type_name: in ROS 2's form.
            type_hash: hash of the type's version.
            seconds: how long to wait for the workers' answers if the type is not installed.

        Returns:
            None if no worker has sent it within ``seconds``; a call more than `ASK_AGAIN_SECONDS` later asks again.
        """
        key = type_name, type_hash
        definition = self._definitions.get(key)
        if definition is not None:
            return definition
        if (definition := self._from_registry(key)) is not None:
            return definition
        query = self._query(key)
        if seconds > 0.0 and query.answered.wait(seconds):
            return self._definitions.get(key)
        return None

    def _from_registry(self, key: tuple[str, str]) -> str | None:
        try:
            text = full_text(self._registry.schema(*key))
        except MessageTypeError:
            return None
        self._definitions[key] = text
        return text

    def _query(self, key: tuple[str, str]) -> _Query:
        now = time.monotonic()
        with self._lock:
            query = self._queries.get(key)
            if query is None or (query.answered.is_set() and now - query.since > ASK_AGAIN_SECONDS):
                if len(self._queries) > _MAX_QUERIES:
                    self._queries.clear()
                query = self._queries[key] = _Query(now)
                self._executor.submit(partial(self._query_workers, key, query))
        return query

    def _query_workers(self, key: tuple[str, str], query: _Query) -> None:
        try:
            if learn(self._hub, self._registry, *key):
                self._from_registry(key)
        except (HubError, MessageTypeError) as err:
            _log.warning("cannot get the definition of %s: %s", key[0], err)
        finally:
            query.answered.set()

    def close(self) -> None:
        self._executor.close()


class HubTopics:
    """The hub's topics, and subscriptions to some of them. Safe to use from any thread.

    Args:
        hub: the session, which stays open.
        registry: the known types.
        changed: called after each change of the hub's graph, on a thread of zenoh. It should only wake another thread,
            which then calls `refresh`.
        taps: include topics that stay on a side, and that its worker shows on request.

    Attributes:
        definitions: the definitions of the topics' types.
    """

    def __init__(
        self, hub: Hub, registry: Registry, changed: Callable[[], None] | None = None, *, taps: bool = False
    ) -> None:
        self._hub, self._taps = hub, taps
        self._lock = threading.RLock()
        self._subscribed: dict[TopicKey, SubscribedTopic] = {}
        self.definitions = Definitions(hub, registry)
        self._watch = hub.graph.watch(changed) if changed is not None else None

    def refresh(self) -> dict[TopicKey, HubTopic]:
        """Return the topics that are published now; renew subscriptions for which a latched publisher has appeared."""
        topics = published(self._hub.graph.publishers(), taps=self._taps)
        with self._lock:
            subscribed = list(self._subscribed.values())
        for topic in subscribed:
            if topic.key in topics:
                topic.renew(topics[topic.key].publishers)
        return topics

    def subscribe(self, topic: HubTopic, on_sample: Callable[[HubSample], None]) -> SubscribedTopic:
        """Subscribe to a topic until `close` or `unsubscribe`; an existing subscription keeps its callback.

        ``on_sample`` runs on several zenoh threads at a time: it should only queue the sample and wake a thread.
        The payload of a sample may be in its sender's shared memory, which is scarce: queue a copy (`HubSample.data`).
        """
        with self._lock:
            subscribed = self._subscribed.get(topic.key)
            if subscribed is None:
                subscribed = self._subscribed[topic.key] = SubscribedTopic(self._hub, topic.key, on_sample)
        subscribed.renew(topic.publishers)
        return subscribed

    def unsubscribe(self, key: TopicKey) -> SubscribedTopic | None:
        """Unsubscribe from a topic; return the closed subscription with its counts, None if there was none."""
        with self._lock:
            topic = self._subscribed.pop(key, None)
        if topic is not None:
            topic.close()
        return topic

    def subscribed(self) -> list[SubscribedTopic]:
        """Return the subscribed topics."""
        with self._lock:
            return list(self._subscribed.values())

    def publisher(self, gid: bytes) -> HubEndpoint | None:
        """Return the publisher of a sample, None if unknown. Cache the result: the call is slow."""
        return self._hub.graph.endpoint(gid)

    def origin(self, sample: HubSample) -> Origin | None:
        """Return the foreign network that a sample comes from, None for a native participant of the hub. Fast."""
        return self._hub.graph.origin_of(sample.zid)

    def close(self) -> None:
        """Unsubscribe from all topics. Safe to call twice."""
        if self._watch is not None:
            self._watch()
        with self._lock:
            topics, self._subscribed = list(self._subscribed.values()), {}
        for topic in topics:
            topic.close()
        self.definitions.close()
