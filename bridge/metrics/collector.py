"""Converts the workers' status documents to metric families."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from contextlib import suppress

import psutil
from prometheus_client.core import Metric
from prometheus_client.registry import Collector

from bridge import __version__
from bridge.daemon.query import Phase
from bridge.hub.security.reasons import EndpointState
from bridge.metrics.families import Families, Family, Kind
from bridge.metrics.routes import RouteMetrics
from bridge.metrics.source import AT_REST, Document, Snapshot, Source
from bridge.sides import all_networks

MOST_CUSTOM = 50
"""Largest number of its own metrics that a worker may add."""

_CUSTOM_NAME = re.compile(r"[a-z][a-z0-9_]{0,60}")
_PHASES = tuple(phase.value for phase in Phase if phase.value not in AT_REST)
_STATES = ("running", "waiting", "standby")
_ENDPOINT_STATES = frozenset(EndpointState)
_MODULE_STATES = ("running", "waiting", "standby", "stopped")


class MidspanCollector(Collector):
    """Collects the metric families of one daemon.

    Args:
        source: provides the status documents.
        most_routes: largest number of routes that are reported for each side.
    """

    def __init__(self, source: Source, most_routes: int) -> None:
        self._source = source
        self._routes = RouteMetrics(most_routes)

    def describe(self) -> Iterable[Metric]:
        """Return nothing: to get the names, the library would query all workers."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """Return all families that have samples."""
        return self.families(self._source.snapshot())

    def families(self, snapshot: Snapshot) -> Families:
        """Return the families of one snapshot."""
        families = Families()
        _daemon(families, snapshot)
        _workers(families, snapshot)
        sides = all_networks()
        for document in snapshot.documents:
            if document.get("module") is True:
                _module(families, document)
            elif document.get("side") in sides:
                _side(families, document)
                self._routes.add(families, document)
            elif document["worker"] == "router":
                _router(families, document)
            _add_custom(families, document)
        return families


def _daemon(families: Families, snapshot: Snapshot) -> None:
    add = families.add
    add("midspan_build_info", 1, __version__, snapshot.name)
    add("midspan_daemon_up", bool(snapshot.daemon))
    add("midspan_hub_up", snapshot.hub)
    add("midspan_ask_duration_seconds", snapshot.seconds)
    if snapshot.daemon:
        add("midspan_daemon_uptime_seconds", snapshot.daemon.get("uptime"))
        add("midspan_daemon_config_refused", bool(snapshot.daemon.get("refused")))
        _process(families, "daemon", snapshot.daemon.get("pid"))


def _workers(families: Families, snapshot: Snapshot) -> None:
    add = families.add
    answering = {document.get("pid") for document in snapshot.documents}
    for status in snapshot.workers:
        worker, phase = status["worker"], status["phase"]
        add("midspan_worker_up", phase == Phase.UP.value, worker)
        for name in _PHASES:
            add("midspan_worker_phase", phase == name, worker, name)
        add("midspan_worker_answering", bool(status["pid"]) and status["pid"] in answering, worker)
        add("midspan_worker_restarts_total", status["restarts"], worker)
        add("midspan_worker_heartbeat_age_seconds", status.get("beat"), worker)
        _process(families, worker, status["pid"])


def _process(families: Families, worker: str, pid: object) -> None:
    """Add the operating system's metrics of a process, which are available even if it hangs."""
    if not isinstance(pid, int) or not pid:
        return
    with suppress(psutil.Error, OSError):
        process = psutil.Process(pid)
        with process.oneshot():
            times = process.cpu_times()
            families.add("midspan_worker_cpu_seconds_total", times.user + times.system, worker)
            families.add("midspan_worker_resident_memory_bytes", process.memory_info().rss, worker)
            families.add("midspan_worker_open_fds", process.num_fds(), worker)


