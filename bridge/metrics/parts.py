"""Reports the state of each part of a daemon as a `diagnostic_msgs/DiagnosticStatus`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import IntEnum
from typing import Any, NamedTuple

from bridge.config.model import Config
from bridge.daemon.query import Phase
from bridge.descriptors import all_workers
from bridge.metrics.source import Snapshot
from bridge.module_keys import BoardKeys
from bridge.sides import all_networks, all_sides
from bridge.status import ModuleStatus, StatusDocument, WorkerReport, WorkerStatus

_LATE_BEAT = 3.0
"""Seconds without a heartbeat after which a worker's reported state is stale; the daemon kills it a little later."""


class Level(IntEnum):
    """Levels of `diagnostic_msgs/DiagnosticStatus`."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class PartStatus(NamedTuple):
    """The status of one part: ``worker ros1``, ``side ros1``, ``module gateway``, ``board /robot/base``."""

    part: str
    level: Level
    message: str
    values: dict[str, Any]

    def message_of(self, daemon: str) -> dict[str, Any]:
        """Return the message's fields; the name starts with the daemon's name, so that aggregators can group by it."""
        return {
            "level": int(self.level),
            "name": f"midspan {daemon}: {self.part}",
            "message": self.message,
            "hardware_id": daemon,
            "values": [{"key": key, "value": str(value)} for key, value in self.values.items() if value is not None],
        }


_STATES = {"running": Level.OK, "standby": Level.OK, "waiting": Level.WARN}
_PHASES = {
    Phase.UP.value: Level.OK, Phase.PAUSED.value: Level.ERROR, Phase.FAILED.value: Level.ERROR,
}  # fmt: skip


def parts(snapshot: Snapshot, config: Config) -> list[PartStatus]:
    """Return the status of the daemon and of each worker, side, module and board."""
    documents = {document.worker: document for document in snapshot.documents}
    workers = {report.worker: report for report in snapshot.workers}
    return [
        _daemon(snapshot),
        *(worker_status(report, documents.get(name)) for name, report in workers.items()),
        *_sides(documents, workers),
        *_modules(documents, workers, config),
    ]


def worker_status(report: WorkerReport, document: StatusDocument | None = None) -> PartStatus:
    """Return the status of a worker, from the daemon's report and the worker's own document."""
    level, beat = _PHASES.get(report.phase, Level.WARN), report.beat
    message = ": ".join(filter(None, (report.phase, report.text)))
    if level is Level.OK and beat is not None and beat > _LATE_BEAT:
        level, message = Level.STALE, f"no heartbeat for {beat:.0f} s"
    values = {"phase": report.phase, "pid": report.pid, "restarts": report.restarts, "heartbeat age (s)": beat}
    costs = {} if document is None else {"cpu (cores)": document.cpu, "memory (bytes)": document.rss}
    return PartStatus(f"worker {report.worker}", level, message, {**values, **costs})


def _daemon(snapshot: Snapshot) -> PartStatus:
    daemon = snapshot.daemon
    if daemon is None:
        return PartStatus("daemon", Level.STALE, "it does not respond", {})
    message = f"a reload was refused: {daemon.refused}" if daemon.refused else daemon.error or "running"
    values = {"pid": daemon.pid, "uptime (s)": daemon.uptime, "configuration": daemon.config}
    return PartStatus("daemon", Level.OK if message == "running" else Level.WARN, message, values)


def _sides(documents: Mapping[str, StatusDocument], workers: Mapping[str, WorkerReport]) -> Iterator[PartStatus]:
    networks = all_networks()
    for document in documents.values():
        if isinstance(document, WorkerStatus) and document.side in networks:
            yield _side(document)
    for side in all_sides():
        names = [network.name for network in side.networks] or [side.name]
        if side.name in workers and not documents.keys() & {*names, side.name}:
            yield PartStatus(f"side {side.name}", Level.STALE, "its worker does not respond", {})


def _side(document: WorkerStatus) -> PartStatus:
    reason = document.error or document.standby or document.waiting or document.network or "its network is unreachable"
    values = {
        "network": document.network,
        "routes": len(document.routes),
        "messages a second": round(sum(route.rate or 0.0 for route in document.routes), 1),
        "dropped": sum(sum(route.drops.values()) for route in document.routes),
        "refused": len(document.refused),
        "lease": document.lease.active,
    }
    level = _level(document)
    return PartStatus(f"side {document.worker}", level, f"{document.state}: {reason}", values)


def _level(document: StatusDocument) -> Level:
    level = _STATES.get(document.state, Level.ERROR)
    return max(level, Level.WARN) if document.error else level


def _modules(
    documents: Mapping[str, StatusDocument], workers: Mapping[str, WorkerReport], config: Config
) -> Iterator[PartStatus]:
    for name, module in documents.items():
        if isinstance(module, ModuleStatus):
            message = ": ".join(filter(None, (module.state, module.error or module.text)))
            yield PartStatus(
                f"module {name}", _level(module), message, {"pid": module.pid, "uptime (s)": module.uptime}
            )
            yield from _boards(module)
    hosts = (workers[worker.name] for worker in all_workers() if worker.hosts and worker.name in workers)
    for report in hosts:
        up = report.phase == Phase.UP.value
        level, reason = (Level.ERROR, "not running") if up else (Level.STALE, "its worker is not running")
        for name in config.hosted.keys() - documents.keys():
            yield PartStatus(f"module {name}", level, reason, {})


def _boards(module: ModuleStatus) -> Iterator[PartStatus]:
    for board in module.other(BoardKeys).boards:
        values = {"joints": len(board.joints), "states": board.states, "dropped commands": board.dropped_commands}
        level = Level.WARN if board.trouble else Level.OK
        yield PartStatus(f"board {board.board}", level, board.trouble or "running", values)
