"""The YARP adapter, with events between two steps of its name server thread."""

from __future__ import annotations

import socket
import threading
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.yarp import edge as edge_module
from bridge.adapters.yarp import ports as ports_module
from bridge.adapters.yarp.edge import YarpEdge
from bridge.adapters.yarp.network import OWNER, new_id
from bridge.adapters.yarp.plan import PlannedLink, PortPlan
from bridge.adapters.yarp.ports import OwnPorts
from bridge.adapters.yarp.services import YarpServices
from bridge.config.model import Config
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.registry import Registry
from bridge.routing.edge import MadeBy
from tests.adapters.yarp.conftest import YarpPort
from tests.peers.yarp.programs import Names
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.registry import Command
from yarp_compat.naming.server import NameServer
from yarp_compat.ports.naming import NoNameServerError
from yarp_compat.wire.binary import encode
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text

REGISTRY = Registry()
STRING = REGISTRY.ros2("std_msgs/msg/String")
LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
LISTENER: Any = SimpleNamespace(
    graph_changed=lambda: None, presence_changed=lambda: None, message_refused=lambda *_: None
)


def cdr(text: str) -> bytes:
    """Encode a String as CDR."""
    content = text.encode() + b"\0"
    return b"\0\1\0\0" + len(content).to_bytes(4, "little") + content


def name_server_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "midspan-yarp-names"]


@pytest.fixture
def names() -> Iterator[Names]:
    names = Names()
    yield names
    names.stop()


@pytest.fixture
def edge(names: Names, tmp_path: Path) -> Iterator[YarpEdge]:
    """A YARP adapter that has not been started."""
    yarp = {"nameserver": "site", "address": names.endpoint, "poll": 0.1}
    edge = YarpEdge(Config.model_validate({"name": "here", "state": tmp_path, "yarp": yarp}), REGISTRY, tmp_path)
    yield edge
    edge.stop()


