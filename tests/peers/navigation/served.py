"""A planner module with YARP, and a program on its hub that sends goals to it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bridge.client.actions import SentGoal
from bridge.hub.node import Hub
from bridge.messages.actions import GoalState
from bridge.messages.registry import Registry
from bridge.modules.host import Host
from tests.peers.hub.modules import Place
from tests.peers.hub.node import HubNode
from tests.peers.navigation.gateway import pose
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.server import NameServer

ACTION, STATUS = "nav2_msgs/action/NavigateToPose", "midspan_msgs/NavigationStatus"


class Program(HubNode):
    """A node with its own thread, and a client of a planner.

    Args:
        hub: the node's hub.
        registry: message types.
        planner: prefix of the planner's names.
    """

    def __init__(self, hub: Hub, registry: Registry, planner: str) -> None:
        super().__init__(hub, registry)
        self._action = f"{planner}/navigate_to_pose"
        self.connect()

    def connect(self) -> None:
        """Connect to the planner, or reconnect."""
        self.client = self.node.action_client(self._action, ACTION)

    def beat(self, seconds: float, tick: Callable[[], Any]) -> None:
        """Call a function periodically."""
        self._timer = self.loop.every(seconds, tick)

    def send(self, x: float, y: float, yaw: float = 0.0, text: str = "", frame: str = "map") -> Sent:
        until(lambda: self.client.ready, "the planner is available", 30)
        return Sent(self, {"pose": pose(x, y, yaw, frame), "behavior_tree": text})

    def close(self) -> None:
        self._timer.close()
        super().close()


class Sent:
    """A sent goal."""

    def __init__(self, program: Program, goal: dict[str, Any]) -> None:
        self.feedback: list[dict[str, Any]] = []
        self._over = threading.Event()
        self._end: tuple[GoalState, dict[str, Any] | None, str] | None = None
        self._loop, client = program.loop, program.client
        self.goal: SentGoal = self._loop.call(lambda: client.send(goal, self._ended, self.feedback.append))

    def _ended(self, goal: SentGoal, result: dict[str, Any] | None, reason: str) -> None:
        self._end = goal.status, result, reason
        self._over.set()

    def cancel(self) -> None:
        self._loop.call(self.goal.cancel)

    def end(self) -> tuple[GoalState, dict[str, Any]]:
        assert self._over.wait(60), "the goal has not ended"
        assert self._end is not None
        status, result, reason = self._end
        assert result is not None, reason
        return status, result


class Served(Place):
    """A place with a name server and a running module.

    Args:
        folder: for the module's state.
        name: the module's name.
    """

    def __init__(self, folder: Path, name: str) -> None:
        super().__init__(folder)
        self._name = name
        self.yarp = NameServer(port=self.port, gc_seconds=0)
        self.yarp.open()

    @property
    def host(self) -> Host:
        return self.worker.running(self._name).host

    @property
    def module(self) -> Any:
        return self.worker.running(self._name).module

    def received(self, port: str) -> int:
        """Return the number of messages that a port of the module has received."""
        return sum(status["messages"] for status in self.host.yarp.status() if status["port"] == port)

    def registered(self, port: str) -> str:
        until(lambda: connections.exists(self.names, port), f"{port} is registered", 30)
        return port

    def close(self) -> None:
        super().close()
        self.yarp.close()
