"""A hub, a separate zenoh network, and programs on it that are modeled on the plugins' sources."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.adapters.zenoh import edge, ros1_discovery
from bridge.clock import SYSTEM
from bridge.config.model import Config
from bridge.hub.session import Hub
from bridge.messages.registry import Registry
from bridge.modules.host import ModuleNode
from bridge.modules.loop import EventLoop
from tests.contract.hubside import HubSide
from tests.contract.zenohside import PERIOD, ZenohBridge
from tests.peers.hub.quick import QuickHub
from tests.peers.zenoh.actions import TEXTS
from tests.peers.zenoh.programs import JsonProgram, Ros1Bridge, Ros2ddsBridge, Router, service_texts
from tests.support.rosbags_messages import Messages
from tests.support.wait import until

ROS1, ROS2 = Messages(ros1=True, texts=service_texts()), Messages(ros1=False, texts=service_texts() | TEXTS)


class Place:
    """The networks of a test and everything that runs on them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.hubs = QuickHub()
        self.router = Router()
        self._open: list[Any] = []
        self._far: HubSide | None = None
        self._node: ModuleNode | None = None

    def config(self, *dialects: dict[str, Any], name: str = "here", **sections: Any) -> Config:
        """Return a configuration with these dialects on the separate network."""
        zenoh = {"router": self.router.endpoint, "dialects": list(dialects)}
        hub = {"listen": self.hubs.endpoint}
        return Config.model_validate({"name": name, "state": self.folder, "hub": hub, "zenoh": zenoh, **sections})

    def bridge(self, *dialects: dict[str, Any], **sections: Any) -> ZenohBridge:
        """Start the adapter with these dialects."""
        bridge = ZenohBridge(self.config(*dialects, **sections))
        self._open.append(bridge)
        return bridge

    @property
    def far(self) -> HubSide:
        """Start a native program on the hub."""
        if self._far is None:
            self._far = HubSide(Hub.open(self.hubs.settings("far")), Registry())
        return self._far

    @property
    def node(self) -> ModuleNode:
        """Return a node on the hub that supports actions."""
        if self._node is None:
            loop = EventLoop("far")
            loop.start()
            self._node = ModuleNode(Hub.open(self.hubs.settings("node")), Registry(), loop, SYSTEM)
        return self._node

    def on_node(self, action: Callable[[], Any]) -> Any:
        """Run an action on the node's thread; return its result."""
        return self.node.loop.call(action)

    def ros2dds(self, namespace: str = "") -> Ros2ddsBridge:
        """Start a zenoh-bridge-ros2dds."""
        return self._keep(Ros2ddsBridge(self.router.endpoint, ROS2, namespace))

    def ros1(self, namespace: str = "*", period: float = PERIOD) -> Ros1Bridge:
        """Start a zenoh-bridge-ros1."""
        return self._keep(Ros1Bridge(self.router.endpoint, ROS1, namespace, period))

    def json(self) -> JsonProgram:
        """Start a program without ROS."""
        return self._keep(JsonProgram(self.router.endpoint))

    def _keep(self, program: Any) -> Any:
        self._open.append(program)
        return program

    def status(self, side: str) -> dict[str, Any]:
        """Return the status of one dialect's worker."""

        def reported() -> dict[str, Any] | None:
            answers = self.far.hub.ask("status", {}, worker=side)
            return next((a.value for a in answers if isinstance(a.value, dict)), None)

        return until(reported, f"{side} reports its status")  # type: ignore[return-value]

    def route(self, side: str, topic: str, direction: str) -> dict[str, Any] | None:
        """Return one route of one dialect."""
        routes = self.status(side)["routes"]
        return next((r for r in routes if r["topic"] == topic and r["direction"] == direction), None)

    def until_route(self, side: str, topic: str, direction: str) -> dict[str, Any]:
        """Wait for a route and return it."""
        result = until(lambda: self.route(side, topic, direction), f"{side} routes {topic} {direction}", every=0.1)
        assert result is not None
        return result

    def explain(self, side: str, topic: str) -> list[dict[str, Any]]:
        """Return the decision of one dialect on a topic."""
        answers = self.far.hub.ask("explain", {"topic": topic}, worker=side)
        return [line for a in answers if isinstance(a.value, list) for line in a.value]

    def close_node(self) -> None:
        """Close the node."""
        node, self._node = self._node, None
        if node is not None:
            node.close()
            node.loop.close()
            node.hub.close()

    def close(self) -> None:
        for thing in reversed(self._open):
            thing.stop()
        if self._far is not None:
            self._far.hub.close()
        self.close_node()
        self.router.stop()
        self.hubs.stop_router()


@pytest.fixture
def place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Place]:
    monkeypatch.setattr(ros1_discovery, "PERIOD", PERIOD)
    monkeypatch.setattr(edge, "LINK_SECONDS", 0.1)
    monkeypatch.setattr(edge, "TICK", 0.05)
    place = Place(tmp_path)
    try:
        yield place
    finally:
        place.close()


def cross(sender: Any, out: int, hearer: Any, heard: int, message: dict[str, Any]) -> Any:
    """Publish until a message arrives; return the first one."""

    def once() -> list[Any]:
        sender.publish(out, message)
        return hearer.wait(heard, 1, 0.2)

    return until(once, "a message crosses")[0]
