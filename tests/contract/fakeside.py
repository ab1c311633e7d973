"""The contract suite's in-memory side: only the engine, with a real hub."""

from __future__ import annotations

import itertools
import threading
from typing import Any

from bridge.config.model import Config
from bridge.hub.endpoints.calls import Call
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from bridge.routing.edge import MadeBy
from bridge.routing.engine import Engine
from bridge.state_file import lane_folder
from tests.contract.hubside import ros2_name, service_name
from tests.contract.side import PEER_FOLDERS, Side
from tests.peers.fake import FakeEdge, FakeNetwork, Reader, Server, Writer
from tests.peers.hub.calls import Calling, Serving
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until


class FakePeer:
    """A native program on the fake network."""

    def __init__(self, network: FakeNetwork, registry: Registry, node: str) -> None:
        self._network, self._registry, self._node = network, registry, node
        self._things: dict[int, tuple[Writer | Reader | Server, str]] = {}
        self._servings: dict[int, Serving] = {}
        self._callings: dict[int, Calling] = {}
        self._received: dict[int, list[dict[str, Any]]] = {}
        self._ids = itertools.count(1)
        self._changed = threading.Condition()

    def advertise(self, topic: str, type_: str, *, latched: bool = False, **_: Any) -> int:
        number = next(self._ids)
        writer = self._network.write_on(topic, ros2_name(type_), _qos(latched=latched), MadeBy.NATIVE, self._node)
        self._things[number] = (writer, ros2_name(type_))
        return number

    def subscribe(self, topic: str, type_: str, *, latched: bool = False, **_: Any) -> int:
        number = next(self._ids)
        received: list[dict[str, Any]] = []
        self._received[number] = received
        name = ros2_name(type_)

        def deliver(payload: bytes, _source: str, _time: int | None) -> None:
            with self._changed:
                received.append(to_json(self._registry, name, payload))
                self._changed.notify_all()

        reader = self._network.read_from(topic, name, _qos(latched=latched), MadeBy.NATIVE, self._node, deliver)
        self._things[number] = (reader, name)
        return number

    def publish(self, endpoint: int, message: dict[str, Any]) -> None:
        writer, name = self._things[endpoint]
        assert isinstance(writer, Writer)
        self._network.write(writer, from_json(self._registry, name, message))

    def wait(self, endpoint: int, count: int, seconds: float = 10.0) -> list[dict[str, Any]]:
        with self._changed:
            self._changed.wait_for(lambda: len(self._received[endpoint]) >= count, seconds)
            return list(self._received[endpoint])

    def ask(self, do: str, **params: Any) -> dict[str, Any]:
        """Execute the service commands of `tests.peers.peer`."""
        if do == "serve":
            number, name = next(self._ids), service_name(params["type"])
            serving = self._servings[number] = Serving(self._registry, name, params)
            server = self._network.serve(params["service"], name, MadeBy.NATIVE, self._node, serving.call)
            self._things[number] = (server, name)
            return {"id": number}
        if do == "call":
            number, name = next(self._ids), service_name(params["type"])
            call: Call = lambda request, done: self._network.call(params["service"], request, done)  # noqa: E731
            self._callings[number] = Calling(self._registry, name, params.get("request") or {}, call)
            return {"id": number}
        number = params.pop("id")
        if do == "result":
            return self._callings[number].result(**params)
        if do == "requests":
            return {"requests": self._servings[number].requests(**params)}
        self._servings[number].release()
        return {}

    def drop(self, endpoint: int) -> None:
        self._network.remove(self._things.pop(endpoint)[0])

    def graph(self) -> dict[str, Any]:
        publishers: dict[str, list[str]] = {}
        for endpoint in self._network.endpoints():
            if endpoint.kind.value == "publisher":
                publishers.setdefault(endpoint.topic, []).append(endpoint.node)
        return {"publishers": publishers, "subscriptions": {}}

    def stop(self, seconds: float = 6.0) -> int:
        for endpoint in list(self._things):
            self.drop(endpoint)
        return int(seconds * 0)


class FakeBridge:
    """An engine on the fake network, in the test's process."""

    def __init__(self, network: FakeNetwork, registry: Registry, hubs: HubNetwork, config: Config) -> None:
        self._hub = Hub.open(hubs.settings("midspan_fake", lane=lane_folder(config)))
        edge = FakeEdge(network, registry)
        self._engine = Engine(edge, self._hub, config.routing, config.name, self._failed, registry)
        self._engine.start()
        self._closers = [
            self._hub.serve("status", lambda _: self._engine.status().document()),
            self._hub.serve("explain", lambda params: self._engine.explain(params["topic"])),
        ]
        until(lambda: self._engine.summary().network, "the engine joins")

    def _failed(self, reason: str) -> None:
        raise AssertionError(reason)

    def reload(self, config: Config) -> None:
        self._engine.reload(config.routing)

    def stop(self) -> None:
        for closer in self._closers:
            closer()
        self._closers = []
        self._engine.stop()
        self._hub.close()

    def kill(self) -> None:
        self.stop()


class FakeSide(Side):
    """A network in memory."""

    name = "fake"
    has_services = True
    has_custom_types = False

    def __init__(self, hubs: HubNetwork) -> None:
        super().__init__()
        self._hubs = hubs
        self._network = FakeNetwork()
        self._registry = Registry(folders=PEER_FOLDERS)
        self._restarts = itertools.count(2)

    def peer(self) -> FakePeer:
        peer = FakePeer(self._network, self._registry, f"/peer{next(self._names)}")
        self._open.append(peer)
        return peer

    def bridge(self, config: Config) -> FakeBridge:
        bridge = FakeBridge(self._network, self._registry, self._hubs, config)
        self._open.append(bridge)
        return bridge

    def restart_network(self) -> None:
        self._network.restart(None)
        self._network.restart(f"fake-{next(self._restarts)}")

    def config(self) -> dict[str, Any]:
        return {}


def _qos(*, latched: bool) -> Qos:
    return Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE, depth=1)
