"""The feeds of the hub: its workers and routes, and its topics."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from bridge.client.errors import ClientError
from bridge.client.session import Client
from bridge.client.status import Document, answered, dicts, route_list
from bridge.concurrency import SerialExecutor
from bridge.daemon.query import Phase, ask_daemon
from bridge.doctor.daemon_state import absent
from bridge.hub.errors import HubError
from bridge.hub.graph.tokens import TAPS
from bridge.modules.host import Host
from bridge.sides import all_sides, label
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

    def open(self) -> None:
        """Query now, and again after each pause."""
        self._timer = self._host.loop.every(self._seconds, self._poll)
        self._poll()

    def close(self) -> None:
        """Stop querying."""
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
    """Makes the value of ``status``; one thread calls it periodically."""

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
    """Return the workers on the hub with their routes, and those that this daemon reports as not answering yet."""
    documents = answered(client, _ASK_SECONDS)
    answering = {(str(document["daemon"]), str(document["worker"])) for document in documents}
    daemon = ask_daemon(client.config) or {}
    silent = [worker for worker in absent(daemon, _NOT_HERE) if (daemon["daemon"], worker["worker"]) not in answering]
    restarts = {worker["pid"]: worker["restarts"] for worker in daemon.get("workers", ()) if worker["pid"]}
    return {
        "workers": [_worker(document, daemon, restarts) for document in (*documents, *silent)],
        "machines": [_machine(document, entry) for document in documents for entry in dicts(document.get("machines"))],
        "endpoints": [
            _endpoint(document, entry) for document in documents for entry in dicts(document.get("endpoints"))
        ],
        "routes": [_route(document, route) for document in documents for route in route_list(document)],
        "refused": [_refused(document, entry) for document in documents for entry in dicts(document.get("refused"))],
    }


def _worker(document: Document, daemon: Document, restarts: Mapping[int, int]) -> dict[str, Any]:
    shown = {key: document.get(key) for key in ("daemon", "worker", "state", "cpu", "rss", "restarts")}
    if shown["restarts"] is None and document.get("daemon") == daemon.get("daemon"):
        shown["restarts"] = restarts.get(document.get("pid", 0))  # only the daemon has this count
    side = document.get("side")
    return {
        **shown,
        "side": label(side) if isinstance(side, str) and side in {side_.name for side_ in all_sides()} else None,
        "text": document.get("error") or document.get("text") or "",
    }


def _machine(document: Document, machine: Document) -> dict[str, Any]:
    return {"daemon": document.get("daemon"), **{key: machine.get(key) for key in ("name", "address", "trusted")}}


def _endpoint(document: Document, endpoint: Document) -> dict[str, Any]:
    return {"daemon": document.get("daemon"), **{key: endpoint.get(key) for key in _ENDPOINT}}


def _route(document: Document, route: Document) -> dict[str, Any]:
    late, drops = route.get("latency_ms"), route.get("drops")
    half = late.get("p50") if isinstance(late, dict) else None
    return {
        "daemon": document.get("daemon"),
        "side": document.get("side"),
        **{key: route.get(key) for key in _ROUTE},
        "dropped": sum(drops.values()) if isinstance(drops, dict) else 0,
        "drops": drops,
        "latency": half / 1000.0 if isinstance(half, int | float) else None,
    }


def _refused(document: Document, refusal: Document) -> dict[str, Any]:
    return {"side": document.get("side"), **{key: refusal.get(key) for key in ("topic", "type", "reason", "cure")}}


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
