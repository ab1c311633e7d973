"""Makes metric families from the workers' status documents."""

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
from bridge.metrics.routes import RouteTeller
from bridge.metrics.source import AT_REST, Document, Snapshot, Source
from bridge.sides import all_networks

MOST_OWN = 50
"""Largest number of figures that a worker may add."""

_OWN_NAME = re.compile(r"[a-z][a-z0-9_]{0,60}")
_PHASES = tuple(phase.value for phase in Phase if phase.value not in AT_REST)
_STATES = ("running", "waiting", "standby")
_ENDPOINT_STATES = frozenset(EndpointState)
_MODULE_STATES = ("running", "waiting", "standby", "stopped")


class MidspanCollector(Collector):
    """Collects the families from a source.

    Args:
        source: of the status documents.
        most_routes: largest number of routes for each side.
    """

    def __init__(self, source: Source, most_routes: int) -> None:
        self._source = source
        self._routes = RouteTeller(most_routes)

    def describe(self) -> Iterable[Metric]:
        """Return nothing: the library would query all workers for the names."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """Return all families that have samples."""
        return self.of(self._source.snapshot())

    def of(self, picture: Snapshot) -> Families:
        """Return the families of one snapshot."""
        families = Families()
        _daemon(families, picture)
        _workers(families, picture)
        sides = all_networks()
        for document in picture.documents:
            if document.get("module") is True:
                _module(families, document)
            elif document.get("side") in sides:
                _side(families, document)
                self._routes.tell(families, document)
            elif document["worker"] == "router":
                _router(families, document)
            _own(families, document)
        return families


def _daemon(families: Families, picture: Snapshot) -> None:
    put = families.put
    put("midspan_build_info", 1, __version__, picture.name)
    put("midspan_daemon_up", bool(picture.daemon))
    put("midspan_hub_up", picture.hub)
    put("midspan_ask_duration_seconds", picture.seconds)
    if picture.daemon:
        put("midspan_daemon_uptime_seconds", picture.daemon.get("uptime"))
        put("midspan_daemon_config_refused", bool(picture.daemon.get("refused")))
        _process(families, "daemon", picture.daemon.get("pid"))


def _workers(families: Families, picture: Snapshot) -> None:
    put = families.put
    answering = {document.get("pid") for document in picture.documents}
    for one in picture.workers:
        worker, phase = one["worker"], one["phase"]
        put("midspan_worker_up", phase == Phase.UP.value, worker)
        for each in _PHASES:
            put("midspan_worker_phase", phase == each, worker, each)
        put("midspan_worker_answering", bool(one["pid"]) and one["pid"] in answering, worker)
        put("midspan_worker_restarts_total", one["restarts"], worker)
        put("midspan_worker_heartbeat_age_seconds", one.get("beat"), worker)
        _process(families, worker, one["pid"])


def _process(families: Families, worker: str, pid: object) -> None:
    """Add the system's figures of a process, which it has of a hanging one too."""
    if not isinstance(pid, int) or not pid:
        return
    with suppress(psutil.Error, OSError):
        process = psutil.Process(pid)
        with process.oneshot():
            times = process.cpu_times()
            families.put("midspan_worker_cpu_seconds_total", times.user + times.system, worker)
            families.put("midspan_worker_resident_memory_bytes", process.memory_info().rss, worker)
            families.put("midspan_worker_open_fds", process.num_fds(), worker)


def _router(families: Families, document: Document) -> None:
    families.put("midspan_router_sessions", document.get("sessions"))
    machines = document.get("machines")
    if isinstance(machines, list):
        for trusted in (True, False):
            count = sum(isinstance(one, dict) and bool(one.get("trusted")) is trusted for one in machines)
            families.put("midspan_router_machines", count, str(trusted).lower())
    families.put("midspan_router_refused_connections_total", document.get("refused_connections"))
    endpoints = document.get("endpoints")
    for one in endpoints if isinstance(endpoints, list) else ():
        if isinstance(one, dict) and one.get("state") in _ENDPOINT_STATES:
            _endpoint(families, one)


def _endpoint(families: Families, one: Document) -> None:
    place, state = (str(one.get("way")), str(one.get("endpoint"))), EndpointState(one["state"])
    families.put("midspan_router_endpoint_up", state.good and state is not EndpointState.CONNECTING, *place)
    for each in EndpointState:
        families.put("midspan_router_endpoint_state", each is state, *place, each)
    families.put("midspan_router_endpoint_since_timestamp_seconds", one.get("since"), *place)


def _module(families: Families, document: Document) -> None:
    put = families.put
    for state in _MODULE_STATES:
        put("midspan_module_state", document.get("state") == state, document["worker"], state)
    store, goals = document.get("store"), document.get("goals_ended")
    if isinstance(store, dict) and document["worker"] == "store":
        _store(families, store)
    if isinstance(goals, dict):
        for outcome, count in goals.items():
            put("midspan_goals_total", count, outcome)
        put("midspan_goal_active", document.get("goal") is not None)


def _store(families: Families, store: Document) -> None:
    put = families.put
    for kind, count in _mapping(store.get("keys")).items():
        put("midspan_store_values", count, kind)
    put("midspan_store_bytes", store.get("bytes"))
    put("midspan_store_limit_bytes", _mapping(store.get("limits")).get("bytes"))
    put("midspan_store_deleted", store.get("deleted"))
    put("midspan_store_conflicts_total", store.get("conflicts"))
    put("midspan_store_refused_total", store.get("refused"))
    put("midspan_store_last_change_timestamp_seconds", store.get("changed"))
    others = store.get("others")
    put("midspan_store_replicas", len(others) if isinstance(others, list) else None)


def _side(families: Families, document: Document) -> None:
    put, side = families.put, document["worker"]
    for state in _STATES:
        put("midspan_side_state", document.get("state") == state, side, state)
    lease = _mapping(document.get("lease"))
    put("midspan_side_lease", lease.get("active"), side)
    put("midspan_side_lease_changes_total", lease.get("changes"), side)
    put("midspan_side_members", lease.get("members"), side)
    refused = document.get("refused")
    put("midspan_side_refused", len(refused) if isinstance(refused, list) else None, side)


def _own(families: Families, document: Document) -> None:
    """Add the figures under the key ``metrics`` of a worker's or a module's status document.

    ``{"metrics": {"written_bytes_total": 12, "disk_free_bytes": 3.5e9}}`` of the worker ``record`` becomes
    ``midspan_record_written_bytes_total`` and ``midspan_record_disk_free_bytes``. A name has small letters, digits and
    underscores, with the unit in it; one that ends in ``_total`` is a counter, which begins at 0 with the process, any
    other is a gauge. Values are numbers. Figures have no labels, and names come from a bounded set.
    """
    worker = re.sub(r"[^a-z0-9_]", "_", str(document["worker"]).lower())
    told = [
        (name, value)
        for name, value in _mapping(document.get("metrics")).items()
        if _OWN_NAME.fullmatch(str(name)) and isinstance(value, int | float)
    ]
    for name, value in told[:MOST_OWN]:
        words = name.removesuffix("_total").replace("_", " ")
        kind: Kind = "counter" if name.endswith("_total") else "gauge"
        families.put_own(Family(f"midspan_{worker}_{name}", kind, f"Told by {worker}: {words}."), float(value))


def _mapping(value: object) -> Mapping[str, object]:
    return value if isinstance(value, dict) else {}
