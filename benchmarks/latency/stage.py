"""The processes of a benchmark: roscore, the daemon and ends that obey commands, in a place of their own."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import benchmarks
from benchmarks.latency.usage import processes
from bridge.demo import requirements
from bridge.demo.child import Child, guarded
from bridge.demo.place import Place
from bridge.demo.traces import marked, remove_unused, shared_memory, sweep

UP_SECONDS = 40.0
_MEMORY = {"MALLOC_MMAP_THRESHOLD_": "1000000000", "MALLOC_TRIM_THRESHOLD_": "1000000000"}
"""glibc keeps freed memory in the ends: with its defaults each large message is paid for again by page faults, 1 MB
over ROS 1 twice and 6 MB over ROS 2 four times as dear, and the floor would be that much easier to reach."""

_PROFILE = Path(__file__).with_name("fastdds.xml")


class Stage:
    """A place, and the processes in it; all end with it.

    Args:
        config: the daemon's configuration, but for what names the place.
    """

    def __init__(self, config: Mapping[str, Any]) -> None:
        self._children: dict[str, Child] = {}
        self.place = place = Place(None, config)
        try:
            (place.system_path / "benchmarks").symlink_to(Path(benchmarks.__path__[0]))
            self._packages = requirements.ros1_packages(place.config)
        except BaseException:
            place.close()
            raise
        self._ros1 = place.ros1_environment(self._packages) | _MEMORY
        self._own = (
            place.environment()
            | _MEMORY
            | {
                "FASTRTPS_DEFAULT_PROFILES_FILE": str(_PROFILE),
                "FASTDDS_DEFAULT_PROFILES_FILE": str(_PROFILE),
                "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
            }
        )

    def start_bridge(self) -> None:
        """Start roscore and the daemon, and wait for the master."""
        place = self.place
        roscore = guarded(requirements.SYSTEM_PYTHON, requirements.roscore(place.config), "-p", str(place.master_port))
        self._children["roscore"] = Child("roscore", roscore, self._ros1, place.folder)
        daemon = guarded(sys.executable, "-m", "bridge.cli.main", "run", "--config", place.config_file)
        self._children["daemon"] = Child("daemon", daemon, place.environment(), place.folder)
        end = time.monotonic() + UP_SECONDS
        while not place.master_answers() and time.monotonic() < end:
            time.sleep(0.1)

    def launch(self, name: str, module: str, *arguments: str, system: bool = False) -> Child:
        """Start an end.

        Args:
            name: its name, for people and for `command`.
            module: the Python module that it runs.
            arguments: the module's.
            system: on the system's Python with ROS 1's packages, instead of Midspan's own.
        """
        python, env = (requirements.SYSTEM_PYTHON, self._ros1) if system else (sys.executable, self._own)
        child = Child(name, [python, "-m", module, *arguments], env, self.place.folder)
        self._children[name] = child
        return child

    def command(self, name: str, do: str, event: str, **params: Any) -> dict[str, Any]:
        """Send an end a command, and wait for its answer."""
        self._children[name].ask(do, **params)
        return self.wait_for(name, event)

    def wait_for(self, name: str, event: str) -> dict[str, Any]:
        """An event that an end tells; raises `RuntimeError` where it does not in time."""
        told = self._children[name].wait_for(event, UP_SECONDS)
        if told is None:
            msg = f"{name} did not answer ({event}):\n{self._children[name].last_words()}"
            raise RuntimeError(msg)
        return told

    def process_ids(self) -> dict[str, int]:
        """Process ids by name: the daemon's processes, the ROS master, the ends."""
        ends = {name: child.pid for name, child in self._children.items() if name not in ("roscore", "daemon")}
        return processes(self.place.folder) | ends

    def words(self) -> str:
        """The daemon's last words."""
        return self._children["daemon"].last_words()

    def prefer(self) -> None:
        """Have all these processes scheduled before the machine's others (Linux, root); for all alike, so fair."""
        for pid in marked(self.place.folder):
            for task in Path(f"/proc/{pid}/task").iterdir():
                with contextlib.suppress(ProcessLookupError):
                    os.sched_setscheduler(int(task.name), os.SCHED_RR, os.sched_param(1))

    def close(self) -> None:
        """End all processes."""
        memory = shared_memory(self.place.folder, self.place.domain_ports)
        last = ("daemon", "roscore")
        groups = [[name for name in self._children if name not in last], *([name] for name in last)]
        for group in groups:
            children = [self._children[name] for name in group if name in self._children]
            for child in children:
                child.begin_stop()
            for child in children:
                child.finish_stop(9.0)
        sweep(self.place.folder)
        remove_unused(memory)
        self.place.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.close()
