"""The name server as others see it: its bytes, its carriers, its page, its persistent connections, its memory."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.ports import free_port
from tests.support.wait import until
from tests.yarp_compat.transcripts import read
from yarp_compat.naming import connections
from yarp_compat.naming import server as server_module
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.server import NameServer
from yarp_compat.ports import text_client
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import NamingError
from yarp_compat.ports.port import PortCore
from yarp_compat.ports.text_client import LineSocket
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text


@pytest.fixture(name="server")
def fixture_server() -> Iterator[NameServer]:
    """A name server that remembers nothing."""
    with NameServer(port=free_port(room=20), gc_seconds=0) as server:
        yield server


@pytest.fixture(name="names")
def fixture_names(server: NameServer) -> NameClient:
    """A client of it."""
    return NameClient(server.address)


def exchange(port: int, data: bytes, end: bytes) -> bytes:
    """Say something on a connection of its own, and hear until an end."""
    with socket.create_connection(("127.0.0.1", port), 10.0) as sock:
        sock.sendall(data)
        heard = b""
        while not heard.endswith(end):
            more = sock.recv(65536)
            assert more, heard
            heard += more
        return heard


def test_every_exchange_of_the_transcript(server: NameServer) -> None:
    """What two real ports and ``yarp connect`` asked, in their bytes, is answered in a real name server's bytes."""
    port = server.address.port
    for spoken in (t for t in read("connect.txt") if t.port == 10000):
        wanted = spoken.said("S").replace(b"port 10002", b"port %d" % (port + 2))
        wanted = wanted.replace(b"port 10003", b"port %d" % (port + 3))
        assert exchange(port, spoken.said("C"), wanted[-6:]) == wanted


def test_many_commands_on_one_connection(server: NameServer) -> None:
    """A name client of old, or a person with telnet: line ends of either kind, nothing in between."""
    with LineSocket("127.0.0.1", server.address.port, 10.0) as peer:
        peer.send(b"NAME_SERVER query /none\nNAME_SERVER register /p\r\n\r\nNAME_SERVER query /p\n")
        heard = [peer.line() for _ in range(5)]
    line = f"registration name /p ip 127.0.0.1 port {server.address.port + 2} type tcp"
    assert heard == ["*** end of message", line, "*** end of message", line, "*** end of message"]


def test_bottles_over_text_ack(names: NameClient) -> None:
    """What tools such as ``yarp clean`` use: lines as they are, or a Bottle."""
    assert text_client.ask(names.contact, ["query", "/none"]) == ["*** end of message"]
    assert text_client.ask(names.contact, ["gc"]) == ["garbage collection done.", "*** end of message"]
    assert text_client.ask(names.contact, ["subscribe"]) == ["subscriptions"]
    names.register("/p")
    names.set_property("/p", "key", "two words", 5)
    assert names.get_property("/p", "key") == [5, "two words"]


@pytest.mark.parametrize("profile", list(Profile))
def test_bottles_over_tcp(server: NameServer, profile: Profile) -> None:
    """Bottle RPC by tcp to /root: text lines, or a Bottle; then the acknowledgement."""
    command = encode(["query", "/root"], profile)
    index = b"YA\n\0\0\0RP\x02\x01" + b"\xff" * 8 + b"\x08\0\0\0" + len(command).to_bytes(4, "little") + bytes(4)
    header = b"YA\xe4\x1e\0\0RP\x05\0\0\0anon\0"
    ack = b"YA\0\0\0\0RP"
    port = server.address.port
    heard = exchange(port, header + index + b"\0\0\0\0~d\0\x01" + command, ack)
    lines = b"registration name /root ip 127.0.0.1 port %d type tcp\r\n*** end of message\r\n" % port
    assert heard == b"YA" + port.to_bytes(4, "little") + b"RP" + lines + ack
    command = encode(["bot", "query", "/root"], profile)
    index = b"YA\n\0\0\0RP\x02\x01" + b"\xff" * 8 + b"\x08\0\0\0" + len(command).to_bytes(4, "little") + bytes(4)
    heard = exchange(port, header + index + b"\0\0\0\0~d\0\x01" + command, ack)
    bottle = from_text(f'port (name "/root") (ip "127.0.0.1") (port_number {port}) (carrier tcp)')
    assert decode(heard[8:-8]) == bottle


