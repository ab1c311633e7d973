"""The embedded master and the real rosmaster receive the same random calls; replies and calls to nodes are compared."""

from __future__ import annotations

import random
import tempfile
import xmlrpc.client
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from bridge.adapters.ros1.master import api
from bridge.adapters.ros1.master.embedded import EmbeddedMaster
from bridge.adapters.ros1.master.registrations import Kind
from tests.peers.ros1.fake_node import FakeNode
from tests.peers.ros1.network import ROS1_PYTHON, ros1_environment
from tests.support.missing import ROS1, need
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until

CALLS = 1000
NAMES = ("/a", "/b", "/ns/c", "rel", "a/b", "/ns/", "~p", "/", "", "a b", "x:y", 5, "//d//e/", "~")
NODES = ("/n1", "/n2", "/ns/n3", "n4", "", 7)
TYPES = ("std_msgs/String", "geometry_msgs/Twist", "*", "bad", "a/b/c", 4)
VALUES: tuple[Any, ...] = (
    1, 2.5, "x", True, "", [], [1, [2]], {}, {"x": 1, "y": {"z": "q"}}, {"y": {"z": 2}}, {"p": {"p": {"p": 0}}}
)  # fmt: skip


class Pair:
    """A master with three fake nodes; in replies and calls, names replace the nodes' addresses."""

    def __init__(self, uri: str) -> None:
        self.proxy = xmlrpc.client.ServerProxy(uri)
        self.nodes = [FakeNode() for _ in range(3)]
        self.names = {node.api: f"http://fake{number}/" for number, node in enumerate(self.nodes)}

    def call(self, method: str, params: list[Any]) -> Any:
        apis = {name: api for api, name in self.names.items()}
        return self.named(getattr(self.proxy, method)(*(apis.get(p, p) if isinstance(p, str) else p for p in params)))

    def named(self, value: Any) -> Any:
        """Replace the addresses of the fake nodes in a value."""
        if isinstance(value, str):
            return self.names.get(value, value)
        if isinstance(value, list | tuple):
            return [self.named(v) for v in value]
        return {k: self.named(v) for k, v in value.items()} if isinstance(value, dict) else value

    def newest(self, method: str) -> list[dict[str, Any]]:
        """Return the last value that each node received for each key."""
        return [{c[1]: self.named(c[2]) for c in node.calls if c[0] == method} for node in self.nodes]

    def has_last_call(self) -> bool:
        return all("/last" in updates for updates in self.newest("publisherUpdate"))

    def close(self) -> None:
        self.proxy("close")()
        for node in self.nodes:
            node.close()


@pytest.fixture
def rosmaster() -> Iterator[str]:
    """Run the real rosmaster, without rosout."""
    need(ROS1)
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        env = {**ros1_environment(), "ROS_LOG_DIR": folder, "ROS_HOME": folder}
        with Process([ROS1_PYTHON, "/usr/bin/rosmaster", "--core", "-p", str(port)], env):
            uri = f"http://127.0.0.1:{port}/"
            until(lambda: _answers(uri), "rosmaster responds")
            yield uri


def _answers(uri: str) -> bool:
    try:
        with xmlrpc.client.ServerProxy(uri) as proxy:
            return bool(proxy.getPid("/test"))
    except OSError:
        return False


