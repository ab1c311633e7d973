"""A subscription: registered through rospy, read by our own connections.

rospy's ``Subscriber`` with ``AnyMsg`` connects to every publisher of a topic, whoever made it, puts no limit on a
message's length, and asks the master for parameters in the caller's thread. Here a connection is opened to publishers
that are known to be native and of the subscription's type, and to nobody else: what a Midspan published never even
comes in, and a latched message is not lost while it is not yet known who sent it.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import rospy
import rospy.impl.registration as registration
from rospy.topics import _TopicImpl

from bridge.adapters.base import Deliver
from bridge.adapters.ros1.errors import Ros1Error, UnreachableError, unanswered
from bridge.adapters.ros1.graph import Link
from bridge.adapters.ros1.handshake import connect
from bridge.adapters.ros1.intake import Intake
from bridge.adapters.ros1.lanes import Lanes
from bridge.adapters.ros1.probe import HANDSHAKE_SECONDS, Facts
from bridge.adapters.ros1.reader import Reader, Refused

_log = logging.getLogger(__name__)

_FIRST_WAIT = 0.2
_LONGEST_WAIT = 5.0


def publisher_id(link: Link, *, latching: bool) -> str:
    """Id of a publisher's endpoint; a node that advertises anew, now latched, is another publisher."""
    return f"publisher {link.topic} {link.node} {link.uri}{' latched' if latching else ''}"


class _Entry(_TopicImpl):  # type: ignore[misc]  # rospy has no types
    """One subscribed topic in rospy's books; what the slave API tells of our subscriptions comes from here."""

    def __init__(self, topic: str) -> None:
        super().__init__(topic, rospy.AnyMsg)
        self.resolved_name = self.name = topic
        # rospy spends an epoll descriptor per topic on broken connections; our readers notice these themselves.
        self.connection_poll.poller.close()

    def check(self) -> None:
        """Nothing to look for; see the constructor."""

    def get_stats(self) -> tuple[str, list[tuple[str, int, int, int, bool]]]:
        """The answer to ``getBusStats``."""
        connections = [(c.id, c.stat_bytes, c.stat_num_msg, -1, not c.done) for c in self.connections]
        return self.resolved_name, connections


def _acquire(topic: str) -> _Entry:
    topics = registration.get_topic_manager()
    with topics.lock:
        entry = topics.subs.get(topic)
        if entry is None:
            entry = _Entry(topic)
            topics._add(entry, topics.subs, registration.Registration.SUB)
        entry.ref_count += 1
        return entry  # type: ignore[no-any-return]


@dataclass(slots=True)
class _Source:
    """One publisher that the subscription wants to hear."""

    reader: Reader | None = None
    connecting: bool = False
    due: float = 0.0
    wait: float = _FIRST_WAIT


class Subscription:
    """Keeps a connection to each native publisher of one topic that has the wanted type."""

    def __init__(
        self,
        topic: str,
        md5: str,
        deliver: Deliver,
        *,
        lanes: Lanes,
        caller: Callable[[], str],
        doubt: Callable[[Link, str], None],
        learned: Callable[[Link, Facts], None],
        refused: Refused,
        limit: int,
        intake: Intake | None,
    ) -> None:
        self.topic = topic
        self._md5, self._deliver, self._refused, self._limit = md5, deliver, refused, limit
        self._intake = intake
        self._lanes, self._caller, self._doubt, self._learned = lanes, caller, doubt, learned
        self._lock = threading.Lock()
        self._sources: dict[Link, _Source] = {}
        self._closed = False
        self._entry = _acquire(topic)

    @property
    def restless(self) -> bool:
        """Whether a publisher is to be connected to."""
        return any(source.reader is None for source in list(self._sources.values()))

    @property
    def connected(self) -> frozenset[Link]:
        """The publishers that are heard now."""
        sources = list(self._sources.items())
        return frozenset(link for link, source in sources if source.reader is not None and not source.reader.done)

    def follow(self, publishers: Mapping[Link, Facts]) -> None:
        """Take up the topic's publishers as they are known now."""
        wanted = {link for link, f in publishers.items() if f.native and self._md5 in (f.md5, "*", "")}
        now = time.monotonic()
        with self._lock:
            if self._closed:
                return
            gone = [self._sources.pop(link) for link in self._sources.keys() - wanted]
            for link in wanted - self._sources.keys():
                self._sources[link] = _Source()
            idle = [(n, s) for n, s in self._sources.items() if s.reader is None and not s.connecting and s.due <= now]
            for _, source in idle:
                source.connecting = True
        for source in gone:
            self._drop(source.reader)
        for link, source in idle:
            self._lanes.submit(link.uri, lambda link=link, source=source: self._connect(link, source))  # type: ignore[misc]

    def close(self) -> None:
        """Close all connections and give the registration back."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            sources, self._sources = list(self._sources.values()), {}
        for source in sources:
            self._drop(source.reader)
        registration.get_topic_manager().release_impl(registration.Registration.SUB, self.topic)

    def _connect(self, link: Link, source: _Source) -> None:
        try:
            sock, header = connect(self._caller(), link.uri, link.topic, HANDSHAKE_SECONDS)
        except Ros1Error as err:
            self._failed(link, source, err)
            return
        facts = Facts.of(header)
        if not facts.native or self._md5 not in (facts.md5, "*", ""):
            sock.close()
            self._doubt(link, "the publisher changed its type or its maker")
            return
        self._learned(link, facts)
        endpoint = publisher_id(link, latching=facts.latching)
        try:
            reader = Reader(
                sock, self.topic, link.uri,
                lambda payload: self._deliver(payload, endpoint, None),
                lambda trouble: self._ended(link, source, trouble),
                self._refused, self._limit, self._intake,
            )  # fmt: skip
        except OSError as err:  # it has broken again
            sock.close()
            self._failed(link, source, unanswered(f"{link.node} breaks off", err))
            return
        with self._lock:
            wanted = self._sources.get(link) is source
            if wanted:
                source.reader, source.connecting, source.wait = reader, False, _FIRST_WAIT
        if not wanted:
            reader.close()
            return
        with self._entry.c_lock:
            self._entry.connections = [*self._entry.connections, reader]
        reader.start()
        if reader.done:
            self._drop(reader)

    def _failed(self, link: Link, source: _Source, err: Ros1Error) -> None:
        with self._lock:
            source.connecting = False
            source.due = time.monotonic() + source.wait
            source.wait = min(2 * source.wait, _LONGEST_WAIT)
        if isinstance(err, UnreachableError):
            # It may be dead though the master still lists it: it counts no more until it answers a probe.
            self._lanes.failed(link.uri)
            self._doubt(link, str(err))

    def _ended(self, link: Link, source: _Source, trouble: str) -> None:
        _log.debug("%s: connection to %s ended: %s", self.topic, link.node, trouble)
        self._drop(source.reader)
        with self._lock:
            source.reader = None
            source.due = time.monotonic() + source.wait
            source.wait = min(2 * source.wait, _LONGEST_WAIT)

    def _drop(self, reader: Reader | None) -> None:
        if reader is None:
            return
        reader.close()
        with self._entry.c_lock:
            self._entry.connections = [c for c in self._entry.connections if c is not reader]
