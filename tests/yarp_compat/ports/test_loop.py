"""The thread that ports share, and how it ends."""

from __future__ import annotations

import selectors
import socket
import threading

from tests.support.wait import until
from yarp_compat.ports.loop import PortLoop


def test_socket_that_is_ready_when_the_loop_stops_is_handled() -> None:
    loop, hold, seen = PortLoop(), threading.Event(), list[int]()
    near, far = socket.socketpair()
    with near, far:
        loop.call(hold.wait)
        loop.call(lambda: loop.watch(near, selectors.EVENT_READ, seen.append))
        stopping = threading.Thread(target=loop.stop)
        stopping.start()
        until(lambda: len(loop._calls) == 2, "the stop follows directly after the watch")
        far.shutdown(socket.SHUT_RDWR)
        hold.set()
        stopping.join()
    assert seen == [selectors.EVENT_READ]


def test_call_after_the_end_runs_on_the_callers_thread() -> None:
    loop, seen = PortLoop(), list[threading.Thread]()
    loop.stop()
    loop.call(lambda: seen.append(threading.current_thread()))
    loop.run(lambda: seen.append(threading.current_thread()))
    assert seen == [threading.current_thread()] * 2
