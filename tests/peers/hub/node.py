"""A node on the hub with its own thread, for programs and rigs in the test's process."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

from bridge.clock import SYSTEM
from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from bridge.messages.registry import Registry
from bridge.modules.host import ModuleNode
from bridge.modules.loop import EventLoop

REGISTRY = Registry()


class HubNode:
    """A node on the hub with its own thread.

    Args:
        hub: settings of a session that the node opens and closes, or an open session.
        registry: message types.
    """

    def __init__(self, hub: Hub | HubSettings, registry: Registry = REGISTRY) -> None:
        self._owns_session = isinstance(hub, HubSettings)
        self.hub = Hub.open(hub) if isinstance(hub, HubSettings) else hub
        self.loop = EventLoop(hub.node if isinstance(hub, HubSettings) else "node")
        self.node = ModuleNode(self.hub, registry, self.loop, SYSTEM)
        self.loop.start()

    def on(self, action: Callable[[], Any]) -> Any:
        """Run an action on the node's thread, and return its result."""
        return self.loop.call(action, 20.0)

    def close(self) -> None:
        """Leave the hub."""
        self.node.close()
        self.loop.close()
        if self._owns_session:
            self.hub.close()

    def stop(self) -> None:
        """Leave the hub."""
        self.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
