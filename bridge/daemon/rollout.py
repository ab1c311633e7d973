"""The order in which workers stop, and in which they receive a reloaded configuration."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence

from bridge.config.model import Config
from bridge.daemon.worker_process import STEP, WorkerProcess
from bridge.sides import all_sides


def stop_order(workers: Sequence[WorkerProcess]) -> tuple[list[WorkerProcess], ...]:
    """Return the workers in three groups, in the order in which they stop.

    The sides stop after the modules, so that a canceled goal and a zero velocity still reach the robot, and modules
    can still unregister their YARP ports. Workers that survive a crash of the daemon, such as the router, stop last.
    """
    names = {side.name for side in all_sides()}
    last = [worker for worker in workers if worker.kind.outlives]
    sides = [worker for worker in workers if worker.name in names]
    return [worker for worker in workers if worker not in (*last, *sides)], sides, last


class Rollout:
    """Hands a reloaded configuration to one group of `stop_order` after the other.

    A group receives it when all workers of the group before have applied it, or have stopped because they restart, but
    ``seconds`` after that group at the latest. Meanwhile no worker starts: first all that restart have stopped.
    """

    def __init__(self, config: Config, workers: Sequence[WorkerProcess], seconds: float) -> None:
        """Create a rollout that is complete: the workers have ``config``."""
        self._config, self._workers, self._seconds = config, workers, seconds
        self._later: deque[list[WorkerProcess]] = deque()
        self._group: list[WorkerProcess] = []
        self._ends = 0.0

    def begin(self, config: Config) -> None:
        """Configure the first group; this replaces a rollout that is not complete."""
        self._config = config
        self._later = deque(group for group in stop_order(self._workers) if group)
        self._group = []
        self.step()

    @property
    def pause(self) -> float:
        """Seconds after which `step` has to be called again, if no worker reports until then."""
        return STEP if self._later or self._group else math.inf

    @property
    def pending(self) -> list[str]:
        """The workers that have not applied the configuration or stopped yet, of one group; [] after the rollout."""
        pending = [worker.name for worker in self._group if worker.is_reconfiguring]
        return pending or [worker.name for group in list(self._later)[:1] for worker in group]

    def step(self) -> None:
        """Configure the next groups that are due."""
        while self._later or self._group:
            if any(worker.is_reconfiguring for worker in self._group) and time.monotonic() < self._ends:
                return
            self._group = self._later.popleft() if self._later else []
            self._ends = time.monotonic() + self._seconds
            for worker in self._group:
                worker.configure(self._config)
