"""The feeds of the hub: its workers and routes, its topics, and any topic's messages."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from bridge.cli.client import CliClient
from bridge.cli.documents import Document, dicts, route_list
from bridge.cli.graph.view import ask_decisions
from bridge.cli.inspection.status import document_of
from bridge.cli.messages import Types
from bridge.cli.output import CliError
from bridge.concurrency import SerialExecutor
from bridge.daemon.query import ask_daemon
from bridge.hub.endpoints.subscription import HubSample, HubSubscription
from bridge.hub.errors import HubError
from bridge.messages.errors import ConversionError
from bridge.modules.host import Host
from bridge.routing.gates import TAPS
from bridge.routing.limits import combined_qos
from bridge.web.feed import Feed

STATUS_SECONDS = 1.0
TOPIC_SECONDS = 0.2
MOST_ITEMS, MOST_TEXT, MOST_DEPTH, MOST_BYTES = 32, 2000, 16, 4 << 20
_ASK_SECONDS = 1.0
_ROUTE = ("direction", "topic", "hub_topic", "type", "kind", "state", "rate", "bytes", "error")
_DECISION = ("daemon", "direction", "decision", "why", "cure")


class AskingFeed(Feed):
    """A feed whose value is asked for again and again, on a thread that may wait."""

    def __init__(
        self, host: Host, name: str, executor: SerialExecutor, ask: Callable[[], Any], seconds: float = STATUS_SECONDS
    ) -> None:
        super().__init__(name)
        self._host, self._executor, self._ask, self._seconds = host, executor, ask, seconds
        self._timer: Any = None
        self._asking = False

    def open(self) -> None:
        """Ask now, and again after each pause."""
        self._timer = self._host.loop.every(self._seconds, self._look)
        self._look()

    def close(self) -> None:
        """Ask no more."""
        self._timer.close()

    def _look(self) -> None:
        if not self._asking and self.watched:
            self._asking = True
            self._executor.submit(self._run)

    def _run(self) -> None:
        try:
            value, why = self._ask(), ""
        except (HubError, CliError) as err:
            value, why = None, str(err)
        self._host.loop.post(partial(self._found, value, why))

    def _found(self, value: Any, why: str) -> None:
        self._asking = False
        self.put(value, why)


class StatusAsker:
    """Makes the value of ``status``. To be called by one thread, again and again."""

    def __init__(self, client: CliClient) -> None:
        self._client = client
        self._bytes: dict[tuple[Any, ...], int] = {}
        self._at = 0.0

    def __call__(self) -> dict[str, Any]:
        """All workers and routes, with the bytes of each route a second since the last call."""
        found = ask_status(self._client)
        now = time.monotonic()
        before, self._bytes = self._bytes, {}
        for route in found["routes"]:
            key = tuple(route[part] for part in ("daemon", "side", "direction", "topic", "type"))
            total = self._bytes[key] = route.pop("bytes") or 0
            grown = total - before.get(key, total)
            route["bytes_per_second"] = round(max(grown, 0) / (now - self._at))
        self._at = now
        return found


def ask_status(client: CliClient) -> dict[str, Any]:
    """All workers that answer on the hub and their routes, and those that do not answer yet, by this daemon's word."""
    documents = [document_of(answer) for answer in client.ask("status", timeout=_ASK_SECONDS)]
    answering = {(str(document["daemon"]), str(document["worker"])) for document in documents}
    said = ask_daemon(client.config) or {}
    absent = [
        {"daemon": said["daemon"], "state": worker["phase"], **{key: worker[key] for key in ("worker", "text")}}
        for worker in said.get("workers", ())
        if worker["phase"] not in ("off", "running") and (said["daemon"], worker["worker"]) not in answering
    ]
    return {
        "workers": [_worker(document) for document in (*documents, *absent)],
        "routes": [_route(document, route) for document in documents for route in route_list(document)],
        "refused": [_refused(document, one) for document in documents for one in dicts(document.get("refused"))],
    }


def _worker(document: Document) -> dict[str, Any]:
    found = {key: document.get(key) for key in ("daemon", "worker", "state", "cpu", "rss", "restarts")}
    return {**found, "text": document.get("error") or document.get("text") or ""}


def _route(document: Document, route: Document) -> dict[str, Any]:
    late, drops = route.get("latency_ms"), route.get("drops")
    half = late.get("p50") if isinstance(late, dict) else None
    return {
        "daemon": document.get("daemon"),
        "side": document.get("side"),
        **{
            key: route.get(key)
            for key in ("direction", "topic", "hub_topic", "type", "kind", "state", "rate", "bytes", "error")
        },
        "dropped": sum(drops.values()) if isinstance(drops, dict) else 0,
        "drops": drops,
        "latency": half / 1000.0 if isinstance(half, int | float) else None,
    }


