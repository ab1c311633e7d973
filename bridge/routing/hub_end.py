"""The hub end of a route to the side: its publishers, its subscription, its held samples, and the demand for it."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from enum import Enum
from functools import partial

from bridge.hub.endpoints.subscription import HubSample, HubSubscription
from bridge.hub.graph import HubEndpoint
from bridge.hub.wire.qos import Durability, Qos
from bridge.routing.backlog import Backlog
from bridge.routing.limits import MAX_PENDING, QUEUE_BYTES, QUEUE_DEPTH, Priority
from bridge.routing.stall import AgeGate
from bridge.state_machine import Machine, Table

UNSUBSCRIBE_SECONDS = 10.0
"""Seconds without a subscriber on the side after which a route unsubscribes from a fast stream."""

QUICK = 5.0
"""Messages per second above which a stream counts as fast, because a new subscriber misses some of its messages anyway.
Rarer messages may be events, which a new subscriber must not miss."""

_MAX_DEPARTED = 4096
"""Maximum number of departed publishers that are remembered, because they may return."""


@dataclass(slots=True)
class HubSource:
    """A publisher on the hub whose messages are bridged; ``age`` checks their timestamps."""

    endpoint: HubEndpoint
    latched: bool
    age: AgeGate


@dataclass(frozen=True, slots=True)
class HubSources:
    """The engine's classification of a topic's publishers on the hub. Immutable, so threads need no lock to read it.

    Attributes:
        allowed: publishers whose messages are bridged, by GID.
        refused: GIDs of publishers whose messages are not bridged.
        waiting: publishers that may be allowed later, by GID.
        natives: allowed publishers that do not belong to workers, by session: some (zenoh-ros2-sdk) put an invented
            GID in their samples.
    """

    allowed: Mapping[bytes, HubSource] = field(default_factory=dict)
    refused: frozenset[bytes] = frozenset()
    waiting: Mapping[bytes, HubEndpoint] = field(default_factory=dict)
    natives: Mapping[str, HubSource] = field(default_factory=dict)

    def updated(
        self, allowed: Sequence[HubEndpoint], refused: Sequence[HubEndpoint], waiting: Sequence[HubEndpoint],
        latches: Callable[[Qos], bool],
    ) -> HubSources:  # fmt: skip
        """Return the next classification; publishers that are still allowed keep their `HubSource`."""
        sources = {e.gid: self.allowed.get(e.gid) or HubSource(e, latches(e.qos), AgeGate()) for e in allowed}
        natives = {s.endpoint.zid: s for s in sources.values() if s.endpoint.origin is None}
        return HubSources(sources, frozenset(e.gid for e in refused), {e.gid: e for e in waiting}, natives)

    def of(self, sample: HubSample) -> HubSource | None:
        """Return the publisher of a sample; None if it is not allowed, or unknown."""
        source = self.allowed.get(sample.gid)
        if source is not None or sample.gid in self.refused or sample.gid in self.waiting:
            return source
        return self.natives.get(sample.zid) if sample.zid else next(iter(self.natives.values()), None)


class RouteSubscription:
    """A route's subscription on the hub, which may be closed and opened again without resetting its counts.

    It is paused while the side has no subscriber to a fast stream. Only the engine's loop opens and closes it; any
    thread may read its state.
    """

    def __init__(self, subscribe: Callable[[Qos], HubSubscription]) -> None:
        self._subscribe = subscribe
        self._current: HubSubscription | None = None
        self._durability: Durability | None = None
        self._lost_before = self._by_lane_before = 0
        self._departed: dict[bytes, None] = {}
        self._demand = StreamDemand()
        self.since = 0.0
        """Time of the last opening (monotonic seconds)."""

    @property
    def open(self) -> bool:
        """Whether the route is subscribed now."""
        return self._current is not None

    @property
    def paused(self) -> bool:
        """Whether the route has unsubscribed from a fast stream, because the side has no subscriber."""
        return self._demand.state is Demand.PAUSED

    def follow_demand(self, messages: int, *, wanted: bool) -> None:
        """Close the subscription if its stream pauses; see `StreamDemand.update`."""
        if self._demand.update(messages, wanted=wanted, subscribed=self.open) is Demand.PAUSED:
            self.close()

    def request(self, qos: Qos) -> bool:
        """Subscribe with a QoS, unless a subscription with that durability exists; return whether one was opened."""
        if self._current is not None and qos.durability is self._durability:
            return False
        self.close()
        self._durability = qos.durability
        self.since = time.monotonic()  # before the first message arrives
        self._current = self._subscribe(qos)
        return True

    def depart(self, gid: bytes) -> None:
        """Note that the latched messages of a publisher were dropped on the side."""
        self._departed[gid] = None
        while len(self._departed) > _MAX_DEPARTED:
            del self._departed[next(iter(self._departed))]

    def request_returned(
        self, allowed: Mapping[bytes, HubSource], publishing: AbstractContextManager[object],
        remove: Callable[[Collection[bytes]], None],
    ) -> None:  # fmt: skip
        """Request the cached messages of departed publishers that are allowed again, although they were received once.

        ``remove`` removes the messages of such publishers that the route holds, because the publishers' caches contain
        these too; it is called while the route's lock ``publishing`` is held.
        """
        for gid in self._departed.keys() & allowed.keys():
            del self._departed[gid]
            endpoint = allowed[gid].endpoint
            if self._current is not None and endpoint.qos.latched:
                with publishing:
                    self._current.request_again(gid, endpoint.zid, partial(remove, {gid}))

    def close(self) -> None:
        if self._current is not None:
            self._lost_before += self._current.lost
            self._by_lane_before += self._current.by_lane
            self._current.close()
            self._current = None

    def status(self) -> tuple[tuple[str, str], int]:
        """Return the transport with the reason for using zenoh, and the number of samples that used the lane."""
        current = self._current
        if current is None:
            return ("", ""), self._by_lane_before
        return (current.way, current.why), self._by_lane_before + current.by_lane

    def losses(self) -> tuple[int, Callable[[], str]] | None:
        """Return the number of lost samples, and a function that explains them; None while closed."""
        current = self._current
        return None if current is None else (self._lost_before + current.lost, current.losses)


class HeldSamples:
    """Samples that a route may publish later; ``dropped`` is called for each sample that a newer one displaces.

    Attributes:
        unknown: samples from publishers that the engine has not classified yet.
        latched: latched samples, which arrive only once, of publishers that may be allowed later, or of any publisher
            while the worker lacks the lease.
    """

    def __init__(self, dropped: Callable[[], None]) -> None:
        self.unknown = Backlog[HubSample](MAX_PENDING, QUEUE_BYTES, dropped)
        self.latched = Backlog[HubSample](QUEUE_DEPTH[Priority.STATE], QUEUE_BYTES, dropped)

    def add_unknown(self, sample: HubSample) -> None:
        """Hold a sample of an unclassified publisher, after the older samples."""
        sample.data()  # it must not occupy the sender's memory
        self.unknown.add(sample.gid, sample, len(sample.payload))

    def add_latched(self, sample: HubSample, endpoint: HubEndpoint) -> None:
        """Hold a latched sample; of each publisher, hold only as many as its ``endpoint`` retains."""
        sample.data()  # it must not occupy the sender's memory
        depth = min(max(endpoint.qos.depth, 1), MAX_PENDING)
        self.latched.keep(sample.gid, sample, len(sample.payload), depth)

    def remove(self, sources: Collection[bytes]) -> None:
        """Remove the samples of publishers, given by GID, without counting them as dropped."""
        for backlog in (self.unknown, self.latched):
            backlog.pop_matching(lambda waiting: waiting.source in sources)


class Demand(Enum):
    """Whether the side has subscribers to a stream."""

    WANTED = "it has subscribers"
    UNWANTED = "it had none at the last check"
    PAUSED = "it has none, and the route has unsubscribed"


class DemandEvent(Enum):
    """The events that change `Demand`."""

    SUBSCRIBED = "a check sees a subscriber on the side"
    UNSUBSCRIBED = "a check sees none"
    WASTED = "the stream was fast for ten seconds, and the side had no subscriber"


DEMAND: Table[Demand, DemandEvent] = {
    Demand.WANTED: {DemandEvent.UNSUBSCRIBED: Demand.UNWANTED},
    Demand.UNWANTED: {DemandEvent.SUBSCRIBED: Demand.WANTED, DemandEvent.WASTED: Demand.PAUSED},
    Demand.PAUSED: {DemandEvent.SUBSCRIBED: Demand.WANTED},
}


class StreamDemand(Machine[Demand, DemandEvent]):
    """Decides when to pause a stream: if it is fast, and the side had no subscriber for `UNSUBSCRIBE_SECONDS`.

    Used only by the engine's loop; any thread may read ``state``.
    """

    def __init__(self) -> None:
        super().__init__(DEMAND, Demand.UNWANTED)
        self._counted_since, self._messages_then = time.monotonic(), 0

    def update(self, messages: int, *, wanted: bool, subscribed: bool) -> Demand:
        """Return the state at a check.

        ``messages``: number of bridged messages so far; ``wanted``: whether the side has a subscriber; ``subscribed``:
        whether the route's subscription is open.
        """
        seconds, count = time.monotonic() - self._counted_since, messages - self._messages_then
        expired = seconds > UNSUBSCRIBE_SECONDS
        if self.state is Demand.WANTED or expired:  # the last check's subscriber may have left just now
            self._counted_since, self._messages_then = time.monotonic(), messages
        if wanted:
            self.on(DemandEvent.SUBSCRIBED)
        elif not self.on(DemandEvent.UNSUBSCRIBED) and subscribed and expired and count > QUICK * seconds:
            self.on(DemandEvent.WASTED)
        return self.state
