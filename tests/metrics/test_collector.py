"""Status documents become Prometheus metrics, in bounded number."""

from __future__ import annotations

import os
from typing import Any

import psutil
import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.metrics_core import Metric
from prometheus_client.openmetrics import exposition as openmetrics
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse_openmetrics
from prometheus_client.parser import text_string_to_metric_families as parse

from bridge.metrics.collector import MAX_CUSTOM, MidspanCollector
from bridge.metrics.source import Snapshot
from bridge.routing.counters import DROPS
from tests.metrics.documents import route, service, side, snapshot


class FixedSource:
    """A source with a fixed snapshot."""

    def __init__(self, known: Snapshot) -> None:
        self.known = known

    def snapshot(self) -> Snapshot:
        return self.known


class Scrape:
    """The samples of a snapshot, in Prometheus' text format."""

    def __init__(self, *documents: dict[str, Any], most: int = 200, **daemon: Any) -> None:
        self.source = FixedSource(snapshot(*documents, **daemon))
        self.registry = CollectorRegistry(auto_describe=False)
        self.registry.register(MidspanCollector(self.source, most))

    def families(self) -> dict[str, Metric]:
        return {family.name: family for family in parse(generate_latest(self.registry).decode())}

    def values(self, name: str, **labels: str) -> list[float]:
        return [
            sample.value
            for family in self.families().values()
            for sample in family.samples
            if sample.name == name and labels.items() <= sample.labels.items()
        ]

    def value(self, name: str, **labels: str) -> float:
        (value,) = self.values(name, **labels)
        return value


def test_a_route_exports_counts_drops_and_times() -> None:
    scrape = Scrape(side(route()))
    where = {"side": "ros1", "direction": "in", "topic": "/scan", "type": "sensor_msgs/msg/LaserScan"}
    assert scrape.value("midspan_route_messages_total", **where) == 3
    assert scrape.value("midspan_route_lane_messages_total", **where) == 2
    assert scrape.value("midspan_route_bytes_total", **where) == 300
    drops = {reason: scrape.value("midspan_route_drops_total", reason=reason, **where) for reason in DROPS}
    assert drops == dict.fromkeys(DROPS, 0) | {"queue": 1}
    assert scrape.value("midspan_route_carry_seconds_count", **where) == 2
    assert scrape.value("midspan_route_carry_seconds_sum", **where) == pytest.approx(2.003, rel=0.1)
    buckets = {le: scrape.value("midspan_route_carry_seconds_bucket", le=le) for le in ("0.0025", "1", "+Inf")}
    assert buckets == {"0.0025": 0, "1": 1, "+Inf": 2}
    assert not scrape.values("midspan_route_latency_seconds_count"), "the source time is unknown"
    scrape = Scrape(side(route(direction="out")))
    where["direction"] = "out"
    assert scrape.value("midspan_route_latency_seconds_count", **where) == 2
    assert scrape.value("midspan_route_latency_seconds_sum", **where) == pytest.approx(0.0403)
    buckets = {le: scrape.value("midspan_route_latency_seconds_bucket", le=le) for le in ("0.00025", "0.0005", "0.05")}
    assert buckets == {"0.00025": 0, "0.0005": 1, "0.05": 2}


def test_topics_of_a_side_that_are_one_topic_on_the_hub_are_counted_together() -> None:
    scrape = Scrape(side(route(), route(side_topic="/scan_front"), route("/other")))
    assert scrape.value("midspan_side_routes", side="ros1") == 2
    for name, count in (("messages_total", 6), ("lane_messages_total", 4), ("bytes_total", 600)):
        assert scrape.value(f"midspan_route_{name}", topic="/scan") == count
    assert scrape.value("midspan_route_drops_total", topic="/scan", reason="queue") == 2
    assert scrape.value("midspan_route_carry_seconds_count", topic="/scan") == 4
    calls = Scrape(side(service(), service()))
    assert calls.value("midspan_route_calls_total", result="reply") == 2
    assert calls.value("midspan_route_calls_pending") == 2


def test_a_service_exports_calls() -> None:
    scrape = Scrape(side(service()))
    calls = {r: scrape.value("midspan_route_calls_total", result=r) for r in ("reply", "error", "abandoned")}
    assert calls == {"reply": 1, "error": 0, "abandoned": 0}
    assert scrape.value("midspan_route_calls_pending") == 1
    assert scrape.value("midspan_route_latency_seconds_count") == 0, "the histogram exists before the first call"


