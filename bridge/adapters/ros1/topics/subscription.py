"""Subscriptions: connections to the native publishers of one topic.

A subscription connects only to publishers that are known to be native and to have the subscription's type. Therefore
messages that Midspan publishes are not even received, and a latched message is not lost while its publisher is still
unknown.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from bridge.adapters.ros1.graph.probe import HANDSHAKE_SECONDS, Facts, ProbedConnection, Prober, Ros1Context
from bridge.adapters.ros1.graph.state import Registration, publisher_id
from bridge.adapters.ros1.handshake import connect
from bridge.adapters.ros1.topics.connection import PublisherConnection, Refused
from bridge.adapters.ros1_peers import ExhaustedError, Ros1Error, UnreachableError, unanswered
from bridge.routing.edge import Deliver

_log = logging.getLogger(__name__)

_FIRST_WAIT = 0.2
_LONGEST_WAIT = 5.0
SETTLE_SECONDS = 0.5
"""How long the connection to a new publisher is left unread. Meanwhile the other sides create their endpoints of the
topic; messages sent before these endpoints have discovered their peers would be lost, so they wait in the connection.
Fast DDS often needs over 0.2 s."""


@dataclass(slots=True)
class _PublisherState:
    """One publisher that the subscription connects to.

    Attributes:
        fresh: whether no connection to the publisher has failed or ended yet.
        latching: whether the publisher announced on the current connection that it latches.
    """

    reader: PublisherConnection | None = None
    connecting: bool = False
    fresh: bool = True
    latching: bool = False
    due: float = 0.0
    wait: float = _FIRST_WAIT

    def is_due(self, now: float, facts: Facts) -> bool:
        """Return whether to connect: for the first time, or again to receive a latched message."""
        missing = self.reader is None or (facts.latching and not self.latching)
        return missing and not self.connecting and self.due <= now

    def postpone(self) -> None:
        self.fresh = False
        self.due, self.wait = time.monotonic() + self.wait, min(2 * self.wait, _LONGEST_WAIT)


class Ros1Subscription:
    """Maintains a connection to each native publisher of one topic with the wanted type; TCP loses no messages."""

    lost = 0

    def __init__(
        self, context: Ros1Context, prober: Prober, topic: str, md5: str, deliver: Deliver, suffix: str,
        take: Callable[[Registration], ProbedConnection | None], refused: Refused,
        closed: Callable[[Ros1Subscription], None], *, settle: float = SETTLE_SECONDS,
    ) -> None:  # fmt: skip
        self.name = self.topic = topic
        self._context, self._prober, self._suffix, self._take = context, prober, suffix, take
        self._md5, self._deliver, self._refused, self._on_closed = md5, deliver, refused, closed
        self._lock = threading.Lock()
        self._publishers: dict[Registration, _PublisherState] = {}
        self._closed = False
        self._settle = settle
        self._entry = context.book.subscribe(topic)

    @property
    def needs_connection(self) -> bool:
        """Whether the subscription needs to connect to a publisher."""
        return any(source.reader is None for source in list(self._publishers.values()))

    @property
    def connected(self) -> frozenset[Registration]:
        """The connected publishers."""
        sources = list(self._publishers.items())
        return frozenset(link for link, source in sources if source.reader is not None and not source.reader.done)

    def unread(self, node: str, uri: str, *, listed: bool) -> bool:
        """Return whether a node may have published a message that is not delivered yet.

        It may have if the connection to it is not read yet, or has unread bytes; with ``listed`` also if there is no
        connection to it yet, although the master lists it as a publisher of the topic.
        """
        link = Registration(node, self.topic, uri)
        with self._lock:
            source = self._publishers.get(link)
        if source is None:
            return listed and self._prober.is_unprobed(link)
        return (source.fresh or listed) if source.reader is None else source.reader.unread

    def follow(self, publishers: Mapping[Registration, Facts]) -> None:
        """Adopt the topic's current publishers, and connect to new ones."""
        wanted = {link for link, facts in publishers.items() if facts.fits(self._md5)}
        now = time.monotonic()
        with self._lock:
            if self._closed:
                return
            removed = [self._publishers.pop(link) for link in self._publishers.keys() - wanted]
            for link in wanted - self._publishers.keys():
                self._publishers[link] = _PublisherState()
            idle = [(link, source) for link, source in self._publishers.items() if source.is_due(now, publishers[link])]
            for _, source in idle:
                source.connecting = True
        for source in removed:
            self._drop(source.reader)
        for link, source in idle:
            self._context.pool.submit(link.uri, lambda link=link, source=source: self._connect(link, source))  # type: ignore[misc]

    def close(self) -> None:
        """Close all connections and unregister. Safe to call twice."""
        self._on_closed(self)
        with self._lock:
            if self._closed:
                return
            self._closed = True
            sources, self._publishers = list(self._publishers.values()), {}
        for source in sources:
            self._drop(source.reader)
        self._context.book.unsubscribe(self._entry)

    def _connect(self, link: Registration, source: _PublisherState) -> None:
        try:
            taken = self._take(link)
            caller = self._context.node() + self._suffix
            sock, header = taken or connect(caller, link.uri, link.topic, HANDSHAKE_SECONDS)
        except Ros1Error as err:
            self._failed(link, source, err)
            return
        facts = Facts.of(header)
        with sock:  # closes the socket unless the reader has taken it over
            if not facts.fits(self._md5):
                self._prober.drop_facts(link, "the publisher changed its type or its origin")
                return
            self._prober.adopt(link, facts)
            endpoint = publisher_id(link, latching=facts.latching)
            try:
                reader = PublisherConnection(
                    sock, self.topic, link.uri, self._deliver, endpoint,
                    lambda trouble: self._ended(link, source, reader, trouble),
                    self._refused, self._context.limit, self._context.loop,
                )  # fmt: skip
            except OSError as err:  # the connection broke
                self._failed(link, source, unanswered(f"{link.node} disconnected", err))
                return
        with self._lock:
            wanted = self._publishers.get(link) is source
            if wanted:
                before, source.reader, source.latching = source.reader, reader, facts.latching
                source.connecting, source.wait = False, _FIRST_WAIT
        if not wanted:
            reader.close()
            return
        self._drop(before)
        self._entry.add(reader)
        if taken and self._settle:
            self._context.timer.after(self._settle, lambda: self._start(reader))
        else:
            self._start(reader)

    def _start(self, reader: PublisherConnection) -> None:
        reader.start()
        if reader.done:
            self._drop(reader)

    def _failed(self, link: Registration, source: _PublisherState, err: Ros1Error) -> None:
        with self._lock:
            source.connecting = False
            source.postpone()
        if isinstance(err, UnreachableError):
            self._context.pool.failed(link.uri)
        if not isinstance(err, ExhaustedError):
            # the publisher may be dead although it is listed, so it is unknown until it responds to a probe
            self._prober.drop_facts(link, str(err))

    def _ended(self, link: Registration, source: _PublisherState, reader: PublisherConnection, trouble: str) -> None:
        _log.debug("%s: connection to %s ended: %s", self.topic, link.node, trouble)
        self._drop(reader)
        with self._lock:
            if source.reader is not reader:  # a newer connection has replaced it
                return
            source.reader = None
            source.postpone()
        self._context.facts_changed()

    def _drop(self, reader: PublisherConnection | None) -> None:
        if reader is None:
            return
        reader.close()
        self._entry.remove(reader)
