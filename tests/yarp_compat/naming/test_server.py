"""The name server from outside: its bytes, carriers, web page, persistent connections and state."""

from __future__ import annotations

import contextlib
import json
import socket
import struct
import threading
import urllib.request
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
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
from yarp_compat.naming.subscriptions import WantedConnection
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
    """Serve a name server without state."""
    with NameServer(port=free_port(room=20), gc_seconds=0) as server:
        yield server


@pytest.fixture(name="names")
def fixture_names(server: NameServer) -> NameClient:
    """Return a client of the name server."""
    return NameClient(server.address, timeout=40.0)


def exchange(port: int, data: bytes, end: bytes) -> bytes:
    """Send data on a new connection, and return the reply up to its end."""
    with socket.create_connection(("127.0.0.1", port), 10.0) as sock:
        sock.sendall(data)
        received = b""
        while not received.endswith(end):
            more = sock.recv(65536)
            assert more, received
            received += more
        return received


def test_every_recorded_exchange_is_reproduced(server: NameServer) -> None:
    """Requests of two real ports and ``yarp connect`` get the bytes of a real name server."""
    port = server.address.port
    for talk in (t for t in read("connect.txt") if t.port == 10000):
        wanted = talk.sent_by("S").replace(b"port 10002", b"port %d" % (port + 2))
        wanted = wanted.replace(b"port 10003", b"port %d" % (port + 3))
        assert exchange(port, talk.sent_by("C"), wanted[-6:]) == wanted


def test_one_connection_may_send_many_commands(server: NameServer) -> None:
    """Old name clients and telnet do this; both kinds of line ends are accepted."""
    with LineSocket("127.0.0.1", server.address.port, 10.0).open() as peer:
        peer.send(b"NAME_SERVER query /none\nNAME_SERVER register /p\r\n\r\nNAME_SERVER query /p\n")
        lines = [peer.line() for _ in range(5)]
    line = f"registration name /p ip 127.0.0.1 port {server.address.port + 2} type tcp"
    assert lines == ["*** end of message", line, "*** end of message", line, "*** end of message"]


