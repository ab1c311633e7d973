"""Whether the daemon of a configuration runs, which of its workers do, and why a worker is missing.

The facts come from the daemon's socket and lock in the state folder, from the status documents on the hub, and from
the process table. A router outlives a daemon that was killed, so an answer on the hub does not show that the daemon
runs.
"""

from __future__ import annotations

import os
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import psutil

from bridge import state_file
from bridge.config.model import Config
from bridge.daemon import units
from bridge.daemon.query import Phase, ask_daemon
from bridge.daemon.workers import worker_kinds
from bridge.hub import WORKER as ROUTER
from bridge.hub.zenoh_config import connect_endpoint
from bridge.state_file import state_folder
from bridge.status import DaemonStatus, StatusDocument, WorkerReport
from bridge.text import duration

ABSENT = {phase.value for phase in (Phase.QUEUED, Phase.STARTING, Phase.PAUSED, Phase.FAILED)}
"""Phases of a worker that is enabled but does not run."""
ENABLED = {*ABSENT, Phase.UP.value, Phase.STOPPING.value}

_LOOPS = 3
"""Restarts from which a worker counts as crash-looping until it has recovered (`_SETTLED_SECONDS`)."""
_SILENT_SECONDS = 2.0
"""A worker hangs if its last heartbeat is older than this; it sends at least one each second."""
_SETTLED_SECONDS = 30.0
"""A worker that has run for longer than this since its last crash counts as recovered."""


RELOAD_CURE = "correct the file, then run 'midspan reload'"
"""The cure for a refused reload."""


class Life(Enum):
    """Whether a daemon runs."""

    RUNNING = "running"
    SILENT = "not answering"
    DOWN = "not running"
    UNKNOWN = "unknown"
    """It has never run with this state folder, or the folder belongs to another user or machine."""


@dataclass(frozen=True)
class DaemonState:
    """The state of one daemon.

    Attributes:
        pid: the daemon's process, or its last process if the daemon is down; 0 if unknown.
        router: the process of the daemon's router if the router runs without the daemon, else 0.
        document: the daemon's own report (`bridge.daemon.query.ask_daemon`).
        unit: the systemd unit of its configuration, for cures.
    """

    name: str
    life: Life = Life.UNKNOWN
    pid: int = 0
    router: int = 0
    document: DaemonStatus = field(default_factory=DaemonStatus)
    unit: str = "midspan"

    @property
    def trouble(self) -> str:
        """Why the daemon does not work or its reply is an error; "" if neither is the case, or if that is unknown."""
        if self.life is Life.DOWN:
            left = f", although its router is (process {self.router})" if self.router else ""
            return f"the daemon {self.name} is not running{left}"
        if self.life is Life.SILENT:
            return f"the daemon {self.name} (process {self.pid}) does not answer: it is starting, is stopped, or hangs"
        if self.document.error:
            return f"the daemon {self.name} (process {self.pid}): {self.document.error}"
        return ""

    @property
    def cure(self) -> str:
        """The cure for `trouble`."""
        silent = f"wait, or end process {self.pid} and start the daemon again: 'midspan run'"
        mixed = "use the commands of its release, or restart it with this release" if self.document.error else ""
        return {Life.DOWN: units.start_hint(self.unit), Life.SILENT: silent}.get(self.life, mixed)

    @property
    def refusal(self) -> str:
        """Why the daemon refused its last reload, and uses its earlier configuration; "" if it did not."""
        reason = self.document.refused
        return f"it refused its last reload, and uses its earlier configuration: {reason}" if reason else ""

    @property
    def workers(self) -> list[WorkerReport]:
        """The workers as the daemon reports them."""
        return self.document.workers

    def why_missing(self, worker: str, config: Config) -> str:
        """Return why a worker does not serve; "" if it runs or if that is unknown."""
        if self.life is not Life.RUNNING:
            return self.trouble
        for report in self.workers:
            if report.worker == worker:
                return _why(self.name, report) or _not_loaded(self.document, report, config)
        return ""

    def absences(self) -> list[str]:
        """Return a line for each worker that is enabled but does not run."""
        return [_why(self.name, report) for report in self.workers if report.phase in ABSENT]


def daemon_state(config: Config, documents: Iterable[StatusDocument] = (), file: Path | None = None) -> DaemonState:
    """Find out whether a configuration's daemon runs, given its file and the status documents on its hub."""
    unit, down = units.unit_of(file), None
    candidates = state_candidates(config)
    for candidate in candidates:
        document = ask_daemon(candidate)
        if document is not None:
            unit = units.unit_of(document.config or file)
            return DaemonState(config.name, Life.RUNNING, document.pid, document=document, unit=unit)
    for candidate in candidates:
        lock = state_file.daemon_lock(candidate)
        pid = _holder(lock)
        if pid and _holds(pid, lock):
            return DaemonState(config.name, Life.SILENT, pid, unit=unit)
        if pid and down is None:
            down = DaemonState(config.name, Life.DOWN, pid, router=_router_process(candidate), unit=unit)
    if down is not None:
        return down
    orphan = _orphaned_router([document for document in documents if document.daemon == config.name], config)
    return DaemonState(config.name, Life.DOWN if orphan else Life.UNKNOWN, router=orphan, unit=unit)


