"""Base of the programs, which measure round trips and are controlled by JSON lines. Standard library only.

Under a prefix (``/there``) a server has four names: ``call`` (a small service), ``map`` (GetMap of 1 MB), ``go`` (an
action whose goals succeed at once) and ``hold`` (an action whose goals end when they are canceled).
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
    """A program that serves or calls, for one middleware; each call returns its duration in nanoseconds."""

    @abstractmethod
    def serve(self, prefix: str) -> None:
        """Serve all four names."""

    @abstractmethod
    def wait_for(self, prefix: str) -> None:
        """Create the clients, and wait for the servers."""

    @abstractmethod
    def call(self, prefix: str) -> int:
        """Make a small call."""

    @abstractmethod
    def get_map(self, prefix: str) -> int:
        """Make a call with a large reply."""

    @abstractmethod
    def run_goal(self, prefix: str) -> int:
        """Measure from sending a goal to receiving its result."""

    @abstractmethod
    def cancel_goal(self, prefix: str) -> int:
        """Measure from the cancel request for a goal to the end of the goal."""

    @abstractmethod
    def close(self) -> None:
        """Leave the network."""

    def run(self) -> None:
        """Execute commands until the input ends."""
        gc.collect()
        gc.disable()  # pauses of these programs must not count
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
