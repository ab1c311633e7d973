"""A publisher on the hub."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import Enum
from functools import partial
from threading import Lock
from typing import Any, ClassVar, Protocol

import zenoh

from bridge.concurrency import DelayedCalls, SerialExecutor
from bridge.hub.endpoints.latched import LatchedPublisher
from bridge.hub.errors import HubClosedError, HubError, zenoh_reason
from bridge.hub.graph import HubGraph
from bridge.hub.graph.tokens import gid_of
from bridge.hub.lane.lane import Lane
from bridge.hub.lane.outlet import Outlet
from bridge.hub.lane.writer import LaneWriter
from bridge.hub.wire.keys import pack_attachment
from bridge.hub.wire.qos import History, Qos, Reliability
from bridge.hub.zenoh_compat import BEHIND, keep_thread_state, source_infos, undeclare
from bridge.hub.zenoh_config import POOL
from bridge.resources import LARGE_MESSAGES

KEEP_ALL_CACHE = 1000
"""Samples that a latched publisher caches if its history is unlimited."""
MAX_CACHE = 10_000

LARGE = POOL
"""Bytes; a larger message does not fit the shared memory, and crosses a link in hundreds of packets."""


NO_LANE = "this worker has no lane"

QUEUE = 1000
"""Messages, other than commands, that wait at most for a lane's reader that is full."""


@dataclass(frozen=True, slots=True)
class EndpointContext:
    """What the endpoints of one node share.

    Attributes:
        reach: other sessions only, or also the other nodes of a shared session.
        own: GIDs of the node's endpoints, whose messages its subscriptions and servers ignore; it changes.
        limit: bytes of the largest message.
        executor: runs calls that may wait for zenoh.
        ends: handles the ends of queries, see `bridge.hub.zenoh_compat`.
        asking: runs queries for the samples that latched publishers cache.
        heartbeats: publishes the numbers of latched publishers' last samples.
        closed: called with each endpoint that has closed.
        lane: the transport to this daemon's other workers; None if the session has no lane.
    """

    session: zenoh.Session
    reach: zenoh.Locality
    own: Collection[bytes]
    graph: HubGraph
    limit: int
    executor: SerialExecutor
    ends: SerialExecutor
    asking: SerialExecutor
    heartbeats: DelayedCalls
    closed: Callable[[Any], None]
    lane: Lane | None = None


class SamplePriority(Enum):
    """The zenoh priority of commands, states and streams."""

    COMMAND = zenoh.Priority.INTERACTIVE_HIGH
    STATE = zenoh.Priority.DATA_HIGH
    STREAM = zenoh.Priority.DATA


class _Sink(Protocol):
    keeps: ClassVar[bool]
    """Whether it caches samples for late subscriptions."""

    def send(self, payload: bytes, attached: bytes) -> None: ...
    def matched(self) -> bool: ...
    def close(self) -> None: ...


def _matching(publisher: zenoh.Publisher) -> bool:
    # an object that is always true, although the wheel's stubs promise a bool
    status: Any = publisher.matching_status
    return bool(status.matching)


class _Matching:
    """Whether another session subscribes to a publisher's key.

    A query of zenoh costs half as much as a put, so after the first one a listener follows the changes.
    """

    def __init__(self, publisher: zenoh.Publisher) -> None:
        self._publisher = publisher
        self._listener: Any = None
        self._told: dict[str, bool] = {}

    def now(self) -> bool:
        """Return the current state; not safe for two threads at once."""
        if self._listener is None:
            self._listener = self._publisher.declare_matching_listener(
                zenoh.handlers.Callback(self._changed, indirect=False)
            )
            # one step of CPython, so that this older state does not replace a change reported meanwhile
            self._told.setdefault("", _matching(self._publisher))
        return self._told[""]

    def _changed(self, status: Any) -> None:
        """Runs on a zenoh thread."""
        keep_thread_state()
        self._told[""] = bool(status.matching)

    def close(self) -> None:
        if self._listener is not None:
            undeclare(self._listener)


