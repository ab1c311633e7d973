"""What the doctor's checks look at: configuration, environment, the hub, the ROS 1 master, the machine."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Any

import psutil

from bridge.adapters.ros1.environment import master_uri
from bridge.adapters.ros1.errors import Ros1Error
from bridge.adapters.ros1.graph import Look, Looker
from bridge.adapters.ros1.rpc import RpcClient
from bridge.config.model import Config
from bridge.doctor.clock import Offset
from bridge.hub.graph import HubEndpoint

Document = Mapping[str, Any]

_MASTER_SECONDS = 2.0


@dataclass(frozen=True)
class HubView:
    """The hub as it was found.

    Attributes:
        error: why nothing could be asked, "" where a router answered.
        documents: status documents of the workers.
        endpoints: the hub's graph.
        clocks: each worker's clock against this machine's, by ``daemon/worker``.
    """

    error: str = ""
    documents: Sequence[Document] = ()
    endpoints: Sequence[HubEndpoint] = ()
    clocks: Mapping[str, Offset] = field(default_factory=dict)

    def of_side(self, side: str, daemon: str | None = None) -> list[Document]:
        """The documents of one side's workers."""
        return [d for d in self.documents if d.get("side") == side and daemon in (None, d.get("daemon"))]


@dataclass
class Around:
    """Everything that the checks may look at.

    Attributes:
        config: the configuration, all defaults where it cannot be used.
        config_text: where it comes from, or what is wrong with it.
        config_good: whether it can be used.
        shm: where POSIX shared memory lies.
        proc: where the system tells of processes.
    """

    config: Config = field(default_factory=Config)
    config_text: str = "no file, all defaults"
    config_good: bool = True
    environ: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))
    hub: HubView = field(default_factory=HubView)
    shm: Path = Path("/dev/shm")  # noqa: S108  where the system keeps it
    proc: Path = Path("/proc")
    _lock: Lock = field(default_factory=Lock, repr=False)

    @property
    def master(self) -> str:
        """The ROS 1 master that the daemon uses by configuration and environment."""
        return master_uri(self.config, self.environ)

    def look_at_master(self) -> Look | Ros1Error:
        """The master's state, or why it does not answer; asked once."""
        with self._lock:
            return self._look

    @cached_property
    def _look(self) -> Look | Ros1Error:
        try:
            client = RpcClient(self.master, _MASTER_SECONDS)
            try:
                return Looker(client, "/midspan_doctor").look()
            finally:
                client.close()
        except Ros1Error as err:
            return err

    def process(self, document: Document) -> psutil.Process | None:
        """The process of a worker of this daemon on this machine, None where it is not here or hidden from us."""
        pid = document.get("pid")
        if document.get("daemon") != self.config.name or not isinstance(pid, int) or pid <= 0:
            return None
        try:
            process = psutil.Process(pid)
            words = process.cmdline()[:4]  # interpreter, its flags, program
        except psutil.Error:
            return None
        return process if any(w.startswith("bridge.") or Path(w).name == "midspan" for w in words) else None


def environment_of(process: psutil.Process | None) -> Mapping[str, str]:
    """A process's environment, empty where it cannot be read."""
    if process is None:
        return {}
    try:
        return process.environ()
    except psutil.Error:
        return {}
