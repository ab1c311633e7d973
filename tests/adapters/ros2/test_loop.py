"""The read loop: idle readers cost nothing, bursts arrive complete, and it works without a compiler."""

from __future__ import annotations

import ctypes
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.loop import TAKES_PER_TURN, EndpointReader, QueueReadLoop
from bridge.adapters.ros2.topics.subscription import ClassReader
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry
from bridge.routing.edge import Kind
from tests.adapters.ros2.conftest import RunningEdge, string, text
from tests.peers.hub.lane import JoinedLane
from tests.peers.peer import Peer
from tests.support.wait import until

STRING = "std_msgs/msg/String"


def test_idle_subscriptions_are_never_polled(
    edge: RunningEdge, peer: Callable[..., Peer], monkeypatch: pytest.MonkeyPatch
) -> None:
    looks: Counter[str] = Counter()
    drain = ClassReader.drain

    def counted(self: ClassReader, taker: rcl.Taker, limit: int) -> None:
        looks[self.topic] += 1
        drain(self, taker, limit)

    monkeypatch.setattr(ClassReader, "drain", counted)
    for number in range(200):
        edge.subscribe(f"/idle/topic{number}", STRING)
    inbox = edge.subscribe("/idle/active", STRING)
    native = peer()
    publisher = native.advertise("/idle/active", "std_msgs/String")
    edge.until_seen("/idle/active", Kind.PUBLISHER)

    def hundred() -> bool:
        native.publish(publisher, {"data": "x"})
        return len(inbox.messages) >= 100

    until(hundred, "a hundred messages arrive")
    assert set(looks) <= {"/idle/active"}


def test_a_burst_longer_than_one_cycle_arrives_complete(edge: RunningEdge, peer: Callable[..., Peer]) -> None:
    texts: list[str] = []
    going = threading.Event()

    def deliver(payload: bytes, _source: str, _time_ns: int | None) -> None:
        received = text(payload)
        if received != "probe":
            going.wait(20)
        texts.append(received)

    count = 5 * TAKES_PER_TURN
    edge.edge.subscribe("/burst", edge.type(STRING), Qos(depth=2 * count), deliver)
    native = peer()
    publisher = native.advertise("/burst", "std_msgs/String", depth=2 * count)
    native.advertise("/burst_known", "std_msgs/String")
    edge.until_seen("/burst", Kind.PUBLISHER)

    def connected() -> bool:  # the native graph lists the subscription before the publisher has matched it
        native.publish(publisher, {"data": "probe"})
        return bool(texts)

    until(connected, "a message arrives")
    for number in range(count):
        native.publish(publisher, {"data": str(number)})
    going.set()
    until(lambda: str(count - 1) in texts, "the whole burst arrives")
    assert [received for received in texts if received != "probe"] == [str(number) for number in range(count)]


def test_messages_are_joined_until_the_loop_waits_again(edge: RunningEdge, peer: Callable[..., Peer]) -> None:
    sent: list[bool] = []

    def deliver(_payload: bytes, _source: str, _time: int | None) -> None:
        if not sent:
            lane.put()
            sent.append(lane.sent())

    lane = JoinedLane()
    edge.edge.subscribe("/joined", edge.type(STRING), Qos(), deliver)
    native = peer()
    publisher = native.advertise("/joined", "std_msgs/String")

    def received() -> bool:
        native.publish(publisher, {"data": "x"})
        return bool(sent)

    until(received, "a message arrives")
    assert sent == [False]
    until(lane.sent, "the joined message is sent")
    lane.close()


class Reader(EndpointReader):
    """A reader that is ready when it is reported, and then calls ``drained``.

    Its end fails if ``fails`` is set, as if rcl refused to remove the callback.
    """

    def __init__(self, drained: Callable[[], None], *, fails: bool = False) -> None:
        self._drained, self._fails = drained, fails
        self.waker: rcl.Waker | None = None
        self.destroyed = False

    def wake(self, waker: rcl.Waker | None) -> None:
        if waker is None and self._fails:
            raise rcl.RclError("waking by the subscription", 1)
        self.waker = waker

    def report(self) -> None:
        assert self.waker is not None
        ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_size_t)(self.waker.callback)(self.waker.data, 1)

    def drain(self, _taker: rcl.Taker, _limit: int) -> None:
        self._drained()

    def destroy(self) -> None:
        self.destroyed = True


def test_joined_messages_do_not_wait_for_calls() -> None:
    order: list[str] = []
    served = threading.Event()

    def call() -> None:
        order.append("sent" if lane.sent() else "joined")
        served.set()

    lane, loop = JoinedLane(), QueueReadLoop()
    for reader in (Reader(lane.put), Reader(call)):
        loop.add(reader)
        reader.report()  # both are ready in the first turn
    loop.start()
    assert served.wait(20.0)
    loop.stop()
    lane.close()
    assert order == ["sent"]