def test_a_side_exports_its_state_and_lease() -> None:
    scrape = Scrape(side(worker="zenoh_ros2dds", state="standby", refused=[{}, {}]))
    states = {s: scrape.value("midspan_side_state", state=s) for s in ("running", "waiting", "standby")}
    assert states == {"running": 0, "waiting": 0, "standby": 1}
    assert scrape.value("midspan_side_lease", side="zenoh_ros2dds") == 1
    assert scrape.value("midspan_side_lease_changes_total") == 3
    assert scrape.value("midspan_side_members") == 2
    assert scrape.value("midspan_side_refused") == 2


def test_workers_are_reported_from_the_daemons_status() -> None:
    def word(worker: str, phase: str, pid: int, beat: float | None) -> dict[str, Any]:
        return {"worker": worker, "phase": phase, "pid": pid, "restarts": 2, "beat": beat, "text": ""}

    scrape = Scrape(
        side(pid=os.getpid()),
        pid=os.getpid(), uptime=5.0, refused="",
        workers=[
            word("ros1", "running", os.getpid(), 0.3), word("ros2", "running", 999_999_999, 4.0),
            word("yarp", "restarting", 0, None), word("sim", "off", 0, None), word("zenoh", "not available", 0, None),
        ],
    )  # fmt: skip
    up = {w: scrape.value("midspan_worker_up", worker=w) for w in ("ros1", "ros2", "yarp")}
    assert up == {"ros1": 1, "ros2": 1, "yarp": 0}
    answering = {w: scrape.value("midspan_worker_answering", worker=w) for w in up}
    assert answering == {"ros1": 1, "ros2": 0, "yarp": 0}, "a hanging worker counts as not answering"
    assert not scrape.values("midspan_worker_up", worker="sim") + scrape.values("midspan_worker_up", worker="zenoh")
    assert scrape.value("midspan_worker_phase", worker="yarp", phase="restarting") == 1
    assert scrape.value("midspan_worker_heartbeat_age_seconds", worker="ros2") == 4
    assert not scrape.values("midspan_worker_heartbeat_age_seconds", worker="yarp")
    for name in ("cpu_seconds_total", "resident_memory_bytes", "open_fds"):
        assert scrape.value(f"midspan_worker_{name}", worker="ros1") > 0
        assert scrape.value(f"midspan_worker_{name}", worker="daemon") > 0
        assert not scrape.values(f"midspan_worker_{name}", worker="ros2"), "the process is missing"


def test_processes_are_measured_without_a_count_of_descriptors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(psutil.Process, "num_fds")  # as on Windows
    scrape = Scrape(pid=os.getpid(), uptime=5.0, refused="", workers=[])
    assert scrape.value("midspan_worker_resident_memory_bytes", worker="daemon") > 0
    assert not scrape.values("midspan_worker_open_fds")


def test_an_unreachable_daemon_is_reported_as_down() -> None:
    scrape = Scrape()
    assert scrape.value("midspan_daemon_up") == 0
    assert scrape.value("midspan_build_info", daemon="here") == 1
    assert not scrape.values("midspan_worker_up")


def test_store_goals_modules_and_router_are_exported() -> None:
    store = {
        "keys": {"map": 1, "location": 4}, "bytes": 77, "limits": {"bytes": 100}, "deleted": 1, "conflicts": 2,
        "refused": 3, "changed": 1.5e9, "others": ["r2"],
    }  # fmt: skip
    ended = {"reached": 5, "failed": 1, "canceled": 2, "replaced": 0}
    head = {"module": True, "state": "running", "routes": []}
    scrape = Scrape(
        {"worker": "store", "store": store, **head},
        {"worker": "gateway", "goals_ended": ended, "goal": [1, 2, 3], **head, "state": "waiting"},
        {"worker": "router", "side": "router", "sessions": 7, "machines": [{"trusted": True}, {"trusted": False}]},
    )
    assert scrape.value("midspan_store_values", kind="location") == 4
    assert scrape.value("midspan_store_bytes") == 77
    assert scrape.value("midspan_store_last_change_timestamp_seconds") == 1.5e9
    assert scrape.value("midspan_store_replicas") == 1
    assert {o: scrape.value("midspan_goals_total", outcome=o) for o in ended} == ended
    assert scrape.value("midspan_goal_active") == 1
    assert scrape.value("midspan_module_state", module="gateway", state="waiting") == 1
    assert scrape.value("midspan_router_sessions") == 7
    assert scrape.value("midspan_router_machines", trusted="false") == 1


