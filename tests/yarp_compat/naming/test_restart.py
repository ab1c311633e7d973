"""A name server that goes away and comes back under live connections."""

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
    """Two connected ports, numbers from one to the other all the time."""

    def __init__(self, address: Address) -> None:
        self.names = NameClient(address, timeout=2.0)
        self.came: list[int] = []
        self.losses: list[object] = []
        self.reader = PortCore("/reader", on_message=self._take, naming=self.names)
        self.writer = PortCore("/writer", naming=self.names, on_event=self._note)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._write)

    def __enter__(self) -> Self:
        self.reader.open()
        self.writer.open()
        connections.connect(self.names, "/writer", "/reader")
        self._thread.start()
        until(lambda: self.came, "messages come")
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self.writer.close()
        self.reader.close()

    def _note(self, event: ConnectionEvent) -> None:
        if not event.up and not event.incoming:
            self.losses.append(event)

    def _take(self, message: PortMessage) -> None:
        self.came += decode(message.payload)

    def _write(self) -> None:
        number = 0
        while not self._stop.wait(0.002):
            self.writer.write(encode([number], Profile.YARP3), wait=True, timeout=10.0)
            number += 1

    def check(self) -> None:
        """Not one message was lost, and messages still come."""
        seen = len(self.came)
        until(lambda: len(self.came) > seen + 3, "messages still come")
        came = list(self.came)
        assert came == list(range(len(came)))
        assert not self.losses


def announced(server: NameServer) -> set[str]:
    """The ports that said to a name server that they listen: a first word of that has them connected anew."""
    return {entry.contact.name for entry in server.registry.entries() if entry.announced}


def where(names: NameClient, *ports: PortCore) -> Callable[[], bool]:
    """Whether the name server knows ports where they are."""

    def known() -> bool:
        try:
            return all(names.query(p.name) == p.contact for p in ports)
        except NoNameServerError:
            return False

    return known


def test_without_memory_ports_register_again() -> None:
    """With the same numbers, what was set at them, and an announcement; the data connection notices nothing."""
    port = free_port(room=20)
    first = NameServer(port=port, gc_seconds=0).open()
    with Pair(first.address) as pair:
        pair.names.set_property("/reader", "type", "std_msgs/String", "two words")
        first.close()
        pair.check()
        with NameServer(port=port, gc_seconds=0) as second:
            names = NameClient(second.address)
            until(where(names, pair.reader, pair.writer), "both are registered again")
            until(
                lambda: set(names.get_property("/reader", "type")) == {"std_msgs/String", "two words"},
                "what was set is set again",
            )
            until(lambda: "fast_tcp" in names.get_property("/writer", "offers"), "and what a port says of itself")
            until(lambda: {"/reader", "/writer"} <= announced(second), "and that both listen")
            names.command(["subscribe", "/writer", "/reader"])
            pair.check()
            assert names.register("/other").port not in (pair.reader.contact.port, pair.writer.contact.port)
            pair.writer.close()
            assert names.query("/writer") is None


@pytest.mark.parametrize("remembers", [True, False])
def test_killed(tmp_path: Path, remembers: bool) -> None:
    """``midspan yarp server`` killed with -9, and started again: nothing is lost, and it knows the ports."""
    address = Address("127.0.0.1", free_port(room=20))
    args = [sys.executable, "-m", "bridge.cli.main", "yarp", "server", "--port", str(address.port), "--gc", "0"]
    args += ["--state", str(tmp_path / "names.json")] if remembers else ["--forget"]
    env = {**os.environ, "YARP_CONFIG_HOME": str(tmp_path), "YARP_NAMESPACE": "/root"}
    names = NameClient(address)
    with ExitStack() as stack:

        def start() -> Process:
            server = Process(args, env)
            stack.callback(server.stop)
            until(lambda: _answers(names), "it answers", seconds=30.0)
            return server

        server = start()
        pair = stack.enter_context(Pair(address))
        names.command(["subscribe", "/writer", "/reader"])
        if remembers:
            until(lambda: _written(tmp_path / "names.json"), "it is written down")
        server.signal(signal.SIGKILL)
        server.popen.wait()
        pair.check()
        start()
        until(where(names, pair.reader, pair.writer), "both are known again")
        kept = names.command(["subscribe"])[1:]
        assert kept == ([["subscription", ["src", "/writer"], ["dest", "/reader"]]] if remembers else [])
        pair.check()


