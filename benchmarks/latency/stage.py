"""The processes of a benchmark whose ends stamp, send and receive messages."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.latency.usage import processes
from benchmarks.processes import Processes

_MEMORY = {"MALLOC_MMAP_THRESHOLD_": "1000000000", "MALLOC_TRIM_THRESHOLD_": "1000000000"}
"""Lets glibc retain freed memory in the ends. Otherwise large messages would cause page faults, which double the cost
of 1 MB over ROS 1 and quadruple the cost of 6 MB over ROS 2, and so make the floor easier to reach."""

_PROFILE = str(Path(__file__).with_name("fastdds.xml"))


class Stage(Processes):
    """A set of processes with a daemon and ends (`benchmarks.latency.end`)."""

    def __init__(self, config: Mapping[str, Any]) -> None:
        super().__init__(config)
        profile = {"FASTRTPS_DEFAULT_PROFILES_FILE": _PROFILE, "FASTDDS_DEFAULT_PROFILES_FILE": _PROFILE}
        self._ros1 = self._ros1 | _MEMORY
        self._own = self._own | _MEMORY | profile | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}

    def start_bridge(self) -> None:
        """Start roscore and the daemon, and wait for the master."""
        self.start_master()
        self.start_daemon()

    def start_ends(self, kinds: Mapping[str, str]) -> None:
        """Start ends of ROS 1 and ROS 2 by name, and wait until they are ready."""
        for name, kind in kinds.items():
            self.launch(name, f"benchmarks.latency.{kind}_end", system=kind == "ros1")
        for name in kinds:
            self.wait_for(name, "ready")

    def until_crosses(self, sender: str, listener: str, topic: str) -> None:
        """Send until a message arrives."""

        def crosses() -> bool:
            self.command(sender, "send", "sent", topic=topic, count=1, period=0.0)
            return bool(self.command(listener, "collect", "collected", topic=topic, count=1, seconds=0.5)["ages"])

        self.until(crosses, f"a message arrives on {topic} from {sender} to {listener}")

    def process_ids(self) -> dict[str, int]:
        """Return process ids by name: the daemon's processes, the ROS master, the ends."""
        ends = {name: child.pid for name, child in self._children.items() if name not in ("roscore", "daemon")}
        return processes(self.place.folder) | ends
