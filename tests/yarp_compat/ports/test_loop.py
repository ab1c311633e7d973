"""The thread that ports share, and how it ends."""

from __future__ import annotations

import errno
import socket
import threading
from collections.abc import Callable

import pytest

from tests.support.wait import until
from tests.yarp_compat.ports.conftest import MakePort
from yarp_compat import threaded_loop
from yarp_compat.ports.inputs import Input
from yarp_compat.ports.loop import PortLoop
from yarp_compat.ports.naming import LocalNaming
from yarp_compat.ports.port import PortCore


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
        until(lambda: len(loop._calls) == 2, "the stop is queued directly after the watch")
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


def test_full_select_still_changes_the_events_of_its_files(fill_select: Callable[[], None]) -> None:
    loop, writable = PortLoop(), threading.Event()
    near, far = socket.socketpair()

    def write() -> None:
        loop.unwatch(near)
        writable.set()

    with near, far:
        loop.on_readable(near, print)
        fill_select()
        with pytest.raises(OSError, match="select"):
            loop.on_readable(far, print)
        loop.on_writable(near, write)
        assert writable.wait(10.0)
        loop.stop()


def test_connection_that_select_cannot_watch_delivers_its_messages(
    make_port: MakePort, monkeypatch: pytest.MonkeyPatch, fill_select: Callable[[], None]
) -> None:
    received, start = list[bytes](), Input.start

    def start_without_room(connection: Input, loop: PortLoop) -> None:
        fill_select()
        start(connection, loop)

    monkeypatch.setattr(Input, "start", start_without_room)
    make_port("/in", lambda message: received.append(bytes(message.payload)))
    writer = make_port("/out")
    writer.add_output("/in")
    writer.write(b"payload", strict=True)
    until(lambda: received == [b"payload"], "the message has arrived")


def test_port_that_select_cannot_watch_is_not_open(
    make_port: MakePort, naming: LocalNaming, fill_select: Callable[[], None]
) -> None:
    first = make_port("/first")
    fill_select()
    second = PortCore("/second", naming=naming)
    with pytest.raises(OSError, match=r"select\(\) watches"):
        second.open()
    assert not second.is_open
    assert naming.query("/second") is None
    assert first.is_open


def test_port_accepts_connections_again_once_select_has_room(
    make_port: MakePort, monkeypatch: pytest.MonkeyPatch, fill_select: Callable[[], None],
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    port, writer, room = make_port("/in"), make_port("/out"), threaded_loop._SELECT_LIMIT
    loop, listener = port._loop, port._listener
    assert loop is not None
    assert listener is not None
    fill_select()
    with socket.create_connection((port.contact.host, port.contact.port), 10.0) as refused:
        assert refused.recv(1) == b""
    assert "cannot accept a connection" in caplog.text
    resumed, resume = threading.Event(), listener._resume
    monkeypatch.setattr(listener, "_resume", lambda: (resume(), resumed.set()))
    loop.run(lambda: listener._make_room(OSError(errno.EMFILE, "too many files")))
    assert resumed.wait(10.0)
    assert caplog.text.count("cannot accept a connection") == 1  # peers try again and again
    monkeypatch.setattr(threaded_loop, "_SELECT_LIMIT", room)
    writer.add_output("/in")
    assert not [record for record in caplog.records if record.name == "yarp.ports" and "failed" in record.getMessage()]
