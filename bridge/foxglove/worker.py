"""The worker of the server for the Foxglove app."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING, Any

from foxglove.websocket import Capability
from typing_extensions import override

from bridge.client.topics import HubTopics
from bridge.client.velocity import STOP_SECONDS
from bridge.config.model import Config
from bridge.foxglove.channels import Channels
from bridge.foxglove.events import Events
from bridge.foxglove.front import Front
from bridge.foxglove.parameters import Parameters
from bridge.foxglove.publishing import Publishing
from bridge.foxglove.scene import SCENE, Scene
from bridge.foxglove.section import FoxgloveSection
from bridge.foxglove.server import FoxgloveServer
from bridge.foxglove.services import Services
from bridge.foxglove.status import ClientStatus, FoxgloveStatus
from bridge.foxglove.visitors import Visitors
from bridge.hub.control import MANUAL_DRIVING_HALTED
from bridge.hub.diagnostics import announce, has_subscribers
from bridge.messages.registry import Registry
from bridge.metrics.section import MetricsSection
from bridge.modules.host import Host
from bridge.web.section import WebSection
from bridge.web.serving.scarce_log import ScarceLog
from bridge.web.verbs.hold import HandDriving
from bridge.worker import Health, StatusHead, Worker

if TYPE_CHECKING:
    from bridge.web.feeds.robot import DrivingFeed
    from bridge.web.serving.tls import ServerTls

_log = logging.getLogger("midspan.foxglove")

GATHER_SECONDS = 0.1
"""Changes of the hub's graph are collected for this long, because hundreds may arrive at once."""


class FoxgloveWorker(Worker):
    """Serves the hub to the Foxglove app, and is a node of the hub like any module."""

    def __init__(self) -> None:
        self._config: Config | None = None
        self._live: Live | None = None

    @override
    def start(self, config: Config) -> None:
        """Open the node and the server; raises `RuntimeError` if the server cannot listen."""
        self._config = config
        SdkLog.install()
        self._live = Live(config)
        self._live.start()
        _log.info("the hub is served to the Foxglove app at %s", self._live.front.address)

    @override
    def reload(self, config: Config) -> bool:
        """Return whether nothing changed; otherwise the worker restarts, and the app reconnects by itself."""
        return config == self._config

    @override
    def health(self) -> Health:
        """Return the server's address and load.

        Raises `TimeoutError` if the worker's thread hangs, and `RuntimeError` if the server has ended.
        """
        assert self._live is not None
        self._live.host.loop.computes()
        self._live.check()
        return Health("running", self._live.text())

    @override
    def diagnostics_wanted(self) -> bool:
        return self._live is not None and has_subscribers(self._live.host.node.hub.graph)

    @override
    def stop(self) -> None:
        live, self._live = self._live, None
        if live is not None:
            live.close()


