"""The host of a module: its hub node, YARP ports, thread and folder."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bridge.client.actions import ActionClient
from bridge.clock import DONE_TOPIC, DONE_TYPE, RunClock
from bridge.config.model import Config
from bridge.hub.node import Hub, follow_clock
from bridge.messages.registry import Registry
from bridge.modules.action_server import RESULT_SECONDS, AcceptGoal, ActionServer, Brake, Cancel
from bridge.modules.background import Background
from bridge.modules.endpoints import Endpoints
from bridge.modules.loop import ClockTimer, EventLoop, Timer
from bridge.modules.ports import Ports
from bridge.modules.shared import Shared, hub_settings
from bridge.state_file import worker_folder
from bridge.stores.entry import StoreError
from bridge.stores.store import Store


class ModuleNode(Endpoints):
    """A module's node with topics, services and actions, which are closed with the node."""

    def __init__(self, hub: Hub, registry: Registry, loop: EventLoop, clock: RunClock) -> None:
        super().__init__(hub, registry, loop, clock)
        self._actions: list[ActionServer] = []

    def action_server(
        self,
        name: str,
        type_name: str,
        accept: AcceptGoal,
        cancel: Cancel | None = None,
        *,
        result_seconds: float = RESULT_SECONDS,
        brake: Brake | None = None,
    ) -> ActionServer:
        """Serve an action; results are stored for ``result_seconds``.

        Raises `bridge.messages.errors.MessageTypeError`.
        """
        server = ActionServer(self, name, type_name, accept, cancel, result_seconds=result_seconds, brake=brake)
        self._actions = [*(other for other in self._actions if not other.closed), server]
        return server

    def fail_goals(self, reason: str) -> None:
        """Cancel and abort the active goals of all actions."""
        for server in self._actions:
            server.fail_goals(reason)

    def action_client(self, name: str, type_name: str) -> ActionClient:
        """Send goals to an action; raises `bridge.messages.errors.MessageTypeError`."""
        return ActionClient(self, name, type_name)


class Host:
    """Everything that a module needs from Midspan; each start of a module gets a new host.

    Args:
        shared: the session and store that all modules of the process use; they stay open when the module stops.

    Attributes:
        config: the whole configuration.
        loop: the module's thread.
        node: the module's node on the hub.
        yarp: the module's YARP ports.
        clock: the clock for the module's stamps.
        log: the module's logger.
        background: runs the module's slow jobs.
    """

    def __init__(self, name: str, config: Config, registry: Registry, shared: Shared | None = None) -> None:
        self.name, self.config = name, config
        self._shared = shared
        self.log = logging.getLogger(f"midspan.{name}")
        self.loop = EventLoop(f"midspan-{name}")
        hub = Hub.open(hub_settings(config, name, name)) if shared is None else shared.join(name, name)
        self.clock = RunClock(simulated=config.clock.simulated)
        follow_clock(self.clock, hub)
        self.node = ModuleNode(hub, registry, self.loop, self.clock)
        self.yarp = Ports(config, name, None if shared is None else shared.findings)
        # in a simulation, results must not depend on timing, and the steps wait for the module's thread
        self.background = Background(self.loop, name, inline=self.clock.simulated)
        if self.clock.simulated:
            self._done = self.node.publisher(DONE_TOPIC, DONE_TYPE)
            self.clock.on_time(self._acknowledge, last=True)

    @property
    def folder(self) -> Path:
        """The module's folder in the state folder, created at first use."""
        folder = worker_folder(self.config) / self.name
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    @property
    def store(self) -> Store:
        """The store of maps and locations, which all modules of the process share, opened at first use.

        A module must withdraw its own watches when it stops.
        Raises `StoreError` if it is disabled, or its file or the hub cannot be used.
        """
        if self._shared is None:
            raise StoreError("this process has no store")
        return self._shared.stores.store

    def every(self, seconds: float, action: Callable[[], Any]) -> Timer | ClockTimer:
        """Run an action periodically on the module's thread, according to the run's clock."""
        if self.clock.simulated:
            return ClockTimer(self.clock, self.loop, seconds, action)
        return self.loop.every(seconds, action)

    def _acknowledge(self, now: int) -> None:
        """Acknowledge a time of the simulation, after the actions of all timers due at that time have been posted."""
        seconds, nanoseconds = divmod(now, 1_000_000_000)
        time_message = {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": self.name}
        self.loop.post(lambda: self._done.publish(time_message))

    def on_jump(self, forget: Callable[[], Any]) -> None:
        """Call ``forget`` on the module's thread when the clock jumps, to discard what depends on time.

        See `RunClock.on_jump`.
        """
        self.clock.on_jump(lambda: self.loop.post(forget))

    def answer(self, verb: str, handler: Callable[[dict[str, Any]], Any]) -> None:
        """Respond to a verb of the control plane under the module's name, on a thread of the hub."""
        self.node.hub.serve(verb, handler)

    def status(self) -> dict[str, Any]:
        """Return the module's topics and ports for the status document."""
        return {"topics": self.node.status(), "ports": self.yarp.status()}

    def tick(self) -> None:
        """Update the rates; called once a second."""
        self.node.tick()
        self.yarp.tick()

    def close(self) -> None:
        """Close the node, the ports and the thread."""
        self.clock.close()
        self.background.close()
        self.yarp.close()
        self.node.close()
        self.loop.close()
        self.node.hub.close()
