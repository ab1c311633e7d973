"""The graph of a YARP network: latching and presence of topic ports."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from bridge.adapters.yarp import graph as graph_module
from bridge.adapters.yarp.graph import KnownPort, NodePort, YarpGraph
from bridge.messages.registry import Registry
from tests.peers.yarp.programs import Names
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.os.ports.nested import LATCHED
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.contact import PortContact

PORT = "/map+@/server"


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a port answer late, because it is in this process, which may stall."""
    monkeypatch.setattr(graph_module, "_ASK_SECONDS", 40.0)
    monkeypatch.setattr(graph_module, "_ANSWER_SECONDS", 40.0)


@pytest.fixture
def names() -> Iterator[Names]:
    names = Names()
    yield names
    names.stop()


def update(graph: YarpGraph, names: Names) -> NodePort:
    """Update the graph, and return its only port."""
    graph.update(names.client, names.client.list(), ())
    (port,) = graph.nodes
    return port


@pytest.fixture
def port(names: Names) -> Iterator[PortCore]:
    core = PortCore(PORT, naming=names.client, type_name="std_msgs/String")
    yield core
    core.close()


@pytest.mark.parametrize(
    ("announced", "latched"), [(1, True), ("true", True), (0, False), ("no", False), (None, False)]
)
def test_publisher_announces_latching_at_the_first_update(
    names: Names, port: PortCore, announced: Any, latched: bool
) -> None:
    if announced is not None:
        port.properties[LATCHED] = announced
    port.open()
    assert update(YarpGraph(Registry()), names).latched is latched


def test_latching_can_be_set_at_the_name_server_later(
    names: Names, port: PortCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(graph_module, "_ANNOUNCE_SECONDS", 60.0)
    port.open()
    graph = YarpGraph(Registry())
    assert not update(graph, names).latched
    names.client.set_property(PORT, LATCHED, "true")
    assert update(graph, names).latched


def test_registered_publisher_that_does_not_listen_yet_is_not_present(
    names: Names, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(graph_module, "_ANNOUNCE_SECONDS", 60.0)
    graph, number = YarpGraph(Registry()), free_port()
    names.client.register(PORT, "127.0.0.1", number)
    update(graph, names)
    assert not graph.is_present(PORT)
    port = PortCore(PORT, naming=names.client, type_name="std_msgs/String", host="127.0.0.1", number=number)
    port.properties[LATCHED] = 1
    port.open()

    def present() -> bool:
        node = update(graph, names)
        return graph.is_present(PORT) and node.latched

    until(present, "the port is present and latched", 20)
    port.close()


def test_publisher_that_listens_long_after_its_registration_is_asked_for_type_and_latching(names: Names) -> None:
    graph, number = YarpGraph(Registry()), free_port()
    names.client.register(PORT, "127.0.0.1", number)
    update(graph, names)
    graph.known[PORT].since -= 60.0
    port = PortCore(PORT, naming=names.client, type_name="std_msgs/String", host="127.0.0.1", number=number)
    port.properties[LATCHED] = 1
    port.open()

    def known() -> bool:
        node = update(graph, names)
        return node.latched and node.type == "std_msgs/msg/String"

    until(known, "the port's type and latching are known", 20)
    port.close()


def test_type_that_is_announced_late_is_read(names: Names) -> None:
    """The program stalls between the registration of its port and the announcement of its type."""
    graph, port = YarpGraph(Registry()), "/map-@/client"
    names.client.register(port, "127.0.0.1", free_port())
    assert update(graph, names).type == ""
    graph.known[port].since -= 60.0
    graph.known[port].read -= 60.0
    names.client.set_property(port, "type", "std_msgs/String")
    assert update(graph, names).type == "std_msgs/msg/String"


class Discarding:
    """A contact that discards its port when it is compared."""

    def __init__(self, graph: YarpGraph, name: str) -> None:
        self._graph, self._name = graph, name

    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, _: object) -> bool:
        self._graph.discard(self._name)
        return True


def test_port_whose_connection_ends_during_an_update_is_discarded(names: Names) -> None:
    graph = YarpGraph(Registry())
    for name in ("/a", "/b", "/c"):
        graph.known[name] = KnownPort(PortContact(name, "127.0.0.1", 10002), 0.0)
    graph.known["/a"].contact = Discarding(graph, "/a")  # type: ignore[assignment]
    graph.known["/b"].contact = Discarding(graph, "/c")  # type: ignore[assignment]
    graph.update(names.client, [PortContact(name, "127.0.0.1", 10002) for name in ("/a", "/b", "/c")], ())
    assert graph.known.keys() == {"/b"}


def test_a_publisher_with_an_invalid_host_is_unreachable(names: Names) -> None:
    """Ports may register any text as their host; the network's other ports are still listed."""
    names.client.register(PORT, "a" * 70, 10999)
    graph = YarpGraph(Registry())
    update(graph, names)
    assert not graph.is_present(PORT)
