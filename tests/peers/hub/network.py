"""A hub for one test: a router on a free port, and settings for sessions that join it."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import zenoh

from bridge.hub.session import HubSettings
from bridge.hub.zenoh_config import make_config, session_tree
from tests.peers.peer import Peer
from tests.peers.zenoh.rmw import rmw_session
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until

ROUTER_PROGRAM = Path(__file__).with_name("router.py")
PEER_PROGRAM = Path(__file__).with_name("peer.py")
RMW_PEER = Path(__file__).parents[1] / "zenoh" / "rmw_peer.py"
RMW_PROGRAM = Path(__file__).parents[1] / "zenoh" / "rmw_node.py"
SDK_PROGRAM = Path(__file__).parents[1] / "zenoh" / "sdk_peer.py"
ROOT = Path(__file__).parents[3]


class HubNetwork:
    """A router in a separate process on a free port of loopback.

    Args:
        domain: the hub's domain.
        zenoh: zenoh configuration that overrides that of the sessions.
        router_zenoh: zenoh configuration that overrides that of the router.
        protocol: ``tcp`` or ``tls``.
        run: whether the router runs from the start.
        external: the configuration's ``hub.open``.
        routing: the configuration's ``routing``.
    """

    def __init__(
        self,
        domain: int = 0,
        zenoh: dict[str, Any] | Path | None = None,
        router_zenoh: dict[str, Any] | Path | None = None,
        protocol: str = "tcp",
        *,
        run: bool = True,
        external: dict[str, Any] | None = None,
        routing: dict[str, Any] | None = None,
    ) -> None:
        self.external = external or {}
        self._routing = routing or {}
        self.domain = domain
        self.port = free_port()
        self.endpoint = f"{protocol}/127.0.0.1:{self.port}"
        self._zenoh = zenoh
        self._router_zenoh = router_zenoh
        self._router: Process | None = None
        if run:
            self.start_router()

    def settings(self, node: str, worker: str = "test", daemon: str = "test", **more: Any) -> HubSettings:
        """Return settings for a session on this hub."""
        values: dict[str, Any] = {"domain": self.domain, "router": self.endpoint, "zenoh": self._zenoh, **more}
        return HubSettings(node=node, worker=worker, daemon=daemon, **values)

    def config(self, **more: Any) -> dict[str, Any]:
        """Return the ``hub`` section of a configuration for this hub."""
        section = {"domain": self.domain, "listen": self.endpoint, "zenoh": self._zenoh, **more}
        return {key: str(value) if isinstance(value, Path) else value for key, value in section.items()}

    def start_router(self) -> None:
        """Start the router, and wait until it listens."""
        hub = self.config(router=True, open=self.external)
        over = self._router_zenoh
        hub["router_zenoh"] = str(over) if isinstance(over, Path) else over
        router = self._router = Process(
            [sys.executable, ROUTER_PROGRAM, json.dumps({"name": "test", "hub": hub, "routing": self._routing})],
            {"PYTHONPATH": str(ROOT)},
        )
        until(lambda: "listening" in router.output() or router.popen.poll() is not None, "the router listens")
        assert router.popen.poll() is None, router.output()

    def signal_router(self, number: signal.Signals) -> None:
        """Send a signal to the router's process."""
        assert self._router is not None
        self._router.signal(number)

    def stop_router(self) -> None:
        """Stop the router; the other sessions of the hub stay open."""
        if self._router is not None:
            self._router.stop()
            self._router = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.stop_router()

    @contextmanager
    def program(self) -> Iterator[zenoh.Session]:
        """Open a session as a plain zenoh program without ROS 2."""
        tree = session_tree(self.endpoint, shared_memory=False, max_payload=1 << 20)
        with zenoh.open(make_config(tree, {"mode": "client"})) as session:
            yield session

    @contextmanager
    def rmw_session(self, mode: str = "peer") -> Iterator[zenoh.Session]:
        """Open a session as an rmw_zenoh node does; see `tests.peers.zenoh.rmw`."""
        with rmw_session(self.endpoint, mode) as session:
            yield session

    def rmw_process(self, node: str, lease: float) -> Process:
        """Start an rmw_zenoh node in a separate process, with a lease in seconds; see `tests.peers.zenoh.rmw_node`."""
        arguments = [self.endpoint, str(self.domain), node, str(round(lease * 1000))]
        return Process([sys.executable, RMW_PROGRAM, *arguments], {"PYTHONPATH": str(ROOT)}, pipes=True)

    def hub_peer(self, node: str, **more: Any) -> Peer:
        """Start a hub session in a separate process, driven by the commands of `tests.peers.hub.peer`."""
        env = {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1", "PYTHONPATH": str(ROOT)}
        settings = json.dumps(asdict(self.settings(node, **more)))
        return Peer(PEER_PROGRAM, Path(sys.executable), env, settings)

    def sdk_peer(self) -> Peer:
        """Start a zenoh-ros2-sdk program on this hub, in a separate process."""
        env = {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1", "HOME": "/nonexistent"}
        return Peer(SDK_PROGRAM, Path(sys.executable), env, str(self.port), str(self.domain))