def random_calls(chance: random.Random) -> Iterator[tuple[str, list[Any]]]:
    """Yield mostly valid calls on few names, so that they affect each other."""

    def mostly(values: tuple[Any, ...], valid: int, share: float) -> Any:
        return chance.choice(values[:valid] if chance.random() < share else values)

    name: Callable[[], Any] = lambda: mostly(NAMES, 4, 0.7)  # noqa: E731
    node: Callable[[], Any] = lambda: mostly(NODES, 3, 0.85)  # noqa: E731
    api: Callable[[], Any] = lambda: mostly(("http://fake0/", "http://fake1/", "http://fake2/", "x", "", 3), 3, 0.9)  # noqa: E731
    service: Callable[[], str] = lambda: f"rosrpc://fake:{chance.randint(1, 3)}"  # noqa: E731
    kind: Callable[[], Any] = lambda: chance.choice(TYPES)  # noqa: E731

    def key() -> Any:
        if chance.random() < 0.1:
            return chance.choice(NAMES)
        return "/".join(chance.choice(("/", "", "~")) + chance.choice("kxyzp") for _ in range(chance.randint(1, 3)))

    specs: dict[str, list[Callable[[], Any]]] = {
        "registerService": [node, name, service, api], "unregisterService": [node, name, service],
        "registerPublisher": [node, name, kind, api], "unregisterPublisher": [node, name, api],
        "registerSubscriber": [node, name, kind, api], "unregisterSubscriber": [node, name, api],
        "lookupNode": [node, lambda: chance.choice(NODES + NAMES)], "lookupService": [node, name],
        "getPublishedTopics": [node, name], "getTopicTypes": [node], "getSystemState": [node],
        "setParam": [node, key, lambda: chance.choice(VALUES)], "getParam": [node, key], "deleteParam": [node, key],
        "hasParam": [node, key], "searchParam": [node, key], "getParamNames": [node],
        "subscribeParam": [node, api, key], "unsubscribeParam": [node, api, key],
    }  # fmt: skip
    # first, because before any service is registered, rosmaster has another text for the removal of a service
    yield "registerService", ["/n1", "/first", "rosrpc://fake:1", "http://fake0/"]
    for _ in range(CALLS):
        method = chance.choice(list(specs))
        params = [make() for make in specs[method]]
        if "Param" in method and method != "searchParam" and not str(params[0]).startswith("/"):
            params[0] = "/n1"  # rosmaster cuts off the first part of node names that are not global
        count = len(params) + chance.choices((0, -1, 1), (97, 2, 1))[0]
        yield method, [*params, "more"][:count]


def comparable(method: str, reply: Any) -> Any:
    """Return the part of a reply that must be the same for both masters."""
    if method == "deleteParam" and reply[0] == -1:  # below a value, rosmaster reports its own exception
        return reply[0]
    return reply


def test_replies_and_calls_are_those_of_rosmaster(rosmaster: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(api, "REPLACED_SECONDS", 0.0)  # because rosmaster lets replaced nodes register
    embedded = EmbeddedMaster("127.0.0.1", 0, rosout=False)
    embedded.start()
    real, own = Pair(rosmaster), Pair(embedded.uri)
    try:
        for pair in (real, own):
            pair.call("setParam", ["/x", "/", {}])
        for method, params in random_calls(random.Random(48)):
            replies = [comparable(method, pair.call(method, params)) for pair in (own, real)]
            assert replies[0] == replies[1], (method, params)
        last = [("registerSubscriber", [f"/last{n}", "/last", "*", f"http://fake{n}/"]) for n in range(3)]
        last.append(("registerPublisher", ["/last", "/last", "std_msgs/String", "http://fake0/"]))
        for pair in (real, own):
            for method, params in last:
                pair.call(method, params)
            until(pair.has_last_call, "the last call has arrived at each node")
        assert own.newest("paramUpdate") == real.newest("paramUpdate")
        for ours, theirs in zip(own.nodes, real.nodes, strict=True):
            assert {c for c in ours.calls if c[0] == "shutdown"} == {c for c in theirs.calls if c[0] == "shutdown"}
        # rosmaster does not report publishers that end because another node takes their name
        registrations = embedded.api.registrations
        for node, updates in zip(own.nodes, own.newest("publisherUpdate"), strict=True):
            for topic, publishers in updates.items():
                if node.api in registrations.apis(Kind.SUBSCRIBER, topic):
                    assert publishers == own.named(registrations.apis(Kind.PUBLISHER, topic)), topic
    finally:
        real.close()
        own.close()
        embedded.close()