def test_commands_are_answered_while_dead_ports_are_probed(
    server: NameServer, names: NameClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, release = threading.Event(), threading.Event()

    def collect(**_: int) -> list[str]:
        begun.set()
        assert release.wait(20)
        return []

    monkeypatch.setattr(server, "collect", collect)
    with ThreadPoolExecutor(1) as pool:
        collection = pool.submit(names.lines, ["gc"])
        try:
            assert begun.wait(20)
            assert names.register("/new", "127.0.0.1").name == "/new"
        finally:
            release.set()
        assert collection.result(20) is not None


def test_a_client_that_reads_no_answers_delays_nobody(server: NameServer, names: NameClient) -> None:
    for number in range(500):
        server.apply(["register", f"/port{number}", "tcp", "127.0.0.1", 20000 + number], "127.0.0.1")
    lists, size = 400, len("".join(f"{line}\r\n" for line in names.lines(["list"])))
    with socket.create_connection(("127.0.0.1", server.address.port), 10.0) as sock:
        sock.sendall(b"NAME_SERVER list\n" * lists)
        until(lambda: any(t.name.endswith(" > /root") for t in threading.enumerate()), "a thread continues", 20)
        assert names.query("/port7") is not None
        received = 0
        while received < lists * size:
            received += len(sock.recv(1 << 20))
        assert names.query("/port7") is not None


def test_a_client_that_is_killed_leaves_no_connection(server: NameServer, caplog: pytest.LogCaptureFixture) -> None:
    """The system resets the connection of a killed client that has not read an answer."""
    with socket.create_connection(("127.0.0.1", server.address.port), 10.0) as client:
        client.sendall(b"NAME_SERVER query /port\n")
        assert client.recv(65536)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connections = server.port.connections
    until(lambda: not connections.inputs and not connections.leaving, "the connection has ended")
    logged = [record for record in caplog.records if record.name.startswith("yarp")]
    assert not [record for record in logged if record.levelname == "ERROR"]


def test_a_line_that_arrives_in_parts_is_answered(server: NameServer) -> None:
    with socket.create_connection(("127.0.0.1", server.address.port), 10.0) as sock:
        sock.sendall(b"NAME_SERVER query /root\n")
        first = sock.recv(4096)
        sock.sendall(b"NAME_SERVER que")
        until(lambda: any(t.name.endswith(" > /root") for t in threading.enumerate()), "a thread reads the rest", 20)
        sock.sendall(b"ry /root\nNAME_SERVER query /root\n")
        received = b""
        while len(received) < 2 * len(first):
            received += sock.recv(4096)
        assert received == 2 * first


def test_text_ack_returns_lines_or_a_bottle(names: NameClient) -> None:
    """Tools such as ``yarp clean`` use this carrier."""
    assert text_client.ask(names.contact, ["query", "/none"]) == ["*** end of message"]
    assert text_client.ask(names.contact, ["gc"]) == ["garbage collection done.", "*** end of message"]
    assert text_client.ask(names.contact, ["subscribe"]) == ["subscriptions"]
    names.register("/p")
    names.set_property("/p", "key", "two words", 5)
    assert names.get_property("/p", "key") == [5, "two words"]


@pytest.mark.parametrize("profile", list(Profile))
def test_tcp_returns_lines_or_a_bottle(server: NameServer, profile: Profile) -> None:
    """The acknowledgment follows the reply."""
    command = encode(["query", "/root"], profile)
    index = b"YA\n\0\0\0RP\x02\x01" + b"\xff" * 8 + b"\x08\0\0\0" + len(command).to_bytes(4, "little") + bytes(4)
    header = b"YA\xe4\x1e\0\0RP\x05\0\0\0anon\0"
    ack = b"YA\0\0\0\0RP"
    port = server.address.port
    reply = exchange(port, header + index + b"\0\0\0\0~d\0\x01" + command, ack)
    lines = b"registration name /root ip 127.0.0.1 port %d type tcp\r\n*** end of message\r\n" % port
    assert reply == b"YA" + port.to_bytes(4, "little") + b"RP" + lines + ack
    command = encode(["bot", "query", "/root"], profile)
    index = b"YA\n\0\0\0RP\x02\x01" + b"\xff" * 8 + b"\x08\0\0\0" + len(command).to_bytes(4, "little") + bytes(4)
    reply = exchange(port, header + index + b"\0\0\0\0~d\0\x01" + command, ack)
    bottle = from_text(f'port (name "/root") (ip "127.0.0.1") (port_number {port}) (carrier tcp)')
    assert decode(reply[8:-8]) == bottle


def test_a_browser_receives_a_page_or_json(server: NameServer, names: NameClient) -> None:
    """The page lists all ports with links; the JSON has yarpserver's format."""
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


def test_a_name_server_serves_another_network() -> None:
    """The name server's port has the network's name (its namespace), which clients get as an argument."""
    with NameServer(port=free_port(room=20), namespace="/lab", gc_seconds=0) as server:
        names = NameClient(server.address, namespace="/lab")
        assert names.contact == server.contact == names.query("/lab")
        assert [c.name for c in names.list()] == ["/lab"]
        assert connections.exists(names, "/lab")
        assert names.query("/root") is None


def test_a_second_name_server_at_an_address_is_refused(server: NameServer) -> None:
    """The first one continues."""
    second = NameServer(port=server.address.port)
    with pytest.raises(NamingError, match="Another one may be running there"):
        second.open()
    assert NameClient(server.address).query("/root") == server.contact


def test_invalid_input_only_ends_its_connection(server: NameServer, names: NameClient) -> None:
    """Endless lines and garbage do not affect the server."""
    for data in (b"NAME_SERVER query " + b"x" * 200_000, b"NAME_SERVER " + b"(" * 60_000 + b"\n", b"GARBAGE!" * 9):
        peer = socket.create_connection(("127.0.0.1", server.address.port), 10.0)
        with peer, contextlib.suppress(OSError):  # the server may close the connection at any time
            peer.sendall(data)
            peer.shutdown(socket.SHUT_WR)
            while peer.recv(65536):
                pass
    assert names.query("/root") == server.contact


class OpenPorts:
    """Ports with their received messages, closed after the test."""

    def __init__(self, names: NameClient) -> None:
        self._names = names
        self._ports: list[PortCore] = []
        self.received: list[list[object]] = []

    def __call__(self, name: str) -> PortCore:
        def on_message(message: PortMessage) -> None:
            self.received.append(decode(message.payload))

        port = PortCore(name, on_message=on_message, naming=self._names)
        port.open()
        self._ports.append(port)
        return port

    def close(self) -> None:
        """Close all ports."""
        for port in self._ports:
            port.close()


@pytest.fixture(name="open_port")
def fixture_open_port(names: NameClient) -> Iterator[OpenPorts]:
    """Yield a function that opens ports."""
    ports = OpenPorts(names)
    yield ports
    ports.close()


def test_registrations_are_published(names: NameClient, open_port: OpenPorts) -> None:
    """Subscribers of the name server's port receive an event for each added and removed port."""
    open_port("/watch")
    connections.connect(names, "/root", "/watch")
    names.register("/p")
    names.unregister("/p")
    until(lambda: open_port.received[-2:] == [["add", "/p"], ["del", "/p"]], "the events have arrived")


def test_a_slow_subscriber_receives_every_event(names: NameClient) -> None:
    """Events for a slow subscriber are queued; none replaces another."""
    received, go_on = list[list[object]](), threading.Event()

    def on_message(message: PortMessage) -> None:
        assert go_on.wait(20)
        received.append(decode(message.payload))

    watch = PortCore("/watch", on_message=on_message, naming=names)
    watch.open()
    connections.connect(names, "/root", "/watch")
    for number in range(20):
        names.register(f"/p{number}")
    go_on.set()
    until(lambda: received[-20:] == [["add", f"/p{number}"] for number in range(20)], "the events have arrived")
    watch.close()


def test_events_arrive_in_the_order_of_registrations(
    server: NameServer, names: NameClient, open_port: OpenPorts, monkeypatch: pytest.MonkeyPatch
) -> None:
    open_port("/watch")
    connections.connect(names, "/root", "/watch")
    write, second = server.port.write, threading.Thread(target=server.apply, args=(["register", "/second"], "1.2.3.4"))

    def slowly(event: bytes, **options: Any) -> int:
        if decode(event) == ["add", "/first"]:
            second.start()
            second.join(0.3)  # the second registration waits meanwhile
        return write(event, **options)

    monkeypatch.setattr(server.port, "write", slowly)
    names.register("/first")
    second.join(20)
    events = [["add", "/first"], ["add", "/second"]]
    until(lambda: all(event in open_port.received for event in events), "the events have arrived")
    assert [event for event in open_port.received if event in events] == events


def test_persistent_connections_are_made_and_restored(names: NameClient, open_port: OpenPorts) -> None:
    """Connections are made when the second port opens, and again when a port reopens, with the requested carrier."""
    assert names.command(["subscribe", "/w", "fast_tcp://r"]) == ["ok"]
    ports = {"/w": open_port("/w"), "/r": open_port("/r")}
    for returning in ("/r", "/w", "/r"):
        until(lambda: ports["/r"].inputs(), "the reader is connected")
        until(lambda: [r.carrier for r in ports["/w"].outputs()] == ["fast_tcp"], "connected")
        seen = len(open_port.received)
        ports["/w"].write(encode(["hello"], Profile.YARP3))
        until(lambda seen=seen: len(open_port.received) > seen, "the message has arrived")
        ports[returning].close()
        ports[returning] = open_port(returning)
    until(lambda: ports["/r"].inputs(), "the reader is connected again")
    assert names.command(["unsubscribe", "/w", "/r"]) == ["ok"]
    assert names.command(["subscribe"]) == ["subscriptions"]


@pytest.mark.parametrize("host", ["a" * 70, "a..b"])
def test_invalid_hosts_do_not_stop_persistent_connections(names: NameClient, open_port: OpenPorts, host: str) -> None:
    """Host names with an overlong or empty part raise `UnicodeError` while they are resolved."""
    for number in range(connections.WORKERS):
        names.register(f"/x{number}", host, 10999)
        names.command(["subscribe", f"/x{number}", "/y"])
        names.lines(["announce", f"/x{number}"])  # announced only, so that no keeper registers the port again
    names.register("/y", host, 10998)
    names.lines(["announce", "/y"])
    names.command(["subscribe", "/w", "/r"])
    open_port("/r")
    writer = open_port("/w")
    until(lambda: [route.target for route in writer.outputs()] == ["/r"], "the ports are connected")


def test_ports_are_connected_through_a_topic(names: NameClient, open_port: OpenPorts) -> None:
    """The topic is a topic of YARP's name server."""
    writer, _ = open_port("/w"), open_port("/r")
    names.command(["subscribe", "/w", "topic://t"])
    names.command(["subscribe", "topic://t", "/r"])
    until(lambda: [r.target for r in writer.outputs()] == ["/r"], "connected")


def test_dead_ports_are_removed(server: NameServer, names: NameClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """A port that refuses connections is removed after two periodic probes, or after one on demand.

    Ports that accept connections, do not reply or use mcast stay.
    """
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


def test_ports_with_invalid_addresses_are_probed_like_others() -> None:
    with socket.socket() as bound:  # refuses connections because it does not listen
        bound.bind(("127.0.0.1", 0))
        dead = PortContact("/dead", "127.0.0.1", bound.getsockname()[1])
        odd = PortContact("/odd", "127.0.0.1%\udc80", 10000)
        assert server_module.refused([odd, dead], 10.0) == {"/dead"}


def test_new_ports_are_not_probed(server: NameServer, names: NameClient) -> None:
    """A port is registered before it listens."""
    names.register("/young", "127.0.0.1", free_port())
    assert server.collect(patience=1) == []
    assert names.query("/young") is not None


def test_a_port_that_registers_after_the_first_probe_is_probed_twice(
    server: NameServer, names: NameClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The program of a dead port was started again, and does not listen yet."""
    monkeypatch.setattr(server_module, "YOUNG", -1.0)
    number = free_port()
    for _ in range(2):
        names.register("/robot", "127.0.0.1", number)
        assert server.collect() == []
    assert server.collect() == ["/robot"]


def test_a_port_that_registers_while_it_is_probed_stays(
    server: NameServer, names: NameClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The program of a dead port was started again, with the same number."""
    monkeypatch.setattr(server_module, "YOUNG", -1.0)
    probe, number = server_module.refused, free_port()

    def register_late(contacts: Iterable[PortContact], seconds: float) -> set[str]:
        dead = probe(contacts, seconds)
        assert dead == {"/robot"}
        names.register("/robot", "127.0.0.1", number)
        return dead

    monkeypatch.setattr(server_module, "refused", register_late)
    names.register("/robot", "127.0.0.1", number)
    assert server.collect(patience=1) == []
    assert names.query("/robot") is not None


def test_dead_ports_are_probed_periodically(monkeypatch: pytest.MonkeyPatch) -> None:
    """The period is ``gc_seconds``."""
    monkeypatch.setattr(server_module, "YOUNG", -1.0)
    with NameServer(port=free_port(room=20), gc_seconds=0.05) as server:
        names = NameClient(server.address)
        names.register("/dead", "127.0.0.1", free_port())
        until(lambda: names.query("/dead") is None, "the port is removed")


def test_commands_that_arrive_while_the_server_opens_wait_for_its_list_of_connections(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A subscription that changed the list meanwhile would make `open` fail, with its port open."""
    server, locked = NameServer(port=free_port(room=20), gc_seconds=0), list[bool]()
    wanted = server.registry.wanted

    def recording() -> list[WantedConnection]:
        locked.append(server._lock.locked())
        return wanted()

    monkeypatch.setattr(server.registry, "wanted", recording)
    with server:
        assert locked == [True]


def test_the_state_survives_a_restart(tmp_path: Path) -> None:
    """The state contains ports, properties, numbers and persistent connections."""
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


@pytest.mark.parametrize("content", [b"", b"{", b'{"version": 1}', b"\xff\xfe"])
def test_an_invalid_state_file_is_renamed(tmp_path: Path, content: bytes, caplog: pytest.LogCaptureFixture) -> None:
    """The server starts with an empty state."""
    state = tmp_path / "names.json"
    state.write_bytes(content)
    with NameServer(port=free_port(room=20), state=state) as server:
        assert NameClient(server.address).list() == [server.contact]
    assert (tmp_path / "names.json.spoilt").read_bytes() == content
    assert "starts empty" in caplog.text


def test_an_unwritable_state_file_is_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The server works without the file."""
    (tmp_path / "plain").write_text("")
    with NameServer(port=free_port(room=20), state=tmp_path / "plain" / "names.json") as server:
        assert NameClient(server.address).register("/p") == PortContact("/p", "127.0.0.1", server.address.port + 2)
    assert "cannot write" in caplog.text
