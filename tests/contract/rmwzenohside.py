"""The contract suite's far end as a real rclpy program on rmw_zenoh_cpp."""

from __future__ import annotations

import time
from typing import Any, ClassVar

from typing_extensions import override

from bridge.hub.graph import HubEndpoint
from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from tests.contract.hubside import HubSide
from tests.peers.peer import Peer

NODE = "far_rmw_zenoh"


class RmwZenohSide(HubSide):
    """Publishes, subscribes, serves and calls in a program; a Midspan session has the graph and the control plane."""

    tells_errors: ClassVar[bool] = False
    hears_itself: ClassVar[bool] = True

    def __init__(self, hub: Hub, registry: Registry, program: Peer) -> None:
        super().__init__(hub, registry)
        self._program = program

    @override
    def advertise(self, topic: str, type_: str, *, latched: bool = False, depth: int = 10) -> int:
        return self._program.advertise(topic, type_, latched=latched, depth=depth)

    @override
    def publish(self, endpoint: int, message: dict[str, Any]) -> None:
        self._program.publish(endpoint, message)

    @override
    def publish_raw(self, endpoint: int, payload: bytes) -> None:
        self._program.ask("publish_raw", id=endpoint, hex=payload.hex())

    @override
    def subscribe(self, topic: str, type_: str, *, latched: bool = False, depth: int = 100) -> int:
        return self._program.subscribe(topic, type_, latched=latched, depth=depth)

    @override
    def wait(self, endpoint: int, count: int, seconds: float = 10.0) -> list[dict[str, Any]]:
        return self._program.wait(endpoint, count, seconds)

    @override
    def wait_without(self, endpoint: int, probe: str, count: int) -> list[dict[str, Any]]:
        deadline, others, wanted = time.monotonic() + 60.0, [], count
        while len(others) < count and (left := deadline - time.monotonic()) > 0:
            messages = self._program.wait(endpoint, wanted, left)
            others = [message for message in messages if message["data"] != probe]
            wanted = len(messages) + count - len(others)
        return others

    @override
    def drop(self, endpoint: int) -> None:
        self._program.drop(endpoint)

    @override
    def serve(self, service: str, type_: str, **params: Any) -> Any:
        server = _Server(self._program, self._program.ask("serve", service=service, type=type_, **params)["id"])
        self.servers[service] = server
        return server

    @override
    def call(self, service: str, type_: str, **request: Any) -> Any:
        answer = self._program.ask("call", service=service, type=type_, request=request, seconds=60.0)
        return _Call(self._program, answer["id"])

    @override
    def _is_own(self, endpoint: HubEndpoint) -> bool:
        return endpoint.own or endpoint.node == NODE

    @override
    def close(self) -> None:
        """Stop the program, and leave the hub."""
        try:
            self._program.stop()
        finally:
            super().close()


class _Server:
    def __init__(self, program: Peer, number: int) -> None:
        self._program, self._number = program, number

    def requests(self, count: int = 1, seconds: float = 40.0) -> list[dict[str, Any]]:
        answer = self._program.ask("requests", id=self._number, count=count, seconds=seconds)
        requests: list[dict[str, Any]] = answer["requests"]
        return requests

    def release(self) -> None:
        self._program.ask("release", id=self._number)

    def close(self) -> None:
        self._program.drop(self._number)


class _Call:
    def __init__(self, program: Peer, number: int) -> None:
        self._program, self._number = program, number

    def result(self, seconds: float = 20.0) -> dict[str, Any]:
        return self._program.ask("result", id=self._number, seconds=seconds)
