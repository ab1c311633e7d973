"""A name server stops and restarts while ports are connected."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Self

import pytest

from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until
from yarp_compat.naming import client as client_module
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer
from yarp_compat.ports.connections import ConnectionEvent
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import NoNameServerError
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.profile import Profile


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_module, "PERIOD", 0.05)


class Pair:
    """Two connected ports, with a continuous stream of numbers."""

    def __init__(self, address: Address) -> None:
        self.names = NameClient(address, timeout=20.0)
        self.received: list[int] = []
        self.losses: list[object] = []
        self.reader = PortCore("/reader", on_message=self._on_message, naming=self.names)
        self.writer = PortCore("/writer", naming=self.names, on_event=self._on_event)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._write)

    def __enter__(self) -> Self:
        self.reader.open()
        self.writer.open()
        connections.connect(self.names, "/writer", "/reader")
        self._thread.start()
        until(lambda: self.received, "messages arrive")
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self.writer.close()
        self.reader.close()

    def _on_event(self, event: ConnectionEvent) -> None:
        if not event.up and not event.incoming:
            self.losses.append(event)

    def _on_message(self, message: PortMessage) -> None:
        self.received += decode(message.payload)

    def _write(self) -> None:
        number = 0
        while not self._stop.wait(0.002):
            self.writer.write(encode([number], Profile.YARP3), wait=True, timeout=10.0)
            number += 1

    def check(self) -> None:
        """Check that no message was lost, and that messages still arrive."""
        seen = len(self.received)
        until(lambda: len(self.received) > seen + 3, "messages still arrive")
        received = list(self.received)
        assert received == list(range(len(received)))
        assert not self.losses


def announced(server: NameServer) -> set[str]:
    """Return the ports that have announced themselves; their first announcement restores persistent connections."""
    return {entry.contact.name for entry in server.registry.entries() if entry.announced}


def are_registered(names: NameClient, *ports: PortCore) -> Callable[[], bool]:
    """Return a condition: the ports are registered with their current addresses."""

    def known() -> bool:
        try:
            return all(names.query(p.name) == p.contact for p in ports)
        except NoNameServerError:
            return False

    return known


def test_ports_register_again_at_a_name_server_without_state() -> None:
    """Ports keep their numbers and properties and announce themselves; data connections are not affected."""
    port = free_port(room=20)
    first = NameServer(port=port, gc_seconds=0).open()
    with Pair(first.address) as pair:
        pair.names.set_property("/reader", "type", "std_msgs/String", "two words")
        first.close()
        pair.check()
        with NameServer(port=port, gc_seconds=0) as second:
            names = NameClient(second.address)
            until(are_registered(names, pair.reader, pair.writer), "both ports are registered again")
            until(
                lambda: set(names.get_property("/reader", "type")) == {"std_msgs/String", "two words"},
                "the property is set again",
            )
            until(
                lambda: "fast_tcp" in names.get_property("/writer", "offers"), "the port's own properties are set again"
            )
            until(lambda: {"/reader", "/writer"} <= announced(second), "both ports are announced")
            names.command(["subscribe", "/writer", "/reader"])
            pair.check()
            assert names.register("/other").port not in (pair.reader.contact.port, pair.writer.contact.port)
            pair.writer.close()
            assert names.query("/writer") is None


@pytest.mark.parametrize("has_state", [True, False])
def test_a_killed_name_server_loses_nothing(tmp_path: Path, has_state: bool) -> None:
    """``midspan yarp server`` is killed with -9 and restarted: no message is lost, and the ports are registered."""
    address = Address("127.0.0.1", free_port(room=20))
    args = [sys.executable, "-m", "bridge.cli.main", "yarp", "server", "--port", str(address.port), "--gc", "0"]
    args += ["--state", str(tmp_path / "names.json")] if has_state else ["--forget"]
    env = {**os.environ, "YARP_CONFIG_HOME": str(tmp_path), "YARP_NAMESPACE": "/root"}
    names = NameClient(address)
    with ExitStack() as stack:

        def start() -> Process:
            server = Process(args, env)
            stack.callback(server.stop)
            until(lambda: _answers(names), "the name server replies", seconds=30.0)
            return server

        server = start()
        pair = stack.enter_context(Pair(address))
        names.command(["subscribe", "/writer", "/reader"])
        if has_state:
            until(lambda: _written(tmp_path / "names.json"), "the state is saved")
        server.signal(signal.SIGKILL)
        server.popen.wait()
        pair.check()
        start()
        until(are_registered(names, pair.reader, pair.writer), "both ports are registered again")
        subscriptions = names.command(["subscribe"])[1:]
        assert subscriptions == ([["subscription", ["src", "/writer"], ["dest", "/reader"]]] if has_state else [])
        pair.check()


def _written(file: Path) -> bool:
    return file.exists() and bool(json.loads(file.read_text(encoding="utf-8"))["subscriptions"]["subscriptions"])


def _answers(names: NameClient) -> bool:
    try:
        return names.query("/none") is None
    except NoNameServerError:
        return False


@pytest.fixture(name="server")
def fixture_server() -> Iterator[NameServer]:
    """Serve a name server without state."""
    with NameServer(port=free_port(room=20), gc_seconds=0) as server:
        yield server


def test_a_closed_port_is_not_registered_again(server: NameServer) -> None:
    """The keeper's thread ends when the last port closes."""
    names = NameClient(server.address)
    port = PortCore("/p", naming=names)
    port.open()
    assert any(t.name == "yarp names" for t in threading.enumerate())
    port.close()
    until(lambda: not any(t.name == "yarp names" for t in threading.enumerate()), "the keeper's thread has ended")
    assert server.registry.find("/p") is None


