"""All metric families of Midspan: their names, kinds, labels and help texts.

Names follow https://prometheus.io/docs/practices/naming/: a prefix, base units, ``_total`` for counters.
A counter starts at 0 with its process, so the restart of a worker is a counter reset, as in any program.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric

Kind = Literal["gauge", "counter", "histogram"]

_MAX_LABEL = 200
"""Maximum length of a label value, in characters, because the length of topic names is not limited."""


class Family(NamedTuple):
    """One metric family; the name of a counter includes ``_total``."""

    name: str
    kind: Kind
    help: str
    labels: tuple[str, ...] = ()

    def metric(self) -> Metric:
        """Create an empty metric of the library's class."""
        types: dict[Kind, type[Metric]] = {
            "gauge": GaugeMetricFamily, "counter": CounterMetricFamily, "histogram": HistogramMetricFamily,
        }  # fmt: skip
        return types[self.kind](self.name, self.help, labels=list(self.labels))  # type: ignore[call-arg]


_ROUTE = ("side", "direction", "kind", "topic", "type")
_WORKER = ("worker",)
_SIDE = ("side",)
_ENDPOINT = ("way", "endpoint")

FAMILIES = (
    Family("midspan_build_info", "gauge", "Always 1; the version, and the daemon's name.", ("version", "daemon")),
    Family("midspan_daemon_up", "gauge", "Whether the daemon answers."),
    Family("midspan_daemon_uptime_seconds", "gauge", "Time since the daemon's start."),
    Family("midspan_daemon_config_refused", "gauge", "Whether the last reload of the configuration was refused."),
    Family("midspan_hub_up", "gauge", "Whether the hub is reachable."),
    Family("midspan_ask_duration_seconds", "gauge", "Duration of a query to all workers; 1 s if one does not answer."),
    Family("midspan_worker_up", "gauge", "Whether the worker's process runs and sends heartbeats.", _WORKER),
    Family("midspan_worker_phase", "gauge", "1 for the phase that the worker is in.", ("worker", "phase")),
    Family("midspan_worker_answering", "gauge", "Whether the worker reported its status in time.", _WORKER),
    Family("midspan_worker_restarts_total", "counter", "Exits of the worker that were not requested.", _WORKER),
    Family("midspan_worker_heartbeat_age_seconds", "gauge", "Time since the worker's last heartbeat.", _WORKER),
    Family("midspan_worker_cpu_seconds_total", "counter", "Processor time of the process.", _WORKER),
    Family("midspan_worker_resident_memory_bytes", "gauge", "Resident memory of the process.", _WORKER),
    Family("midspan_worker_open_fds", "gauge", "Open file descriptors of the process.", _WORKER),
    Family("midspan_router_sessions", "gauge", "Sessions connected to the hub's router."),
    Family("midspan_router_machines", "gauge", "Other machines that are connected.", ("trusted",)),
    Family("midspan_router_endpoint_up", "gauge", "Whether the endpoint of hub.open works.", _ENDPOINT),
    Family("midspan_router_endpoint_state", "gauge", "1 for the endpoint's state.", (*_ENDPOINT, "state")),
    Family("midspan_router_endpoint_since_timestamp_seconds", "gauge", "When the endpoint's state began.", _ENDPOINT),
    Family("midspan_router_refused_connections_total", "counter", "Connections refused because of a certificate."),
    Family("midspan_module_state", "gauge", "1 for the state that the hosted module is in.", ("module", "state")),
    Family("midspan_side_state", "gauge", "1 for the state that the side is in.", ("side", "state")),
    Family("midspan_side_lease", "gauge", "Whether this daemon bridges the side's network to the hub.", _SIDE),
    Family("midspan_side_lease_changes_total", "counter", "How often the lease was acquired or lost.", _SIDE),
    Family("midspan_side_members", "gauge", "Midspan workers on the side's network, including this one.", _SIDE),
    Family("midspan_side_routes", "gauge", "All routes of the side, including those not reported.", _SIDE),
    Family("midspan_side_routes_untold", "gauge", "Routes beyond metrics.routes, which are not reported.", _SIDE),
    Family("midspan_side_refused", "gauge", "Topics and services not bridged; see midspan status.", _SIDE),
    Family("midspan_route_messages_total", "counter", "Messages bridged; for a service, calls.", _ROUTE),
    Family("midspan_route_lane_messages_total", "counter", "Messages bridged over the local transport.", _ROUTE),
    Family("midspan_route_bytes_total", "counter", "Bytes bridged.", _ROUTE),
    Family("midspan_route_drops_total", "counter", "Messages that were dropped.", (*_ROUTE, "reason")),
    Family("midspan_route_latency_seconds", "histogram", "Time from source to side; for calls, duration.", _ROUTE),
    Family("midspan_route_carry_seconds", "histogram", "Time that the bridge needs for a message to the hub.", _ROUTE),
    Family("midspan_route_calls_total", "counter", "Calls of a service by result.", (*_ROUTE, "result")),
    Family("midspan_route_calls_pending", "gauge", "Calls of a service that are pending.", _ROUTE),
    Family("midspan_store_values", "gauge", "Values in the store of maps and places.", ("kind",)),
    Family("midspan_store_bytes", "gauge", "Bytes of all values in the store."),
    Family("midspan_store_limit_bytes", "gauge", "Bytes that the store may hold."),
    Family("midspan_store_deleted", "gauge", "Tombstones of deleted values."),
    Family("midspan_store_conflicts_total", "counter", "Changes overruled by a concurrent change elsewhere."),
    Family("midspan_store_refused_total", "counter", "Changes of other stores that were refused."),
    Family("midspan_store_last_change_timestamp_seconds", "gauge", "Time of the newest change in any replica."),
    Family("midspan_store_replicas", "gauge", "Other replicas of the store."),
    Family("midspan_goals_total", "counter", "Goals of clients by outcome.", ("outcome",)),
    Family("midspan_goal_active", "gauge", "Whether a client's goal is active."),
)


