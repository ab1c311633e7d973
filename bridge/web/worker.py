"""The worker of the console."""

from __future__ import annotations

import logging
from typing import Any

from starlette.websockets import WebSocket
from typing_extensions import override

from bridge import __version__
from bridge.client.session import Client
from bridge.client.types import Types
from bridge.client.velocity import STOP_SECONDS
from bridge.concurrency import SerialExecutor
from bridge.config.model import Config
from bridge.hub.control import MANUAL_DRIVING_HALTED, WorkerAnswer
from bridge.hub.daemons import identity_of
from bridge.hub.diagnostics import announce, has_subscribers
from bridge.hub.namesakes import own_answers
from bridge.messages.registry import Registry
from bridge.metrics.endpoint import MetricsRoutes
from bridge.metrics.section import MetricsSection
from bridge.metrics.source import ASK_SECONDS, Source
from bridge.modules.host import Host
from bridge.state_file import worker_folder
from bridge.status import WorkerStatus
from bridge.web.feeds.feed import Feeds
from bridge.web.feeds.frames import FrameFollower
from bridge.web.feeds.map_pictures import Pictures
from bridge.web.feeds.maps import StoreFollower
from bridge.web.feeds.patrol import PatrolFeed
from bridge.web.feeds.planner import PLANNER_SECONDS, PlannerFollower
from bridge.web.feeds.robot import DrivingFeed
from bridge.web.page import Page
from bridge.web.section import WebSection
from bridge.web.serving.access import Access, Grant, stored_secret
from bridge.web.serving.console import WebServer, hello
from bridge.web.serving.tls import ServerTls
from bridge.web.verbs.hold import HOLD_SECONDS, HandDriving
from bridge.web.verbs.patrol import ANOTHER, STOPPED, Patrol
from bridge.web.verbs.robot import RobotVerbs
from bridge.web.verbs.verbs import Verbs
from bridge.web.views import Parts, all_views
from bridge.worker import Health, StatusHead, Worker

_log = logging.getLogger("midspan.web")


class WebWorker(Worker):
    """Serves the console's page, and is a node of the hub like any module."""

    def __init__(self) -> None:
        self._config: Config | None = None
        self._console: Console | None = None

    @override
    def start(self, config: Config) -> None:
        """Open the node and the server; raises `RuntimeError` if the server cannot listen or store its secret."""
        self._config = config
        self._console = Console(config)
        self._console.start()
        _log.info("the console is at %s", self._console.server.address)

    @override
    def reload(self, config: Config) -> bool:
        """Return whether nothing changed; otherwise the worker restarts, and pages reconnect by themselves."""
        return config == self._config

    @override
    def health(self) -> Health:
        """Return the address and the number of open pages.

        Raises `TimeoutError` if the module's thread hangs, and `RuntimeError` if the server has ended.
        """
        assert self._console is not None
        console = self._console
        console.host.loop.computes()
        console.refresh_tls()
        if console.server.trouble:
            raise RuntimeError(console.server.trouble)
        pages = console.server.pages
        return Health("running", console.server.address + (f", {pages} open" if pages else ""))

    @override
    def diagnostics_wanted(self) -> bool:
        return self._console is not None and has_subscribers(self._console.host.node.hub.graph)

    @override
    def stop(self) -> None:
        console, self._console = self._console, None
        if console is not None:
            console.close()


