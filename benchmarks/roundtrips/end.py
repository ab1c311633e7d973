"""What the programs share: they obey JSON lines, and measure round trips. Standard library only.

Under a prefix (``/there``) a server has four names: ``call`` (a small service), ``map`` (GetMap of 1 MB), ``go`` (an
action whose goals succeed at once) and ``hold`` (one whose goals end when they are cancelled).
"""

from __future__ import annotations

import gc
import json
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable

from benchmarks.latency.end import reply

MAP_SIDE = 1000
"""Cells of the map along each side, one byte each."""
CASES = ("call", "map", "go", "hold")


class End(ABC):
    """A program that serves and one that calls, for one middleware. Each call returns the nanoseconds it took."""

    @abstractmethod
    def serve(self, prefix: str) -> None:
        """Serve all four."""

    @abstractmethod
    def wait_for(self, prefix: str) -> None:
        """Make the clients, and wait until there are servers."""

    @abstractmethod
    def call(self, prefix: str) -> int:
        """A small call."""

    @abstractmethod
    def get_map(self, prefix: str) -> int:
        """A call with a large reply."""

    @abstractmethod
    def run_goal(self, prefix: str) -> int:
        """A goal, to its result."""

    @abstractmethod
    def cancel_goal(self, prefix: str) -> int:
        """From the request to cancel a goal to its end."""

    @abstractmethod
    def close(self) -> None:
        """Leave the network."""

    def run(self) -> None:
        """Obey until the input ends."""
        gc.collect()
        gc.disable()  # pauses of these programs are not what is measured
        reply("ready")
        cases: dict[str, Callable[[str], int]] = {
            "call": self.call,
            "map": self.get_map,
            "go": self.run_goal,
            "hold": self.cancel_goal,
        }
        try:
            for line in sys.stdin:
                command = json.loads(line)
                prefix = command["prefix"]
                if command["do"] == "serve":
                    self.serve(prefix)
                    reply("serving")
                elif command["do"] == "find":
                    self.wait_for(prefix)
                    reply("found")
                else:
                    trip, times = cases[command["case"]], []
                    for _ in range(command["count"]):
                        times.append(trip(prefix))
                        time.sleep(command["pause"])
                    reply("measured", times=times)
        finally:
            self.close()
