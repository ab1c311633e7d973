"""The queue delivers a publisher's messages only from the reader of the publisher's current class."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, Self

from bridge.adapters.ros2.topics.subscription import ClassReader, Ros2Subscription
from bridge.hub.wire.qos import LATCHED, Durability, Qos, Reliability
from bridge.routing.edge import Endpoint, Kind, MadeBy

GID = bytes(16)


class Handle:
    pointer = 1

    def __enter__(self) -> Self:
        return self


class Loop:
    """Has the subscription's readers; ``opened`` is called for each new one."""

    def __init__(self) -> None:
        self.readers: list[ClassReader] = []
        self.overlaps: list[bytes] = []

    def add(self, reader: ClassReader) -> None:
        # a reader that exists beside the new one receives the same messages
        self.overlaps += [gid for other in self.readers for gid in other.sources]
        self.readers.append(reader)

    def remove(self, reader: ClassReader) -> None:
        self.overlaps += list(reader.sources)
        self.readers.remove(reader)


def publisher(qos: Qos) -> Endpoint:
    return Endpoint("the publisher", Kind.PUBLISHER, "/t", "std_msgs/msg/String", qos, MadeBy.NATIVE)


def test_a_publisher_that_changes_its_class_is_delivered_by_one_reader() -> None:
    publishers: dict[bytes, Endpoint] = {GID: publisher(Qos(Reliability.RELIABLE, Durability.VOLATILE))}
    loop = Loop()
    context: Any = SimpleNamespace(
        participant=SimpleNamespace(make_reader=lambda *_: Handle(), resolve=None),
        loop=loop,
        graph=SimpleNamespace(publishers=lambda _topic: publishers),
    )
    message_class = SimpleNamespace(type_name="std_msgs/msg/String")
    subscription = Ros2Subscription("/t", message_class, LATCHED, lambda *_: None, context, lambda _: None)
    (before,) = loop.readers
    assert before.sources == {GID: "the publisher"}
    publishers[GID] = publisher(LATCHED)
    subscription.refit()
    (after,) = loop.readers
    assert after is not before
    assert (before.sources, after.sources) == ({}, {GID: "the publisher"})
    assert loop.overlaps == []
    subscription.close()
    assert after.sources == {}
