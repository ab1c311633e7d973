"""A publisher on the hub."""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import Enum
from functools import partial
from threading import Lock
from typing import Any, Protocol

import zenoh

from bridge.hub import attachment
from bridge.hub.errors import HubClosedError, HubError, zenoh_reason
from bridge.hub.graph import HubGraph
from bridge.hub.latched import Heartbeats, LatchedPublisher
from bridge.hub.liveliness import gid_of
from bridge.hub.qos import History, Qos, Reliability

KEEP_ALL_CACHE = 1000
"""Samples that a latched publisher keeps when its history is unlimited."""
MAX_CACHE = 10_000


class Priority(Enum):
    """zenoh's priority for each of Midspan's classes; command before state before stream."""

    COMMAND = zenoh.Priority.INTERACTIVE_HIGH
    STATE = zenoh.Priority.DATA_HIGH
    STREAM = zenoh.Priority.DATA


class _Sink(Protocol):
    def send(self, payload: bytes, attached: bytes) -> None: ...
    def matched(self) -> bool: ...
    def close(self) -> None: ...


def _matching(publisher: zenoh.Publisher) -> bool:
    # the wheel returns a MatchingStatus (always true) where its stubs say bool
    status: Any = publisher.matching_status
    return bool(status.matching)


class _PlainSink:
    """A volatile publisher: nothing is kept."""

    def __init__(self, session: zenoh.Session, key: str, options: PublisherOptions) -> None:
        self._publisher = session.declare_publisher(
            key,
            congestion_control=options.congestion,
            priority=options.priority,
            express=options.express,
            allowed_destination=zenoh.Locality.REMOTE,
        )
        # of the source info only the session's id is read; the attachment numbers the samples
        self._put = partial(self._publisher.put, source_info=zenoh.SourceInfo(self._publisher.id, 0))

    def send(self, payload: bytes, attached: bytes) -> None:
        self._put(payload, attachment=attached)

    def matched(self) -> bool:
        return _matching(self._publisher)

    def close(self) -> None:
        self._publisher.undeclare()  # type: ignore[no-untyped-call]


class _LatchedSink:
    """A transient-local publisher: it keeps its last samples and gives them to late joiners."""

    def __init__(
        self, session: zenoh.Session, key: str, options: PublisherOptions, qos: Qos, heartbeats: Heartbeats
    ) -> None:
        reliable = qos.reliability is Reliability.RELIABLE
        self._publisher = LatchedPublisher(
            session,
            key,
            cache_depth(qos),
            heartbeats if reliable else None,
            congestion=options.congestion,
            priority=options.priority,
            express=options.express,
        )
        # the wheel's AdvancedPublisher does not tell whether it is matched
        self._shadow = session.declare_publisher(key, allowed_destination=zenoh.Locality.REMOTE)

    def send(self, payload: bytes, attached: bytes) -> None:
        self._publisher.put(payload, attached)

    def matched(self) -> bool:
        return _matching(self._shadow)

    def close(self) -> None:
        self._shadow.undeclare()  # type: ignore[no-untyped-call]
        self._publisher.close()


class PublisherOptions:
    """How zenoh carries a publisher's samples.

    As in rmw_zenoh samples are dropped where a link is congested, and only RELIABLE with KEEP_ALL blocks: one slow peer
    must not delay the others. What a latched publisher lost so, a latched subscription recovers from its cache.
    """

    def __init__(self, qos: Qos, priority: str, express: bool | None) -> None:
        blocks = qos.reliability is Reliability.RELIABLE and qos.history is History.KEEP_ALL
        self.congestion = zenoh.CongestionControl.BLOCK if blocks else zenoh.CongestionControl.DROP
        self.priority: zenoh.Priority = Priority[priority.upper()].value
        self.express = self.priority == Priority.COMMAND.value if express is None else express


def cache_depth(qos: Qos) -> int:
    """How many samples a latched publisher with this QoS keeps, and a latched subscription asks for."""
    return KEEP_ALL_CACHE if qos.history is History.KEEP_ALL else min(max(qos.depth, 1), MAX_CACHE)


class HubPublisher:
    """Publishes one topic on the hub; made by `bridge.hub.session.Hub.publisher`. Safe to use from any thread.

    Attributes:
        topic: the topic's name.
        gid: the 16 bytes that name the publisher in its samples.
    """

    def __init__(
        self,
        session: zenoh.Session,
        graph: HubGraph,
        token: str,
        key: str,
        topic: str,
        qos: Qos,
        options: PublisherOptions,
        limit: int,
        heartbeats: Heartbeats,
        on_close: Callable[[HubPublisher], None],
    ) -> None:
        self.topic = topic
        self.gid = gid_of(token)
        self._limit = limit
        self._on_close = on_close
        self._lock = Lock()
        self._sequence = 0
        self._sink: _Sink | None = (
            _LatchedSink(session, key, options, qos, heartbeats) if qos.latched else _PlainSink(session, key, options)
        )
        self._withdraw = graph.announce(token)

    def put(self, payload: bytes, source_time_ns: int | None = None) -> None:
        """Publish CDR bytes, encapsulation header first.

        Args:
            payload: the message.
            source_time_ns: system time of its source in nanoseconds; default now.

        Raises:
            HubClosedError: the publisher or its session is closed.
            HubError: the message is larger than the hub takes.
        """
        if len(payload) > self._limit:
            msg = f"message of {len(payload)} bytes on {self.topic}: the hub takes up to {self._limit}"
            raise HubError(msg)
        if source_time_ns is None:
            source_time_ns = time.time_ns()
        # the lock is held while sending, so that the numbers arrive in order
        with self._lock:
            if self._sink is None:
                msg = f"publisher of {self.topic} is closed"
                raise HubClosedError(msg)
            self._sequence += 1
            attached = attachment.pack(self._sequence, source_time_ns, self.gid)
            try:
                self._sink.send(payload, attached)
            except zenoh.ZError as err:
                msg = f"cannot publish on {self.topic}: {zenoh_reason(err)}"
                raise HubClosedError(msg) from None

    def matched(self) -> bool:
        """Whether anybody subscribes on another session."""
        with self._lock:
            return self._sink is not None and self._sink.matched()

    def close(self) -> None:
        """Leave the graph; a latched publisher's samples are no longer served. Safe to call twice."""
        with self._lock:
            sink, self._sink = self._sink, None
        if sink is not None:
            self._withdraw()
            sink.close()
            self._on_close(self)
