"""A hub, a separate zenoh network, and programs on it that are modeled on the plugins' sources."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.adapters.zenoh import edge, ros1_discovery
from bridge.config.model import Config
from bridge.modules.host import ModuleNode
from tests.contract.zenohside import PERIOD, ZenohBridge
from tests.peers.hub.node import HubNode
from tests.peers.hub.rig import HubRig
from tests.peers.zenoh.actions import TEXTS
from tests.peers.zenoh.programs import JsonProgram, Program, Ros1Bridge, Ros2ddsBridge, Router, service_texts
from tests.support.rosbags_messages import Messages
from tests.support.wait import until

ROS1, ROS2 = Messages(ros1=True, texts=service_texts()), Messages(ros1=False, texts=service_texts() | TEXTS)


class Place(HubRig):
    """The networks of a test and everything that runs on them."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.router = Router()
        self._node: HubNode | None = None

    def config(self, *dialects: dict[str, Any], **sections: Any) -> Config:
        """Return a configuration with these dialects on the separate network."""
        return super().config(**{"zenoh": {"router": self.router.endpoint, "dialects": list(dialects)}, **sections})

    def bridge(self, *dialects: dict[str, Any], **sections: Any) -> ZenohBridge:
        """Start the adapter with these dialects."""
        return self.keep(ZenohBridge(self.config(*dialects, **sections)))

    @property
    def node(self) -> ModuleNode:
        """Return a node on the hub that supports actions."""
        if self._node is None:
            self._node = HubNode(self.hubs.settings("node"))
        return self._node.node

    def on_node(self, action: Callable[[], Any]) -> Any:
        """Run an action on the node's thread, and return its result."""
        return self.node.loop.call(action, 60.0)

    def ros2dds(self, namespace: str = "") -> Ros2ddsBridge:
        """Start a bridge like zenoh-bridge-ros2dds."""
        return self.keep(Ros2ddsBridge(self.router.endpoint, ROS2, namespace))

    def ros1(self, namespace: str = "*", period: float = PERIOD) -> Ros1Bridge:
        """Start a bridge like zenoh-bridge-ros1."""
        return self.keep(Ros1Bridge(self.router.endpoint, ROS1, namespace, period))

    def json(self) -> JsonProgram:
        """Start a program without ROS."""
        return self.keep(JsonProgram(self.router.endpoint))

    def route(self, side: str, topic: str, direction: str) -> Any:
        """Return one route of one dialect as a dictionary, or None if it does not exist."""
        routes = self.answer(side)["routes"]
        return next((r for r in routes if r["topic"] == topic and r["direction"] == direction), None)

    def until_route(self, side: str, topic: str, direction: str) -> dict[str, Any]:
        """Wait for a route, and return it."""
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

    def close(self) -> None:
        self.close_node()
        super().close()
        self.router.stop()


@pytest.fixture
def place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Place]:
    monkeypatch.setattr(ros1_discovery, "PERIOD", PERIOD)
    monkeypatch.setattr(edge, "LINK_SECONDS", 0.1)
    monkeypatch.setattr(edge, "TICK", 0.05)
    with Place(tmp_path) as place:
        yield place


def until_linked(program: Program, sessions: int = 1) -> None:
    """Wait until zenoh has linked a program to other sessions directly; meanwhile it may lose a message or a query."""
    until(lambda: len(program.session.info.peers_zid()) >= sessions, f"it is linked to {sessions} other sessions")


def cross(sender: Any, out: int, hearer: Any, heard: int, message: dict[str, Any]) -> Any:
    """Publish until a message arrives, and return the first one."""

    def once() -> list[Any]:
        sender.publish(out, message)
        return hearer.wait(heard, 1, 0.2)

    return until(once, "a message crosses")[0]
