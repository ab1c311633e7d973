"""The interface between a worker and the daemon that starts and monitors it."""

from __future__ import annotations

import os
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import psutil

from bridge.config.model import Config


@dataclass(frozen=True, slots=True)
class Health:
    """The state of a worker, for example ``waiting`` for its network, or ``standby`` while another daemon is active."""

    state: Literal["running", "waiting", "standby"]
    text: str


class WorkerFailedError(RuntimeError):
    """A worker cannot continue; the text is the reason. Its process exits and is restarted."""


class StatusHead:
    """Creates the first fields of one worker's or module's status documents: its names, its process, its state.

    Args:
        names: ``daemon`` and ``worker``, and ``side`` or ``module``.
        uptime: whether the documents contain the time since this object was created.
        costs: whether they contain the process's CPU and memory usage.
    """

    def __init__(self, names: Mapping[str, Any], *, uptime: bool = True, costs: bool = True) -> None:
        self._names = dict(names)
        self._started = time.monotonic() if uptime else None
        self._process = psutil.Process() if costs else None
        if self._process is not None:
            self._process.cpu_percent()  # the next call covers the time since this one

    def fields(self, state: str, text: str | None = None, **own: Any) -> dict[str, Any]:
        """Return the first fields of a `bridge.status.StatusDocument`, and the worker's ``own`` keys."""
        fields = {**self._names, "pid": os.getpid(), "state": state, **({} if text is None else {"text": text})}
        if self._started is not None:
            fields["uptime"] = round(time.monotonic() - self._started, 1)
        return {**fields, **({} if self._process is None else _costs(self._process)), **own}


def _costs(process: psutil.Process) -> dict[str, float]:
    """Return the CPU usage in cores since the last call, and the memory usage in bytes.

    The result is empty if no file descriptor is free to read them, so that the rest of the document is still reported.
    """
    try:
        return {"cpu": round(process.cpu_percent() / 100, 4), "rss": process.memory_info().rss}
    except OSError:
        return {}


class Worker(ABC):
    """The job of one process: a side's adapter, the router, the modules or the simulator.

    The process's main loop calls these methods, one at a time.
    """

    @abstractmethod
    def start(self, config: Config) -> None:
        """Start without waiting for the network.

        Raises:
            RuntimeError: the worker cannot work on this machine; the text is a plain reason.
            HubError: the worker cannot join the hub now; its process exits and is restarted.
        """

    @abstractmethod
    def reload(self, config: Config) -> bool:
        """Apply a new, already checked configuration; return False if that needs a restart of the worker."""

    @abstractmethod
    def health(self) -> Health:
        """Return the worker's state, from its main loop.

        Raises:
            TimeoutError: the main loop does not respond in time.
            WorkerFailedError: the worker cannot continue; its process exits and is restarted.
        """

    def diagnostics_wanted(self) -> bool:
        """Return whether ``/diagnostics`` has a subscriber, and one process of the daemon must therefore publish it.

        A worker that does not see the hub's graph, or itself publishes ``/diagnostics``, returns False.
        """
        return False

    @abstractmethod
    def stop(self) -> None:
        """Stop and unregister everything, within two seconds. Safe to call twice."""