class Console:
    """The console with all its parts.

    Attributes:
        feeds: what pages may watch.
        verbs: what pages may call.
    """

    def __init__(self, config: Config) -> None:
        section = config.section(WebSection)
        registry = Registry.of(config.types)
        pictures = Pictures(section.prefix)
        self._tls = ServerTls(config) if section.guarded else None
        access = Access(section, stored_secret(worker_folder(config)) if section.guarded else b"")
        metrics = MetricsRoutes(config, Source(config, self._ask_workers))
        views = all_views()
        self.server = WebServer(
            section.listen, self._serve, views, pictures, access, self._tls, metrics.routes, section.names
        )
        try:
            self.host = host = Host("web", config, registry)
        except BaseException:
            self.server.close()
            raise
        if config.section(MetricsSection).diagnostics:
            announce(host.node.hub, registry)
        self._head = StatusHead({"side": "web"}, uptime=False)
        client = Client(host.node.hub, config, f"the hub of {config.name}")
        known = Types(client)
        self._asking, self._decoding = SerialExecutor("midspan-web-ask"), SerialExecutor("midspan-web-decode")
        follower, self._store = FrameFollower(host, config), StoreFollower(host, config)
        driving, patrol_feed = DrivingFeed(host, config), PatrolFeed()
        self._driving, self._patrol = driving, Patrol(host, driving, patrol_feed.publish)
        self._planner = PlannerFollower(host, client, driving, self._asking)
        parts = Parts(
            host, config, client, known, follower, self._store, driving, pictures, self._asking, self._decoding
        )
        offers = [view.offer(parts) for view in views]
        self._closing = [action for offer in offers for action in offer.closing]
        self.feeds = Feeds(
            [driving, patrol_feed, *(feed for offer in offers for feed in offer.feeds)],
            {prefix: make for offer in offers for prefix, make in offer.factories.items()},
        )
        most = (section.speed, section.turn)
        self._hold = HandDriving(
            host, config.navigation.velocity, most,
            busy=lambda: driving.busy or self._patrol.busy, on_begin=driving.moved_by_hand,
        )  # fmt: skip
        self._robot = robot = RobotVerbs(
            host, config, client, known, self._store.client,
            on_planner=driving.on_planner, pause_or_resume=self._patrol.pause_or_resume,
        )  # fmt: skip
        self.verbs = Verbs(
            {
                **robot.verbs(),
                **self._patrol.verbs(),
                **{name: verb for offer in offers for name, verb in offer.verbs.items()},
            },
            host.loop.post,
            {
                **dict.fromkeys(("stop", "halt"), self._stop_robot),
                **dict.fromkeys(("goto", "goto_place"), lambda: self._patrol.end(ANOTHER)),
            },
        )
        host.answer("halt", self._on_halt)
        self._hello = hello(config.name, __version__, config.navigation.frame, most, HOLD_SECONDS)

    def start(self) -> None:
        loop = self.host.loop
        loop.start()
        loop.call(lambda: self._driving.watch(self))  # always, because a page must not drive against a planner
        self.host.answer("status", self._status)
        loop.every(1.0, self.host.tick)
        loop.every(PLANNER_SECONDS, self._follow_planner)
        self.server.start()

    def changed(self, name: str, n: int, text: str) -> None:
        """Do nothing: only `DrivingFeed.busy` is used."""

    def _follow_planner(self) -> None:
        if self.server.pages:
            self._planner.refresh()

    def refresh_tls(self) -> None:
        """Load a renewed certificate."""
        if self._tls is not None:
            self._tls.refresh()

    async def _serve(self, socket: WebSocket, grant: Grant) -> None:
        await Page(socket, grant, self._hello, self.feeds, self.verbs, self._hold, self.host.loop.post).serve()

    def _ask_workers(self) -> list[WorkerAnswer]:
        """Query the status of this daemon's workers, on a server thread that may block."""
        hub, config = self.host.node.hub, self.host.config
        answers = hub.ask("status", {}, daemon=config.name, timeout=ASK_SECONDS)
        return own_answers(answers, hub.zid, identity_of(config))

    def _stop_robot(self) -> None:
        self._hold.halt()
        self._patrol.end(STOPPED)
        self._robot.cancel_starting()

    def _on_halt(self, _params: Any) -> dict[str, Any]:
        self.host.loop.call(self._stop_robot)
        return MANUAL_DRIVING_HALTED

    def _status(self, _params: Any) -> dict[str, Any]:
        pages = self.server.pages
        head = self._head.fields("running", self.server.address, pages=pages)
        return WorkerStatus(**head, metrics={"pages": pages}, **self.host.status()).document()

    def close(self) -> None:
        """Stop the robot if a page or a patrol drives it, then leave the hub."""
        self.server.close()
        self.host.loop.call(self._stop_robot)
        self.host.loop.call(self._hold.end)  # the server's thread may still run
        self.host.loop.call(self.feeds.close)
        self.verbs.close()
        for close in self._closing:
            close()
        for executor in (self._asking, self._decoding):
            executor.close()
        self._store.close()
        self._hold.stopped.wait(2 * STOP_SECONDS)
        self.host.close()
