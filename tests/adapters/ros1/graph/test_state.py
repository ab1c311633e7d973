"""Reads of a master's state."""

import contextlib
from collections.abc import Callable
from typing import Any

import pytest

from bridge.adapters.ros1.graph.state import MasterReader, Registration
from bridge.adapters.ros1_peers import Call, Ros1Error, UnreachableError, XmlRpcClient
from tests.peers.ros1.servers import node


class Master:
    """A master's API with a state that the test sets."""

    def __init__(self) -> None:
        self.nodes = {"/a": "http://a:1/"}
        self.publishers = [["/topic", ["/a"]]]
        self.run_id: list[Any] = [1, "", "run"]
        self.presence: list[Any] = [-1, "not set", 0]
        self.services = {"/serve": ("/a", "rosrpc://a:2")}
        self.lookups: list[str] = []
        self.at_end: Callable[[], None] = lambda: None

    def uri(self, _caller: str) -> list[Any]:
        """Return the URI. This is the last call of a read that does not know any nodes yet."""
        self.at_end()
        return [1, "", "http://master:11311/"]

    def lookup(self, _caller: str, name: str) -> list[Any]:
        return [1, "", self.nodes[name]] if name in self.nodes else [-1, "unknown node", ""]

    def lookup_service(self, _caller: str, name: str) -> list[Any]:
        self.lookups.append(name)
        return [1, "", self.services[name][1]] if name in self.services else [-1, "no provider", ""]

    def state(self, _caller: str) -> list[Any]:
        services = [[name, [node]] for name, (node, _) in self.services.items()]
        return [1, "", [self.publishers, [["/topic", ["/b"]]], services]]

    def methods(self) -> dict[str, Any]:
        return {
            "getSystemState": self.state,
            "getTopicTypes": lambda _: [1, "", [["/topic", "std_msgs/String"]]],
            "getParam": lambda _, key: self.run_id if key == "/run_id" else self.presence,
            "getPid": lambda _: [1, "", 42],
            "getUri": self.uri,
            "lookupNode": self.lookup,
            "lookupService": self.lookup_service,
        }


@pytest.fixture
def master():
    return Master()


@pytest.fixture
def reader(master):
    with node(**master.methods()) as uri:
        client = XmlRpcClient(uri, 40.0)
        with contextlib.closing(client):
            yield MasterReader(client, "/me")


def test_the_state_lists_registrations_types_and_presence_entries(master, reader):
    state = reader.read()
    assert (state.network, state.run) == ("run", "run#42")
    assert state.publishers == {Registration("/a", "/topic", "http://a:1/")}
    assert state.subscribers == {Registration("/b", "/topic", "")}
    assert state.servers == {Registration("/a", "/serve", "rosrpc://a:2")}
    assert state.types == {"/topic": "std_msgs/String"}
    assert state.presence == {}
    assert reader.read() is state
    master.presence = [1, "", {"midspan": {"pid": 1}, "odd": 3}]
    assert reader.read().presence == {"midspan": {"pid": 1}}


def test_a_master_without_a_run_id_is_identified_by_address_and_process_id(master, reader):
    master.run_id = [-1, "not set", 0]
    assert reader.read().network == "http://master:11311/#42"


def test_a_node_that_registers_during_a_read_is_in_the_next_state(master, reader):
    def arrive() -> None:
        master.nodes["/late"] = "http://late:1/"
        master.publishers = [["/topic", ["/a", "/late"]]]

    master.at_end = arrive
    reader.read()
    assert Registration("/late", "/topic", "http://late:1/") in reader.read().publishers


def test_a_node_that_moved_is_listed_at_its_new_address(master, reader):
    reader.read()
    master.nodes["/a"] = "http://a:2/"
    assert reader.read().publishers == {Registration("/a", "/topic", "http://a:2/")}


def test_a_services_address_is_looked_up_once(master, reader):
    first = reader.read()
    master.services["/more"] = ("/b", "rosrpc://b:3")
    assert reader.read().servers == {*first.servers, Registration("/b", "/more", "rosrpc://b:3")}
    assert master.lookups == ["/serve", "/more"]
    del master.services["/more"]
    assert reader.read().servers == first.servers
    master.services["/more"] = ("/b", "rosrpc://b:4")
    assert Registration("/b", "/more", "rosrpc://b:4") in reader.read().servers, (
        "a returning service may have another address"
    )


def test_a_services_address_is_looked_up_again_on_request(master, reader):
    first = reader.read()
    reader.recheck_service("/serve")
    assert reader.read() is first, "the service's address is unchanged"
    master.services["/serve"] = ("/a", "rosrpc://a:7")
    assert reader.read() is first, "a new address is not visible in a master's state"
    reader.recheck_service("/serve")
    assert reader.read().servers == {Registration("/a", "/serve", "rosrpc://a:7")}


def test_a_service_that_unregisters_during_a_read_has_no_address(master, reader):
    master.services["/gone"] = ("/c", 5)
    assert Registration("/c", "/gone", "") in reader.read().servers


def test_a_failed_look_up_of_an_address_is_repeated(master, reader, monkeypatch):
    """Otherwise the next reads would return the state from before the change, until something else changes."""
    reader.read()
    calls = reader._client.calls

    def fail(batch: list[Call]) -> list[Any]:
        if batch[0][0] == "lookupService":
            raise UnreachableError("the master does not respond in time")
        return calls(batch)

    master.services["/more"] = ("/b", "rosrpc://b:3")
    with monkeypatch.context() as busy:
        busy.setattr(reader._client, "calls", fail)
        with pytest.raises(UnreachableError):
            reader.read()
    assert Registration("/b", "/more", "rosrpc://b:3") in reader.read().servers


@pytest.mark.parametrize(("topics", "least", "most"), [(1, 0.5, 0.5), (1500, 0.51, 1.99), (5000, 2.0, 2.0)])
def test_a_master_with_a_large_state_is_read_less_often(master, reader, topics, least, most):
    master.publishers = [[f"/a_topic_of_many/{number}", ["/a"]] for number in range(topics)]
    reader.read()
    assert least <= reader.pause(0.5) <= most
    assert reader.pause(5.0) == 5.0


def test_an_unreachable_master_is_retried_at_the_normal_rate(master):
    master.publishers = [[f"/a_topic_of_many/{number}", ["/a"]] for number in range(5000)]
    with node(**master.methods()) as uri:
        client = XmlRpcClient(uri, 40.0)
        reader = MasterReader(client, "/me")
        reader.read()
    with contextlib.closing(client), pytest.raises(Ros1Error):
        reader.read()
    assert reader.pause(0.5) == 0.5
