"""The thread of a route's own for large messages."""

from __future__ import annotations

import threading

from bridge.routing.lane import Lane
from tests.support.wait import until


def test_it_carries_in_order_and_the_oldest_make_room() -> None:
    go_on, carried, dropped = threading.Event(), list[int](), list[bool]()

    def carry(message: int) -> None:
        assert go_on.wait(40)
        carried.append(message)
        if message == 8:
            raise ValueError(message)

    lane = Lane[int]("lane", 3, 100, carry, lambda: dropped.append(True))
    try:
        assert not lane.busy
        lane.put(0, 1)
        until(lambda: not lane._queue, "the first one is under way")
        assert lane.busy
        for number in range(1, 8):
            lane.put(number, 1)
        lane.put(8, 99)  # no room beside more than one other
        go_on.set()
        until(lambda: not lane.busy, "all are carried")
        assert carried == [0, 7, 8]
        assert len(dropped) == 6
        lane.put(9, 1000)  # the newest always fits, and a failed one stops nothing
        until(lambda: carried[-1] == 9, "it goes on")
    finally:
        lane.close()
        lane.close()


def test_closing_drops_what_waits() -> None:
    inside, go_on, carried = threading.Event(), threading.Event(), list[int]()

    def carry(message: int) -> None:
        inside.set()
        assert go_on.wait(40)
        carried.append(message)

    lane = Lane[int]("lane", 10, 100, carry, lambda: None)
    lane.put(1, 1)
    assert inside.wait(40)
    lane.put(2, 1)
    closer = threading.Thread(target=lane.close)
    closer.start()
    until(lambda: lane._closed, "closing")
    go_on.set()
    closer.join(40)
    lane.put(3, 1)
    assert carried == [1]


def test_what_is_offered_is_taken_only_where_there_is_room() -> None:
    inside, go_on, carried = threading.Event(), threading.Event(), list[int]()

    def carry(message: int) -> None:
        inside.set()
        assert go_on.wait(40)
        carried.append(message)

    lane = Lane[int]("lane", 2, 100, carry, lambda: None)
    try:
        assert lane.offer(0, 1000)
        assert inside.wait(40)
        assert [lane.offer(number, size) for number, size in ((1, 60), (2, 60), (3, 40), (4, 0))] == [
            True,
            False,
            True,
            False,
        ]
        go_on.set()
        until(lambda: not lane.busy, "all are carried")
        assert carried == [0, 1, 3]
    finally:
        lane.close()
    assert not lane.offer(5, 1)