def test_the_routers_endpoints_are_exported() -> None:
    endpoints = [
        {"way": "connect", "endpoint": "tls/r:7448", "state": "refused", "reason": "why", "since": 1.5e9},
        {"way": "listen", "endpoint": "tls/0.0.0.0:7448", "state": "listening", "reason": "", "since": 1.6e9},
        {"way": "connect", "endpoint": "tls/s:7448", "state": "connecting", "reason": "", "since": 1.6e9},
        {"way": "connect", "endpoint": "tls/t:7448", "state": "of a later version"},
        "rubbish",
    ]
    scrape = Scrape({"worker": "router", "side": "router", "endpoints": endpoints, "refused_connections": 3})
    assert {e: scrape.value("midspan_router_endpoint_up", endpoint=e) for e in ("tls/r:7448", "tls/0.0.0.0:7448")} == {
        "tls/r:7448": 0, "tls/0.0.0.0:7448": 1,
    }  # fmt: skip
    assert scrape.value("midspan_router_endpoint_up", endpoint="tls/s:7448") == 0
    assert scrape.value("midspan_router_endpoint_state", endpoint="tls/r:7448", way="connect", state="refused") == 1
    assert scrape.value("midspan_router_endpoint_state", endpoint="tls/r:7448", state="connected") == 0
    assert scrape.value("midspan_router_endpoint_since_timestamp_seconds", endpoint="tls/r:7448") == 1.5e9
    assert scrape.value("midspan_router_refused_connections_total") == 3


def test_routes_beyond_the_limit_are_counted_and_reported_ones_stay_reported() -> None:
    scrape = Scrape(side(*(route(f"/t{n}") for n in range(5, 9))), most=3)
    topics = lambda: {s.labels["topic"] for s in scrape.families()["midspan_route_bytes"].samples}  # noqa: E731
    assert topics() == {"/t5", "/t6", "/t7"}
    assert scrape.value("midspan_side_routes_untold") == 1
    scrape.source.known = snapshot(side(*(route(f"/t{n}") for n in (1, 2, 6, 7, 8))))
    assert topics() == {"/t1", "/t6", "/t7"}, "a new route does not displace a reported one"
    assert scrape.value("midspan_side_routes") == 5
    assert scrape.value("midspan_side_routes_untold") == 2


def test_a_worker_may_add_metrics() -> None:
    metrics = {"written_bytes_total": 12, "disk_free_bytes": 3.5, "Bad name": 1, "text": "7", "none": None}
    scrape = Scrape(
        {"worker": "record", "side": "record", "metrics": metrics}, {"worker": "build", "metrics": {"info": 5}}
    )
    families = scrape.families()
    assert (families["midspan_record_written_bytes"].type, families["midspan_record_disk_free_bytes"].type) == (
        "counter",
        "gauge",
    )
    assert scrape.value("midspan_record_written_bytes_total") == 12
    assert not [name for name in families if name.startswith("midspan_record") and name.endswith(("name", "text"))]
    assert scrape.value("midspan_build_info", daemon="here") == 1, "the name is in use"
    many = Scrape({"worker": "x", "metrics": {f"n{n}": n for n in range(2 * MAX_CUSTOM)}})
    assert sum(name.startswith("midspan_x_") for name in many.families()) == MAX_CUSTOM


def test_openmetrics_is_parsed() -> None:
    scrape = Scrape(side(route(), service()), {"worker": "record", "metrics": {"a_total": 1}})
    text = openmetrics.generate_latest(scrape.registry).decode()
    families = {family.name: family for family in parse_openmetrics(text)}
    assert text.endswith("# EOF\n")
    assert families["midspan_route_messages"].type == "counter"
    assert families["midspan_route_latency_seconds"].type == "histogram"
    assert families["midspan_record_a"].samples[0].name == "midspan_record_a_total"


@pytest.mark.parametrize(
    "odd",
    [
        {"routes": [7, {}, {"drops": 1, "ways": 2, "latency": {"buckets": [1]}, "messages": "x"}]},
        {"routes": [{"hub_topic": '/\udc80\n"\\' + "x" * 1000, "messages": 1}]},
        {"routes": [], "lease": 5, "refused": 9, "metrics": [1], "state": 8},
    ],
)
def test_malformed_documents_do_not_break_the_scrape(odd: dict[str, Any]) -> None:
    scrape = Scrape(side(**odd), {"worker": "store", "module": True, "store": {"keys": 1, "others": 2}})
    assert all(len(v) <= 200 for f in scrape.families().values() for s in f.samples for v in s.labels.values())
