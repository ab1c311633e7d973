"""Publishers of raw bytes: one rospy publication per topic, shared by the bridge's publishers of that topic.

A ROS 1 node has one publication per topic, while the hub may have any number of publishers. Latched messages are
retained here for each of them, and every late joiner receives all; rospy retains only a publication's last one.
"""

from __future__ import annotations

import math
import socket
from collections import deque
from collections.abc import Callable, Mapping
from threading import Lock
from typing import Any

import rospy
import rospy.impl.registration as registration
from rospy.impl.tcpros_pubsub import TCPROSPub
from rospy.topics import _PublisherImpl, _TopicImpl

from bridge.adapters.ros1.handshake import ORIGIN_FIELD
from bridge.adapters.ros1.topics.outlet import SubscriberConnection
from bridge.hub.wire.qos import Qos
from bridge.messages.errors import MessageTypeError
from bridge.messages.transcode.conversion import SideType


class Publication(_PublisherImpl):  # type: ignore[misc]  # rospy has no types
    """One topic that this node publishes; rospy's TCPROS server passes it the subscribers."""

    def __init__(self, topic: str, side_type: SideType, origin: str, heard_changed: Callable[[], None]) -> None:
        # rospy compares and announces these attributes; a plain AnyMsg would only serve AnyMsg subscribers
        names = {"_type": side_type.name, "_md5sum": side_type.type_id, "_full_text": side_type.definition}
        message = type("Raw", (rospy.AnyMsg,), {**names, "__slots__": []})
        super().__init__(topic, message)
        self.resolved_name = self.name = topic
        self.headers = {ORIGIN_FIELD: origin}
        self.side_type = side_type
        self.latches = 0
        self.dropped_before = 0
        self._heard_changed = heard_changed
        self._outlets: dict[Any, SubscriberConnection] = {}
        self._retained: dict[str, deque[bytes]] = {}

    @property
    def is_latch(self) -> bool:
        """The value of ``latching`` in the connection header."""
        return self.latches > 0

    @is_latch.setter
    def is_latch(self, value: bool) -> None:
        """Ignore the value of rospy's constructor: the publishers that share the topic decide."""

    def add_connection(self, transport: Any) -> bool:
        """Add a subscriber, and send it the retained messages."""
        sock = transport.socket
        sock.deadline = math.inf
        sock.settimeout(None)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with self.c_lock:
            if not _TopicImpl.add_connection(self, transport):
                transport.close()
                return False
            outlet = SubscriberConnection(sock, f"midspan-ros1-out{self.resolved_name}")
            self._outlets = {**self._outlets, transport: outlet}
            for source, payloads in self._retained.items():
                for payload in payloads:
                    outlet.send(payload, source, len(payloads))
        self._heard_changed()
        return True

    def remove_connection(self, transport: Any) -> None:
        """Remove a subscriber."""
        with self.c_lock:
            outlet = self._outlets.get(transport)
            if outlet is not None:
                self._outlets = {t: o for t, o in self._outlets.items() if t is not transport}
                self.dropped_before += outlet.dropped
                outlet.close()
        super().remove_connection(transport)
        self._heard_changed()

    def close(self) -> None:
        """Close all connections."""
        greeting = TCPROSPub(self.resolved_name, self.data_class, headers=self.headers)
        note_ended(self.resolved_name, greeting.get_header_fields())
        with self.c_lock:
            for outlet in self._outlets.values():
                outlet.close()
            self._outlets = {}
        super().close()
        # rospy leaves the descriptor to the garbage collector
        self.connection_poll.poller.close()

    def send(self, payload: bytes, source: str, depth: int, *, retain: bool) -> None:
        """Publish to all subscribers without blocking."""
        with self.c_lock:
            if self.closed:
                return
            if retain:
                kept = self._retained.get(source)
                if kept is None or kept.maxlen != depth:
                    kept = self._retained[source] = deque(kept or (), depth)
                kept.append(payload)
            self.message_data_sent += len(payload)
            broken = [t for t, outlet in self._outlets.items() if not outlet.send(payload, source, depth)]
        for transport in broken:
            transport.close()

    def drop_source(self, source: str) -> None:
        """Drop a source's retained messages."""
        with self.c_lock:
            self._retained.pop(source, None)

    @property
    def has_subscribers(self) -> bool:
        """Whether a subscriber is connected."""
        return bool(self._outlets)

    @property
    def dropped(self) -> int:
        """Number of messages that slow subscribers missed."""
        return self.dropped_before + sum(o.dropped for o in self._outlets.values())


