"""A daemon between programs of every side, and a census of its resources."""

from __future__ import annotations

import os
import time
import xmlrpc.client
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from typing_extensions import override

from benchmarks.latency.cases import CASES, Case, Prepared, prepare
from benchmarks.latency.stage import Stage
from benchmarks.latency.usage import DAEMON, WORKERS, Meter, Usage, processes
from bridge.client.status import document_of
from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from bridge.status import StatusDocument

SIDES = ("ros1", "ros2", "zenoh")
QUIET_SECONDS = 1.0
"""Seconds without a message after which no further messages are expected."""


@dataclass(frozen=True, slots=True)
class Census:
    """The daemon's resources at one moment.

    Attributes:
        used: its processes' memory, threads and descriptors, by name.
        routes: routes of each worker.
        tokens: endpoints, nodes and origins in the hub's graph.
        registrations: its publishers, subscribers and services on the ROS 1 master.
    """

    used: Mapping[str, Usage]
    routes: Mapping[str, int]
    tokens: int
    registrations: int


class Deployment(Stage):
    """A stage with a running daemon, a session that observes the hub, and the programs that `program` starts."""

    def __init__(self, cases: Sequence[Case] = CASES, config: Mapping[str, Any] | None = None) -> None:
        lane = {"hub": {"lane": os.environ.get("MIDSPAN_TEST_LANE") != "off"}}
        super().__init__({"ros1": {"poll": 0.1}, "log": {"level": "warning"}, **lane, **(config or {})})
        self._hub: Hub | None = None
        try:
            self._messages: dict[str, Prepared] = {case.key: prepare(case, self.place.folder) for case in cases}
            self.start_bridge()
            self._hub = Hub.open(
                HubSettings(
                    domain=self.place.config.hub.domain,
                    router=self._router,
                    node="watch",
                    daemon="watch",
                    worker="w",
                    shared_memory=False,  # otherwise this session would retain the shared memory of every killed worker
                )
            )
            self.until(
                lambda: sum(worker.state == "running" for worker in self.status().values()) == len(WORKERS),
                "both workers run",
            )
            self.pids = processes(self.place.folder)
        except BaseException:
            self.close()
            raise

    @property
    def _router(self) -> str:
        return f"tcp/127.0.0.1:{self.place.router_port}"

    def program(self, side: str, name: str = "") -> str:
        """Start a program of a side; return the program's name, which is the side's by default."""
        name = name or side
        arguments = (self._router, str(self.place.config.hub.domain)) if side == "zenoh" else ()
        self.launch(name, f"benchmarks.endurance.{side}_program", *arguments, system=side == "ros1")
        self.wait_for(name, "done")
        return name

    def ask(self, program: str, do: str, **params: Any) -> dict[str, Any]:
        """Send a command to a program, and return the answer."""
        return self.command(program, do, "done", **params)

    def topic(self, side: str, name: str, case: str, *, latched: bool = False) -> dict[str, Any]:
        """Return a topic in the format of the programs' commands."""
        return self._messages[case].topic(name, ros1=side == "ros1") | {"latched": latched}

    def status(self) -> dict[str, StatusDocument]:
        """Return each worker's status by side, without the router."""
        assert self._hub is not None
        documents = [document_of(answer) for answer in self._hub.ask("status", {}, timeout=5.0)]
        return {document.side: document for document in documents if document.side in WORKERS}

    def routes(self, prefix: str) -> dict[str, int]:
        """Return the number of each worker's routes for topics with a prefix."""
        return {side: sum(r.topic.startswith(prefix) for r in d.routes) for side, d in self.status().items()}

    def drained(self, *programs: str, seconds: float = QUIET_SECONDS) -> None:
        """Wait until these programs have received nothing for a time, after the senders have stopped."""
        count, since = -1, time.monotonic()
        while time.monotonic() < since + seconds:
            received = sum(self.ask(name, "count")["count"] for name in programs)
            if received != count:
                count, since = received, time.monotonic()
            time.sleep(0.1)

    def census(self) -> Census:
        """Return the daemon's current resources."""
        assert self._hub is not None
        graph = self._hub.graph
        tokens = len(graph.endpoints()) + len(graph.nodes()) + len(graph.origins())
        return Census(self.usage(), self.routes("/"), tokens, self._registrations())

    def usage(self) -> dict[str, Usage]:
        """Return the daemon's processes' memory, threads and descriptors; raises `RuntimeError` if one exited."""
        try:
            return Meter({name: self.pids[name] for name in DAEMON}).read()
        except FileNotFoundError as err:
            msg = f"a process of the daemon has exited ({err.filename}); process ids: {self.pids}\n{self.words()}"
            raise RuntimeError(msg) from err

    def _registrations(self) -> int:
        with xmlrpc.client.ServerProxy(self.place.master) as master:
            state: Any = master.getSystemState("/census")
        return sum(node.startswith("/midspan") for kind in state[2] for _, nodes in kind for node in nodes)

    @override
    def close(self) -> None:
        hub, self._hub = self._hub, None
        if hub is not None:
            hub.close()
        super().close()