def test_a_browser(server: NameServer, names: NameClient) -> None:
    """The list of all ports as a page with links to each, and as JSON in yarpserver's form."""
    names.register("/robot/camera")
    url = f"http://127.0.0.1:{server.address.port}"
    with urllib.request.urlopen(f"{url}/data=list", timeout=10) as page:
        text = page.read().decode()
    assert f'<a href="http://127.0.0.1:{server.address.port + 2}' in text
    assert "/robot/camera" in text
    with urllib.request.urlopen(f"{url}/?req=list&format=json", timeout=10) as page:
        listed = json.loads(page.read())
    port = server.address.port
    fields = {"type": "port", "ip": "127.0.0.1", "carrier": "tcp"}
    assert listed == [
        "ports",
        {**fields, "name": "/robot/camera", "port_number": port + 2},
        {**fields, "name": "/root", "port_number": port},
    ]
    with urllib.request.urlopen(f"{url}/web/main.css", timeout=10) as page:
        assert page.headers["Content-Type"] == "text/css"
        assert page.read().startswith(b"body {")


def test_another_network() -> None:
    """Its name server's port has its name; a client is told of it, or finds it in the environment."""
    with NameServer(port=free_port(room=20), namespace="/lab", gc_seconds=0) as server:
        names = NameClient(server.address, namespace="/lab")
        assert names.contact == server.contact == names.query("/lab")
        assert [c.name for c in names.list()] == ["/lab"]
        assert connections.exists(names, "/lab")
        assert names.query("/root") is None


def test_a_taken_address(server: NameServer) -> None:
    """Two name servers at one address: the second says so, and the first goes on."""
    second = NameServer(port=server.address.port)
    with pytest.raises(NamingError, match="Is another one running there"):
        second.open()
    assert NameClient(server.address).query("/root") == server.contact


def test_long_lines_and_garbage(server: NameServer, names: NameClient) -> None:
    """Lines without end and what nobody understands end their connection, not the server."""
    for data in (b"NAME_SERVER query " + b"x" * 200_000, b"NAME_SERVER " + b"(" * 60_000 + b"\n", b"GARBAGE!" * 9):
        peer = socket.create_connection(("127.0.0.1", server.address.port), 10.0)
        with peer, contextlib.suppress(OSError):  # it may close at any time
            peer.sendall(data)
            peer.shutdown(socket.SHUT_WR)
            while peer.recv(65536):
                pass
    assert names.query("/root") == server.contact


class Open:
    """Ports with what came in at them, closed after the test."""

    def __init__(self, names: NameClient) -> None:
        self._names = names
        self._ports: list[PortCore] = []
        self.came: list[list[object]] = []

    def __call__(self, name: str) -> PortCore:
        def take(message: PortMessage) -> None:
            self.came.append(decode(message.payload))

        port = PortCore(name, on_message=take, naming=self._names)
        port.open()
        self._ports.append(port)
        return port

    def close(self) -> None:
        """Close all that are open."""
        for port in self._ports:
            port.close()


@pytest.fixture(name="open_port")
def fixture_open_port(names: NameClient) -> Iterator[Open]:
    """Opens ports."""
    ports = Open(names)
    yield ports
    ports.close()


def test_events(names: NameClient, open_port: Open) -> None:
    """Whoever is connected to the name server's port is told which ports come and go."""
    open_port("/watch")
    connections.connect(names, "/root", "/watch")
    names.register("/p")
    names.unregister("/p")
    until(lambda: open_port.came[-2:] == [["add", "/p"], ["del", "/p"]], "the events came")


def test_who_listens_slowly_hears_every_event(names: NameClient) -> None:
    """None takes the place of another."""
    came, go_on = list[list[object]](), threading.Event()

    def take(message: PortMessage) -> None:
        assert go_on.wait(20)
        came.append(decode(message.payload))

    watch = PortCore("/watch", on_message=take, naming=names)
    watch.open()
    connections.connect(names, "/root", "/watch")
    for number in range(20):
        names.register(f"/p{number}")
    go_on.set()
    until(lambda: came[-20:] == [["add", f"/p{number}"] for number in range(20)], "the events came")
    watch.close()


