"""The state of each part of a daemon, as a `diagnostic_msgs/DiagnosticStatus`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import IntEnum
from typing import Any, NamedTuple

from bridge.config.model import Config
from bridge.daemon.query import Phase
from bridge.metrics.source import Document, Snapshot
from bridge.sides import all_networks, all_sides

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
        """Return the message's fields; the name starts with the daemon's, by which aggregators group."""
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
    documents = {str(document["worker"]): document for document in snapshot.documents}
    workers = {status["worker"]: status for status in snapshot.workers}
    return [
        _daemon(snapshot),
        *(worker_status(status, documents.get(name)) for name, status in workers.items()),
        *_sides(documents, workers),
        *_modules(documents, workers, config),
    ]


def worker_status(worker: Document, document: Document | None = None) -> PartStatus:
    """Return the status of a worker, from the daemon's report and the worker's own document."""
    level, beat = _PHASES.get(worker["phase"], Level.WARN), worker.get("beat")
    message = ": ".join(filter(None, (worker["phase"], worker["text"])))
    if level is Level.OK and isinstance(beat, int | float) and beat > _LATE_BEAT:
        level, message = Level.STALE, f"no heartbeat for {beat:.0f} s"
    values = {"phase": worker["phase"], "pid": worker["pid"], "restarts": worker["restarts"], "heartbeat age (s)": beat}
    costs = {name: (document or {}).get(key) for name, key in (("cpu (cores)", "cpu"), ("memory (bytes)", "rss"))}
    return PartStatus(f"worker {worker['worker']}", level, message, {**values, **costs})


def _daemon(snapshot: Snapshot) -> PartStatus:
    daemon = snapshot.daemon
    if not daemon:
        return PartStatus("daemon", Level.STALE, "it does not respond", {})
    refused = daemon.get("refused")
    message = f"a reload was refused: {refused}" if refused else "running"
    values = {"pid": daemon.get("pid"), "uptime (s)": daemon.get("uptime"), "configuration": daemon.get("config")}
    return PartStatus("daemon", Level.WARN if refused else Level.OK, message, values)


def _sides(documents: dict[str, Document], workers: dict[str, Document]) -> Iterator[PartStatus]:
    networks = all_networks()
    for name, document in documents.items():
        if document.get("side") in networks and not document.get("module"):
            yield _side(name, document)
    for side in all_sides():
        names = [network.name for network in side.networks] or [side.name]
        if side.name in workers and not documents.keys() & {*names, side.name}:
            yield PartStatus(f"side {side.name}", Level.STALE, "its worker does not respond", {})


def _side(name: str, document: Document) -> PartStatus:
    state, routes = str(document.get("state")), document.get("routes")
    routes = [route for route in routes if isinstance(route, dict)] if isinstance(routes, list) else []
    refused, lease = document.get("refused"), document.get("lease")
    reason = (
        document.get("standby") or document.get("waiting") or document.get("network") or "its network is unreachable"
    )
    drops = sum(sum(counts.values()) for route in routes if isinstance(counts := route.get("drops"), dict))
    values = {
        "network": document.get("network"),
        "routes": len(routes),
        "messages a second": round(sum(route.get("rate") or 0.0 for route in routes), 1),
        "dropped": drops,
        "refused": len(refused) if isinstance(refused, list) else 0,
        "lease": lease.get("active") if isinstance(lease, dict) else None,
    }
    return PartStatus(f"side {name}", _STATES.get(state, Level.ERROR), f"{state}: {reason}", values)


def _modules(documents: dict[str, Document], workers: dict[str, Document], config: Config) -> Iterator[PartStatus]:
    for name, document in documents.items():
        if document.get("module") is True:
            state, text = str(document.get("state")), str(document.get("text", ""))
            values = {"pid": document.get("pid"), "uptime (s)": document.get("uptime")}
            level = _STATES.get(state, Level.ERROR)
            yield PartStatus(f"module {name}", level, ": ".join(filter(None, (state, text))), values)
            yield from _boards(document.get("boards"))
    worker = workers.get("modules")
    if worker is not None:
        up = worker["phase"] == Phase.UP.value
        level, reason = (Level.ERROR, "not running") if up else (Level.STALE, "its worker is not running")
        for name in config.hosted.keys() - documents.keys():
            yield PartStatus(f"module {name}", level, reason, {})


def _boards(boards: object) -> Iterable[PartStatus]:
    for board in boards if isinstance(boards, list) else ():
        trouble = str(board.get("trouble", ""))
        values = {
            "joints": len(board.get("joints", ())), "states": board.get("states"),
            "dropped commands": board.get("dropped_commands"),
        }  # fmt: skip
        level = Level.WARN if trouble else Level.OK
        yield PartStatus(f"board {board.get('board')}", level, trouble or "running", values)
