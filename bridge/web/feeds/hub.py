"""The feeds of the hub: its workers and routes, and its topics."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from typing_extensions import override

from bridge.client.errors import ClientError
from bridge.client.session import Client
from bridge.client.status import answered
from bridge.concurrency import SerialExecutor
from bridge.daemon.query import Phase, ask_daemon
from bridge.doctor.daemon_state import absent
from bridge.hub.errors import HubError
from bridge.hub.graph.tokens import TAPS
from bridge.modules.host import Host
from bridge.sides import all_sides, label
from bridge.status import (
    DaemonStatus,
    EndpointStatus,
    MachineStatus,
    RefusedRoute,
    RouteStatus,
    StatusDocument,
    refused_routes,
    routers_of,
)
from bridge.web.feeds.feed import Feed

_log = logging.getLogger("midspan.web")

STATUS_SECONDS = 1.0
_ASK_SECONDS = 1.0
_NOT_HERE = {phase.value for phase in Phase} - {Phase.OFF.value, Phase.UP.value}
_ROUTE = ("direction", "topic", "hub_topic", "type", "kind", "state", "rate", "bytes", "error", "way", "why")
_ENDPOINT = ("way", "endpoint", "state", "reason", "cure", "machine", "since")


class PolledFeed(Feed):
    """A feed that queries its value periodically, on a thread that may block."""

    def __init__(
        self, host: Host, name: str, executor: SerialExecutor, ask: Callable[[], Any], seconds: float = STATUS_SECONDS
    ) -> None:
        super().__init__(name)
        self._host, self._executor, self._ask, self._seconds = host, executor, ask, seconds
        self._timer: Any = None
        self._asking = False

    @override
    def open(self) -> None:
        """Query now, and then periodically."""
        self._timer = self._host.loop.every(self._seconds, self._poll)
        self._poll()

    @override
    def close(self) -> None:
        self._timer.close()

    def _poll(self) -> None:
        if not self._asking and self.watched:
            self._asking = True
            self._executor.submit(self._run)

    def _run(self) -> None:
        try:
            value, reason = self._ask(), ""
        except (HubError, ClientError) as err:
            value, reason = None, str(err)
        except Exception as err:  # the feed continues: the next query may succeed
            _log.exception("cannot query the feed %s", self.name)
            value, reason = None, f"{type(err).__name__}: {err}"
        self._host.loop.post(partial(self._on_value, value, reason))

    def _on_value(self, value: Any, reason: str) -> None:
        self._asking = False
        self.put(value, reason)


class StatusPoller:
    """Creates the value of the feed ``status``; one thread calls it periodically."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._bytes: dict[tuple[Any, ...], int] = {}
        self._at = 0.0

    def __call__(self) -> dict[str, Any]:
        """Return all workers and routes, with the bytes per second of each route since the last call."""
        status = ask_status(self._client)
        now = time.monotonic()
        before, self._bytes = self._bytes, {}
        for route in status["routes"]:
            key = tuple(route[part] for part in ("daemon", "side", "direction", "topic", "type"))
            total = self._bytes[key] = route.pop("bytes") or 0
            grown = total - before.get(key, total)
            route["bytes_per_second"] = round(max(grown, 0) / (now - self._at))
        self._at = now
        return status


def ask_status(client: Client) -> dict[str, Any]:
    """Return the workers on the hub with their routes, and this daemon's workers that do not answer yet."""
    documents = answered(client, _ASK_SECONDS)
    answering = {(document.daemon, document.worker) for document in documents}
    daemon = ask_daemon(client.config) or DaemonStatus()
    silent = [worker for worker in absent(daemon, _NOT_HERE) if (worker.daemon, worker.worker) not in answering]
    routers = routers_of(documents)
    return {
        "workers": [_worker(document, daemon) for document in (*documents, *silent)],
        "machines": [_machine(router.daemon, machine) for router in routers for machine in router.machines],
        "endpoints": [_endpoint(router.daemon, endpoint) for router in routers for endpoint in router.endpoints],
        "routes": [_route(document, route) for document in documents for route in document.routes],
        "refused": [_refused(document, route) for document in documents for route in refused_routes(document)],
    }


def _worker(document: StatusDocument, daemon: DaemonStatus) -> dict[str, Any]:
    shown = {key: getattr(document, key) for key in ("daemon", "worker", "state", "cpu", "rss", "restarts")}
    if document.restarts is None and document.daemon == daemon.daemon and document.pid:
        reports = (report.restarts for report in daemon.workers if report.pid == document.pid)
        shown["restarts"] = next(reports, None)  # only the daemon counts restarts
    return {
        **shown,
        "side": label(document.side) if document.side in {side.name for side in all_sides()} else None,
        "text": document.error or document.text,
    }


def _machine(daemon: str, machine: MachineStatus) -> dict[str, Any]:
    return {"daemon": daemon, "name": machine.name, "address": machine.address, "trusted": machine.trusted}


def _endpoint(daemon: str, endpoint: EndpointStatus) -> dict[str, Any]:
    return {"daemon": daemon, **{key: getattr(endpoint, key) for key in _ENDPOINT}}


def _route(document: StatusDocument, route: RouteStatus) -> dict[str, Any]:
    half = route.latency_ms.get("p50")
    return {
        "daemon": document.daemon,
        "side": document.side,
        **{key: getattr(route, key) for key in _ROUTE},
        "dropped": sum(route.drops.values()),
        "drops": route.drops,
        "latency": None if half is None else half / 1000.0,
    }


def _refused(document: StatusDocument, route: RefusedRoute) -> dict[str, Any]:
    return {"side": document.side, **{key: getattr(route, key) for key in ("topic", "type", "reason", "cure")}}


def list_topics(client: Client) -> list[dict[str, Any]]:
    """Return the value of ``topics``: the topics on the hub."""
    topics: dict[tuple[str, str], dict[str, Any]] = {}
    graph = client.hub.graph
    for key, endpoints in (("publishers", graph.publishers()), ("subscribers", graph.subscriptions())):
        for end in endpoints:
            if not end.topic.startswith(TAPS):
                empty = {"topic": end.topic, "type": end.type_name, "publishers": 0, "subscribers": 0}
                topics.setdefault((end.topic, end.type_name), empty)[key] += 1
    return [topics[key] for key in sorted(topics)]
