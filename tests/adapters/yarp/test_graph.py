"""What the bridge knows of the ports of topics."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import Any

import pytest

from bridge.adapters.yarp.graph import KnownPort, NodePort, YarpGraph
from bridge.messages.registry import Registry
from tests.support.wait import until
from tests.support.yarp_programs import Names
from yarp_compat.os.ports.nested import LATCHED
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.contact import PortContact

PORT = "/map+@/server"


@pytest.fixture
def names() -> Iterator[Names]:
    names = Names()
    yield names
    names.stop()


def look(graph: YarpGraph, names: Names) -> NodePort:
    """The port, as the graph has it after one more look."""
    graph.update(names.client, names.client.list(), ())
    (found,) = graph.nodes
    return found


@pytest.fixture
def port(names: Names) -> Iterator[PortCore]:
    core = PortCore(PORT, naming=names.client, type_name="std_msgs/String")
    yield core
    core.close()


@pytest.mark.parametrize(("own", "latched"), [(1, True), ("true", True), (0, False), ("no", False), (None, False)])
def test_a_publisher_itself_tells_at_the_first_look_whether_it_is_latched(
    names: Names, port: PortCore, own: Any, latched: bool
) -> None:
    if own is not None:
        port.properties[LATCHED] = own
    port.open()
    assert look(YarpGraph(Registry()), names).latched is latched


def test_what_the_name_server_is_told_later_counts_too(names: Names, port: PortCore) -> None:
    port.open()
    graph = YarpGraph(Registry())
    assert not look(graph, names).latched
    names.client.set_property(PORT, LATCHED, "true")
    assert look(graph, names).latched


def test_a_publisher_that_is_registered_and_does_not_listen_yet_is_not_there(names: Names) -> None:
    graph = YarpGraph(Registry())
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
    names.client.register(PORT, "127.0.0.1", number)
    look(graph, names)
    assert not graph.is_present(PORT)
    port = PortCore(PORT, naming=names.client, type_name="std_msgs/String", host="127.0.0.1", number=number)
    port.properties[LATCHED] = 1
    port.open()

    def there() -> bool:
        found = look(graph, names)
        return graph.is_present(PORT) and found.latched

    until(there, "it is there, and known for latched", 20)
    port.close()


class Forgetting:
    """A contact whose port is forgotten as it is looked at."""

    def __init__(self, graph: YarpGraph, name: str) -> None:
        self._graph, self._name = graph, name

    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, _: object) -> bool:
        self._graph.forget(self._name)
        return True


def test_a_port_whose_connection_ends_as_the_list_is_taken_up_is_forgotten(names: Names) -> None:
    graph = YarpGraph(Registry())
    for name in ("/a", "/b", "/c"):
        graph.known[name] = KnownPort(PortContact(name, "127.0.0.1", 10002), 0.0)
    graph.known["/a"].contact = Forgetting(graph, "/a")  # type: ignore[assignment]
    graph.known["/b"].contact = Forgetting(graph, "/c")  # type: ignore[assignment]
    graph.update(names.client, [PortContact(name, "127.0.0.1", 10002) for name in ("/a", "/b", "/c")], ())
    assert graph.known.keys() == {"/b"}