class Live:
    """The server with all its parts.

    Attributes:
        visitors: the connected clients with their roles.
    """

    def __init__(self, config: Config) -> None:
        section = config.section(FoxgloveSection)
        registry = Registry.of(config.types)
        self._tls = _tls(config) if section.guarded else None
        self.visitors = Visitors()
        self.host = host = Host("foxglove", config, registry)
        self._events = events = Events(self.visitors, lambda: host.loop.post(self._on_events))
        with contextlib.ExitStack() as stack:
            stack.callback(host.close)
            self._server = server = FoxgloveServer(config.name, events, _capabilities(section))
            stack.callback(server.close)
            self.front = Front(section, server.inner, self.visitors, announces=section.commanded, tls=self._tls)
            stack.pop_all()
        self._graph = Gathered(host, self._on_graph_change)
        self._topics = HubTopics(host.node.hub, registry, self._graph.changed)
        self._channels = Channels(server, self._topics)
        self._scene = Scene(host, config, server)
        self._gateway = _gateway(host, config) if section.commanded else None
        web = config.section(WebSection)
        most = web.speed, web.turn
        busy = partial(getattr, self._gateway, "busy", "")
        self._driving = driving = HandDriving(host, config.navigation.velocity, most, busy)
        self._publishing = Publishing(host, server, events, self.visitors, self._topics.definitions, driving)
        self._services = Services(host, server, self.visitors)
        self._parameters = events.parameters = Parameters(host, server, self.visitors)
        if config.section(MetricsSection).diagnostics:
            announce(host.node.hub, registry)
        self._head = StatusHead({"daemon": config.name, "worker": "foxglove", "side": "foxglove"})

    def start(self) -> None:
        loop = self.host.loop
        loop.start()
        if (gateway := self._gateway) is not None:
            loop.call(lambda: gateway.watch(self))  # manual driving must not compete with a planner
        self.host.answer("status", self._status)
        self.host.answer("halt", self._on_halt)
        loop.every(1.0, self._tick)
        self._graph.changed()
        self.front.start()

    def changed(self, name: str, n: int, text: str) -> None:
        """Do nothing: only `DrivingFeed.busy` is used."""

    def check(self) -> None:
        """Reload a certificate that has changed; raises `RuntimeError` if the server has ended."""
        if self._tls is not None:
            self._tls.refresh()
        if self.front.trouble:
            raise RuntimeError(self.front.trouble)

    def text(self) -> str:
        """Return a text with the address and the numbers of clients and topics."""
        clients = len(self.visitors.all())
        shown = f"{self._channels.count} topics, {self._channels.watched} watched"
        return f"{self.front.address}, {clients} client{'' if clients == 1 else 's'}, {shown}"

    def _on_graph_change(self) -> None:
        self._channels.refresh()
        if self.host.config.section(FoxgloveSection).commanded:
            self._services.refresh()

    def _on_events(self) -> None:
        watched, late = self._events.pop_watched()
        self._channels.watch(watched, late)
        self._scene.watch_channels(watched, late)
        self._publishing.refresh()

    def _tick(self) -> None:
        self.host.tick()
        self._channels.tick()
        self._publishing.tick()
        self._services.tick()
        self._parameters.tick()

    def _on_halt(self, _params: Any) -> dict[str, Any]:
        self.host.loop.call(self._driving.halt)
        return MANUAL_DRIVING_HALTED

    def _status(self, _params: Any) -> dict[str, Any]:
        now = time.monotonic()
        clients = [
            ClientStatus(who=v.who, role=v.grant.role, bytes=v.sent, since=round(now - v.since, 1))
            for v in self.visitors.all()
        ]
        return FoxgloveStatus(
            **self._head.fields("running", self.text()),
            refused=self._channels.refused(),
            warnings=[f"{SCENE} without places: {self._scene.error}"] if self._scene.error else [],
            clients=clients,
            topics=[*self._channels.status(), *self._publishing.status()],
            services=self._services.count,
            dropped=self._events.dropped,
            channels=self._channels.count,
        ).document()

    def stop_publishing(self) -> None:
        """Stop the robot if a client drives it, and stop publishing. Call it on the worker's thread."""
        self._publishing.close()

    def close(self) -> None:
        """Stop the robot if a client drives it, disconnect the clients, then leave the hub."""
        self.host.loop.call(self.stop_publishing)
        self.front.close()
        self._server.close()
        self._services.close()
        self.host.loop.call(self._parameters.close)
        self.host.loop.call(self._scene.end)
        self.host.loop.call(self._channels.close)
        self._topics.close()
        self._driving.stopped.wait(2 * STOP_SECONDS)
        self.host.close()


def _gateway(host: Host, config: Config) -> DrivingFeed:
    from bridge.web.feeds.robot import DrivingFeed  # not needed for watching

    return DrivingFeed(host, config)


def _tls(config: Config) -> ServerTls:
    from bridge.web.serving.tls import ServerTls

    return ServerTls(config, "the Foxglove server")


def _capabilities(section: FoxgloveSection) -> list[Capability]:
    """Return the capabilities to announce to all clients.

    A client that may only watch can read parameters, but is refused when it sets them, publishes or calls services.
    """
    commands = [Capability.ClientPublish, Capability.Services] if section.commanded else []
    return [Capability.Parameters, *commands]


class SdkLog(logging.Handler):
    """Rate-limits the SDK's log, which has a line for each invalid frame of a client."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._log = ScarceLog("midspan.foxglove")

    @override
    def emit(self, record: logging.LogRecord) -> None:
        self._log.warn(f"the SDK: {record.getMessage()[:500]}")

    @classmethod
    def install(cls) -> None:
        """Handle everything that the SDK logs in this process."""
        logger = logging.getLogger("foxglove")
        logger.handlers, logger.propagate = [cls()], False


class Gathered:
    """Merges many changes into one delayed call on the worker's thread."""

    def __init__(self, host: Host, callback: Callable[[], None]) -> None:
        self._host, self._callback = host, callback
        self._lock = Lock()
        self._due = False

    def changed(self) -> None:
        """Schedule the call. Safe from any thread, even before the worker's thread runs."""
        with self._lock:
            due, self._due = self._due, True
        if not due:
            self._host.loop.after(GATHER_SECONDS, self._run)

    def _run(self) -> None:
        with self._lock:
            self._due = False
        self._callback()
