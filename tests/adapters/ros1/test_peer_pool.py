"""Conversations with other nodes: few at a time with each of them, and none delays another node's."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from bridge.adapters.ros1.peer_pool import AT_ONCE, PeerPool
from tests.support.wait import until

NODE, OTHER = "http://127.0.0.1:1/", "http://127.0.0.1:2/"


class Talks:
    """Jobs that go on until they are let go."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.go_on = threading.Event()
        self.now = self.most = self.done = 0

    def talk(self) -> None:
        with self._lock:
            self.now += 1
            self.most = max(self.most, self.now)
        self.go_on.wait(30)
        with self._lock:
            self.now -= 1
            self.done += 1


@pytest.fixture
def pool() -> Iterator[PeerPool]:
    pool = PeerPool()
    yield pool
    pool.stop()


def test_a_node_is_spoken_to_by_few_at_a_time(pool: PeerPool) -> None:
    """Rospy's and roscpp's servers let five connections wait; one more is dropped, and comes again after a second."""
    talks, others = Talks(), Talks()
    others.go_on.set()
    for _ in range(20):
        pool.submit(NODE, talks.talk)
    pool.submit(OTHER, others.talk)
    until(lambda: talks.now == AT_ONCE and others.done, "both nodes are spoken to")
    talks.go_on.set()
    until(lambda: talks.done == 20, "all conversations were held")
    assert talks.most == AT_ONCE


@pytest.mark.parametrize("doubtful", [False, True])
def test_a_conversation_that_fails_keeps_no_place(pool: PeerPool, doubtful: bool) -> None:
    def fail() -> None:
        msg = "no peer"
        raise ValueError(msg)

    if doubtful:
        pool.failed(NODE)
    talks = Talks()
    for _ in range(2 * AT_ONCE):
        pool.submit(NODE, fail)
    for _ in range(AT_ONCE):
        pool.submit(NODE, talks.talk)
    until(lambda: talks.now == AT_ONCE, "as many as ever")
    talks.go_on.set()
    until(lambda: talks.done == AT_ONCE, "all conversations were held")


def test_a_node_that_fails_while_others_wait_keeps_the_first_lane_free(pool: PeerPool) -> None:
    """Its jobs that wait change to the lane of those that failed."""
    pool = PeerPool(fresh=1, doubtful=1)
    try:
        dead, good = Talks(), Talks()
        good.go_on.set()
        pool.submit(NODE, lambda: pool.failed(NODE))
        pool.submit(NODE, dead.talk)
        until(lambda: dead.now == 1, "the dead one's second conversation is under way")
        pool.submit(OTHER, good.talk)
        until(lambda: good.done == 1, "the other node is spoken to")
        dead.go_on.set()
    finally:
        pool.stop()
