"""All processes of one run: roscore, the daemon, and programs of each side that communicate through it."""

from __future__ import annotations

import contextlib
import os
import signal
import time
import xmlrpc.client
from pathlib import Path
from typing import Any

import psutil
from typing_extensions import override

from benchmarks.processes import Processes
from bridge.adapters.ros2.graph.ports import lost_ports
from bridge.concurrency import GOOD_LIFE
from bridge.daemon.query import ask_daemon
from bridge.demo.leftovers import marked
from bridge.status import DaemonStatus

WORKERS = ("router", "ros1", "ros2")
ANCHORS = ("ros1", "ros2", "hub")
"""Programs that survive most losses, by side."""
EXTRAS = {"ros1": "ros1_extra", "ros2": "ros2_extra"}
"""Further programs of ROS 1 and ROS 2, which are killed."""
JOINER = "ros1_joiner"
"""The program that repeatedly joins ``/state`` late on ROS 1; on the other sides the anchors do."""

Flow = tuple[str, str]
"""Subscribing program, and topic."""


class Field(Processes):
    """Starts all processes; `close` stops them.

    Args:
        patient: kill a worker again only once its restart would not be delayed because of earlier restarts.

    Attributes:
        states: the newest latched line of each publishing program.
        lingering: latched lines of killed DDS participants, with the time until which late joiners may receive them.
        clock: whether the ROS 1 anchor publishes ``/clock``.
    """

    def __init__(self, *, patient: bool = True) -> None:
        super().__init__({"ros1": {"poll": 0.25}})
        self._patient = patient
        self.states: dict[str, str] = {}
        self.lingering: dict[str, float] = {}
        self.clock = False
        self._number = 0
        try:
            self.start_master()
            self.start_daemon()
            self.start_programs(*ANCHORS, JOINER)
            self.until(self._joined, "all workers have joined")
        except BaseException:
            self.close()
            raise

    # -- starting ------------------------------------------------------------------------------------------------------

    def start_programs(self, *names: str) -> None:
        """Start programs, and wait until they have joined their networks and published their latched line."""
        for name in names:
            hub = self.place.config.hub
            more = [hub.listen, str(hub.domain)] if name == "hub" else ["silent"] if name == JOINER else []
            module = f"benchmarks.losses.{_side(name)}_program"
            self.launch(name, module, name, *more, system=_side(name) == "ros1")
        for name in names:
            self.wait_for(name, "ready")
        for name in names:
            if name == JOINER:
                continue
            others = [*(n for n in (*ANCHORS, *EXTRAS.values()) if _side(n) != _side(name)), "clock"]
            self.command(name, "listen", "listening", sources=others if name in ANCHORS else [])
            self.say_state(name)

    # -- messages ------------------------------------------------------------------------------------------------------

    def say_state(self, *names: str) -> None:
        """Let programs publish new latched lines."""
        self._number += 1
        for name in names:
            self.states[name] = f"{name} {self._number}"
            self.command(name, "state", "stated", number=self._number)

    def sounds(self, since: float) -> dict[Flow, list[tuple[float, float, float]]]:
        """Return the messages that each anchor has received since a moment, as arrival, time of sending and number."""
        result = {}
        for name in ANCHORS:
            if name in self._children:
                for topic, sounds in self.command(name, "received", "sounds", since=since)["sounds"].items():
                    result[name, topic] = [(s[0], s[1], s[2]) for s in sounds]
        return result

    def flows(self) -> list[Flow]:
        """Return all flows between the running programs, which must become steady again after a loss."""
        talking = [n for n in (*ANCHORS, *EXTRAS.values()) if n in self._children]
        flows = [
            (listener, f"/{talker}/{kind}")
            for listener in ANCHORS
            for talker in talking
            for kind in ("stream", "cmd_vel")
            if _side(talker) != _side(listener)
        ]
        return flows + ([("ros2", "/clock"), ("hub", "/clock")] if self.clock else [])

    def master(self, method: str, *params: Any) -> Any:
        """Call the ROS master; return the value of its answer, None if the call fails."""
        with contextlib.suppress(OSError, xmlrpc.client.Error), xmlrpc.client.ServerProxy(self.place.master) as proxy:
            code, _, value = getattr(proxy, method)("/field", *params)
            return value if code == 1 else None
        return None

    # -- the daemon ----------------------------------------------------------------------------------------------------

    def document(self) -> DaemonStatus:
        """Return the daemon's status, empty if it does not answer."""
        return ask_daemon(self.place.config) or DaemonStatus()

    def worker(self, name: str) -> psutil.Process:
        """Return a worker's process."""
        pid = next((w.pid for w in self.document().workers if w.worker == name), 0)
        if not pid:
            msg = f"unknown worker {name}"
            raise RuntimeError(msg)
        return psutil.Process(pid)

    def until_old(self, name: str) -> None:
        """If patient, wait until a worker has run long enough that its restart will not be delayed."""
        born = self.worker(name).create_time()
        restarted = any(w.worker == name and w.restarts for w in self.document().workers)
        if restarted and self._patient:
            time.sleep(max(0.0, born + GOOD_LIFE + 1 - time.time()))

    def kill_daemon(self) -> None:
        """Send SIGKILL to the daemon, but not to its workers."""
        os.kill(self.document().pid, signal.SIGKILL)
        self.stop("daemon")

    def _joined(self) -> bool:
        running = {w.worker for w in self.document().workers if w.phase == "running"}
        return running >= set(WORKERS)

    @override
    def words(self) -> str:
        """Return the end of the daemon's log, and the processes that receive nothing over Fast DDS's shared memory."""
        lost = {pid: lost_ports(Path(f"/proc/{pid}")) for pid in marked(self.place.folder)}
        lines = [f"process {pid} has lost {', '.join(sorted(ports))}" for pid, ports in lost.items() if ports]
        return "\n".join([super().words(), *lines])

    # -- killing -------------------------------------------------------------------------------------------------------

    def kill(self, *names: str) -> None:
        """Send SIGKILL to roscore or programs, and to all their children."""
        for name in names:
            for process in _tree(self._children[name].pid):
                with contextlib.suppress(psutil.Error):
                    process.kill()
            self.stop(name)

    @override
    def stop(self, name: str) -> None:
        # the program's latched line is gone when it exits
        self.states.pop(name, None)
        super().stop(name)

    def shared_memory(self) -> tuple[int, int]:
        """Return number and bytes of the files in shared memory that processes of this run use or used."""
        sizes = []
        for file in self.remember_memory():
            with contextlib.suppress(OSError):
                sizes.append(file.stat().st_blocks * 512)
        return len(sizes), sum(sizes)

    @override
    def close(self) -> None:
        with contextlib.suppress(RuntimeError, psutil.Error):
            for name in WORKERS:
                self.worker(name).resume()
        super().close()


def _side(name: str) -> str:
    return name.partition("_")[0]


def _tree(pid: int) -> list[psutil.Process]:
    try:
        process = psutil.Process(pid)
        return [*process.children(recursive=True), process]
    except psutil.Error:
        return []
