"""Metrics for Prometheus: workers, sides, routes, the store and goals."""

from bridge.descriptors import DIAGNOSTICS, WorkerDescriptor

WORKER = WorkerDescriptor(
    name="metrics",
    factory="bridge.web.metrics_worker:MetricsWorker",
    section="bridge.metrics.section:MetricsSection",
    about="Figures for Prometheus; see docs/operate/metrics.md.",
    sections=frozenset({"web", "clock", "types"}) | DIAGNOSTICS,
    uses="bridge.web.section:certificate_keys",
    needs=("starlette", "uvicorn", "websockets"),
    extra="web",
)
