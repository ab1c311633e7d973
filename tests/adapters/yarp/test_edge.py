"""The edge itself, with what happens between two steps of its clerk."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.yarp import edge as edge_module
from bridge.adapters.yarp import network as network_module
from bridge.adapters.yarp.edge import YarpEdge
from bridge.adapters.yarp.network import OWNER, new_id
from bridge.adapters.yarp.plan import PortPlan
from bridge.adapters.yarp.ports import OwnPorts
from bridge.adapters.yarp.services import YarpServices
from bridge.config.model import Config
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.registry import Registry
from bridge.routing.edge import MadeBy
from tests.adapters.yarp.conftest import YarpPort
from tests.support.wait import until
from tests.support.yarp_programs import Names
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.wire.binary import encode
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text

REGISTRY = Registry()
STRING = REGISTRY.ros2("std_msgs/msg/String")
LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
LISTENER: Any = SimpleNamespace(
    graph_changed=lambda: None, presence_changed=lambda: None, message_refused=lambda *_: None
)


def cdr(text: str) -> bytes:
    """A String on the hub."""
    content = text.encode() + b"\0"
    return b"\0\1\0\0" + len(content).to_bytes(4, "little") + content


def clerks() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "midspan-yarp-clerk"]


@pytest.fixture
def names() -> Iterator[Names]:
    names = Names()
    yield names
    names.stop()


@pytest.fixture
def edge(names: Names, tmp_path: Path) -> Iterator[YarpEdge]:
    """One that is not started."""
    yarp = {"nameserver": "site", "address": names.endpoint, "poll": 0.1}
    edge = YarpEdge(Config.model_validate({"name": "here", "state": tmp_path, "yarp": yarp}), REGISTRY, tmp_path)
    yield edge
    edge.stop()


def test_who_connects_as_a_port_opens_gets_what_is_kept(
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


def test_who_subscribes_during_a_turn_hears_everything_from_then_on(
    names: Names, edge: YarpEdge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The turn knows of the subscriptions that there were at its beginning."""
    writer, got = YarpPort(names, "/writer"), list[bytes]()
    look, connect, turn = OwnPorts.look_for_callers, OwnPorts.connect, threading.Event()

    def looking(ports: OwnPorts) -> None:
        if not turn.is_set() and ports.made_by("/writer") is MadeBy.NATIVE:
            turn.set()
            edge.subscribe("/talk", STRING, Qos(), lambda cdr, *_: got.append(cdr))
        look(ports)

    def connecting(ports: OwnPorts) -> None:
        if turn.is_set() and not got:
            for word in ("one", "two"):
                writer.core.write(encode([word], Profile.YARP3), wait=True, timeout=20)
        connect(ports)

    monkeypatch.setattr(OwnPorts, "connect", connecting)
    monkeypatch.setattr(OwnPorts, "look_for_callers", looking)
    edge.advertise("/talk", STRING, Qos())
    edge.start(LISTENER)
    writer.write_to("/midspan/talk:i")
    until(lambda: cdr("two") in got, "what is written after that")
    assert got == [cdr("one"), cdr("two")]
    writer.stop()