class _PlainSink:
    """A volatile publisher, which caches nothing."""

    keeps: ClassVar[bool] = False

    def __init__(self, context: EndpointContext, key: str, options: PublisherOptions) -> None:
        self._declare = partial(context.session.declare_publisher, key, allowed_destination=context.reach)
        self._publisher = self._declare(
            congestion_control=options.congestion, priority=options.priority, express=options.express
        )
        self._large: zenoh.Publisher | None = None
        self._matching = _Matching(self._publisher)
        self._blocks = options.congestion is zenoh.CongestionControl.BLOCK
        self._put = self._publisher.put
        # the large publisher continues the count under the same id, so that subscribers see one source without gaps
        self._infos = source_infos(self._publisher)

    def send(self, payload: bytes, attached: bytes) -> None:
        if len(payload) > LARGE and self._large is None and not self._blocks:
            # later messages use it too, so that none overtakes the large one
            self._large = self._declare(congestion_control=zenoh.CongestionControl.DROP, priority=BEHIND)
            self._put = self._large.put
        self._put(payload, attachment=attached, source_info=next(self._infos))

    def matched(self) -> bool:
        return self._matching.now()

    def close(self) -> None:
        self._matching.close()
        for publisher in (self._publisher, self._large):
            if publisher is not None:
                undeclare(publisher)


class _LatchedSink:
    """A transient-local publisher, which caches its last samples for late joiners."""

    keeps: ClassVar[bool] = True

    def __init__(self, context: EndpointContext, key: str, options: PublisherOptions, qos: Qos) -> None:
        reliable = qos.reliability is Reliability.RELIABLE
        self._publisher = LatchedPublisher(
            context.session,
            key,
            cache_depth(qos),
            context.heartbeats if reliable else None,
            reach=context.reach,
            congestion=options.congestion,
            priority=options.priority,
            express=options.express,
        )
        # the wheel's AdvancedPublisher does not show whether it is matched
        self._shadow = context.session.declare_publisher(key, allowed_destination=context.reach)

    def send(self, payload: bytes, attached: bytes) -> None:
        self._publisher.put(payload, attached)

    def matched(self) -> bool:
        return _matching(self._shadow)

    def close(self) -> None:
        undeclare(self._shadow)
        self._publisher.close()


class PublisherOptions:
    """How zenoh carries a publisher's samples.

    As in rmw_zenoh, samples are dropped on a congested link, and only RELIABLE with KEEP_ALL blocks: one slow peer must
    not delay the others. A latched subscription recovers dropped samples from the publisher's cache.
    """

    def __init__(self, qos: Qos, priority: str, express: bool | None, queue: int | None = None) -> None:
        self.blocks = qos.reliability is Reliability.RELIABLE and qos.history is History.KEEP_ALL
        self.congestion = zenoh.CongestionControl.BLOCK if self.blocks else zenoh.CongestionControl.DROP
        self.priority: zenoh.Priority = SamplePriority[priority.upper()].value
        self.express = self.priority == SamplePriority.COMMAND.value if express is None else express
        self.queue = queue or (1 if self.priority == SamplePriority.COMMAND.value else QUEUE)


def cache_depth(qos: Qos) -> int:
    """Return how many samples a latched publisher with this QoS caches, and a latched subscription requests."""
    return KEEP_ALL_CACHE if qos.history is History.KEEP_ALL else min(max(qos.depth, 1), MAX_CACHE)


