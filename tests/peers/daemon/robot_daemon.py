"""A real daemon with a router, a store and a gateway, but without sides, and its command line."""

from __future__ import annotations

import contextlib
import os
import signal
from pathlib import Path
from typing import Any

import psutil

from bridge.config.load import load
from bridge.daemon.query import ask_daemon
from tests.peers.daemon.midspan import MidspanDaemon
from tests.peers.daemon.routers import end_router
from tests.support.process import Process
from tests.support.wait import until

OFF = {side: {"enabled": False} for side in ("ros1", "ros2", "yarp", "zenoh")}


class RobotDaemon(MidspanDaemon):
    """The daemon ``robot``; ``stand_in`` is a class that replaces its worker ``modules``.

    Attributes:
        env: the environment of the daemon and the commands.
    """

    def __init__(self, folder: Path, stand_in: str = "", **sections: Any) -> None:
        env = {**os.environ, "FAKE_FOLDER": str(folder), "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
        if stand_in:
            env["MIDSPAN_WORKERS"] = f"modules={stand_in}"
        super().__init__(folder, "robot", env)
        self.configure(**sections)
        self._processes: list[Process] = []

    def configure(self, **sections: Any) -> None:
        """Write the configuration file."""
        modules = {"map2d_server": {"enabled": True}}
        super().configure(**{"navigation": {"planner": "robot_goto"}, "modules": modules, **OFF, **sections})

    def midspan(self, *words: str) -> Process:
        """Start a command that is stopped after the test."""
        process = super().midspan(*words)
        self._processes.append(process)
        return process

    def worker(self, name: str) -> dict[str, Any]:
        """Return the daemon's report about a worker, or an empty one if the daemon does not run."""
        status = ask_daemon(load(self.file))
        reports = [] if status is None else status.workers
        return next((report.document() for report in reports if report.worker == name), {})

    def until_phase(self, worker: str, phase: str, restarts: int = 0) -> dict[str, Any]:
        """Wait until a worker is in a phase, after a number of restarts."""

        def reached() -> dict[str, Any] | None:
            report = self.worker(worker)
            return report if report.get("phase") == phase and report["restarts"] >= restarts else None

        report: dict[str, Any] = until(reached, f"{worker} is {phase}", 40)
        return report

    def kill(self) -> int:
        """Kill only the daemon, and wait until its workers have exited; return the process ID of its router."""
        assert self.daemon is not None
        # a report is empty if the daemon does not respond within a second
        router, modules = (self.until_phase(worker, "running")["pid"] for worker in ("router", "modules"))
        os.kill(self.daemon.pid, signal.SIGKILL)
        self.daemon.popen.wait(20)
        until(lambda: not psutil.pid_exists(modules), "the other workers have exited", 20)
        return int(router)

    def close(self) -> None:
        """Stop all processes, including a router that has outlived its daemon."""
        workers: list[psutil.Process] = []
        for process in self._processes:
            with contextlib.suppress(psutil.NoSuchProcess):
                if process.popen.poll() is None:
                    workers += psutil.Process(process.pid).children()
        for process in self._processes:
            process.signal(signal.SIGCONT)
            process.stop()
        for pid in {child.pid for child in workers}:
            with contextlib.suppress(ProcessLookupError):  # it has exited
                os.kill(pid, signal.SIGKILL)
        end_router(self.folder / "state")
