"""What a worker is to the daemon that starts and watches it, whatever it joins."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Literal

import psutil

from bridge.config.model import Config


@dataclass(frozen=True, slots=True)
class Health:
    """How a worker is: ``waiting`` where its network is away, ``standby`` where another daemon is active on it."""

    state: Literal["running", "waiting", "standby"]
    text: str


def costs(process: psutil.Process) -> dict[str, Any]:
    """Processor (share of a core since the last call) and memory (bytes), as they stand in a status document.

    Nothing where no file descriptor is left to read them with: the rest of the document is all the more wanted then.
    """
    try:
        return {"cpu": round(process.cpu_percent() / 100, 4), "rss": process.memory_info().rss}
    except OSError:
        return {}


class Worker(ABC):
    """One process's job: a side's adapter, the router, the modules or the simulator.

    The process's main loop calls these, never two at once.
    """

    @abstractmethod
    def start(self, config: Config) -> None:
        """Begin; returns soon. Raises `RuntimeError` with a plain reason where it can never work here."""

    @abstractmethod
    def reload(self, config: Config) -> bool:
        """Take up a new, already checked configuration; False where only a restart of the worker can."""

    @abstractmethod
    def health(self) -> Health:
        """How the worker is, asked of its real loop.

        Raises:
            TimeoutError: that loop does not answer in time.
            RuntimeError: the worker cannot go on; its process ends, and is started again.
        """

    def hears_diagnostics(self) -> bool:
        """Whether somebody hears ``/diagnostics``, which this process then tells unless another one of the daemon does.

        False of a worker that cannot see it, or tells by itself.
        """
        return False

    @abstractmethod
    def stop(self) -> None:
        """Stop and unregister everything, within two seconds. Safe to call twice."""
