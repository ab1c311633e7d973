"""Closing a port: messages and connections that arrive meanwhile, and cleanup."""

from __future__ import annotations

import threading

import pytest

from tests.support.wait import until
from tests.yarp_compat.ports.conftest import MakePort
from tests.yarp_compat.ports.test_port import HELLO
from yarp_compat.ports import loop
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import LocalNaming
from yarp_compat.ports.port import PortCore


def test_replaced_connection_ends_with_the_port(make_port: MakePort) -> None:
    """After the port has closed, the replaced connection delivers nothing more, and its thread has ended."""
    got: list[bytes] = []
    go_on = threading.Event()
    earlier = threading.enumerate()

    def on_message(message: PortMessage) -> None:
        got.append(bytes(message.payload))
        assert go_on.wait(20)

    reader, writer = make_port("/r", on_message), make_port("/w")
    writer.add_output("fast_tcp://r")
    writer.write(b"1")
    until(lambda: got, "on_message has a message")
    writer.write(b"2", strict=True)
    (former,) = reader.connections.inputs
    writer.add_output("fast_tcp://r")
    until(lambda: reader.connections.inputs not in ([], [former]), "a new connection of the same port")
    closer = threading.Thread(target=reader.close)
    closer.start()
    until(lambda: not reader.is_open, "the port is closing")
    closer.join(0.3)
    assert closer.is_alive(), "closing waits until on_message returns"
    go_on.set()
    closer.join(20)
    assert not [t for t in threading.enumerate() if t.name == "yarp /w > /r" and t not in earlier]
    assert got == [b"1"]
    assert reader.connections.leaving == []


def test_pending_request_of_a_replaced_connection_is_abandoned_when_the_port_closes(make_port: MakePort) -> None:
    waiting: list[PortMessage] = []
    earlier = threading.enumerate()

    def on_message(message: PortMessage) -> None:
        message.later()
        waiting.append(message)

    server, client = make_port("/server", on_message), make_port("/client")
    client.add_output("/server")

    def ask() -> None:
        with pytest.raises(ConnectionError):
            client.request(HELLO, timeout=20)

    asker = threading.Thread(target=ask)
    asker.start()
    until(lambda: waiting, "the request has arrived")
    (former,) = server.connections.inputs
    client.add_output("/server")
    until(lambda: server.connections.inputs not in ([], [former]), "a new connection of the same port")
    asker.join(20)
    assert not waiting[0].is_retired, "a replaced connection still waits for the reply"
    server.close()
    assert waiting[0].is_retired
    assert not [t for t in threading.enumerate() if t.name == "yarp /client > /server" and t not in earlier]


def test_port_opened_while_another_thread_closes_it_is_open_afterwards(
    naming: LocalNaming, make_port: MakePort, monkeypatch: pytest.MonkeyPatch
) -> None:
    port, client = PortCore("/port", naming=naming), make_port("/client")
    port.open()
    close, closing, opener = port.connections.close, threading.Event(), threading.Thread(target=port.open)
    closed_again = threading.Event()

    def slowly() -> None:
        closing.set()
        opener.start()
        opener.join(0.3)  # the opening thread is waiting
        assert closed_again.wait(20)
        close()

    monkeypatch.setattr(port.connections, "close", slowly)
    closer = threading.Thread(target=port.close)
    closer.start()
    assert closing.wait(20)
    port.close()  # the other thread is already closing the port
    closed_again.set()
    for thread in (closer, opener):
        thread.join(20)
    monkeypatch.undo()
    assert client.add_output("/port")[0]
    assert naming.query("/port") == port.contact
    port.close()


def test_connection_closed_while_its_queue_becomes_empty_sends_a_farewell(
    make_port: MakePort, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The shared thread, which has sent the queue, leaves the socket open for the thread that closes the output."""
    taken, go_on = list[PortMessage](), threading.Event()

    def on_message(message: PortMessage) -> None:
        taken.append(message)
        assert go_on.wait(20)

    make_port("/r", on_message)
    writer = make_port("/w")
    writer.add_output("tcp://r")
    (output,) = writer.connections.outputs
    step, send = output._step, output.socket_side.send_farewell
    emptied, sent = threading.Event(), list[bool]()

    def stepping() -> int | None:
        events = step()
        if events is None:
            closer.start()
            assert emptied.wait(20)
        return events

    def sending(*, patient: bool) -> None:
        emptied.set()
        shared.run(lambda: None)  # the shared thread has sent the queue
        sent.append(output.sock.fileno() >= 0)
        send(patient=patient)

    closer = threading.Thread(target=output.close)
    monkeypatch.setattr(output, "_step", stepping)
    monkeypatch.setattr(output.socket_side, "send_farewell", sending)
    shared = loop.acquire()
    try:
        for _ in range(2):  # the second message is queued until the first is acknowledged
            assert writer.write(HELLO, strict=True) == 1
        until(lambda: taken, "the first message has arrived")
        go_on.set()
        until(lambda: sent, "the farewell is sent")
        closer.join(20)
    finally:
        loop.release(shared)
    assert sent == [True]


def test_port_that_is_opened_again_is_not_checked_more_often(
    make_port: MakePort, monkeypatch: pytest.MonkeyPatch
) -> None:
    check, checked = PortCore._check_connections, list[str]()

    def count(port: PortCore) -> None:
        checked.append(port.name)
        check(port)

    monkeypatch.setattr(loop, "_CHECK_PERIOD", 0.05)
    monkeypatch.setattr(PortCore, "_check_connections", count)
    make_port("/another")  # keeps the shared thread
    port = make_port("/r")
    for _ in range(10):
        port.close()
        port.open()
    for _ in range(2):  # the first time until the checks of the closed ports, which were due earlier, have run
        checked.clear()
        until(lambda: checked.count("/another") >= 5, "the other port is checked")
    assert 0 < checked.count("/r") <= 2 * checked.count("/another")


def test_the_checks_of_all_ports_wake_the_shared_thread_only_once(
    make_port: MakePort, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise a worker with many ports would wake up several times for each of them at rest."""
    step, steps, checked = loop.PortLoop.step, list[None](), list[None]()

    def count(port_loop: loop.PortLoop, seconds: float | None = None) -> None:
        steps.append(None)
        step(port_loop, seconds)

    monkeypatch.setattr(loop, "_CHECK_PERIOD", 0.05)
    monkeypatch.setattr(PortCore, "_check_connections", lambda _: checked.append(None))
    for number in range(10):
        make_port(f"/p{number}")
    monkeypatch.setattr(loop.PortLoop, "step", count)
    until(lambda: steps, "the shared thread has woken up after the last port was opened")
    steps.clear()
    checked.clear()
    until(lambda: len(checked) >= 100, "the ports are checked")
    assert 10 * len(steps) < 3 * len(checked)  # more than 100 checks, if this thread was delayed
