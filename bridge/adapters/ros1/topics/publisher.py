"""Publishers of raw bytes on ROS 1 topics."""

from __future__ import annotations

from collections.abc import Mapping

from bridge.adapters.ros1.topics.book import TopicBook
from bridge.hub.wire.qos import Qos
from bridge.messages.errors import MessageTypeError
from bridge.messages.transcode.conversion import SideType


class Ros1Publisher:
    """One of the bridge's publishers of a topic."""

    def __init__(self, book: TopicBook, topic: str, side_type: SideType, qos: Qos) -> None:
        if not side_type.type_id or side_type.type_id == "*":
            raise MessageTypeError(
                f"the md5 sum of {side_type.name} is unknown, so ROS 1 subscribers would reject it",
                "give the type's .msg folder under types.folders",
            )
        self._book = book
        self._latched, self._depth = qos.latched, max(qos.depth, 1)
        self._sources: set[str] = set()
        self._closed = False
        lifespan = None if qos.lifespan_ns is None else qos.lifespan_ns / 1e9
        self._publication = book.publish(topic, side_type, latched=qos.latched, lifespan=lifespan)

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
        """Close the publisher; the last publisher of a topic unregisters the topic. Safe to call twice."""
        if self._closed:
            return
        self._closed = True
        for source in list(self._sources):
            self.drop_source(source)
        self._book.unpublish(self._publication, latched=self._latched)

    @property
    def native(self) -> object:
        """Sends small messages in C (``outputs.c``); None for latched messages and commands."""
        return None if self._latched else self._publication.outputs

    @property
    def subscribers(self) -> Mapping[str, int]:
        """The nodes that are connected to the topic, with the number of each node's connection."""
        return {connection.peer: connection.id for connection in self._publication.connections}

    @property
    def has_subscribers(self) -> bool:
        """Whether a subscriber is connected to the topic."""
        return bool(self._publication.connections)

    @property
    def dropped(self) -> int:
        """Number of messages of this topic that slow subscribers missed."""
        return self._publication.dropped
