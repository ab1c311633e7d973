"""Only a few requests at a time go to each node, without delaying requests to other nodes."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from bridge.adapters.ros1.peer_pool import AT_ONCE, PeerPool
from tests.support.no_threads import no_threads
from tests.support.wait import until

NODE, OTHER = "http://127.0.0.1:1/", "http://127.0.0.1:2/"


class Talks:
    """Jobs that run until they are released."""

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


def test_concurrent_requests_to_a_node_are_limited(pool: PeerPool) -> None:
    """Servers of rospy and roscpp have a backlog of five; a sixth connection is dropped and retried later."""
    talks, others = Talks(), Talks()
    others.go_on.set()
    for _ in range(20):
        pool.submit(NODE, talks.talk)
    pool.submit(OTHER, others.talk)
    until(lambda: talks.now == AT_ONCE and others.done, "requests to both nodes run")
    talks.go_on.set()
    until(lambda: talks.done == 20, "all requests have ended")
    assert talks.most == AT_ONCE


@pytest.mark.parametrize("doubtful", [False, True])
def test_a_failed_request_frees_its_place(pool: PeerPool, doubtful: bool) -> None:
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
    until(lambda: talks.now == AT_ONCE, "as many requests as before run")
    talks.go_on.set()
    until(lambda: talks.done == AT_ONCE, "all requests have ended")


@pytest.mark.parametrize("name", ["fresh", "doubtful"])
def test_requests_are_started_once_the_system_has_threads_again(pool: PeerPool, name: str) -> None:
    if name == "doubtful":
        pool.failed(NODE)
    talks = Talks()
    talks.go_on.set()
    with no_threads(f"midspan-ros1-{name}"):
        for _ in range(2 * AT_ONCE):
            pool.submit(NODE, talks.talk)
        pool.resume()
        assert not talks.done
    pool.resume()
    until(lambda: talks.done == 2 * AT_ONCE, "all requests have ended")
    until(lambda: not pool._peers, "no request is waiting")


def test_waiting_requests_to_a_failed_node_move_to_the_other_pool(pool: PeerPool) -> None:
    """The node's waiting jobs move to the pool for failed addresses."""
    pool = PeerPool(fresh=1, doubtful=1)
    try:
        dead, good = Talks(), Talks()
        good.go_on.set()
        pool.submit(NODE, lambda: pool.failed(NODE))
        pool.submit(NODE, dead.talk)
        until(lambda: dead.now == 1, "the second request to the dead node is running")
        pool.submit(OTHER, good.talk)
        until(lambda: good.done == 1, "the request to the other node runs")
        dead.go_on.set()
    finally:
        pool.stop()