def test_a_late_turn_cuts_no_connection_of_the_port_that_has_the_name_by_now(
    names: Names, edge: YarpEdge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The worker stood still between its look at the name server and its connections, and another took over."""
    reader = YarpPort(names, "/talk-@/reader")
    names.client.set_property(reader.name, "type", "std_msgs/String")
    edge.advertise("/talk", STRING, Qos())
    connect, port, others = OwnPorts.connect, "/midspan/talk:o", list[YarpPort]()

    def late(ports: OwnPorts) -> None:
        own = ports.own.get(port)
        if own is None or reader.name not in own.links or others:
            connect(ports)
            return
        others.append(YarpPort(names, port, naming=NameClient(names.address)))
        others[0].write_to(reader.name)
        connect(ports)
        (making,) = own.making.values()
        assert not making.result(20)
        others[0].write(["still heard"])

    monkeypatch.setattr(OwnPorts, "connect", late)
    edge.start(LISTENER)
    assert reader.messages(1, 20), "the other one's connection is as it was"
    edge.stop()
    assert names.client.query(port) == others[0].core.contact
    for one in (*others, reader):
        one.stop()


def test_what_a_late_turn_opens_is_closed(names: Names, edge: YarpEdge, monkeypatch: pytest.MonkeyPatch) -> None:
    """The clerk is held up for longer than its end is waited for, and opens a port then."""
    monkeypatch.setattr(edge_module, "_LAST_WORDS", 0.05)
    follow, at, go_on = OwnPorts.follow, threading.Event(), threading.Event()

    def slowly(ports: OwnPorts, plan: dict[str, PortPlan], *more: Any) -> None:
        if plan:
            at.set()
            assert go_on.wait(20)
        follow(ports, plan, *more)

    monkeypatch.setattr(OwnPorts, "follow", slowly)
    edge.advertise("/talk", STRING, Qos())
    edge.start(LISTENER)
    assert at.wait(20)
    edge.stop()
    go_on.set()
    until(lambda: not clerks(), "the turn is over", 20)
    assert names.client.list("/midspan") == []


def test_a_late_turn_does_not_come_onto_the_network(
    names: Names, edge: YarpEdge, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(edge_module, "_LAST_WORDS", 0.05)
    at, go_on = threading.Event(), threading.Event()

    def slowly(*_: object) -> None:
        at.set()
        assert go_on.wait(20)

    monkeypatch.setattr(OwnPorts, "bury", slowly)
    edge.start(LISTENER)
    assert at.wait(20)
    edge.stop()
    go_on.set()
    until(lambda: not clerks(), "the turn is over", 20)
    assert edge.network() is None
    assert names.client.list("/midspan") == []


class Failing(dict[str, PortPlan]):
    """A plan without ports; a connection fails as it is looked at."""

    def __init__(self, trouble: dict[str, tuple[float, str]]) -> None:
        super().__init__()
        self._trouble = trouble

    def __contains__(self, name: object) -> bool:
        self._trouble[f"/here /peer{len(self._trouble)}"] = 0.0, "it is gone"
        return name == "/here"


def test_a_connection_that_fails_as_ports_are_planned_is_told(edge: YarpEdge) -> None:
    ports = edge.ports
    ports.trouble = {"/gone /peer": (0.0, "it is not there")}
    ports.follow(Failing(ports.trouble), {}, {})
    assert ports.warnings() == ["it is gone"]


def test_a_service_may_go_as_ports_are_planned(
    edge: YarpEdge, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    plan, connect = YarpServices.plan, OwnPorts.connect
    server = edge.serve("/lamp", REGISTRY.service_ros2("std_srvs/srv/SetBool"), lambda *_: lambda: None)
    planned, ended = threading.Event(), threading.Event()

    def planning(*args: Any) -> dict[str, PortPlan]:
        found = plan(*args)
        server.close()
        planned.set()
        return found

    def connecting(ports: OwnPorts) -> None:
        connect(ports)
        if planned.is_set():
            ended.set()

    monkeypatch.setattr(YarpServices, "plan", planning)
    monkeypatch.setattr(OwnPorts, "connect", connecting)
    edge.start(LISTENER)
    assert ended.wait(20)
    assert "following the network failed" not in caplog.text


def test_the_id_of_the_worker_is_never_a_number_in_yarps_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A name server reads an id such as 715758e2 as a number, unless it is quoted."""
    monkeypatch.setattr(network_module.uuid, "uuid4", lambda: SimpleNamespace(hex="123456789e12" + 20 * "0"))
    yarp = {"nameserver": "site", "address": "127.0.0.1:10000"}
    edge = YarpEdge(Config.model_validate({"name": "here", "state": tmp_path, "yarp": yarp}), REGISTRY, tmp_path)
    owner = (tmp_path / "yarp_owner").read_text().strip()
    assert from_text(owner) == [owner]
    assert from_text(new_id()) == [new_id()]
    edge.stop()
