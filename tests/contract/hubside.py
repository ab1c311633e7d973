"""The far end of the contract suite: a native participant of the hub that sends and receives messages by fields."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from typing import Any, ClassVar

from bridge.hub.endpoints.services import HubClient
from bridge.hub.graph import HubEndpoint
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from tests.contract.side import PeerLike
from tests.peers.hub.calls import Calling, Serving
from tests.support.wait import until


class HubSide:
    """Publishes and receives messages on the hub by their fields. Types are spelled ``package/Name``.

    ``tells_errors``: calls and servers report errors, and calls end when their server leaves.
    ``hears_itself``: its subscriptions receive what its own publishers publish.
    """

    tells_errors: ClassVar[bool] = True
    hears_itself: ClassVar[bool] = False

    def __init__(self, hub: Hub, registry: Registry) -> None:
        self.hub, self.registry = hub, registry
        self._publishers: dict[int, tuple[Any, str]] = {}
        self._received: dict[int, list[dict[str, Any]]] = {}
        self._subscriptions: dict[int, Any] = {}
        self._changed = threading.Condition()
        self._next = 0
        self.servers: dict[str, Any] = {}
        self._clients: dict[str, HubClient] = {}

    def advertise(self, topic: str, type_: str, *, latched: bool = False, depth: int = 10) -> int:
        name = ros2_name(type_)
        qos = Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE, depth=depth)
        self._next += 1
        publisher = self._publisher(topic, name, self.registry.ros2(name).type_id, qos)
        self._publishers[self._next] = (publisher, name)
        return self._next

    def _publisher(self, topic: str, name: str, type_hash: str, qos: Qos) -> Any:
        return self.hub.publisher(topic, name, type_hash, qos)

    def publish(self, endpoint: int, message: dict[str, Any]) -> None:
        publisher, name = self._publishers[endpoint]
        publisher.put(from_json(self.registry, name, message))

    def publish_raw(self, endpoint: int, payload: bytes) -> None:
        self._publishers[endpoint][0].put(payload)

    def subscribe(self, topic: str, type_: str, *, latched: bool = False, depth: int = 100) -> int:
        name = ros2_name(type_)
        qos = Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE, depth=depth)
        self._next += 1
        received: list[dict[str, Any]] = []

        def receive(payload: bytes) -> None:
            with self._changed:
                received.append(to_json(self.registry, name, payload))
                self._changed.notify_all()

        self._received[self._next] = received
        type_hash = self.registry.ros2(name).type_id
        self._subscriptions[self._next] = self._subscription(topic, name, type_hash, qos, receive)
        return self._next

    def _subscription(self, topic: str, name: str, type_hash: str, qos: Qos, receive: Callable[[bytes], None]) -> Any:
        return self.hub.subscription(topic, name, type_hash, qos, lambda sample: receive(sample.data()))

    def wait(self, endpoint: int, count: int, seconds: float = 10.0) -> list[dict[str, Any]]:
        with self._changed:
            self._changed.wait_for(lambda: len(self._received[endpoint]) >= count, seconds)
            return list(self._received[endpoint])

    def wait_without(self, endpoint: int, probe: str, count: int) -> list[dict[str, Any]]:
        """Return all messages but the probes, once ``count`` others have arrived, or after a minute."""

        def others() -> list[dict[str, Any]]:
            return [m for m in self._received[endpoint] if m["data"] != probe]

        with self._changed:
            self._changed.wait_for(lambda: len(others()) >= count, 60.0)
            return others()

    def drop(self, endpoint: int) -> None:
        if endpoint in self._publishers:
            self._publishers.pop(endpoint)[0].close()
        if endpoint in self._subscriptions:
            self._subscriptions.pop(endpoint).close()

    def hub_publish_until(self, endpoint: int, message: dict[str, Any], arrived: Callable[[], Any]) -> None:
        """Publish until a message arrives on the side, because the route may not exist yet for the first ones."""

        def once() -> Any:
            self.publish(endpoint, message)
            return arrived()

        until(once, "a message from the hub arrives on the side", 20)

    def publish_until(self, peer: PeerLike, endpoint: int, message: dict[str, Any], arrived: Callable[[], Any]) -> int:
        """Publish from a peer on the side until a message arrives on the hub; return how many were published."""
        count = itertools.count(1)

        def once() -> Any:
            peer.publish(endpoint, message)
            number = next(count)
            return number if arrived() else None

        return int(until(once, "a message from the side arrives on the hub", 20))

    def close(self) -> None:
        """Leave the hub."""
        self.hub.close()

    def publishers(self, topic: str) -> list[Any]:
        return [e for e in self.hub.graph.publishers(topic) if not self._is_own(e)]

    def _is_own(self, endpoint: HubEndpoint) -> bool:
        return endpoint.own

    def until_published(self, topic: str, count: int = 1, seconds: float = 15) -> None:
        until(lambda: len(self.publishers(topic)) >= count, f"{count} publishers of {topic} on the hub", seconds)

    def until_unpublished(self, topic: str, seconds: float = 15) -> None:
        until(lambda: not self.publishers(topic), f"no publisher of {topic} on the hub", seconds)

    def status(self) -> dict[str, Any]:
        """Return the bridge worker's status, ignoring the router's reply."""

        def answers() -> list[dict[str, Any]]:
            return [a.value for a in self.hub.ask("status", {}) if isinstance(a.value, dict) and a.worker != "router"]

        return until(answers, "the worker reports its status")[0]

    def serve(self, service: str, type_: str, **params: Any) -> Any:
        """Serve on the hub until the server, which is then in ``servers``, is closed."""
        name = service_name(type_)
        serving = Serving(self.registry, name, params)
        self.servers[service] = self.hub.server(service, name, self.registry.service_ros2(name).type_id, serving.call)
        return serving

    def call(self, service: str, type_: str, **request: Any) -> Any:
        """Call a service as soon as the hub has a server for it."""
        name = service_name(type_)
        client = self._clients.get(service)
        if client is None:
            client = self.hub.client(service, name, self.registry.service_ros2(name).type_id)
            self._clients[service] = client
        # the server's token arrives after a previous server's tokens have been withdrawn
        until(lambda: self.hub.graph.servers(service) and client.ready, f"a server of {service} on the hub", 60)
        return Calling(self.registry, name, request, client.call)

    def route(self, topic: str, direction: str) -> Any:
        """Return one route as a dictionary, or None if it does not exist."""
        return next((r for r in self.status()["routes"] if r["topic"] == topic and r["direction"] == direction), None)

    def uses_transport(self, topic: str, direction: str, *, lane: bool) -> bool:
        """Return whether a route has bridged messages over the expected transport: the lane if ``lane``, else zenoh."""
        routes = [r for r in self.status()["routes"] if (r["hub_topic"], r["direction"]) == (topic, direction)]
        transport = "lane" if lane else "zenoh"
        return bool(routes and routes[0]["way"] == transport and routes[0]["ways"][transport])

    def until_route(self, topic: str, direction: str, seconds: float = 15) -> dict[str, Any]:
        return until(lambda: self.route(topic, direction), f"a route {direction} for {topic}", seconds, every=0.1)

    def explain(self, topic: str) -> list[dict[str, Any]]:
        return [
            line for a in self.hub.ask("explain", {"topic": topic}) if isinstance(a.value, list) for line in a.value
        ]


def ros2_name(type_: str) -> str:
    package, _, name = type_.partition("/")
    return f"{package}/msg/{name}"


def service_name(type_: str) -> str:
    package, _, name = type_.partition("/")
    return f"{package}/srv/{name}"