class Families:
    """The families of one scrape; samples are added to them."""

    def __init__(self) -> None:
        self._known = {family.name: family for family in FAMILIES}
        self._metrics: dict[str, Metric] = {}

    def add(self, name: str, value: object, *labels: object) -> None:
        """Add a sample; values that are not numbers are skipped."""
        if isinstance(value, int | float):
            self._metric(name).add_metric([label(text) for text in labels], float(value))  # type: ignore[attr-defined]

    def add_histogram(
        self, name: str, bounds: Sequence[float], counts: Sequence[int], total: float, *labels: object
    ) -> None:
        """Add a histogram.

        ``bounds``: upper bounds of all buckets except the last, which is unbounded. ``counts``: number of values in
        each bucket, not cumulative. ``total``: sum of all values.
        """
        buckets, below = [], 0
        for bound, count in zip((*(f"{bound:g}" for bound in bounds), "+Inf"), counts, strict=True):
            below += count
            buckets.append((bound, below))
        self._metric(name).add_metric([label(text) for text in labels], buckets, total)  # type: ignore[attr-defined]

    def add_custom(self, family: Family, value: float) -> None:
        """Add a family that is not in `FAMILIES`, with its only sample; do nothing if the name is in use."""
        if family.name not in self._known and family.name not in self._metrics:
            metric = self._metrics[family.name] = family.metric()
            metric.add_metric([], value)  # type: ignore[attr-defined]

    def __iter__(self) -> Iterator[Metric]:
        """Iterate over the families that have samples."""
        return iter(self._metrics.values())

    def _metric(self, name: str) -> Metric:
        if name not in self._metrics:
            self._metrics[name] = self._known[name].metric()
        return self._metrics[name]


def label(value: object) -> str:
    """Return a label value as valid UTF-8 of bounded length."""
    return str(value)[:_MAX_LABEL].encode(errors="replace").decode()
