"""The input of the doctor's checks: configuration, environment, hub, clocks, ROS 1 master, machine."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from threading import Lock

import psutil

from bridge.adapters.ros1.environment import master_uri
from bridge.adapters.ros1.graph.state import MasterReader, MasterState
from bridge.adapters.ros1_peers import Ros1Error, XmlRpcClient
from bridge.config.model import Config
from bridge.doctor.daemon_state import DaemonState
from bridge.hub.graph import HubEndpoint
from bridge.status import StatusDocument, WorkerStatus


@dataclass(frozen=True, slots=True)
class Offset:
    """Seconds by which another clock is ahead of this machine's, within plus or minus ``error``."""

    seconds: float
    error: float


def measure(ask: Callable[[], int | None], times: int = 5) -> Offset | None:
    """Measure a clock by asking for its system time in ns; the quickest answer is used. None without an answer."""
    best: Offset | None = None
    for _ in range(times):
        started, before = time.monotonic_ns(), time.time_ns()  # in this order the round trip includes a pause between
        reported = ask()
        round_trip = time.monotonic_ns() - started
        if reported is None:
            continue
        offset = Offset((reported - before - round_trip / 2) / 1e9, round_trip / 2e9)
        if best is None or offset.error < best.error:
            best = offset
    return best


_MASTER_SECONDS = 2.0


@dataclass(frozen=True)
class HubSnapshot:
    """A snapshot of the hub, with each worker's clock by ``daemon/worker``; ``error`` is why no router answered."""

    error: str = ""
    documents: Sequence[StatusDocument] = ()
    endpoints: Sequence[HubEndpoint] = ()
    clocks: Mapping[str, Offset] = field(default_factory=dict)

    def of_side(self, side: str, daemon: str | None = None) -> list[WorkerStatus]:
        """Return the documents of one side's workers."""
        workers = [document for document in self.documents if isinstance(document, WorkerStatus)]
        return [worker for worker in workers if worker.side == side and daemon in (None, worker.daemon)]


@dataclass
class CheckContext:
    """The input of the checks; the configuration is all defaults if the file cannot be used."""

    config: Config = field(default_factory=Config)
    config_text: str = "no file, all defaults"
    config_good: bool = True
    environ: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))
    hub: HubSnapshot = field(default_factory=HubSnapshot)
    daemon: DaemonState = field(default_factory=lambda: DaemonState(""))
    shm: Path = Path("/dev/shm")  # noqa: S108  where the system keeps it
    proc: Path = Path("/proc")
    root: Path = Path("/")
    _lock: Lock = field(default_factory=Lock, repr=False)

    @property
    def master(self) -> str:
        """The ROS 1 master that the daemon uses by configuration and environment."""
        return master_uri(self.config, self.environ)

    def master_state(self) -> MasterState | Ros1Error:
        """Return the master's state, or why it does not answer; the master is queried only once."""
        with self._lock:
            return self._query_master

    @cached_property
    def _query_master(self) -> MasterState | Ros1Error:
        return read_master(self.master)

    def process(self, document: StatusDocument) -> psutil.Process | None:
        """Return the process of a worker of this daemon, None if it is on another machine or hidden."""
        if document.daemon != self.config.name or document.pid <= 0:
            return None
        try:
            process = psutil.Process(document.pid)
            arguments = process.cmdline()[:4]  # interpreter, its flags, program
        except psutil.Error:
            return None
        return process if any(w.startswith("bridge.") or Path(w).name == "midspan" for w in arguments) else None


def read_master(uri: str) -> MasterState | Ros1Error:
    """Return a master's state, or why it does not answer."""
    try:
        with contextlib.closing(XmlRpcClient(uri, _MASTER_SECONDS)) as client:
            return MasterReader(client, "/midspan_doctor").read()
    except Ros1Error as err:
        return err


def environment_of(process: psutil.Process | None) -> Mapping[str, str]:
    """Return a process's environment, empty if it cannot be read."""
    if process is None:
        return {}
    try:
        return process.environ()
    except psutil.Error:
        return {}