def state_candidates(config: Config) -> list[Config]:
    """Return the configuration with each state folder that its daemon may have: this user's, and the services'."""
    folders = [state_folder(config).absolute()]
    if config.state is None and units.STATE not in folders:
        folders.append(units.STATE)
    return [config.model_copy(update={"state": folder}) for folder in folders]


def own_router(config: Config) -> int:
    """Return the process of a configuration's router if it holds the hub's port, else 0."""
    from bridge.hub.router import port_holder  # many commands need no router

    holder = port_holder(config.hub.listen)
    routers = [_router_process(candidate) for candidate in state_candidates(config)]
    return holder.pid if holder is not None and holder.pid in routers else 0


def unresponsive_router(config: Config) -> str:
    """Return a message if the process of a configuration's router holds the hub's port, "" otherwise.

    Meant for a port at which no router answers: a router that hangs, or that has no free file descriptor, still
    listens there. Settings of zenoh may also keep programs out, so the message names them.
    """
    pid = own_router(config)
    if not pid:
        return ""
    place, settings = connect_endpoint(config.hub.listen), zenoh_settings(config)
    cause = f"; {settings} may be the cause" if settings else ""
    return f"the router of {config.name} (process {pid}) listens at {place}, but accepts no connection{cause}"


def zenoh_settings(config: Config) -> str:
    """Return the names of the zenoh settings that apply to links with the router; "" without any."""
    settings = (("hub.zenoh", config.hub.zenoh), ("hub.router_zenoh", config.hub.router_zenoh))
    return " and ".join(
        name if isinstance(value, Path) else ", ".join(f"{name}.{key}" for key in _keys(value))
        for name, value in settings
        if value
    )


def _keys(settings: Mapping[str, Any]) -> Iterator[str]:
    """Yield the keys of all values in zenoh settings, with dots between levels."""
    for key, value in settings.items():
        if isinstance(value, dict) and key != "access_control":
            yield from (f"{key}.{inner}" for inner in _keys(value))
        else:
            yield key


def describe(report: WorkerReport) -> str:
    """Describe a worker's state and its crashes, from the daemon's report."""
    text, crashes = report.text, restarted(report.restarts, report.ended)
    if not crashes:
        return text
    return f"({crashes})" if text in ("", report.ended) else f"{text} ({crashes})"


def restarted(restarts: int | None, ended: str) -> str:
    """Describe how often a worker was restarted, and how its last process ended; "" without restarts."""
    if not restarts:
        return ""
    times = "once" if restarts == 1 else f"{restarts} times"
    return f"restarted {times}" + (f"; last end: {ended}" if ended else "")


def is_crash_looping(report: WorkerReport) -> bool:
    """Whether a worker keeps crashing, according to the daemon, even if it is starting or has just started."""
    settled = report.phase == Phase.UP.value and (report.since or 0.0) > _SETTLED_SECONDS
    return report.restarts >= _LOOPS and not settled


def _why(daemon: str, report: WorkerReport) -> str:
    """Return why a worker does not serve, by the daemon's report; "" if it serves or is disabled."""
    phase, beat = report.phase, report.beat
    name, text = f"the worker '{report.worker}' of {daemon}", describe(report)
    if phase == Phase.UP.value:
        if beat is not None and beat > _SILENT_SECONDS:
            return f"{name} hangs: its last heartbeat was {beat:.0f} s ago"
        return ""
    if phase == Phase.OFF.value:
        return ""
    return f"{name} is {phase}: {text}" if phase != Phase.FAILED.value else f"{name} {phase}: {text}"


def _not_loaded(daemon: DaemonStatus, report: WorkerReport, config: Config) -> str:
    """Return a text if this configuration enables a worker that is off, as the daemon runs another one; else ""."""
    kind = worker_kinds().get(report.worker)
    if report.phase != Phase.OFF.value or kind is None or not kind.enabled(config):
        return ""
    return (
        f"the daemon {daemon.daemon} runs without the worker '{report.worker}': it has not loaded this"
        f" configuration (it runs {daemon.config or 'its defaults'}; 'midspan reload' makes it load its file again)"
    )


def _holder(lock: Path) -> int:
    """Return the process of this machine that a lock names, even if the process is dead; else 0."""
    from bridge.daemon.lock import Lock

    try:
        if not lock.exists():
            return 0
        opened = Lock(lock)
    except OSError:
        return 0
    try:
        holder = opened.holder()
    finally:
        opened.close()
    return holder.pid if holder is not None and holder.is_here else 0


