"""A native hub program that creates endpoints, sends, receives and counts.

Usage: ``python -m benchmarks.endurance.zenoh_program ROUTER DOMAIN``.
"""

from __future__ import annotations

import os
import sys

from typing_extensions import override

from benchmarks.endurance.program import DEPTH, Close, OnMessage, Program
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.registry import Registry


class ZenohProgram(Program):
    """A program that is a node on the hub, with its own zenoh session."""

    def __init__(self, router: str, domain: int) -> None:
        super().__init__()
        node = f"program_{os.getpid()}"
        self._hub = Hub.open(HubSettings(domain=domain, router=router, node=node, daemon="program", worker=node))
        self._registry = Registry()

    @override
    def publisher(self, topic: str, type_: str, *, latched: bool) -> HubPublisher:
        return self._hub.publisher(topic, type_, self._registry.ros2(type_).type_id, _qos(latched=latched))

    @override
    def listen(self, topic: str, type_: str, *, latched: bool, on_message: OnMessage) -> Close:
        # ``on_message`` runs on zenoh's receiving thread, so that a slow callback (``pause``) blocks the program's link
        type_hash = self._registry.ros2(type_).type_id
        subscription = self._hub.subscription(
            topic, type_, type_hash, _qos(latched=latched), lambda sample: on_message(sample.data())
        )
        return subscription.close

    @override
    def close(self) -> None:
        self._hub.close()


def _qos(*, latched: bool) -> Qos:
    return Qos(durability=Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE, depth=DEPTH)


if __name__ == "__main__":
    ZenohProgram(sys.argv[1], int(sys.argv[2])).run()