def _acquire(
    topic: str, side_type: SideType, origin: str, heard_changed: Callable[[], None], *, latched: bool
) -> Publication:
    """Return the publication of a topic. rospy's own ``Publisher`` registers before its header fields are set."""
    topics = registration.get_topic_manager()
    with topics.lock:
        publication = topics.pubs.get(topic)
        if publication is None:
            publication = Publication(topic, side_type, origin, heard_changed)
            publication.latches += latched
            publication.ref_count += 1
            topics._add(publication, topics.pubs, registration.Registration.PUB)
            return publication
        if publication.side_type.type_id != side_type.type_id:
            raise MessageTypeError(
                f"{topic} is already published on ROS 1 as {publication.side_type.name}, it cannot also be"
                f" {side_type.name} (md5 {side_type.type_id})",
                "rename one of the two by a rule: a ROS 1 node has one type per topic",
            )
        publication.latches += latched
        publication.ref_count += 1
        return publication  # type: ignore[no-any-return]


class Ros1Publisher:
    """One of the bridge's publishers of a topic."""

    def __init__(
        self, topic: str, side_type: SideType, qos: Qos, origin: str, heard_changed: Callable[[], None]
    ) -> None:
        if not side_type.type_id or side_type.type_id == "*":
            raise MessageTypeError(
                f"the md5 sum of {side_type.name} is unknown, ROS 1 subscribers would reject it",
                "give the type's .msg folder under types.folders",
            )
        self._latched, self._depth = qos.latched, max(qos.depth, 1)
        self._topic = topic
        self._sources: set[str] = set()
        self._closed = False
        self._publication = _acquire(topic, side_type, origin, heard_changed, latched=qos.latched)

    def send(self, payload: bytes, source: str) -> None:
        """Publish a message of the hub publisher ``source``; retained for late joiners if this publisher is latched."""
        if self._closed:
            return
        if self._latched:
            self._sources.add(source)
        self._publication.send(payload, source, self._depth, retain=self._latched)

    def drop_source(self, source: str) -> None:
        """Drop the retained messages of a hub publisher that left."""
        self._sources.discard(source)
        self._publication.drop_source(source)

    def close(self) -> None:
        """Close the publisher; the last one of a topic unregisters it. Safe to call twice."""
        if self._closed:
            return
        self._closed = True
        for source in list(self._sources):
            self.drop_source(source)
        topics = registration.get_topic_manager()
        with topics.lock:
            self._publication.latches -= self._latched
            topics.release_impl(registration.Registration.PUB, self._topic)

    @property
    def subscribers(self) -> frozenset[str]:
        """The nodes that are connected to the topic."""
        return frozenset(transport.endpoint_id for transport in self._publication.connections)

    @property
    def has_subscribers(self) -> bool:
        """Whether a subscriber is connected to the topic."""
        return self._publication.has_subscribers

    @property
    def dropped(self) -> int:
        """Number of messages of this topic that slow subscribers missed."""
        return self._publication.dropped


# -- publications that ended -------------------------------------------------------------------------------------------
# A subscriber that learned of a publication just before its end, and connects later, gets a header and is disconnected.
#
# rospy never retries a publisher whose connection header was an error or missing: the failed connection stays in its
# list permanently, and while it is listed, the master's updates about that publisher are ignored
# (``robust_connect_subscriber`` of ``tcpros_pubsub.py`` and ``_connect_topic`` of ``masterslave.py``, rospy 1.15.15;
# observed with workers that were killed in sequence). Such a subscriber would receive nothing on a topic that Midspan
# publishes again later, until one of the two is restarted. A connection that ends after its header is removed as usual.

_MOST = 2000
"""Limit of stored topics; beyond it, those that ended first are dropped."""

_ANY = "*"

_lock = Lock()
_headers: dict[str, dict[str, str]] = {}


def note_ended(topic: str, header: Mapping[str, str]) -> None:
    """Store the connection ``header`` of a publication that ends."""
    with _lock:
        _headers.pop(topic, None)
        _headers[topic] = dict(header)
        if len(_headers) > _MOST:
            del _headers[next(iter(_headers))]


def late_header(header: Mapping[str, str]) -> dict[str, str] | None:
    """Return the connection header for a late subscriber with ``header``; None if the topic or type never matched."""
    with _lock:
        stored = _headers.get(header.get("topic", ""))
    return stored if stored is not None and header.get("md5sum") in {_ANY, stored["md5sum"]} else None