def test_events_come_in_the_order_of_what_happened(
    server: NameServer, names: NameClient, open_port: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    open_port("/watch")
    connections.connect(names, "/root", "/watch")
    write, second = server.port.write, threading.Thread(target=server.apply, args=(["register", "/second"], "1.2.3.4"))

    def slowly(event: bytes, **options: Any) -> int:
        if decode(event) == ["add", "/first"]:
            second.start()
            second.join(0.3)  # it waits
        return write(event, **options)

    monkeypatch.setattr(server.port, "write", slowly)
    names.register("/first")
    second.join(20)
    events = [["add", "/first"], ["add", "/second"]]
    until(lambda: all(event in open_port.came for event in events), "the events came")
    assert [event for event in open_port.came if event in events] == events


def test_persistent_connections(names: NameClient, open_port: Open) -> None:
    """Made when the second port comes, and again whenever one returns; by the carrier that was asked for."""
    assert names.command(["subscribe", "/w", "fast_tcp://r"]) == ["ok"]
    ports = {"/w": open_port("/w"), "/r": open_port("/r")}
    for returning in ("/r", "/w", "/r"):
        until(lambda: ports["/r"].inputs(), "connected at the reader")
        until(lambda: [r.carrier for r in ports["/w"].outputs()] == ["fast_tcp"], "connected")
        seen = len(open_port.came)
        ports["/w"].write(encode(["hello"], Profile.YARP3))
        until(lambda seen=seen: len(open_port.came) > seen, "the message came")
        ports[returning].close()
        ports[returning] = open_port(returning)
    until(lambda: ports["/r"].inputs(), "connected again")
    assert names.command(["unsubscribe", "/w", "/r"]) == ["ok"]
    assert names.command(["subscribe"]) == ["subscriptions"]


def test_topics(names: NameClient, open_port: Open) -> None:
    """Through a YARP topic too."""
    writer, _ = open_port("/w"), open_port("/r")
    names.command(["subscribe", "/w", "topic://t"])
    names.command(["subscribe", "topic://t", "/r"])
    until(lambda: [r.target for r in writer.outputs()] == ["/r"], "connected")


def test_dead_ports_are_forgotten(server: NameServer, names: NameClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """A port at whose address nobody listens: found twice, or once on demand; those that live, and mcast, stay."""
    monkeypatch.setattr(server_module, "YOUNG", -1.0)
    monkeypatch.setattr(server_module, "PROBE_SECONDS", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        names.register("/live", "127.0.0.1", listening.getsockname()[1])
        names.register("/dead", "127.0.0.1", free_port())
        names.register("/group", carrier="mcast")
        names.register("/far", "192.0.2.7", 10002)
        assert server.collect() == []
        assert server.collect() == ["/dead"]
        names.register("/dead", "127.0.0.1", free_port())
        assert names.lines(["gc"]) == ["garbage collection done."]
        assert {c.name for c in names.list()} == {"/live", "/group", "/far", "/root"}


def test_young_ports_are_not_looked_for(server: NameServer, names: NameClient) -> None:
    """A port is registered before it listens."""
    names.register("/young", "127.0.0.1", free_port())
    assert server.collect(patience=1) == []
    assert names.query("/young") is not None


def test_it_looks_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Now and then."""
    monkeypatch.setattr(server_module, "YOUNG", -1.0)
    with NameServer(port=free_port(room=20), gc_seconds=0.05) as server:
        names = NameClient(server.address)
        names.register("/dead", "127.0.0.1", free_port())
        until(lambda: names.query("/dead") is None, "it was forgotten")


def test_memory(tmp_path: Path) -> None:
    """Ports, properties, numbers and persistent connections outlive the server."""
    port, state = free_port(room=20), tmp_path / "deep" / "names.json"
    with NameServer(port=port, state=state) as server:
        names = NameClient(server.address)
        first = names.register("/p")
        names.set_property("/p", "key", "value")
        names.set_property("/root", "network", "lab")
        names.command(["subscribe", "/p", "/q"])
    with NameServer(port=port, state=state) as server:
        assert names.query("/p") == first
        assert names.get_property("/p", "key") == ["value"]
        assert names.get_property("/root", "network") == ["lab"]
        assert names.command(["subscribe"])[1:] == [["subscription", ["src", "/p"], ["dest", "/q"]]]
        assert names.register("/q").port == port + 3
        names.unregister("/p")
        assert names.register("/p") == first
    assert sorted(p.name for p in state.parent.iterdir()) == ["names.json"]


@pytest.mark.parametrize("spoilt", [b"", b"{", b'{"version": 1}', b"\xff\xfe"])
def test_spoilt_memory(tmp_path: Path, spoilt: bytes, caplog: pytest.LogCaptureFixture) -> None:
    """A file that is no state is kept aside, and the server begins empty."""
    state = tmp_path / "names.json"
    state.write_bytes(spoilt)
    with NameServer(port=free_port(room=20), state=state) as server:
        assert NameClient(server.address).list() == [server.contact]
    assert (tmp_path / "names.json.spoilt").read_bytes() == spoilt
    assert "begins empty" in caplog.text


def test_memory_that_cannot_be_written(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The server serves without it, and says so."""
    (tmp_path / "plain").write_text("")
    with NameServer(port=free_port(room=20), state=tmp_path / "plain" / "names.json") as server:
        assert NameClient(server.address).register("/p") == PortContact("/p", "127.0.0.1", server.address.port + 2)
    assert "cannot be written" in caplog.text
