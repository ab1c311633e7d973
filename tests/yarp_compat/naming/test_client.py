"""The name server client: its commands, which equal those of YARP's programs byte for byte, and its errors."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.peers.yarp.scripted import Scripted
from tests.support.ports import free_port
from tests.yarp_compat.transcripts import Talk, read
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.ports import text_client
from yarp_compat.ports.dial import dial, dial_group, send_farewell
from yarp_compat.ports.naming import NameRefusedError, NamingConfigError, NamingError, NoNameServerError, PortError
from yarp_compat.ports.text_client import LineSocket
from yarp_compat.wire import carriers
from yarp_compat.wire.carriers import CARRIERS
from yarp_compat.wire.contact import PortContact

TALKS = {talk.number: talk for talk in read("connect.txt")}
CONNECT = (15, 16, 17, 18)
"""The connections of ``yarp connect /writer /reader``: two queries to the name server, two to the port."""


def script(talk: Talk, port: int | None = None) -> list[tuple[int, bytes | None]]:
    """Return the recorded answers of a real peer, with its port number replaced by ``port``."""
    steps = [(step.by, step.data) for step in talk.steps]
    requests = [data for by, data in steps if by == "C"]
    answers = [data for by, data in steps if by == "S"]
    if port is not None:
        answers = [data.replace(b"port 10003", b"port %d" % port) for data in answers]
    return [(data.count(b"\n"), answer) for data, answer in zip(requests, answers, strict=True)]


def client(port: int, timeout: float = 5.0) -> NameClient:
    """Return a client of the server at a port."""
    return NameClient(Address("127.0.0.1", port), timeout=timeout)


def test_a_port_is_opened_with_the_commands_of_a_real_program() -> None:
    """These are query, register, four times set, announce and unregister; only the values of the properties differ."""
    with Scripted(*(script(TALKS[n]) for n in (1, 2, 3, 4, 5, 6, 7, 25))) as server:
        names = client(server.port)
        assert names.query("/reader") is None
        assert names.register("/reader") == PortContact("/reader", "127.0.0.1", 10002, "tcp")
        names.announce("/reader")
        names.unregister("/reader")
    real = [TALKS[n].sent_by("C") for n in (1, 2, 3, 4, 5, 6, 7, 25)]
    ours = server.received
    assert [ours[i] for i in (0, 1, 6, 7)] == [real[i] for i in (0, 1, 6, 7)]
    offers = " ".join(CARRIERS).encode()
    assert ours[2:6] == [
        b"NAME_SERVER set /reader offers " + offers + b"\r\n",
        b"NAME_SERVER set /reader accepts " + offers + b"\r\n",
        b"NAME_SERVER set /reader ips 127.0.0.1\r\n",
        b"NAME_SERVER set /reader process %d\r\n" % os.getpid(),
    ]
    assert set(offers.split()) < set(real[2].split())


def test_two_ports_are_connected_with_the_commands_of_yarp_connect() -> None:
    """The four exchanges equal those of ``yarp connect /writer /reader`` byte for byte."""
    with (
        Scripted(*(script(TALKS[n]) for n in (17, 18))) as port,
        Scripted(*(script(TALKS[n], port.port) for n in (15, 16))) as server,
    ):
        reply = connections.connect(client(server.port), "/writer", "/reader")
    assert reply == "Added connection from /writer to tcp://reader"
    assert [*server.received, *port.received] == [TALKS[n].sent_by("C") for n in CONNECT]


@pytest.mark.parametrize(
    ("register", "command"),
    [
        (lambda n: n.register("..."), b"NAME_SERVER register ...\r\n"),
        (lambda n: n.register(""), b"NAME_SERVER register ...\r\n"),
        (lambda n: n.register("/p", "10.0.0.1", 10555), b"NAME_SERVER register /p tcp 10.0.0.1 10555\r\n"),
        (lambda n: n.register("/p", port=10555), b"NAME_SERVER register /p tcp ... 10555\r\n"),
        (lambda n: n.register("/p", "10.0.0.1"), b"NAME_SERVER register /p tcp 10.0.0.1 ...\r\n"),
        (lambda n: n.register("/m", carrier="mcast"), b"NAME_SERVER register /m mcast ... ...\r\n"),
    ],
)
def test_the_server_completes_a_registration(register: Callable[[NameClient], Any], command: bytes) -> None:
    """Name, address and number may each be omitted."""
    with Scripted([(1, b"*** end of message\r\n")]) as server, pytest.raises(NameRefusedError, match="refused"):
        register(client(server.port))
    assert server.received == [command]


def test_yarp_ip_selects_the_registered_address(monkeypatch: pytest.MonkeyPatch) -> None:
    """``YARP_IP`` is an address, or the beginning of one of this machine's addresses."""
    for variable, host in (("127", b"127.0.0.1"), ("10.9.9.9", b"10.9.9.9")):
        monkeypatch.setenv("YARP_IP", variable)
        command = b"NAME_SERVER register /p tcp %s ...\r\n" % host
        with Scripted([(1, b"*** end of message\r\n")]) as server, pytest.raises(NameRefusedError):
            client(server.port).register("/p")
        assert server.received == [command]


def test_a_closed_port_is_reported_with_address_and_cure() -> None:
    """If the port is closed, the client reports the address and the cure at once."""
    port = free_port()
    with pytest.raises(NoNameServerError) as caught:
        client(port).query("/p")
    text = str(caught.value)
    assert f"127.0.0.1 port {port}" in text
    assert "refused" in text
    assert "midspan yarp server" in text


