"""A deployment for one test: roscore, a ROS 2 domain, a hub port, a state folder, and the real daemon."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from bridge.hub.node import Hub
from bridge.interfaces.builder import build
from bridge.interfaces.cache import environment
from bridge.interfaces.folders import read_folders
from bridge.messages.registry import Registry
from tests.contract.rmwside import RmwSide
from tests.contract.side import CUSTOM_FOLDER, CUSTOM_TYPES, PEER_FOLDERS
from tests.peers.daemon.midspan import MidspanDaemon
from tests.peers.daemon.routers import end_router
from tests.peers.hub.network import RMW_PEER, ROOT, SDK_PROGRAM
from tests.peers.peer import Peer, stop_all
from tests.peers.ros1.network import EMBEDDED, RosMaster
from tests.peers.ros2.network import ROS2_PEER, ros2_domain, ros2_environment, ros2_python
from tests.support.lane import LANE
from tests.support.missing import COMPILER, ROS2, need
from tests.support.process import DAEMON_SECONDS
from tests.support.status_documents import DOCUMENTS, check_document
from tests.support.wait import until

ANSWER_SECONDS = 5.0
"""Timeout (s) for a worker's reply on a busy machine; nothing waits for a worker that has exited."""


class Deployment(MidspanDaemon):
    """Everything on one machine, started by `midspan run` as a user would do.

    ``embedded`` selects Midspan's own ROS 1 master.
    """

    def __init__(self, folder: Path, *, embedded: bool = EMBEDDED) -> None:
        for reason in (ROS2, COMPILER):
            need(reason)
        super().__init__(folder, "interop")
        self.master = RosMaster(embedded=embedded)
        self._sides = ["ros1", "ros2"]
        self._open: list[Any] = []
        self._own = 0
        """Number of leading items in ``_open`` that belong to the deployment rather than to a test."""
        self._names = 0
        self._watch: Hub | None = None
        self._registry = Registry(folders=PEER_FOLDERS)

    def configure(self, **sections: Any) -> None:
        """Write the configuration file."""
        config = {
            "hub": {"listen": self.endpoint, "lane": LANE},
            "ros1": {"master": self.master.uri, "poll": 0.1},
            "ros2": {"domain": ros2_domain()},
            "types": {"folders": [str(CUSTOM_FOLDER)]},
            **sections,
        }
        self._sides = ["ros1", "ros2"]
        if config.get("yarp", {}).get("enabled", False) or "nameserver" in config.get("yarp", {}):
            self._sides.append("yarp")
        super().configure(**config)

    def start(self, **sections: Any) -> None:
        """Start roscore and the daemon; return when the workers of ROS, and of YARP if it is used, have joined."""
        self.master.start()
        self.configure(**sections)
        self.run()

    def run(self) -> None:
        """Start the daemon; return when all its workers have joined."""
        super().run()
        until(self.joined, f"the workers of {self._sides} have joined", 40, every=0.2)
        self._own = len(self._open)

    def joined(self) -> bool:
        assert self.daemon is not None
        assert self.daemon.popen.poll() is None, self.daemon.output()
        return all(self.worker(side).get("state") == "running" for side in self._sides)

    def status(self) -> list[dict[str, Any]]:
        """Return the status of each worker."""
        if self._watch is None:
            self._watch = Hub.open(self.settings("watch", "w"))
            self._open.append(_Closer(self._watch))
        answers = self._watch.ask("status", {}, timeout=ANSWER_SECONDS)
        answers = [answer for answer in answers if isinstance(answer.value, dict)]
        for answer in answers:
            if answer.worker in DOCUMENTS and answer.value.get("state") != "stopped":
                check_document(answer.value, answer.worker)
        return [answer.value for answer in answers]

    def explain(self, topic: str) -> list[dict[str, Any]]:
        """Return the workers' decisions on a topic."""
        assert self._watch is not None
        answers = self._watch.ask("explain", {"topic": topic}, timeout=ANSWER_SECONDS)
        return [line for a in answers if isinstance(a.value, list) for line in a.value]

    def worker(self, side: str) -> dict[str, Any]:
        """Return the status of one side's worker, or an empty one if it does not respond."""
        return next((d for d in self.status() if d.get("side") == side), {})

    def answer(self, side: str) -> dict[str, Any]:
        """Wait for the status of one side's worker, because a busy worker may not respond at once."""
        status: dict[str, Any] = until(lambda: self.worker(side), f"{side} reports its status")
        return status

    def route(self, side: str, topic: str, direction: str) -> Any:
        """Return one route of one worker as a dictionary, or None if it does not exist."""
        routes = self.worker(side).get("routes", [])
        return next((r for r in routes if r["topic"] == topic and r["direction"] == direction), None)

    def ros1(self, name: str = "") -> Peer:
        """Start a rospy program."""
        peer = self.master.peer(name or self._name("ros1"))
        self._open.append(peer)
        for type_ in CUSTOM_TYPES:
            peer.ask("define", type=type_, definition=self._registry.ros1(type_).definition)
        return peer

    def ros2(self, name: str = "") -> Peer:
        """Start an rclpy program."""
        env = {**ros2_environment(), **environment([build(read_folders([CUSTOM_FOLDER]))])}
        peer = Peer(ROS2_PEER, ros2_python(), env, name or self._name("ros2"))
        self._open.append(peer)
        return peer

    def zenoh(self) -> RmwSide:
        """Start an rmw_zenoh node, whose services run on a Midspan session."""
        hub = Hub.open(self.settings(self._name("zenoh"), "far"))
        side = RmwSide(hub, self._registry, self.endpoint)
        self._open.append(_Closer(side))
        return side

    def rmw(self) -> Peer:
        """Start an rmw_zenoh node in a separate process, with topics only."""
        env = {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1", "PYTHONPATH": str(ROOT)}
        name = self._name("zenoh")
        peer = Peer(RMW_PEER, Path(sys.executable), env, self.endpoint, str(self.settings(name).domain), name)
        self._open.append(peer)
        return peer

    def sdk(self) -> Peer:
        """Start a zenoh-ros2-sdk program, which shares no code with Midspan."""
        env = {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1", "HOME": "/nonexistent"}
        peer = Peer(SDK_PROGRAM, Path(sys.executable), env, str(self.port), "0")
        self._open.append(peer)
        return peer

    def keep(self, thing: Any) -> Any:
        """Register something to be stopped with the deployment, and return it."""
        self._open.append(thing)
        return thing

    def _name(self, side: str) -> str:
        self._names += 1
        return f"{side}_program_{self._names}"

    def until_route(self, side: str, topic: str, direction: str, **values: Any) -> dict[str, Any]:
        """Wait for a route with these values, and return it."""

        def matching() -> dict[str, Any] | None:
            route = self.route(side, topic, direction)
            return route if route and all(route[k] == v for k, v in values.items()) else None

        return until(matching, f"{side} routes {topic} {direction} with {values}", 60, every=0.1)  # type: ignore[return-value]

    def hang_up(self) -> None:
        """Reload the daemon's configuration with SIGHUP."""
        assert self.daemon is not None
        os.kill(self.daemon.pid, signal.SIGHUP)

    def stop_programs(self) -> None:
        """Stop the programs that a test has started; the daemon and the master keep running for the next test."""
        programs = self._open[self._own :]
        del self._open[self._own :]
        stop_all(programs)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        with contextlib.ExitStack() as stack:
            stack.callback(self.master.close)
            stack.callback(self._stop_daemon, show=kind is not None)
            stack.callback(stop_all, self._open)

    def _stop_daemon(self, *, show: bool) -> None:
        if self.daemon is None:
            return
        if show:
            print(self.daemon.output()[-8000:])
        self.daemon.stop(DAEMON_SECONDS)
        end_router(self.folder / "state")


class _Closer:
    def __init__(self, end: Hub | RmwSide) -> None:
        self._end = end

    def stop(self) -> None:
        self._end.close()