def _holds(pid: int, lock: Path) -> bool:
    """Whether a process holds a lock, by the kernel's table, as trying to lock could make a starting daemon fail."""
    try:
        inode, rows = str(lock.stat().st_ino), Path("/proc/locks").read_text(encoding="utf-8").splitlines()
    except OSError:
        return _is_alive(pid)
    held = {(row.split()[-4], row.split()[-3].rpartition(":")[2]) for row in rows if " FLOCK " in row}
    return (str(pid), inode) in held


def _is_alive(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return False


def _router_process(config: Config) -> int:
    """Return the process of this daemon's router, which may outlive the daemon; 0 if it does not run."""
    pid = _holder(state_file.worker_lock(config, ROUTER.name))
    return pid if pid and _is_alive(pid) else 0


def _orphaned_router(documents: list[StatusDocument], config: Config) -> int:
    """Return the process of another user's router if its daemon has exited and only the router still runs; else 0.

    A router that was started without a daemon ('midspan worker router') does not count.
    """
    if [document.worker for document in documents] != [ROUTER.name]:
        return 0
    others = [
        kind for name, kind in worker_kinds().items() if name != ROUTER.name and kind.enabled(config) is not False
    ]
    pid = documents[0].pid
    if not others or pid in (0, os.getpid()):
        return 0
    try:
        process = psutil.Process(pid)
        parent = process.parent()
        supervised = {"bridge.cli.child", "--supervised"} <= set(process.cmdline())
        left = parent is None or "run" not in parent.cmdline()
    except psutil.Error:
        return 0
    return pid if supervised and left else 0


def absent(report: DaemonStatus, phases: Container[str] = ABSENT, *, looping: bool = False) -> list[StatusDocument]:
    """Return the workers in these phases from a daemon's own report; ``looping`` adds those that keep crashing."""
    return [
        _reported(report.daemon, worker)
        for worker in report.workers
        if worker.phase in phases or (looping and is_crash_looping(worker))
    ]


def without_node(report: DaemonStatus) -> list[StatusDocument]:
    """Return the running workers that are not nodes of the hub, from a daemon's own report."""
    kinds = worker_kinds()
    return [
        _reported(report.daemon, worker)
        for worker in report.workers
        if worker.phase == Phase.UP.value and worker.worker in kinds and not kinds[worker.worker].node
    ]


def unanswered(report: DaemonStatus, documents: Iterable[StatusDocument]) -> list[StatusDocument]:
    """Return the running workers that should be nodes of the hub, but sent none of the documents."""
    kinds, known = worker_kinds(), list(documents)
    pids = {document.pid for document in known}
    names = {document.worker for document in known if document.daemon == report.daemon}
    missing = [
        worker
        for worker in report.workers
        if worker.phase == Phase.UP.value
        and not (worker.pid in pids or worker.worker in names)
        and worker.worker in kinds
        and kinds[worker.worker].node
    ]
    return [
        _reported(report.daemon, worker).model_copy(
            update={"error": f"no answer on the hub{f'; {worker.text}' if worker.text else ''}", "text": ""}
        )
        for worker in missing
    ]


def _reported(daemon: str, report: WorkerReport) -> StatusDocument:
    document = StatusDocument(
        daemon=daemon,
        worker=report.worker,
        state=report.phase,
        text=" ".join(filter(None, (describe(report), f"({duration(report.since)})"))),
        pid=report.pid,
        restarts=report.restarts,
    )
    return document.model_copy(update={"loops": True}) if is_crash_looping(report) else document


def with_silent(documents: Sequence[StatusDocument], silent: Sequence[StatusDocument]) -> list[StatusDocument]:
    """Add the workers that do not answer, and mark those that answer but keep crashing, by their daemon's report."""
    reported = {(document.daemon, document.worker): document for document in silent}
    answering: list[StatusDocument] = []
    for document in documents:
        other = reported.pop((document.daemon, document.worker), None)
        if other is not None and other.loops:
            update = {"loops": True, "restarts": other.restarts, "text": other.text}
            answering.append(document.model_copy(update=update))
        else:
            answering.append(document)
    return [*answering, *reported.values()]


def with_restarts(documents: Sequence[StatusDocument], report: DaemonStatus) -> list[StatusDocument]:
    """Add the restarts, which only the daemon knows, to the documents from its processes, with the last reason."""
    reports = {worker.pid: worker for worker in report.workers if worker.pid and worker.restarts}

    def completed(document: StatusDocument) -> StatusDocument:
        worker = reports.get(document.pid) if document.daemon == report.daemon else None
        if worker is None or document.restarts is not None:
            return document
        return document.model_copy(update={"restarts": worker.restarts, "ended": worker.ended})

    return [completed(document) for document in documents]
