"""Converts the workers' status documents to metric families."""

from __future__ import annotations

import re
from collections.abc import Iterable
from contextlib import suppress

import psutil
from prometheus_client.core import Metric
from prometheus_client.registry import Collector
from typing_extensions import override

from bridge import __version__
from bridge.daemon.query import Phase
from bridge.hub.security.reasons import EndpointState
from bridge.metrics.families import Families, Family, Kind
from bridge.metrics.routes import RouteMetrics
from bridge.metrics.source import AT_REST, Snapshot, Source
from bridge.module_keys import GatewayKeys, StoreContent, StoreKeys
from bridge.sides import all_networks
from bridge.status import EndpointStatus, ModuleStatus, RouterStatus, StatusDocument, WorkerStatus

MAX_CUSTOM = 50
"""Maximum number of custom metrics that a worker may add."""

_CUSTOM_NAME = re.compile(r"[a-z][a-z0-9_]{0,60}")
_PHASES = tuple(phase.value for phase in Phase if phase.value not in AT_REST)
_STATES = ("running", "waiting", "standby")
_ENDPOINT_STATES = frozenset(EndpointState)
_MODULE_STATES = ("running", "waiting", "standby", "stopped")


class MidspanCollector(Collector):
    """Collects the metric families of one daemon.

    Args:
        source: provides the status documents.
        most_routes: maximum number of routes that are reported for each side.
    """

    def __init__(self, source: Source, most_routes: int) -> None:
        self._source = source
        self._routes = RouteMetrics(most_routes)

    def describe(self) -> Iterable[Metric]:
        """Return nothing; without this method, the library would query all workers only to get the names."""
        return ()

    @override
    def collect(self) -> Iterable[Metric]:
        return self.families(self._source.snapshot())

    def families(self, snapshot: Snapshot) -> Families:
        """Return the families of one snapshot."""
        families = Families()
        _daemon(families, snapshot)
        _workers(families, snapshot)
        sides = all_networks()
        for document in snapshot.documents:
            if isinstance(document, ModuleStatus):
                _module(families, document)
            elif isinstance(document, RouterStatus):
                _router(families, document)
            elif isinstance(document, WorkerStatus) and document.side in sides:
                _side(families, document)
                self._routes.add(families, document)
            _add_custom(families, document)
        return families


def _daemon(families: Families, snapshot: Snapshot) -> None:
    add = families.add
    add("midspan_build_info", 1, __version__, snapshot.name)
    add("midspan_daemon_up", snapshot.daemon is not None)
    add("midspan_hub_up", snapshot.hub)
    add("midspan_ask_duration_seconds", snapshot.seconds)
    if snapshot.daemon is not None:
        add("midspan_daemon_uptime_seconds", snapshot.daemon.uptime)
        add("midspan_daemon_config_refused", bool(snapshot.daemon.refused))
        _process(families, "daemon", snapshot.daemon.pid)


def _workers(families: Families, snapshot: Snapshot) -> None:
    add = families.add
    answering = {document.pid for document in snapshot.documents}
    for report in snapshot.workers:
        worker, phase = report.worker, report.phase
        add("midspan_worker_up", phase == Phase.UP.value, worker)
        for name in _PHASES:
            add("midspan_worker_phase", phase == name, worker, name)
        add("midspan_worker_answering", bool(report.pid) and report.pid in answering, worker)
        add("midspan_worker_restarts_total", report.restarts, worker)
        add("midspan_worker_heartbeat_age_seconds", report.beat, worker)
        _process(families, worker, report.pid)


def _process(families: Families, worker: str, pid: int) -> None:
    """Add the operating system's metrics of a process, which are available even if it hangs."""
    if pid <= 0:
        return
    with suppress(psutil.Error, OSError):
        process = psutil.Process(pid)
        with process.oneshot():
            times = process.cpu_times()
            families.add("midspan_worker_cpu_seconds_total", times.user + times.system, worker)
            families.add("midspan_worker_resident_memory_bytes", process.memory_info().rss, worker)
            if hasattr(process, "num_fds"):  # not on Windows
                families.add("midspan_worker_open_fds", process.num_fds(), worker)


def _router(families: Families, router: RouterStatus) -> None:
    families.add("midspan_router_sessions", router.sessions)
    for trusted in (True, False):
        count = sum(machine.trusted is trusted for machine in router.machines)
        families.add("midspan_router_machines", count, str(trusted).lower())
    families.add("midspan_router_refused_connections_total", router.refused_connections)
    for endpoint in router.endpoints:
        if endpoint.state in _ENDPOINT_STATES:
            _endpoint(families, endpoint)


def _endpoint(families: Families, endpoint: EndpointStatus) -> None:
    labels, state = (endpoint.way, endpoint.endpoint), EndpointState(endpoint.state)
    families.add("midspan_router_endpoint_up", state.good and state is not EndpointState.CONNECTING, *labels)
    for other in EndpointState:
        families.add("midspan_router_endpoint_state", other is state, *labels, other)
    families.add("midspan_router_endpoint_since_timestamp_seconds", endpoint.since, *labels)


def _module(families: Families, module: ModuleStatus) -> None:
    add = families.add
    for state in _MODULE_STATES:
        add("midspan_module_state", module.state == state, module.worker, state)
    if module.worker == "store":
        _store(families, module.other(StoreKeys).store)
    gateway = module.other(GatewayKeys)
    if gateway.goals_ended is not None:
        for outcome, count in gateway.goals_ended.items():
            add("midspan_goals_total", count, outcome)
        add("midspan_goal_active", gateway.goal is not None)


def _store(families: Families, store: StoreContent) -> None:
    add = families.add
    for kind, count in store.keys.items():
        add("midspan_store_values", count, kind)
    add("midspan_store_bytes", store.bytes)
    add("midspan_store_limit_bytes", store.limits.get("bytes"))
    add("midspan_store_deleted", store.deleted)
    add("midspan_store_conflicts_total", store.conflicts)
    add("midspan_store_refused_total", store.refused)
    add("midspan_store_last_change_timestamp_seconds", store.changed)
    add("midspan_store_replicas", None if store.others is None else len(store.others))


def _side(families: Families, document: WorkerStatus) -> None:
    add, side, lease = families.add, document.worker, document.lease
    for state in _STATES:
        add("midspan_side_state", document.state == state, side, state)
    add("midspan_side_lease", lease.active, side)
    add("midspan_side_lease_changes_total", lease.changes, side)
    add("midspan_side_members", lease.members, side)
    add("midspan_side_refused", len(document.refused), side)


def _add_custom(families: Families, document: StatusDocument) -> None:
    """Add the metrics under the key ``metrics`` of a worker's or module's status document.

    ``{"metrics": {"written_bytes_total": 12, "disk_free_bytes": 3.5e9}}`` of the worker ``record`` becomes
    ``midspan_record_written_bytes_total`` and ``midspan_record_disk_free_bytes``. A name consists of
    lower-case letters, digits and underscores, and includes the unit. A name that ends in ``_total`` is a counter,
    which starts at 0 with the process; any other is a gauge. Values are numbers. These metrics have no labels, and
    their names are a bounded set.
    """
    worker = re.sub(r"[^a-z0-9_]", "_", document.worker.lower())
    samples = [(name, value) for name, value in document.metrics.items() if _CUSTOM_NAME.fullmatch(name)]
    for name, value in samples[:MAX_CUSTOM]:
        title = name.removesuffix("_total").replace("_", " ")
        kind: Kind = "counter" if name.endswith("_total") else "gauge"
        families.add_custom(Family(f"midspan_{worker}_{name}", kind, f"Reported by {worker}: {title}."), float(value))