def _refused(document: Document, one: Document) -> dict[str, Any]:
    return {"side": document.get("side"), **{key: one.get(key) for key in ("topic", "type", "reason", "cure")}}


def list_topics(client: CliClient) -> list[dict[str, Any]]:
    """The value of ``topics``: what is on the hub."""
    found: dict[tuple[str, str], dict[str, Any]] = {}
    graph = client.hub.graph
    for key, endpoints in (("publishers", graph.publishers()), ("subscribers", graph.subscriptions())):
        for end in endpoints:
            if not end.topic.startswith(TAPS):
                empty = {"topic": end.topic, "type": end.type_name, "publishers": 0, "subscribers": 0}
                found.setdefault((end.topic, end.type_name), empty)[key] += 1
    return [found[key] for key in sorted(found)]


def explain(client: CliClient, name: str) -> list[dict[str, Any]]:
    """Why a topic, a service or an action crosses or does not."""
    return [
        {
            "side": found.worker,
            **{key: getattr(found, key) for key in _DECISION},
        }
        for found in ask_decisions(client, name, None)
    ]


class MessageFeed(Feed):
    """``topic:/name``: the newest message of a topic, at most five times a second."""

    def __init__(self, host: Host, client: CliClient, types: Types, executor: SerialExecutor, name: str) -> None:
        super().__init__(name)
        self._host, self._client, self._types, self._executor = host, client, types, executor
        self._topic = name.removeprefix("topic:")
        self._ends: dict[tuple[str, str], HubSubscription] = {}
        self._newest: tuple[HubSample, str, str] | None = None
        self._count, self._since = 0, 0.0
        self._rate: float | None = None
        self._timers: list[Any] = []
        self._busy = False

    def open(self) -> None:
        """Subscribe to whoever publishes it."""
        self._count, self._since, self._rate, self._newest = 0, time.monotonic(), None, None
        self._timers = [
            self._host.loop.every(TOPIC_SECONDS, self._look),
            self._host.loop.every(STATUS_SECONDS, self._second),
        ]
        self._find()

    def close(self) -> None:
        """Subscribe no more."""
        for timer in self._timers:
            timer.close()
        ends, self._ends = self._ends, {}
        for end in ends.values():
            end.close()

    def _find(self) -> None:
        groups: dict[tuple[str, str], list[Any]] = {}
        for endpoint in self._host.node.hub.graph.publishers(self._topic):
            groups.setdefault((endpoint.type_name, endpoint.type_hash), []).append(endpoint)
        for (type_name, type_hash), endpoints in groups.items():
            if (type_name, type_hash) not in self._ends:
                qos = combined_qos([endpoint.qos for endpoint in endpoints])
                take = partial(self._take, type_name, type_hash)
                hub = self._host.node.hub
                self._ends[type_name, type_hash] = hub.subscription(self._topic, type_name, type_hash, qos, take)
        if not self._ends:
            self.put(None, f"nobody publishes {self._topic} on the hub")

    def _take(self, type_name: str, type_hash: str, sample: HubSample) -> None:
        """On zenoh's thread: keep the newest."""
        self._newest = (sample, type_name, type_hash)
        self._count += 1

    def _second(self) -> None:
        now = time.monotonic()
        self._rate, self._count, self._since = round(self._count / (now - self._since), 1), 0, now
        self._find()

    def _look(self) -> None:
        newest, self._newest = self._newest, None
        if newest is not None and not self._busy:
            self._busy = True
            self._executor.submit(partial(self._decode, *newest))

    def _decode(self, sample: HubSample, type_name: str, type_hash: str) -> None:
        """On a thread that may wait: the type's definition may have to be asked for."""
        why, message = "", None
        if len(sample.payload) > MOST_BYTES:
            why = f"a message of {len(sample.payload)} bytes is not shown: pages get at most {MOST_BYTES}"
        else:
            try:
                message = cut(self._types.decode(type_name, type_hash, sample.data()))
            except (CliError, ConversionError, HubError) as err:
                why = str(err)
        self._host.loop.post(partial(self._decoded, type_name, message, why))

    def _decoded(self, type_name: str, message: Any, why: str) -> None:
        self._busy = False
        self.put(None if why else {"type": type_name, "message": message, "rate": self._rate}, why)


def cut(value: Any, depth: int = 0) -> Any:
    """A message as pages get it: of long arrays and texts the beginning, ``{"...": 360}`` says how long they are."""
    if isinstance(value, dict):
        return {key: cut(item, depth + 1) for key, item in value.items()} if depth < MOST_DEPTH else {"...": len(value)}
    if isinstance(value, list):
        found = [cut(item, depth + 1) for item in value[:MOST_ITEMS]]
        return [*found, {"...": len(value)}] if len(value) > MOST_ITEMS else found
    if isinstance(value, str) and len(value) > MOST_TEXT:
        return f"{value[:MOST_TEXT]}... ({len(value)} characters in all)"
    return value
