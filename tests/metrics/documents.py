"""Status documents of workers, for tests of the metrics."""

from __future__ import annotations

import time
from typing import Any

from bridge.metrics.source import Snapshot
from bridge.routing.counters import Counters
from bridge.routing.services.route import CallCounters
from bridge.status import read_daemon_status, read_status


def route(topic: str = "/scan", **more: Any) -> dict[str, Any]:
    """Return a topic's route with real counters: three messages, two with a latency, one drop."""
    counters = Counters()
    counters.crossed(100)
    for before in (0.003, 2.0):
        counters.carried(100, time.monotonic() - before)
    counters.add_latency(300_000)
    counters.add_latency(40_000_000)
    counters.dropped("queue")
    row = {"kind": "topic", "direction": "in", "hub_topic": topic, "type": "sensor_msgs/msg/LaserScan"}
    return {**row, **counters.as_dict(), "ways": {"lane": 2, "zenoh": 1}, **more}


def service(name: str = "/add") -> dict[str, Any]:
    """Return a service's route with one reply and one pending call."""
    counters = CallCounters()
    counters.crossed(8)
    counters.replies = counters.pending = 1
    return {"kind": "service", "direction": "out", "hub_topic": name, "type": "a/srv/Add", **counters.as_dict()}


def side(*routes: dict[str, Any], worker: str = "ros1", **more: Any) -> dict[str, Any]:
    """Return a side's status document."""
    lease = {"active": True, "changes": 3, "members": 2}
    head = {"daemon": "here", "worker": worker, "side": worker, "pid": 0, "state": "running", "lease": lease}
    return {**head, "refused": [], "routes": list(routes), **more}


def snapshot(*documents: dict[str, Any], **daemon: Any) -> Snapshot:
    """Return a source's snapshot."""
    read = tuple(read_status(document, "here", document["worker"]) for document in documents)
    return Snapshot("here", read, read_daemon_status(daemon) if daemon else None, hub=True, seconds=0.01)