def test_a_port_that_closes_while_it_is_announced_is_not_kept(
    server: NameServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep, names = client_module.Keeper.keep, NameClient(server.address)

    def keep_late(keeper: client_module.Keeper, client: NameClient, contact: PortContact) -> None:
        client.unregister(contact.name)
        keep(keeper, client, contact)

    monkeypatch.setattr(client_module.Keeper, "keep", keep_late)
    names.register("/p")
    names.announce("/p")
    until(lambda: not any(t.name == "yarp names" for t in threading.enumerate()), "the keeper's thread has ended")
    assert names.query("/p") is None


def test_a_port_that_does_not_listen_yet_is_registered_again_without_an_announcement(server: NameServer) -> None:
    """A keeper that saw an earlier port of this name may restore the registration before the new port listens."""
    names, others = NameClient(server.address), NameClient(server.address)
    contact = names.register("/p")
    others.unregister("/p")
    names.restore("/p")
    assert others.query("/p") == contact
    assert "/p" not in announced(server)
    names.announce("/p")
    others.unregister("/p")
    names.restore("/p")
    assert "/p" in announced(server)
    names.unregister("/p")


class RecordingClient(NameClient):
    """A client that records its queries, and answers them from ``known``."""

    def __init__(self, known: dict[str, PortContact]) -> None:
        super().__init__(Address("127.0.0.1", 10000))
        self.known = known
        self.queries: list[str] = []
        self.restored: list[str] = []

    def query(self, name: str) -> PortContact | None:
        """Record the query."""
        self.queries.append(name)
        return self.known.get(name)

    def restore(self, name: str) -> None:
        """Record the call."""
        self.restored.append(name)


CONTACTS = [PortContact(f"/p{i}", "127.0.0.1", 10002 + i) for i in range(30)]


def test_a_missing_port_causes_a_check_of_all() -> None:
    """All ports of all clients are checked instead of only the next few."""
    clients = RecordingClient({}), RecordingClient({})
    client_module.Keeper().check([(clients[i % 2], contact) for i, contact in enumerate(CONTACTS)])
    for i, client in enumerate(clients):
        assert sorted(client.restored) == sorted(contact.name for contact in CONTACTS[i::2])


def test_each_check_queries_a_few_ports_of_all_clients() -> None:
    """Whatever the number of clients, a check queries AT_ONCE ports, and a sequence of checks queries all ports."""
    known = {contact.name: contact for contact in CONTACTS}
    clients = [RecordingClient(known) for _ in CONTACTS]
    keeper, kept = client_module.Keeper(), list(zip(clients, CONTACTS, strict=True))
    for turn in range(1, 7):
        keeper.check(kept)
        assert sum(len(client.queries) for client in clients) == turn * client_module.AT_ONCE
    assert all(client.queries == [contact.name] for client, contact in kept)
    assert not any(client.restored for client in clients)


def test_lost_ports_register_again_and_closed_ones_do_not(server: NameServer) -> None:
    """The program has several ports."""
    names = NameClient(server.address)
    ports = [PortCore(f"/p{i}", naming=names) for i in range(12)]
    for port in ports:
        port.open()
    others = NameClient(server.address)
    for port in ports[::2]:
        others.unregister(port.name)
    until(are_registered(others, *ports), "all ports are registered")
    for port in ports[::2]:
        others.unregister(port.name)
    for port in ports:
        port.close()
    until(lambda: not any(t.name == "yarp names" for t in threading.enumerate()), "the keeper's last check has ended")
    assert others.list() == [server.contact]


def test_a_name_taken_over_by_another_port_is_logged_once(server: NameServer, caplog: pytest.LogCaptureFixture) -> None:
    """The other port keeps the name."""
    names = NameClient(server.address)
    port = PortCore("/p", naming=names)
    port.open()
    taken = NameClient(server.address).register("/p", "127.0.0.1", 12345)
    until(
        lambda: "the name /p was taken over by a port at tcp://127.0.0.1:12345/" in caplog.text,
        "the takeover is logged",
    )
    assert names.query("/p") == taken
    port.close()


def test_a_name_taken_over_by_another_port_stays_registered(server: NameServer) -> None:
    names, others = NameClient(server.address), NameClient(server.address)
    port = PortCore("/p", naming=names)
    port.open()
    assert not names.is_taken("/p")
    assert not others.is_taken("/p"), "the port never registered the name"
    taken = others.register("/p", "127.0.0.1", 12345)
    assert names.is_taken("/p")
    names.leave("/p")
    port.close()
    assert others.query("/p") == taken
    assert not names.is_taken("/p"), "the name is no longer claimed"