def _written(file: Path) -> bool:
    return file.exists() and bool(json.loads(file.read_text())["subscriptions"]["subscriptions"])


def _answers(names: NameClient) -> bool:
    try:
        return names.query("/none") is None
    except NoNameServerError:
        return False


@pytest.fixture(name="server")
def fixture_server() -> Iterator[NameServer]:
    """A name server."""
    with NameServer(port=free_port(room=20), gc_seconds=0) as server:
        yield server


def test_a_closed_port_is_not_registered_again(server: NameServer) -> None:
    """And the thread that looks ends with the last port."""
    names = NameClient(server.address)
    port = PortCore("/p", naming=names)
    port.open()
    assert any(t.name == "yarp names" for t in threading.enumerate())
    port.close()
    assert not any(t.name == "yarp names" for t in threading.enumerate())
    assert server.registry.find("/p") is None


class Asked(NameClient):
    """A client that notes what it is asked, and answers by what is known."""

    def __init__(self, known: dict[str, PortContact]) -> None:
        super().__init__(Address("127.0.0.1", 10000))
        self.known = known
        self.asked: list[str] = []
        self.restored: list[str] = []

    def query(self, name: str) -> PortContact | None:
        """Note it."""
        self.asked.append(name)
        return self.known.get(name)

    def restore(self, name: str) -> None:
        """Note it."""
        self.restored.append(name)


CONTACTS = [PortContact(f"/p{i}", "127.0.0.1", 10002 + i) for i in range(30)]


def test_where_one_is_missing_all_are_asked_for() -> None:
    """Not only those few whose turn it is, and those of other clients too."""
    clients = Asked({}), Asked({})
    client_module.Keeper().ask([(clients[i % 2], contact) for i, contact in enumerate(CONTACTS)])
    for i, client in enumerate(clients):
        assert sorted(client.restored) == sorted(contact.name for contact in CONTACTS[i::2])


def test_the_clients_of_one_name_server_take_turns() -> None:
    """However many they are, it is asked for a few ports at a look, and in time for all."""
    known = {contact.name: contact for contact in CONTACTS}
    clients = [Asked(known) for _ in CONTACTS]
    keeper, kept = client_module.Keeper(), list(zip(clients, CONTACTS, strict=True))
    for turn in range(1, 7):
        keeper.ask(kept)
        assert sum(len(client.asked) for client in clients) == turn * client_module.AT_ONCE
    assert all(client.asked == [contact.name] for client, contact in kept)
    assert not any(client.restored for client in clients)


def test_many_ports(server: NameServer) -> None:
    """Some are lost, and come back; all that are closed stay away."""
    names = NameClient(server.address)
    ports = [PortCore(f"/p{i}", naming=names) for i in range(12)]
    for port in ports:
        port.open()
    others = NameClient(server.address)
    for port in ports[::2]:
        others.unregister(port.name)
    until(where(others, *ports), "all are registered")
    for port in ports[::2]:
        others.unregister(port.name)
    for port in ports:
        port.close()
    assert others.list() == [server.contact]


def test_a_name_that_another_took(server: NameServer, caplog: pytest.LogCaptureFixture) -> None:
    """It is left to him, and said once."""
    names = NameClient(server.address)
    port = PortCore("/p", naming=names)
    port.open()
    taken = NameClient(server.address).register("/p", "127.0.0.1", 12345)
    until(lambda: "the name /p was taken by a port at tcp://127.0.0.1:12345/" in caplog.text, "it is said")
    assert names.query("/p") == taken
    port.close()


def test_a_name_that_another_took_may_be_left_to_it(server: NameServer) -> None:
    names, others = NameClient(server.address), NameClient(server.address)
    port = PortCore("/p", naming=names)
    port.open()
    assert not names.is_taken("/p")
    assert not others.is_taken("/p"), "it never had it"
    taken = others.register("/p", "127.0.0.1", 12345)
    assert names.is_taken("/p")
    names.leave("/p")
    port.close()
    assert others.query("/p") == taken
    assert not names.is_taken("/p"), "it is given up"
