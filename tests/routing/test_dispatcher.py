"""The dispatcher, and the order of messages that routes publish, whatever the thread."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest
import zenoh

from bridge.hub.endpoints.subscription import HubSample
from bridge.routing import dispatcher as dispatcher_module
from bridge.routing.dispatcher import Dispatcher, RouteQueue
from bridge.routing.limits import BULK, Priority
from tests.support.wait import until


def stuck(dispatcher: Dispatcher) -> str:
    try:
        return dispatcher.alive("publishing")
    except TimeoutError as err:
        return str(err).partition(" for ")[0]


def test_work_on_the_callers_thread_is_watched(monkeypatch: pytest.MonkeyPatch) -> None:
    dispatcher = Dispatcher("test")
    inside, go_on = threading.Event(), threading.Event()

    def work() -> None:
        inside.set()
        go_on.wait(40)

    thread = threading.Thread(target=dispatcher.run_here, args=(work,))
    thread.start()
    assert inside.wait(40)
    monkeypatch.setattr("bridge.routing.dispatcher._STUCK_SECONDS", 0.01)
    until(lambda: stuck(dispatcher) == "publishing has been stuck", "the running work is detected")
    go_on.set()
    thread.join()
    assert dispatcher.alive("publishing") == ""


def test_work_that_fails_stops_nothing() -> None:
    dispatcher = Dispatcher("test")
    dispatcher.start()
    done = threading.Event()
    try:
        dispatcher.run_here(lambda: 1 // 0)  # type: ignore[arg-type]
        dispatcher.submit(Priority.STREAM, lambda: 1 // 0)  # type: ignore[arg-type]
        dispatcher.submit(Priority.STREAM, done.set)
        assert done.wait(40)
    finally:
        dispatcher.stop()


class Queued:
    """A queue whose messages a test publishes, on dispatchers without a thread."""

    def __init__(self, admits: Callable[[HubSample], bool] | None = None) -> None:
        self.published: list[int] = []
        self.dropped = 0
        self.small, self.bulk = Waiting("small"), Waiting("bulk")
        self.queue = RouteQueue(self.small, self.bulk, self._publish, self._drop, admits)
        self.queue.depth = 3

    def _publish(self, sample: HubSample) -> None:
        assert self.queue.publishing.locked()
        self.published.append(sample.sequence)

    def _drop(self) -> None:
        self.dropped += 1

    def receive(self, *numbers: int, size: int = 1) -> None:
        for number in numbers:
            self.queue.receive(HubSample(zenoh.ZBytes(bytes(size)), number, 0, b"g", "z"))


class Waiting(Dispatcher):
    """Stores the submitted calls until the test runs them."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.calls: list[tuple[Priority, Callable[[], None]]] = []

    def submit(self, priority: Priority, work: Callable[[], None]) -> None:
        self.calls.append((priority, work))

    def run(self) -> None:
        calls, self.calls = self.calls, []
        for _, work in calls:
            work()


def test_small_message_is_published_on_the_receiving_thread() -> None:
    queued = Queued()
    queued.receive(1, 2)
    assert (queued.published, queued.small.calls, queued.bulk.calls) == ([1, 2], [], [])
    assert not queued.queue.publishing.locked()


def test_message_received_while_another_is_published_is_queued_in_order_and_in_its_class() -> None:
    queued = Queued()
    queued.queue.priority = Priority.COMMAND
    with queued.queue.publishing:
        queued.receive(1, 2)
    queued.receive(3)
    assert queued.published == [], "a later message does not overtake"
    assert [priority for priority, _ in queued.small.calls] == [Priority.COMMAND] * 3
    queued.small.run()
    assert queued.published == [1, 2, 3]
    queued.receive(4)
    assert queued.published == [1, 2, 3, 4]


def test_full_queue_drops_its_oldest_messages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dispatcher_module, "QUEUE_BYTES", 100)
    queued = Queued()
    with queued.queue.publishing:
        queued.receive(1, 2, 3, 4, 5)
        assert queued.dropped == 2
        queued.receive(6, 7, size=99)
    queued.small.run()
    assert (queued.published, queued.dropped) == ([7], 6), "the newest message does not count against the bytes"


def test_large_message_moves_the_route_to_the_bulk_dispatcher() -> None:
    queued = Queued()
    queued.receive(1)
    queued.receive(2, size=BULK + 1)
    queued.receive(3)
    assert (len(queued.small.calls), len(queued.bulk.calls)) == (0, 2)
    queued.bulk.run()
    assert queued.published == [1, 2, 3]


def test_message_over_the_rate_is_neither_published_nor_queued() -> None:
    queued = Queued(lambda sample: sample.sequence % 2 == 0)
    queued.receive(1, 2)
    with queued.queue.publishing:
        queued.receive(3, 4)
    queued.small.run()
    assert (queued.published, queued.dropped) == ([2, 4], 0)


def test_cleared_queue_publishes_nothing() -> None:
    queued = Queued()
    with queued.queue.publishing:
        queued.receive(1)
    queued.queue.clear()
    queued.small.run()
    assert queued.published == []


def test_failed_publish_does_not_block_the_next_message() -> None:
    published: list[int] = []

    def publish(sample: HubSample) -> None:
        if sample.sequence == 1:
            raise OSError("the side has no memory")
        published.append(sample.sequence)

    small = Waiting("small")
    queue = RouteQueue(small, small, publish, lambda: None)
    for number in (1, 2):
        queue.receive(HubSample(zenoh.ZBytes(b"x"), number, 0, b"g", "z"))
    assert (published, small.calls) == ([2], [])