def _router(families: Families, document: Document) -> None:
    families.add("midspan_router_sessions", document.get("sessions"))
    machines = document.get("machines")
    if isinstance(machines, list):
        for trusted in (True, False):
            count = sum(isinstance(entry, dict) and bool(entry.get("trusted")) is trusted for entry in machines)
            families.add("midspan_router_machines", count, str(trusted).lower())
    families.add("midspan_router_refused_connections_total", document.get("refused_connections"))
    endpoints = document.get("endpoints")
    for entry in endpoints if isinstance(endpoints, list) else ():
        if isinstance(entry, dict) and entry.get("state") in _ENDPOINT_STATES:
            _endpoint(families, entry)


def _endpoint(families: Families, endpoint: Document) -> None:
    labels, state = (str(endpoint.get("way")), str(endpoint.get("endpoint"))), EndpointState(endpoint["state"])
    families.add("midspan_router_endpoint_up", state.good and state is not EndpointState.CONNECTING, *labels)
    for other in EndpointState:
        families.add("midspan_router_endpoint_state", other is state, *labels, other)
    families.add("midspan_router_endpoint_since_timestamp_seconds", endpoint.get("since"), *labels)


def _module(families: Families, document: Document) -> None:
    add = families.add
    for state in _MODULE_STATES:
        add("midspan_module_state", document.get("state") == state, document["worker"], state)
    store, goals = document.get("store"), document.get("goals_ended")
    if isinstance(store, dict) and document["worker"] == "store":
        _store(families, store)
    if isinstance(goals, dict):
        for outcome, count in goals.items():
            add("midspan_goals_total", count, outcome)
        add("midspan_goal_active", document.get("goal") is not None)


def _store(families: Families, store: Document) -> None:
    add = families.add
    for kind, count in _mapping(store.get("keys")).items():
        add("midspan_store_values", count, kind)
    add("midspan_store_bytes", store.get("bytes"))
    add("midspan_store_limit_bytes", _mapping(store.get("limits")).get("bytes"))
    add("midspan_store_deleted", store.get("deleted"))
    add("midspan_store_conflicts_total", store.get("conflicts"))
    add("midspan_store_refused_total", store.get("refused"))
    add("midspan_store_last_change_timestamp_seconds", store.get("changed"))
    others = store.get("others")
    add("midspan_store_replicas", len(others) if isinstance(others, list) else None)


def _side(families: Families, document: Document) -> None:
    add, side = families.add, document["worker"]
    for state in _STATES:
        add("midspan_side_state", document.get("state") == state, side, state)
    lease = _mapping(document.get("lease"))
    add("midspan_side_lease", lease.get("active"), side)
    add("midspan_side_lease_changes_total", lease.get("changes"), side)
    add("midspan_side_members", lease.get("members"), side)
    refused = document.get("refused")
    add("midspan_side_refused", len(refused) if isinstance(refused, list) else None, side)


def _add_custom(families: Families, document: Document) -> None:
    """Add the metrics under the key ``metrics`` of a worker's or module's status document.

    ``{"metrics": {"written_bytes_total": 12, "disk_free_bytes": 3.5e9}}`` of the worker ``record`` becomes
    ``midspan_record_written_bytes_total`` and ``midspan_record_disk_free_bytes``. A name consists of
    lower-case letters, digits and underscores, and includes the unit. A name that ends in ``_total`` is a counter,
    which starts at 0 with the process; any other is a gauge. Values are numbers. These metrics have no labels, and
    their names are a bounded set.
    """
    worker = re.sub(r"[^a-z0-9_]", "_", str(document["worker"]).lower())
    samples = [
        (name, value)
        for name, value in _mapping(document.get("metrics")).items()
        if _CUSTOM_NAME.fullmatch(str(name)) and isinstance(value, int | float)
    ]
    for name, value in samples[:MOST_CUSTOM]:
        title = name.removesuffix("_total").replace("_", " ")
        kind: Kind = "counter" if name.endswith("_total") else "gauge"
        families.add_custom(Family(f"midspan_{worker}_{name}", kind, f"Reported by {worker}: {title}."), float(value))


def _mapping(value: object) -> Mapping[str, object]:
    return value if isinstance(value, dict) else {}
