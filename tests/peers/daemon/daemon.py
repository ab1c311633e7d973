"""A real ``midspan run`` with fake workers."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import psutil

from tests.support.forks import DAEMON, DAEMON_AND_WORKERS
from tests.support.process import Process
from tests.support.wait import until

ROOT = Path(__file__).parents[3]
IMPORTS = (*DAEMON_AND_WORKERS, "tests.peers.daemon.fakes")
FAKES = ",".join(f"{name}=tests.peers.daemon.fakes:{name.capitalize()}" for name in ("router", "ros1", "ros2", "sim"))


class Daemon:
    """Starts daemons in one folder, and reads the events of their workers."""

    def __init__(self, folder: Path, config: str = "") -> None:
        self.folder = folder
        self.file = folder / "midspan.yaml"
        self.configure(config)
        self.processes: list[Process] = []
        self.env = {
            **{name: value for name, value in os.environ.items() if not name.startswith(("MIDSPAN_", "ROS_"))},
            "MIDSPAN_WORKERS": FAKES,
            "FAKE_FOLDER": str(folder),
            "PYTHONPATH": str(ROOT),
            "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
        }

    def configure(self, config: str) -> None:
        """Write the configuration file, with the test's name and state folder."""
        self.file.write_text(f"name: test\nstate: state\n{config}")

    def order(self, worker: str, *orders: str) -> None:
        """Set the behavior of a worker from now on."""
        file = self.folder / f"{worker}.do"
        new = file.with_suffix(".new")
        new.write_text(" ".join(orders))
        new.replace(file)

    def start(self, *options: str, env: dict[str, str] | None = None) -> Process:
        """Start a daemon."""
        return self.midspan("run", "--config", str(self.file), *options, env=env)

    def quick(self, cores: int, **limits: float) -> Process:
        """Start a daemon with other limits (`Timing`), as on a machine with this number of cores."""
        options = [f"{name}={seconds}" for name, seconds in limits.items()]
        command = [sys.executable, "-m", "tests.peers.daemon.quick", str(self.file), str(cores), *options]
        process = Process(command, self.env, imports=IMPORTS)
        self.processes.append(process)
        return process

    def midspan(self, *arguments: str, env: dict[str, str] | None = None) -> Process:
        """Start any midspan command."""
        command = [sys.executable, "-m", "bridge.cli.main", *arguments]
        imports = IMPORTS if arguments[:1] == ("run",) else DAEMON
        process = Process(command, {**self.env, **(env or {})}, imports=imports)
        self.processes.append(process)
        return process

    def events(self, worker: str, kind: str = "") -> list[list[str]]:
        """Return a worker's events so far, each split into words."""
        file = self.folder / f"{worker}.events"
        lines = file.read_text().splitlines() if file.exists() else []
        return [line.split() for line in lines if line.startswith(kind)]

    def pids(self, worker: str) -> list[int]:
        """Return the process ids of all starts of a worker so far."""
        return [int(fields[1]) for fields in self.events(worker, "start")]

    def wait_started(self, worker: str, count: int = 1, seconds: float = 40.0) -> int:
        """Return the process id of a worker's start number ``count``."""
        until(lambda: len(self.pids(worker)) >= count, f"start {count} of {worker}", seconds)
        return self.pids(worker)[count - 1]

    def wait_ready(self, process: Process) -> None:
        """Wait until the daemon logs that it is ready."""
        until(lambda: "ready: " in process.output(), "the daemon is ready")

    def expect_output(self, process: Process, text: str, seconds: float = 40.0) -> None:
        """Wait for a text in a process's output."""
        until(lambda: text in process.output(), f"{text!r} in:\n{process.output()}", seconds)

    def close(self) -> None:
        """Stop all daemons, and kill all workers that a test left running."""
        for process in self.processes:
            process.signal(signal.SIGCONT)
            process.stop()
        for worker in ("router", "ros1", "ros2", "sim"):
            for pid in self.pids(worker):
                with contextlib.suppress(ProcessLookupError):  # it may exit meanwhile
                    if alive(pid):
                        os.kill(pid, signal.SIGKILL)


def alive(pid: int) -> bool:
    """Return whether a process runs (a zombie does not)."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def exited(pid: int) -> Callable[[], bool]:
    """Return a function that checks whether a process has exited."""
    return lambda: not alive(pid)