class HubPublisher:
    """Publishes one topic on the hub; made by `bridge.hub.session.Hub.publisher`. Safe to use from any thread.

    Attributes:
        gid: the 16 bytes that name the publisher in its samples.
        by_lane: messages sent on at least one lane.
    """

    def __init__(
        self,
        context: EndpointContext,
        token: str,
        key: str,
        topic: str,
        qos: Qos,
        options: PublisherOptions,
    ) -> None:
        self.topic, self.key = topic, key
        self.gid = gid_of(token)
        self._command, self._queue = options.priority == SamplePriority.COMMAND.value, options.queue
        self._outlets: tuple[Outlet, ...] = ()
        self._writer: LaneWriter | None = None
        self._why = NO_LANE
        self.by_lane = 0
        self._limit, self._on_close = context.limit, context.closed
        self._lock = Lock()
        self._sequence = 0
        self._sink: _Sink | None
        if qos.latched:
            self._sink = _LatchedSink(context, key, options, qos)
            self._why = "it is kept for late joiners"
        else:
            self._sink = _PlainSink(context, key, options)
            if context.lane is not None and not options.blocks:
                self._writer = context.lane.writer
                self._why = context.lane.why
        if self._writer is not None:  # before the token announces the publisher
            self._writer.add(self)
        self._withdraw = context.graph.announce(token)

    def put(self, payload: bytes, source_time_ns: int | None = None) -> None:
        """Publish CDR bytes, encapsulation header first.

        ``source_time_ns`` is the system time of its source, by default now. Raises `HubClosedError` if the publisher or
        its session is closed, and `HubError` if the message is larger than the hub's limit.
        """
        if len(payload) > self._limit:
            raise HubError(f"message of {len(payload)} bytes on {self.topic}: the hub's limit is {self._limit}")
        LARGE_MESSAGES.passed(len(payload))
        if source_time_ns is None:
            source_time_ns = time.time_ns()
        # the lock is held while sending, so that the numbers arrive in order
        with self._lock:
            if self._sink is None:
                raise HubClosedError(f"publisher of {self.topic} is closed")
            self._sequence += 1
            attached = pack_attachment(self._sequence, source_time_ns, self.gid)
            if self._outlets:
                self.by_lane += 1
                for outlet in self._outlets:
                    outlet.send(attached, payload)
            try:
                self._sink.send(payload, attached)
            except zenoh.ZError as err:
                raise HubClosedError(f"cannot publish on {self.topic}: {zenoh_reason(err)}") from None

    def pass_over(self) -> bool:
        """Number a message without encoding it, if no subscription exists; return False if it has to be `put`.

        Messages of a volatile publisher without subscriptions reach no one. Later subscriptions see the same numbers as
        if it had been put. Raises `HubClosedError` if the publisher is closed.
        """
        with self._lock:
            if self._sink is None:
                raise HubClosedError(f"publisher of {self.topic} is closed")
            if self._outlets or self._sink.keeps or self._sink.matched():
                return False
            self._sequence += 1
            return True

    def matched(self) -> bool:
        """Return whether any subscription exists, on another session or on another node of a shared session."""
        with self._lock:
            return self._sink is not None and (bool(self._outlets) or self._sink.matched())

    def way(self) -> tuple[str, str]:
        """Return the current transport and, for zenoh, the reason.

        The transport is ``lane``, ``zenoh``, ``both``, or "" if no subscription exists.
        """
        with self._lock:
            lane = bool(self._outlets)
            other = self._sink is not None and self._sink.matched()
        if lane or self._writer is not None:
            return {(True, False): "lane", (True, True): "both", (False, True): "zenoh"}.get((lane, other), ""), (
                "a listener is not on the lane" if other else ""
            )
        return ("zenoh" if other else ""), self._why

    def attach(self, outlet: Outlet) -> None:
        """Send all further messages on a lane too, and first the number of the last message before."""
        with self._lock:
            outlet.command = outlet.command or self._command
            outlet.depth = max(outlet.depth, self._queue)
            if outlet not in self._outlets:
                self._outlets += (outlet,)
            outlet.mark(self.gid, self._sequence)

    def detach(self, outlet: Outlet) -> None:
        """Stop sending on a lane."""
        with self._lock:
            self._outlets = tuple(other for other in self._outlets if other is not outlet)

    def close(self) -> None:
        """Leave the graph and drop the cached samples. Safe to call twice."""
        with self._lock:
            sink, self._sink = self._sink, None
            self._outlets = ()
        if sink is not None:
            if self._writer is not None:
                self._writer.remove(self)
            self._withdraw()
            sink.close()
            self._on_close(self)