def test_reader_that_connects_while_the_port_opens_receives_the_latched_message(
    names: Names, edge: YarpEdge, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = YarpPort(names, "/late")
    edge.advertise("/map_name", STRING, LATCHED).send(cdr("kitchen"), "far")
    port, mark = "/midspan/map_name:o", NameClient.set_property

    def marking(client: NameClient, name: str, key: str, *values: Any) -> None:
        if (name, key) == (port, OWNER) and not reader.core.inputs():
            connections.connect(names.client, port, reader.name)
        mark(client, name, key, *values)

    monkeypatch.setattr(NameClient, "set_property", marking)
    edge.start(LISTENER)
    assert reader.bottles(1, 20) == [["kitchen"]]
    reader.stop()


def test_subscription_added_during_an_update_receives_every_later_message(
    names: Names, edge: YarpEdge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The update uses the subscriptions that existed when it began."""
    writer, received = YarpPort(names, "/writer"), list[bytes]()
    abandon_calls, connect, subscribed = OwnPorts.abandon_calls, OwnPorts.connect, threading.Event()

    def subscribe_then_abandon(ports: OwnPorts) -> None:
        if not subscribed.is_set() and ports.made_by("/writer") is MadeBy.NATIVE:
            subscribed.set()
            edge.subscribe("/talk", STRING, Qos(), lambda cdr, *_: received.append(cdr))
        abandon_calls(ports)

    def write_then_connect(ports: OwnPorts) -> None:
        if subscribed.is_set() and not received and writer.core.outputs():
            for text in ("one", "two"):
                writer.core.write(encode([text], Profile.YARP3), wait=True, timeout=20)
        connect(ports)

    monkeypatch.setattr(OwnPorts, "connect", write_then_connect)
    monkeypatch.setattr(OwnPorts, "abandon_calls", subscribe_then_abandon)
    edge.advertise("/talk", STRING, Qos())
    edge.start(LISTENER)
    writer.write_to("/midspan/talk:i")
    until(lambda: cdr("two") in received, "the second message arrives")
    assert received == [cdr("one"), cdr("two")]
    writer.stop()


def test_delayed_update_does_not_disconnect_the_new_owner_of_the_name(
    names: Names, edge: YarpEdge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The worker hung after it had read the name server's list; meanwhile, another worker registered the port."""
    reader = YarpPort(names, "/talk-@/reader")
    names.client.set_property(reader.name, "type", "std_msgs/String")
    edge.advertise("/talk", STRING, Qos())
    connect, port, others = OwnPorts.connect, "/midspan/talk:o", list[YarpPort]()

    def connect_late(ports: OwnPorts) -> None:
        opened = ports.own.get(port)
        if opened is None or reader.name not in opened.links or others:
            connect(ports)
            return
        others.append(YarpPort(names, port, naming=NameClient(names.address)))
        others[0].write_to(reader.name)
        connect(ports)
        key = f"{port} {reader.name}"
        until(lambda: "another program has the name" in ports.trouble.get(key, (0.0, ""))[1], "it does not connect")
        others[0].write(["still connected"])

    monkeypatch.setattr(OwnPorts, "connect", connect_late)
    edge.start(LISTENER)
    assert reader.messages(1, 20), "the new owner is still connected to the reader"
    edge.stop()
    assert names.client.query(port) == others[0].core.contact
    for program in (*others, reader):
        program.stop()


def test_port_opened_by_a_delayed_update_is_closed(
    names: Names, edge: YarpEdge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The name server thread hangs for longer than `stop` waits for it, and then opens a port."""
    monkeypatch.setattr(edge_module, "_STOP_TIMEOUT", 0.05)
    monkeypatch.setattr(NameClient, "hurry", lambda *_: None)  # the name server may take longer to unregister the ports
    apply, reached, resume = OwnPorts.apply, threading.Event(), threading.Event()

    def apply_slowly(ports: OwnPorts, plan: dict[str, PortPlan], *more: Any) -> None:
        if plan:
            reached.set()
            assert resume.wait(20)
        apply(ports, plan, *more)

    monkeypatch.setattr(OwnPorts, "apply", apply_slowly)
    edge.advertise("/talk", STRING, Qos())
    edge.start(LISTENER)
    assert reached.wait(20)
    edge.stop()
    resume.set()
    until(lambda: not name_server_threads(), "the update ends", 20)
    assert names.client.list("/midspan") == []


def test_every_port_is_unregistered_although_the_name_server_is_slow_when_the_edge_stops(
    names: Names, edge: YarpEdge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the time for all commands together is limited (`edge._STOP_TIMEOUT`)."""
    monkeypatch.setattr(edge_module, "_STOP_TIMEOUT", 20.0)
    for number in range(10):
        edge.advertise(f"/talk_{number}", STRING, Qos())
    edge.start(LISTENER)
    until(lambda: len(names.client.list("/midspan")) > 10, "the ports are registered", 20)
    apply, late = NameServer.apply, list[str]()

    def apply_late(server: NameServer, words: Sequence[Any], remote: str) -> Command:
        if words[:1] == ["unregister"] and not late:
            late.append(str(words[1]))
            time.sleep(0.5)  # the name server is slow
        return apply(server, words, remote)

    monkeypatch.setattr(NameServer, "apply", apply_late)
    edge.stop()
    assert late
    assert names.client.list("/midspan") == []


def test_delayed_update_does_not_join_the_network(
    names: Names, edge: YarpEdge, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(edge_module, "_STOP_TIMEOUT", 0.05)
    reached, resume = threading.Event(), threading.Event()

    def unregister_slowly(*_: object) -> None:
        reached.set()
        assert resume.wait(20)

    monkeypatch.setattr(OwnPorts, "unregister_dead", unregister_slowly)
    edge.start(LISTENER)
    assert reached.wait(20)
    edge.stop()
    resume.set()
    until(lambda: not name_server_threads(), "the update ends", 20)
    assert edge.network() is None
    assert names.client.list("/midspan") == []


@pytest.fixture
def silent_port(names: Names) -> Iterator[PortContact]:
    """A registered port that accepts no connection for now, because its backlog is full."""
    with ExitStack() as stack:
        server = stack.enter_context(socket.create_server(("127.0.0.1", 0), backlog=0))
        for _ in range(4):
            waiting = stack.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(server.getsockname())
        yield names.client.register("/midspan/talk:o", "127.0.0.1", server.getsockname()[1])


def test_port_that_does_not_answer_in_time_keeps_its_name(
    names: Names, edge: YarpEdge, silent_port: PortContact, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ports_module, "_CONNECT_SECONDS", 0.2)
    monkeypatch.setattr(ports_module, "_REFUSED_SECONDS", 0.0)
    edge.advertise("/talk", STRING, Qos())
    edge.start(LISTENER)
    until(lambda: names.client.query("/midspan/here/talk:o"), "the port opens under its alternative name", 20)
    assert names.client.query(silent_port.name) == silent_port


def test_unmarked_port_is_unregistered_only_after_it_has_refused_connections_for_a_while(
    names: Names, edge: YarpEdge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A port is registered before it listens; the others were left by a killed worker."""
    now = 100.0
    monkeypatch.setattr(ports_module, "time", SimpleNamespace(monotonic=lambda: now))
    dead = names.client.register("/midspan/dead:o", "127.0.0.1", free_port())
    young = names.client.register("/midspan/young:o", "127.0.0.1", free_port())
    contacts = {contact.name: contact for contact in (dead, young)}
    edge.ports.unregister_dead(contacts)
    edge.ports.unregister_unmarked(contacts)
    assert names.client.query(dead.name) == dead
    with socket.create_server(("127.0.0.1", young.port)):
        now += 60.0
        edge.ports.unregister_unmarked(contacts)
    edge.ports.unregister_unmarked(contacts)
    assert names.client.query(dead.name) is None
    assert names.client.query(young.name) == young


class Failing(dict[str, PortPlan]):
    """A plan without ports, in which each lookup records one more failed connection."""

    def __init__(self, trouble: dict[str, tuple[float, str]]) -> None:
        super().__init__()
        self._trouble = trouble

    def __contains__(self, name: object) -> bool:
        self._trouble[f"/here /peer{len(self._trouble)}"] = 0.0, "connection refused"
        return name == "/here"


def test_connection_that_fails_during_planning_is_a_warning(edge: YarpEdge) -> None:
    ports = edge.ports
    ports.trouble = {"/gone /peer": (0.0, "port not registered")}
    ports.apply(Failing(ports.trouble), {}, {})
    assert ports.warnings() == ["connection refused"]


def test_port_stays_present_if_the_name_server_does_not_answer_after_it_was_connected(
    edge: YarpEdge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise its route would close, and end the connection."""

    def set_property(*_: object) -> None:
        raise NoNameServerError("no reply within 2 s")

    monkeypatch.setattr(NameClient, "set_property", set_property)
    peer, connected = "/talk-@/reader", list[str]()
    core = SimpleNamespace(name="/midspan/talk:o", add_output=lambda name: (connected.append(name), (True, ""))[1])
    port: Any = SimpleNamespace(core=core, plan=SimpleNamespace(writes=True))
    edge.ports._graph.contacts = {peer: PortContact(peer, "127.0.0.1", 10002)}
    edge.ports._link(port, peer, PlannedLink())
    assert connected == [peer]
    assert edge.ports._graph.is_present(peer)


def test_service_can_close_during_planning(
    edge: YarpEdge, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    plan, connect = YarpServices.plan, OwnPorts.connect
    server = edge.serve("/lamp", REGISTRY.service_ros2("std_srvs/srv/SetBool"), lambda *_: lambda: None)
    planned, updated = threading.Event(), threading.Event()

    def plan_and_close(*args: Any) -> dict[str, PortPlan]:
        ports = plan(*args)
        server.close()
        planned.set()
        return ports

    def connect_and_report(ports: OwnPorts) -> None:
        connect(ports)
        if planned.is_set():
            updated.set()

    monkeypatch.setattr(YarpServices, "plan", plan_and_close)
    monkeypatch.setattr(OwnPorts, "connect", connect_and_report)
    edge.start(LISTENER)
    assert updated.wait(20)
    assert "cannot update the ports and connections" not in caplog.text


def test_worker_id_never_parses_as_a_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A name server parses an unquoted ID such as 715758e2 as a number."""
    monkeypatch.setattr(uuid, "uuid4", lambda: SimpleNamespace(hex="123456789e12" + 20 * "0"))
    yarp = {"nameserver": "site", "address": "127.0.0.1:10000"}
    edge = YarpEdge(Config.model_validate({"name": "here", "state": tmp_path, "yarp": yarp}), REGISTRY, tmp_path)
    owner = (tmp_path / "yarp_owner").read_text().strip()
    assert from_text(owner) == [owner]
    assert from_text(new_id()) == [new_id()]
    edge.stop()


@pytest.mark.parametrize("stored", ["75e5e286e164", "650875027306", "00e123456789"])
def test_a_stored_worker_id_that_parses_as_a_number_is_replaced(tmp_path: Path, stored: str) -> None:
    """Earlier versions stored such IDs; yarpserver returns them as ``0.0`` or as an int, even if they were quoted."""
    (tmp_path / "yarp_owner").write_text(stored + "\n")
    yarp = {"nameserver": "site", "address": "127.0.0.1:10000"}
    edge = YarpEdge(Config.model_validate({"name": "here", "state": tmp_path, "yarp": yarp}), REGISTRY, tmp_path)
    edge.stop()
    owner = (tmp_path / "yarp_owner").read_text().strip()
    assert from_text(owner) == [owner]
    assert owner != stored
