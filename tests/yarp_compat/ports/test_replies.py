"""Replies of ports: immediate, deferred, and missing ones."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from tests.support.wait import until
from tests.yarp_compat.ports.conftest import MakePort
from tests.yarp_compat.ports.test_port import HELLO
from yarp_compat.ports.message import PortMessage
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.profile import Profile

REPLYING = ["tcp", "fast_tcp", "text_ack", "local"]


@pytest.mark.parametrize("carrier", REPLYING)
def test_request_gets_the_owners_reply(make_port: MakePort, carrier: str) -> None:
    make_port("/server", lambda m: m.reply(encode(["got", *decode(m.payload)], Profile.YARP3)), rpc=True)
    client = make_port("/client", rpc=True)
    client.add_output(f"{carrier}://server")
    for _ in range(3):
        assert decode(client.request(HELLO, timeout=10)) == ["got", "hello", 42, 3.5]


@pytest.mark.parametrize("carrier", REPLYING)
def test_request_always_gets_a_reply(make_port: MakePort, carrier: str) -> None:
    """A port replies even if its owner does not, fails, or does not exist."""

    def fail(_: PortMessage) -> None:
        raise ValueError

    client = make_port("/client")
    for name, owner in (("/silent", lambda _: None), ("/failing", fail), ("/nobody", None)):
        port = make_port(name, owner)
        client.add_output(f"{carrier}:/{name}")
        assert decode(client.request(HELLO, timeout=10)) == []
        client.remove_output(name)
        if name != "/silent":
            assert port.counters.dropped.total() == 1


def test_a_reply_may_come_from_another_thread(make_port: MakePort) -> None:
    waiting: list[PortMessage] = []

    def on_message(message: PortMessage) -> None:
        message.later()
        waiting.append(message)

    make_port("/server", on_message)
    client = make_port("/client")
    client.add_output("/server")
    got: list[bytes] = []
    thread = threading.Thread(target=lambda: got.append(client.request(HELLO, timeout=10)))
    thread.start()
    until(lambda: waiting, "the request has arrived")
    waiting[0].reply([HELLO[:5], HELLO[5:]])
    thread.join(10)
    assert got == [HELLO]


def _defer_while_closing(message: PortMessage) -> None:
    until(lambda: message.is_retired, "the port is closing")
    message.later()


@pytest.mark.parametrize("owner", [PortMessage.later, _defer_while_closing])
def test_request_without_a_reply_ends_with_the_port(make_port: MakePort, owner: Callable[[PortMessage], None]) -> None:
    """An empty reply would look like a real one, so the connection must end, even if the port already closes."""
    server = make_port("/server", owner)
    client = make_port("/client")
    client.add_output("/server")
    failed: list[Exception] = []

    def ask() -> None:
        try:
            client.request(HELLO, timeout=20)
        except ConnectionError as error:
            failed.append(error)

    thread = threading.Thread(target=ask)
    thread.start()
    until(lambda: server.counters.received, "the request has arrived")
    server.close()
    thread.join(10)
    assert failed


@pytest.mark.parametrize("owner", [lambda message: message.reply(HELLO), None])
def test_request_during_closing_gets_no_reply(
    make_port: MakePort, monkeypatch: pytest.MonkeyPatch, owner: Callable[[PortMessage], None] | None
) -> None:
    """There is not even an empty reply: the client sees the connection close."""
    server, client = make_port("/server", owner), make_port("/client")
    client.add_output("/server")
    until(server.inputs, "the server is connected")
    close, failed = server.connections.close, list[Exception]()

    def close_after_request() -> None:
        try:
            client.request(HELLO, timeout=20)
        except ConnectionError as error:
            failed.append(error)
        close()

    monkeypatch.setattr(server.connections, "close", close_after_request)
    server.close()
    assert failed


def test_late_reply_closes_the_connection(make_port: MakePort) -> None:
    """The reply may still arrive, and must not be mistaken for the reply to the next request."""
    make_port("/server", PortMessage.later)
    client = make_port("/client")
    client.add_output("/server")
    with pytest.raises(TimeoutError, match="/server"):
        client.request(HELLO, timeout=0.3)
    assert client.outputs() == []
    with pytest.raises(ConnectionError, match="not connected"):
        client.request(HELLO, timeout=0.3)


def test_udp_carries_no_replies(make_port: MakePort) -> None:
    make_port("/server")
    client = make_port("/client")
    client.add_output("udp://server")
    with pytest.raises(ConnectionError, match="tcp"):
        client.request(HELLO, timeout=5)


def test_closing_port_sends_the_reply_that_its_owner_is_making(make_port: MakePort) -> None:
    """For example, a module closes its ports while it replies to ``quit``."""
    ends: list[threading.Thread] = []

    def on_message(message: PortMessage) -> None:
        ends.append(threading.Thread(target=server.close))
        ends[0].start()
        until(lambda: not server.is_open, "the port is closing")
        message.reply(HELLO)

    server, client = make_port("/server", on_message), make_port("/client")
    client.add_output("/server")
    assert client.request(HELLO, timeout=10) == HELLO
    ends[0].join(10)
    assert not ends[0].is_alive()


def test_closing_port_sends_the_reply_of_another_thread(make_port: MakePort) -> None:
    """For example, a program replies to the last request and closes."""
    for _ in range(50):
        waiting: list[PortMessage] = []

        def on_message(message: PortMessage, waiting: list[PortMessage] = waiting) -> None:
            message.later()
            waiting.append(message)

        server, client = make_port("/server", on_message), make_port("/client")
        client.add_output("/server")
        got: list[bytes] = []
        thread = threading.Thread(target=lambda c=client, g=got: g.append(c.request(HELLO, timeout=10)))
        thread.start()
        until(lambda w=waiting: w, "the request has arrived")
        waiting[0].reply(HELLO)
        server.close()
        thread.join(10)
        assert got == [HELLO]
        client.close()
