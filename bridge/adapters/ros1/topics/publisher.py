"""Publishing bytes: one rospy publication per topic, shared by all of the bridge's publishers of that topic.

A ROS 1 node has one publication per topic, while the hub has any number of publishers. Latched messages are kept here
for each of these and given whole to every late joiner; rospy keeps only a publication's last.
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
    """One topic that our node publishes; rospy's TCPROS server hands it its subscribers."""

    def __init__(self, topic: str, side_type: SideType, origin: str, heard_changed: Callable[[], None]) -> None:
        # rospy compares and announces these attributes; an AnyMsg of its own only serves AnyMsg subscribers.
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
        """What the connection header says as ``latching``."""
        return self.latches > 0

    @is_latch.setter
    def is_latch(self, value: bool) -> None:
        """Rospy's constructor sets it; here the publishers that share the topic decide."""

    def add_connection(self, transport: Any) -> bool:
        """A subscriber is connected: it gets what is retained, and then everything new."""
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
        """A subscriber is gone."""
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
        """Publish to all subscribers without waiting for any."""
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

    def forget(self, source: str) -> None:
        """Drop what is retained of a source."""
        with self.c_lock:
            self._retained.pop(source, None)

    @property
    def heard(self) -> bool:
        """Whether a subscriber is connected."""
        return bool(self._outlets)

    @property
    def dropped(self) -> int:
        """Messages that slow subscribers did not get."""
        return self.dropped_before + sum(o.dropped for o in self._outlets.values())


def _acquire(
    topic: str, side_type: SideType, origin: str, heard_changed: Callable[[], None], *, latched: bool
) -> Publication:
    """The publication of a topic. rospy's own ``Publisher`` registers before its header fields are set."""
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
    """One of the bridge's publishers of a topic; see `bridge.routing.edge.EdgePublisher`."""

    def __init__(
        self, topic: str, side_type: SideType, qos: Qos, origin: str, heard_changed: Callable[[], None]
    ) -> None:
        if not side_type.type_id or side_type.type_id == "*":
            raise MessageTypeError(
                f"the md5 sum of {side_type.name} is not known, ROS 1 subscribers would refuse it",
                "give the type's .msg folder under types.folders",
            )
        self._latched, self._depth = qos.latched, max(qos.depth, 1)
        self._topic = topic
        self._sources: set[str] = set()
        self._closed = False
        self._publication = _acquire(topic, side_type, origin, heard_changed, latched=qos.latched)

    def send(self, payload: bytes, source: str) -> None:
        """Publish bytes of the hub publisher ``source``; retained for late joiners where this publisher is latched."""
        if self._closed:
            return
        if self._latched:
            self._sources.add(source)
        self._publication.send(payload, source, self._depth, retain=self._latched)

    def forget(self, source: str) -> None:
        """The hub publisher ``source`` is gone: late joiners get its last message no more."""
        self._sources.discard(source)
        self._publication.forget(source)

    def close(self) -> None:
        """Give the endpoint back; the topic is unregistered with its last publisher."""
        if self._closed:
            return
        self._closed = True
        for source in list(self._sources):
            self.forget(source)
        topics = registration.get_topic_manager()
        with topics.lock:
            self._publication.latches -= self._latched
            topics.release_impl(registration.Registration.PUB, self._topic)

    @property
    def subscribers(self) -> frozenset[str]:
        """The nodes that are connected to the topic now."""
        return frozenset(transport.endpoint_id for transport in self._publication.connections)

    @property
    def heard(self) -> bool:
        """Whether a subscriber is connected to the topic."""
        return self._publication.heard

    @property
    def dropped(self) -> int:
        """Messages of this topic that slow subscribers did not get."""
        return self._publication.dropped


# -- publications that ended -------------------------------------------------------------------------------------------
# A subscriber that read of a publication a moment before its end, and connects now, gets a header and is let go.
#
# rospy never tries a publisher again whose connection header was an error, or did not come: the connection that failed
# stays in its list for good, and while one of a publisher is in there, no master's word of that publisher counts
# (``robust_connect_subscriber`` of ``tcpros_pubsub.py`` and ``_connect_topic`` of ``masterslave.py``, rospy 1.15.15;
# seen with workers that were killed one after the other). Such a subscriber would hear nothing of a topic that we
# publish again later, until one of the two is restarted. A connection that ends after its header is removed as usual.

_MOST = 2000
"""Topics that are remembered; of more, those that ended first are forgotten."""

_ANY = "*"

_lock = Lock()
_headers: dict[str, dict[str, str]] = {}


def note_ended(topic: str, header: Mapping[str, str]) -> None:
    """A publication ends; ``header`` is what its subscribers got as connection header."""
    with _lock:
        _headers.pop(topic, None)
        _headers[topic] = dict(header)
        if len(_headers) > _MOST:
            del _headers[next(iter(_headers))]


def late_header(header: Mapping[str, str]) -> dict[str, str] | None:
    """The connection header for one who comes too late, given its own; None where that is no subscriber of ours."""
    with _lock:
        found = _headers.get(header.get("topic", ""))
    return found if found is not None and header.get("md5sum") in {_ANY, found["md5sum"]} else None
