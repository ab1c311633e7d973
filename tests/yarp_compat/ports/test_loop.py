"""The thread that ports share, and how it ends."""

from __future__ import annotations

import socket
import threading

import pytest

from tests.support.wait import until
from yarp_compat.ports.loop import PortLoop


def test_socket_that_is_ready_when_the_loop_stops_is_handled() -> None:
    loop, hold, read = PortLoop(), threading.Event(), list[bytes]()
    near, far = socket.socketpair()

    def receive() -> None:
        read.append(near.recv(1))
        loop.unwatch(near)

    with near, far:
        loop.call_soon(hold.wait)
        loop.call_soon(lambda: loop.on_readable(near, receive))
        stopping = threading.Thread(target=loop.stop)
        stopping.start()
        until(lambda: len(loop._calls) == 2, "the stop follows directly after the watch")
        far.shutdown(socket.SHUT_RDWR)
        hold.set()
        stopping.join()
    assert read == [b""]


def test_call_after_the_end_runs_on_the_callers_thread() -> None:
    loop, seen = PortLoop(), list[threading.Thread]()
    loop.stop()
    loop.call_soon(lambda: seen.append(threading.current_thread()))
    loop.run(lambda: seen.append(threading.current_thread()))
    assert seen == [threading.current_thread()] * 2


def test_exceptions_are_logged_and_delay_no_other_callback(caplog: pytest.LogCaptureFixture) -> None:
    loop, done = PortLoop(), threading.Event()

    def fail() -> None:
        raise ZeroDivisionError

    def start() -> None:
        loop.call_later(0.0, fail)
        loop.call_later(0.0, done.set)

    loop.call_soon(fail)
    loop.call_soon(start)
    assert done.wait(10.0)
    loop.stop()
    assert caplog.text.count("a callback of the thread yarp-loop failed") == 2