def test_joined_messages_are_sent_when_the_loop_stops() -> None:
    lane, loop = JoinedLane(), QueueReadLoop()

    def last() -> None:
        lane.put()
        stopper.start()
        until(lambda: loop._stopping.is_set(), "the loop stops")

    stopper = threading.Thread(target=loop.stop)
    reader = Reader(last)
    loop.add(reader)
    reader.report()
    loop.start()
    until(lambda: reader.destroyed, "the loop has stopped", 20.0)
    stopper.join()
    assert lane.sent()
    lane.close()


def test_a_reader_that_cannot_be_closed_stops_no_other(caplog: pytest.LogCaptureFixture) -> None:
    """It stays, because rcl may still report its messages."""
    loop, served = QueueReadLoop(), threading.Event()
    stays, leaves, works = Reader(lambda: None, fails=True), Reader(lambda: None), Reader(served.set)
    for reader in (stays, leaves, works):
        loop.add(reader)
    loop.start()
    loop.remove(stays)
    loop.remove(leaves)
    until(lambda: leaves.destroyed, "the reader after it is closed", 20.0)
    works.report()
    assert served.wait(20.0)
    loop.stop()
    assert (stays.destroyed, works.destroyed) == (False, True)
    assert "cannot destroy a reader" in caplog.text
    stays.report()


def test_a_loop_whose_wait_fails_does_not_spin(monkeypatch: pytest.MonkeyPatch) -> None:
    loop, failures = QueueReadLoop(), list[float]()
    queue = loop._queue

    def wait() -> None:
        failures.append(time.monotonic())
        raise OSError

    monkeypatch.setattr(loop, "_queue", SimpleNamespace(wait=wait, wake=queue.wake))
    loop.start()
    until(lambda: len(failures) >= 3, "the wait is repeated")
    assert failures[2] - failures[0] > 0.15
    loop.stop()


def test_large_messages_of_any_size_arrive_whole(edge: RunningEdge, peer: Callable[..., Peer]) -> None:
    """Messages of equal size are taken into the object that is delivered; a different one in between must not be."""
    sizes = [100_000, 100_000, 100_000, 100_000, 100_001, 100_000, 70_000, 20, 100_000, 100_000, 100_000]
    native = peer()
    inbox = edge.subscribe("/large", STRING, Qos(depth=len(sizes)))
    publisher = native.advertise("/large", "std_msgs/String", depth=len(sizes))

    def connected() -> bool:
        native.publish(publisher, {"data": "first"})
        return bool(inbox.messages)

    until(connected, "a message arrives")
    sent = [f"{number:x}" * size for number, size in enumerate(sizes)]
    for number, data in enumerate(sent):
        native.publish(publisher, {"data": data})
        until(lambda number=number: text(inbox.messages[-1][0]) == sent[number], f"message {number}")  # type: ignore[misc]
    sent_texts = [text(payload) for payload, _, _ in inbox.messages]
    assert [received for received in sent_texts if received != "first"] == sent


def test_an_exception_in_one_route_does_not_stop_the_others(edge: RunningEdge, peer: Callable[..., Peer]) -> None:
    def broken(_payload: bytes, _source: str, _time_ns: int | None) -> None:
        raise RuntimeError

    edge.edge.subscribe("/raises", edge.type(STRING), Qos(), broken)
    inbox = edge.subscribe("/raises", STRING)
    native = peer()
    publisher = native.advertise("/raises", "std_msgs/String")

    def ten() -> bool:
        native.publish(publisher, {"data": "x"})
        return len(inbox.messages) >= 10

    until(ten, "ten messages arrive in spite of the broken route")


def test_messages_are_published_and_received_without_a_compiler(
    registry: Registry, peer: Callable[..., Peer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rcl, "service_callbacks", None)
    monkeypatch.setattr(rcl, "_publish", rcl._publish_by_ctypes)
    edge = RunningEdge(registry, tmp_path)
    try:
        closed = edge.edge.subscribe("/wait_set", edge.type(STRING), Qos(), lambda _p, _s, _t: None)
        inbox = edge.subscribe("/wait_set", STRING)
        native = peer()
        publisher = native.advertise("/wait_set", "std_msgs/String")

        def more(than: int) -> bool:
            native.publish(publisher, {"data": "x"})
            return len(inbox.messages) > than

        until(lambda: more(2), "messages arrive through the wait set")
        received = native.subscribe("/bare_out", "std_msgs/String")
        ours = edge.edge.advertise("/bare_out", edge.type(STRING), Qos())

        def published() -> bool:
            ours.send(string("y"), "hub")
            return bool(native.wait(received, 1, 0.1))

        until(published, "a message that was published through ctypes arrives")
        closed.close()
        count = len(inbox.messages)
        until(lambda: more(count + 2), "messages arrive after a subscription was closed")
    finally:
        edge.edge.stop()
