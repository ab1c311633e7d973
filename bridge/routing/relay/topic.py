"""A topic that is relayed from the publishers of one type hash to the subscriptions of others."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from contextlib import nullcontext
from functools import partial
from threading import Lock
from typing import NamedTuple

from bridge.concurrency import BoundedQueue, SerialExecutor
from bridge.hub.endpoints.relaying import RelayPublisher
from bridge.hub.endpoints.subscription import HubSample, HubSubscription
from bridge.hub.endpoints.variants import TypeVersions
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.unchanged import same
from bridge.routing.admission import TopicAdmission
from bridge.routing.backlog import Backlog
from bridge.routing.counters import Counters
from bridge.routing.hold import Hold
from bridge.routing.hub_end import HubSource, HubSources, RouteSubscription
from bridge.routing.limits import MAX_PENDING, QUEUE_BYTES, QUEUE_DEPTH, Priority, combined_qos
from bridge.routing.peer_watch import ALONE
from bridge.routing.relay.pairs import RelayKey, TopicPair
from bridge.routing.rules import RoutePolicy
from bridge.routing.stall import StallDetector

PENDING_SECONDS = 2.0
"""Seconds for which a message from an unknown publisher is held."""

_SHARED = b""


class RelayContext(NamedTuple):
    """What all relayed topics share.

    Attributes:
        node: the relay's node on the hub.
        versions: converts between the versions of types.
        stall_detector: detects that this process was suspended.
        hold: the velocities that may not pass now.
        wake: schedules a check of the pairs.
        closing: closes what may wait for a congested link.
    """

    node: Hub
    versions: TypeVersions
    stall_detector: StallDetector
    hold: Hold
    wake: Callable[[], None]
    closing: SerialExecutor


class RelayedTopic(TopicAdmission):
    """Relays a topic's messages, each with its original number, time and GID.

    Each latched publisher has its own publishers here, so that its cached messages disappear when it leaves; all other
    publishers share one for each hash. A command is never latched or held, and is dropped if it is too old, unless it
    is a velocity of zero.

    The receiving threads only queue the messages, because sending may wait for a congested link. ``_lock`` keeps the
    order between held and new messages.
    """

    def __init__(self, key: RelayKey, policy: RoutePolicy, pair: TopicPair, context: RelayContext) -> None:
        super().__init__((key.topic,), key.type_name, policy, Counters(), context.stall_detector)
        self.key, self.pair = key, pair
        self._context = context
        self._priority = Priority.STREAM
        self._sources = HubSources()
        self._publishers: dict[tuple[str, bytes], RelayPublisher] = {}  # by hash, and by GID if latched
        self._subscription = RouteSubscription(self._subscribe)
        self._lock = Lock()
        self._unknown = Backlog[HubSample](MAX_PENDING, QUEUE_BYTES, self.crowded_out)
        self._queue: BoundedQueue[tuple[HubSample, HubSource]] | None = None

    # -- the relay's loop ----------------------------------------------------------------------------------------------

    def update(self, pair: TopicPair) -> None:
        """Follow the publishers and subscriptions."""
        self.pair = pair
        self._priority = self.priority_of(latched=any(self.policy.override(end.qos).latched for end in pair.publishers))
        if self._queue is None:
            depth = self.policy.depth or QUEUE_DEPTH[self._priority]
            self._queue = BoundedQueue("midspan-relay", depth, QUEUE_BYTES, self._relay, self.crowded_out)
        sources = self._sources.updated(pair.publishers, (), (), self.latches)
        refused = HubSources(sources.allowed, pair.others, {}, sources.natives)
        before = self._sources.allowed
        opened = self._open_publishers(pair, refused)
        for gid in before:
            if before[gid].latched and (gid in opened or gid not in sources.allowed):
                self._subscription.depart(gid)
        self._sources = refused
        qos = combined_qos([end.qos for end in pair.publishers])
        if self._priority is Priority.COMMAND:
            qos = Qos(qos.reliability, Durability.VOLATILE, depth=1)
        self._subscription.request(qos)
        # The subscription calls `_remove` while it holds its lock, which its receiving threads hold before `_lock`.
        self._subscription.request_returned(sources.allowed, nullcontext(), self._remove)
        self._release()

    def _open_publishers(self, pair: TopicPair, sources: HubSources) -> set[bytes]:
        """Open and close publishers; return the GIDs of the latched sources for which one was opened."""
        wanted: dict[tuple[str, bytes], Qos] = {}
        for target in pair.subscriptions:
            for source in sources.allowed.values():
                qos = self.policy.override(source.endpoint.qos)
                if source.latched:
                    wanted[target, source.endpoint.gid] = qos
                else:
                    wanted.setdefault((target, _SHARED), self._volatile(qos))
        opened = {at: self._publisher(at[0], qos) for at, qos in wanted.items() if at not in self._publishers}
        ended = [publisher for at, publisher in self._publishers.items() if at not in wanted]
        kept = {at: publisher for at, publisher in self._publishers.items() if at in wanted}
        self._publishers = kept | opened
        if ended:
            self._context.closing.submit(partial(_close, ended))
        return {gid for _, gid in opened}

    def _volatile(self, qos: Qos) -> Qos:
        if self._priority is Priority.COMMAND:  # a history of all would wait for a congested link
            return Qos(qos.reliability, Durability.VOLATILE, depth=1)
        return Qos(qos.reliability, Durability.VOLATILE, qos.history, qos.depth)

    def _publisher(self, target: str, qos: Qos) -> RelayPublisher:
        topic, type_name, source, grouped = self.key
        convert = None if grouped else self._context.versions.converter(type_name, source, target)
        if convert is same:
            convert = None
        return self._context.node.relay_publisher(topic, type_name, target, qos, convert, priority=self._priority.value)

    def _subscribe(self, qos: Qos) -> HubSubscription:
        topic, type_name, type_hash, grouped = self.key
        subscribe = self._context.node.subscription
        return subscribe(topic, type_name, type_hash, qos, self._receive, self._refused, grouped=grouped)

    def _release(self) -> None:
        """Relay the held messages of publishers that are known by now, and drop those that are overdue."""
        before = self._unknown.overdue(PENDING_SECONDS)
        if not self._unknown:
            return
        with self._lock:
            for waiting in self._unknown.pop_matching(lambda _: True):
                source = self._sources.of(waiting.message)
                if source is not None:
                    self._enqueue(waiting.message, source)
                elif waiting.message.gid not in self._sources.refused:
                    if waiting.since >= before:
                        self._unknown.put_back(waiting)
                    else:
                        self.counters.dropped("unknown")

    def _remove(self, sources: Collection[bytes]) -> None:
        """Remove the held messages of publishers whose caches will deliver them."""
        with self._lock:
            self._unknown.pop_matching(lambda waiting: waiting.source in sources)

    # -- messages ------------------------------------------------------------------------------------------------------

    def _refused(self, reason: str, why: str) -> None:
        self.counters.dropped(reason)
        self.counters.failed(why)

    def _receive(self, sample: HubSample) -> None:
        """Queue a message of a known publisher; called on the receiving threads."""
        with self._lock:
            sources = self._sources
            source = sources.of(sample)
            if source is not None and not self._unknown.holds(sample.gid):
                self._enqueue(sample, source)
                return
            if sample.gid in sources.refused or self._context.node.graph.is_midspan(sample.zid):
                return
            if self._priority is Priority.COMMAND:
                self.counters.dropped("unknown")
            else:
                self._unknown.add(sample.gid, sample, len(sample.payload))
        self._context.wake()

    def _enqueue(self, sample: HubSample, source: HubSource) -> None:
        if self._queue is not None and not self.over_rate(sample.data, latched=source.latched):
            self._queue.put((sample, source), len(sample.payload))

    def _relay(self, message: tuple[HubSample, HubSource]) -> None:
        """Publish a message; called on the queue's thread."""
        sample, source = message
        if not source.latched and self._stall_detector.hung(ALONE) and not self._stops(sample.data):
            self.counters.dropped("standby")
            return
        if self._context.hold.blocks_native(self.key.topic):
            self.counters.dropped("held")
            return
        if self._priority is Priority.COMMAND and self.is_stale(sample.data, source.age, sample.source_time_ns):
            self.counters.dropped("stale")
            return
        at = source.endpoint.gid if source.latched else _SHARED
        payload = sample.data()
        for (_, gid), publisher in self._publishers.items():
            if gid == at:
                publisher.put(sample, payload)
        self.counters.crossed(len(payload))

    def close(self) -> None:
        """Stop relaying."""
        self._subscription.close()
        publishers, self._publishers = self._publishers, {}
        self._context.closing.submit(partial(self._close_publishers, publishers.values()))

    def _close_publishers(self, publishers: Iterable[RelayPublisher]) -> None:
        if self._queue is not None:
            self._queue.close()
        _close(publishers)


def _close(publishers: Iterable[RelayPublisher]) -> None:
    for publisher in publishers:
        publisher.close()
