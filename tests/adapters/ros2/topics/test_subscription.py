"""A subscription while the graph changes."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

from bridge.adapters.ros2.edge import Ros2Edge
from bridge.adapters.ros2.graph.graph import GraphSnapshot
from bridge.config.model import Config
from bridge.hub.wire.qos import Qos, Reliability
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import SideType
from bridge.routing.edge import Endpoint, Kind, MadeBy
from tests.adapters.ros2.conftest import Inbox, RunningEdge
from tests.peers.peer import Peer
from tests.support.wait import until

TYPE = "std_msgs/msg/String"
RELIABLE, BEST_EFFORT = Qos(), Qos(Reliability.BEST_EFFORT)


def publisher(gid: bytes, qos: Qos) -> Endpoint:
    return Endpoint(gid.hex(), Kind.PUBLISHER, "/t", TYPE, qos, MadeBy.NATIVE, "/n", "")


class Ros2Graph:
    """The publishers of one topic."""

    def __init__(self) -> None:
        self.there = {b"1" * 16: publisher(b"1" * 16, RELIABLE)}

    def publishers(self, _topic: str) -> dict[bytes, Endpoint]:
        return self.there


class Handle:
    """A DDS reader."""

    pointer = 1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def test_a_publisher_that_appears_during_construction_is_received(tmp_path: Path) -> None:
    """The change is notified only once, while DDS creates the first reader."""
    graph, edge, request = Ros2Graph(), Ros2Edge(Config(), Registry(), tmp_path), set[Reliability]()

    def make_reader(_kind: object, _topic: str, qos: Qos) -> Handle:
        request.add(qos.reliability)
        if len(graph.there) > 1:
            return Handle()
        graph.there = {**graph.there, b"2" * 16: publisher(b"2" * 16, BEST_EFFORT)}
        change = threading.Thread(target=edge._changed, args=(GraphSnapshot(publishers={"/t": graph.there}),))
        change.start()
        change.join()
        return Handle()

    participant = SimpleNamespace(make_reader=make_reader)
    loop = SimpleNamespace(add=lambda _: None, remove=lambda _: None)
    heartbeats = SimpleNamespace(follow=lambda _: None)
    context: Any = SimpleNamespace(participant=participant, loop=loop, graph=graph, heartbeats=heartbeats)
    types: Any = SimpleNamespace(message_class=lambda *_: SimpleNamespace(type_name=TYPE))
    edge._context, edge._types = context, types
    edge.subscribe("/t", SideType(TYPE, "", ""), RELIABLE, lambda *_: None)
    assert request == {Reliability.RELIABLE, Reliability.BEST_EFFORT}


def test_a_message_that_fast_dds_drops_after_a_large_one_is_counted(
    edge: RunningEdge, peer: Callable[..., Peer]
) -> None:
    """Fast DDS drops what is no CDR if messages are taken as structures, as after a large one."""
    inbox, native = Inbox(), peer()
    subscription = edge.edge.subscribe("/odd", edge.type(TYPE), RELIABLE, inbox.deliver)
    native_end = native.advertise("/odd", "std_msgs/String")

    def received(text: str) -> bool:
        native.publish(native_end, {"data": text})
        return any(text.encode() in payload for payload, _, _ in inbox.messages)

    until(lambda: received("x" * 100_000), "a large message arrives")
    native.ask("publish_raw", id=native_end, hex=b'{"a": 1}'.hex())
    until(lambda: received("after"), "the message after it arrives")
    assert not any(b'"a"' in payload for payload, _, _ in inbox.messages)
    until(lambda: subscription.lost == 1, "the loss is counted, after the delivery that shows it")