@pytest.mark.parametrize("answer", [b"registration name /p ip 127", b"registration name /p\r\nmore\r\n"])
def test_a_truncated_reply_is_an_error(answer: bytes) -> None:
    """The connection closes within a reply."""
    with Scripted([(1, answer), (0, b"")]) as server, pytest.raises(NoNameServerError, match="closed before"):
        client(server.port).list()


def test_a_connection_that_fails_at_once_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    broken: list[LineSocket] = []  # keep a reference, because garbage collection would close the socket

    def send(peer: LineSocket, _data: bytes) -> None:
        broken.append(peer)
        raise BrokenPipeError

    monkeypatch.setattr(LineSocket, "send", send)
    with socket.create_server(("127.0.0.1", 0)) as server:
        with pytest.raises(NoNameServerError):
            client(server.getsockname()[1]).query("/a")
        assert len(broken) == 1
        peer, _ = server.accept()
        with peer:
            peer.settimeout(20)
            assert peer.recv(1) == b""


def test_a_silent_name_server_causes_a_timeout() -> None:
    """A call to a silent name server ends after the timeout."""
    with Scripted([(0, None)]) as server:
        began = time.monotonic()
        with pytest.raises(NoNameServerError, match=r"no reply within 0\.2 s"):
            client(server.port, 0.2).query("/p")
        assert time.monotonic() - began < 20.0


def test_an_endless_reply_is_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reply may have up to MAX_ANSWER bytes."""
    monkeypatch.setattr("yarp_compat.naming.client.MAX_ANSWER", 1000)
    with Scripted([(1, b"x" * 5000)]) as server, pytest.raises(NoNameServerError, match="longer than 1000 bytes"):
        client(server.port).list()


def test_the_address_is_read_from_yarp_conf(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Without yarp.conf, the error names the file; an existing client uses a changed address."""
    monkeypatch.setenv("YARP_CONFIG_HOME", str(tmp_path))
    monkeypatch.delenv("YARP_NAMESPACE", raising=False)
    names = NameClient()
    with pytest.raises(NoNameServerError, match=str(tmp_path / "yarp.conf")):
        names.query("/p")
    closed = free_port()
    (tmp_path / "yarp.conf").write_text(f"127.0.0.1 {closed} yarp\n")
    with pytest.raises(NoNameServerError, match=f"does not answer at 127.0.0.1 port {closed}"):
        names.query("/p")
    with Scripted([(1, b"*** end of message\r\n")]) as server:
        (tmp_path / "yarp.conf").write_text(f"127.0.0.1 {server.port} yarp\n")
        assert names.query("/p") is None
    (tmp_path / "yarp.conf").write_text("nonsense\n")
    with pytest.raises(NamingConfigError, match="expected '<address> <port> yarp'"):
        NameClient().query("/p")


def test_invalid_names_are_rejected_locally() -> None:
    """A name that contains an address is not queried either."""
    names = client(free_port())
    for name in ("two words", "/a,b", "/a(b", "/a{b", "/a\nb", '/a"b', "/" + "x" * 2000):
        with pytest.raises(NameRefusedError, match="without spaces"):
            names.register(name)
        assert names.query(name) is None
    with pytest.raises(NamingError, match="one line"):
        names.line(["set", "/p", "key", "a\nb"])
    assert names.query("tcp://127.0.0.1:10002/p") == PortContact("/p", "127.0.0.1", 10002, "tcp")
    with pytest.raises(PortError, match="not a valid port name"):
        connections.connect(names, "reader", "/b")


@pytest.mark.parametrize("greeting", [b"HTTP/1.1 400 Bad Request\r\n", b""])
def test_another_kind_of_server_is_recognized(greeting: bytes) -> None:
    """Another kind of server listens at a port's address."""
    problem = "not a YARP port: it answers 'HTTP" if greeting else "closed before"
    with Scripted([(2, greeting)]) as other, pytest.raises(PortError, match=problem):
        connections.ping(client(1), f"tcp://127.0.0.1:{other.port}/p")


def test_a_reply_that_is_not_a_bottle_is_an_error() -> None:
    with (
        Scripted([(3, b"Welcome admin\r\n" + b"(" * 200 + b"\r\n<ACK>\r\n")]) as peer,
        pytest.raises(PortError, match="not a Bottle"),
    ):
        text_client.admin(PortContact("/odd", "127.0.0.1", peer.port), ["list"], 20.0)


@pytest.mark.parametrize("host", ["a" * 70, "a..b", "\udc80"])
def test_a_host_that_is_not_a_name_is_an_error_of_its_port(host: str) -> None:
    """Ports can register any text as their host."""
    contact = PortContact("/odd", host, 10000)
    assert not connections.responds(contact)
    with pytest.raises(PortError, match=r"cannot query /odd at tcp://.*: .* is not a host name"):
        text_client.admin(contact, ["list"])
    for connect in (
        lambda: dial(contact, carriers.TCP, "/me"),
        lambda: dial_group(contact, "/me", "", lambda _interface: ("224.1.1.1", 10001)),
        lambda: send_farewell(contact, "/me"),
    ):
        with pytest.raises(OSError, match="not a host name"):
            connect()
    with pytest.raises(NoNameServerError, match="not a host name"):
        NameClient(Address(host, 10000)).register("/p")


def test_an_overlong_answer_is_the_reason_of_the_error() -> None:
    with (
        Scripted([(3, b"Welcome admin\r\n" + b"x" * (1 << 21))]) as peer,
        pytest.raises(PortError, match=r"cannot query /odd at .*: the answer is longer than 1048576 bytes"),
    ):
        text_client.admin(PortContact("/odd", "127.0.0.1", peer.port), ["list"], 20.0)
