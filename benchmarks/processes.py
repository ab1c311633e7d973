"""The processes of a benchmark: roscore, the daemon, and programs that execute commands, in a temporary sandbox."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import benchmarks
from bridge.demo import sandbox
from bridge.demo.leftovers import SharedMemory, erase, marked
from bridge.demo.processes import DemoChild, guarded
from bridge.demo.sandbox import Sandbox

UP_SECONDS = 60.0


class Processes:
    """A sandbox with its processes, which end with the sandbox.

    Args:
        config: the daemon's configuration, without the sandbox's folders and addresses.
        template: a configuration file that ``config`` overrides.
        yarp: whether there is also a YARP network, to which every topic is bridged.
    """

    def __init__(self, config: Mapping[str, Any], template: Path | None = None, *, yarp: bool = False) -> None:
        self._children: dict[str, DemoChild] = {}
        self.place = place = Sandbox(template, config, yarp=yarp)
        self._memory = SharedMemory(place.folder, place.domain_ports)
        try:
            (place.system_path / "benchmarks").symlink_to(Path(benchmarks.__path__[0]))
            self._ros1 = place.ros1_environment()
        except BaseException:
            place.close()
            raise
        self._own = place.environment()

    def start_master(self) -> None:
        """Start roscore, and wait until it replies."""
        place = self.place
        roscore = sandbox.roscore(place.config)
        assert roscore is not None
        command = guarded(sandbox.SYSTEM_PYTHON, roscore, "-p", str(place.master_port))
        self._spawn("roscore", command, self._ros1)
        self.until(place.master_answers, "roscore answers")

    def start_daemon(self) -> None:
        """Start the daemon, without waiting for it."""
        command = guarded(sys.executable, "-m", "bridge.cli.main", "run", "--config", self.place.config_file)
        self._spawn("daemon", command, self.place.environment())

    def launch(self, name: str, module: str, *arguments: str, system: bool = False) -> DemoChild:
        """Start a program.

        Args:
            name: its name, for display and for `command`.
            module: the Python module that it runs.
            arguments: the module's arguments.
            system: whether it runs on the system's Python with ROS 1's packages, instead of Midspan's.
        """
        python, env = (sandbox.SYSTEM_PYTHON, self._ros1) if system else (sys.executable, self._own)
        return self._spawn(name, [python, "-m", module, *arguments], env)

    def _spawn(self, name: str, command: Sequence[str | Path], env: Mapping[str, str]) -> DemoChild:
        child = self._children[name] = DemoChild(name, command, env, self.place.folder)
        return child

    def command(self, name: str, do: str, event: str, **params: Any) -> dict[str, Any]:
        """Send a command to a program, and return its answer."""
        self._children[name].ask(do, **params)
        return self.wait_for(name, event)

    def wait_for(self, name: str, event: str) -> dict[str, Any]:
        """Wait for an event from a program; raises `RuntimeError` on a time-out."""
        message = self._children[name].wait_for(event, UP_SECONDS)
        if message is None:
            msg = f"{name} did not answer ({event}):\n{self._children[name].last_output()}\n{self.words()}"
            raise RuntimeError(msg)
        return message

    def until(
        self, condition: Callable[[], object], what: str, seconds: float = UP_SECONDS, every: float = 0.05
    ) -> float:
        """Wait for a condition, and return the moment at which it held; raises `RuntimeError` on a time-out."""
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                msg = f"not within {seconds:g} s: {what}\n{self.words()}"
                raise RuntimeError(msg)
            time.sleep(every)
        return time.monotonic()

    def words(self) -> str:
        """Return the end of the daemon's log."""
        return self._children["daemon"].last_output() if "daemon" in self._children else ""

    def prefer(self) -> None:
        """Schedule all these processes before the machine's others (Linux, root)."""
        for pid in marked(self.place.folder):
            for task in Path(f"/proc/{pid}/task").iterdir():
                with contextlib.suppress(ProcessLookupError):
                    os.sched_setscheduler(int(task.name), os.SCHED_RR, os.sched_param(1))

    def stop(self, name: str) -> None:
        """Stop a process in an orderly manner."""
        child = self._children.pop(name)
        child.begin_stop()
        child.finish_stop(5.0)

    def remember_memory(self) -> set[Path]:
        """Return the files in shared memory that processes of this run use, or used at an earlier call."""
        self._memory.note()
        return self._memory.own

    def close(self) -> None:
        self._memory.note()
        last = ("daemon", "roscore")
        groups = [[name for name in self._children if name not in last], *([name] for name in last)]
        for group in groups:
            children = [self._children[name] for name in group if name in self._children]
            for child in children:
                child.begin_stop()
            for child in children:
                child.finish_stop(9.0)
        erase(self.place.folder, self.place.domain_ports)
        self._memory.remove()
        self.place.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.close()


def add_realtime_option(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--realtime`` to a benchmark, for `Processes.prefer`."""
    parser.add_argument(
        "--realtime",
        action="store_true",
        help="schedule the benchmark's processes before the machine's others (Linux, root)",
    )
