"""A record that a full socket has refused is not overtaken before its link's lock is free."""

from __future__ import annotations

import contextlib
import math
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterator
from types import TracebackType

import pytest

from bridge.hub.lane.joining import MAX_JOINED, Joining
from bridge.hub.lane.numbering import Epoch, Link, Sender
from bridge.hub.lane.wire import DATA, HEAD, SIZE
from bridge.hub.wire.keys import pack_attachment
from bridge.routing.doorway import Deadline, Doorway
from tests.hub.lane.test_senders import GID, QueuedLane


class BusyLock:
    """A lock that another thread uses just before the next one who acquires it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.other: Callable[[], None] | None = None

    def __enter__(self) -> None:
        other, self.other = self.other, None
        if other is not None:
            other()
        self._lock.acquire()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._lock.release()


@pytest.fixture
def queued() -> Iterator[QueuedLane]:
    lane = QueuedLane()
    yield lane
    lane.close()


@pytest.mark.parametrize("large", [False, True])
def test_a_refused_record_is_not_overtaken_by_the_next_message(queued: QueuedLane, *, large: bool) -> None:
    lock, numbers, joining = BusyLock(), list[int](), Joining()
    queued.reader_link._lock = lock  # type: ignore[assignment]
    with contextlib.suppress(BlockingIOError):
        while True:
            queued.near.send(
                HEAD.pack(DATA, 1) + SIZE.pack(1000) + pack_attachment(0, 0, GID) + bytes(1000)
            )  # until the socket is full
    queued.doorway(b"first", "a", 0)

    def other() -> None:
        numbers.extend(message.number for message in queued.messages() if message.number)
        queued.reader_link.flush()
        queued.doorway(bytes(5000 if large else 5), "a", 0)

    lock.other = other
    joining.end()
    queued.reader_link.flush()
    numbers += [message.number for message in queued.messages() if message.number]
    assert numbers == [1, 2]
    queued.doorway(b"third", "a", 0)
    assert [message.number for message in queued.messages()] == [3]
    assert queued.by_python == int(large), "the doorway sends again"


def test_a_link_is_not_ready_while_a_full_record_waits() -> None:
    """A thread may set ``ready`` between the refusal of the socket and the owner's reaction."""
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    near.setblocking(False)
    link, sender, lease = Link(near.fileno(), lambda: None), Sender(GID, Epoch()), Deadline()
    sender.send_to(((link, 1),))
    sender.rest(0, 0)
    sender.direct, lease.until = True, math.inf
    doorway = Doorway(lambda *_: pytest.fail("it is sent"), lease, None, deque(), None, 100, ())
    doorway.admit("a", sender)
    joining = Joining()
    with near, far:
        with contextlib.suppress(BlockingIOError):
            while True:
                near.send(bytes(1000))
        for _ in range(MAX_JOINED):
            assert link.ready
            doorway(b"x", "a", 1)
        link.ready = True
        assert not link.ready
        joining.end()
