"""All processes of one run: roscore, the daemon, and programs of each side that talk to each other through it."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
import xmlrpc.client
from collections.abc import Callable, Iterable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import psutil

import benchmarks
from bridge.daemon.backoff import GOOD_LIFE
from bridge.daemon.query import ask_daemon
from bridge.demo import requirements
from bridge.demo.child import Child, guarded
from bridge.demo.place import Place
from bridge.demo.traces import remove_unused, shared_memory, sweep

UP_SECONDS = 60.0
WORKERS = ("router", "ros1", "ros2")
ANCHORS = ("ros1", "ros2", "hub")
"""Programs that live through most losses, by the side that they are on."""
EXTRAS = {"ros1": "ros1_extra", "ros2": "ros2_extra"}
"""Programs that are killed."""
JOINER = "ros1_joiner"
"""Joins ``/state`` late on ROS 1, again and again; on the other sides the anchors do."""

Flow = tuple[str, str]
"""Listening program and topic."""


class Field:
    """Starts everything; `close` ends it.

    Args:
        patient: kill a worker again only once its death brings no longer pause than the first one did.

    Attributes:
        states: the newest latched line of each program that publishes.
        clock: whether the ROS 1 anchor publishes ``/clock``.
    """

    def __init__(self, *, patient: bool = True) -> None:
        self._patient = patient
        self.states: dict[str, str] = {}
        self.lingering: dict[str, float] = {}
        self.clock = False
        self._children: dict[str, Child] = {}
        self._memory: set[Path] = set()
        self._number = 0
        self.place = Place(None, {"ros1": {"poll": 0.25}})
        try:
            (self.place.system_path / "benchmarks").symlink_to(Path(benchmarks.__path__[0]))
            packages = requirements.ros1_packages(self.place.config)
            self._ros1, self._own = self.place.ros1_environment(packages), self.place.environment()
            self.start_master()
            self.start_daemon()
            self.start_programs(*ANCHORS, JOINER)
            self.wait(self._joined, "all workers are up")
        except BaseException:
            self.close()
            raise

    # -- starting ------------------------------------------------------------------------------------------------------

    def start_master(self) -> None:
        """Start roscore and wait until it answers."""
        place = self.place
        command = guarded(requirements.SYSTEM_PYTHON, requirements.roscore(place.config), "-p", str(place.master_port))
        self._launch("roscore", command, self._ros1)
        self.wait(place.master_answers, "roscore answers", every=0.05)

    def start_daemon(self) -> None:
        """Start the daemon; returns at once."""
        command = guarded(sys.executable, "-m", "bridge.cli.main", "run", "--config", self.place.config_file)
        self._launch("daemon", command, self._own)

    def start_programs(self, *names: str) -> None:
        """Start programs; returns when they are on their networks and have said their latched line."""
        for name in names:
            self._launch(name, self._command(name), self._ros1 if name.startswith("ros1") else self._own)
        for name in names:
            self._await(name, "ready")
        for name in names:
            if name == JOINER:
                continue
            others = [*(n for n in (*ANCHORS, *EXTRAS.values()) if _side(n) != _side(name)), "clock"]
            self.ask(name, "hear", "hearing", sources=others if name in ANCHORS else [])
            self.say_state(name)

    def _command(self, name: str) -> list[str | Path]:
        module = f"benchmarks.losses.{_side(name)}_program"
        python: str | Path = requirements.SYSTEM_PYTHON if name.startswith("ros1") else sys.executable
        more = [self.place.config.hub.listen, str(self.place.config.hub.domain)] if name == "hub" else []
        return [python, "-m", module, name, *more, *(["silent"] if name == JOINER else [])]

    def _launch(self, name: str, command: list[str | Path], env: dict[str, str]) -> None:
        self._children[name] = Child(name, command, env, self.place.folder)

    # -- talking -------------------------------------------------------------------------------------------------------

    def ask(self, name: str, do: str, event: str, **params: Any) -> dict[str, Any]:
        """Have a program do something; what it tells."""
        self._children[name].ask(do, **params)
        return self._await(name, event)

    def say_state(self, *names: str) -> None:
        """Have programs publish new latched lines."""
        self._number += 1
        for name in names:
            self.states[name] = f"{name} {self._number}"
            self.ask(name, "state", "stated", number=self._number)

    def sounds(self, since: float) -> dict[Flow, list[tuple[float, float, float]]]:
        """What each anchor heard since a moment: arrival, time of sending, number."""
        heard = {}
        for name in ANCHORS:
            if name in self._children:
                for topic, sounds in self.ask(name, "heard", "sounds", since=since)["sounds"].items():
                    heard[name, topic] = [(s[0], s[1], s[2]) for s in sounds]
        return heard

    def flows(self) -> list[Flow]:
        """What must be heard all the time."""
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
        """Call the ROS master; the value of its answer, None where it fails."""
        with contextlib.suppress(OSError, xmlrpc.client.Error), xmlrpc.client.ServerProxy(self.place.master) as proxy:
            code, _, value = getattr(proxy, method)("/field", *params)
            return value if code == 1 else None
        return None

    def _await(self, name: str, event: str) -> dict[str, Any]:
        told = self._children[name].wait_for(event, UP_SECONDS)
        if told is None:
            msg = f"{name} did not answer ({event}):\n{self._children[name].last_words()}\n{self.words()}"
            raise RuntimeError(msg)
        return told

    def words(self) -> str:
        """The daemon's last ones."""
        return self._children["daemon"].last_words()

    def wait(self, condition: Callable[[], Any], what: str, seconds: float = UP_SECONDS, every: float = 0.1) -> float:
        """Wait for a condition; the moment at which it held."""
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                msg = f"not within {seconds:g} s: {what}\n{self.words() if 'daemon' in self._children else ''}"
                raise RuntimeError(msg)
            time.sleep(every)
        return time.monotonic()

    # -- the daemon ----------------------------------------------------------------------------------------------------

    def document(self) -> dict[str, Any]:
        """What the daemon says of itself."""
        return ask_daemon(self.place.config) or {"workers": [], "uptime": 0.0, "pid": 0}

    def worker(self, name: str) -> psutil.Process:
        """A worker's process."""
        pid = next((w["pid"] for w in self.document()["workers"] if w["worker"] == name), 0)
        if not pid:
            msg = f"the daemon has no worker {name}"
            raise RuntimeError(msg)
        return psutil.Process(pid)

    def until_old(self, name: str) -> None:
        """Wait until a worker has lived so long that its death brings no longer pause than the first, where patient."""
        born = self.worker(name).create_time()
        restarted = any(w["worker"] == name and w["restarts"] for w in self.document()["workers"])
        if restarted and self._patient:
            time.sleep(max(0.0, born + GOOD_LIFE + 1 - time.time()))

    def kill_daemon(self) -> None:
        """SIGKILL the daemon alone."""
        os.kill(int(self.document()["pid"]), signal.SIGKILL)
        self.stop("daemon")

    def _joined(self) -> bool:
        running = {w["worker"] for w in self.document()["workers"] if w["phase"] == "running"}
        return running >= set(WORKERS)

    # -- killing -------------------------------------------------------------------------------------------------------

    def kill(self, *names: str) -> None:
        """SIGKILL roscore or programs, with all that they started."""
        for name in names:
            for process in _tree(self._children[name].pid):
                with contextlib.suppress(psutil.Error):
                    process.kill()
            self.stop(name)

    def stop(self, name: str) -> None:
        """Have a program leave in good order."""
        self.states.pop(name, None)
        child = self._children.pop(name)
        child.begin_stop()
        child.finish_stop(5.0)

    def shared_memory(self) -> tuple[int, int]:
        """Files in shared memory that a process of this run uses or used: how many are there, and their bytes."""
        self._memory |= shared_memory(self.place.folder, self.place.domain_ports)
        sizes = []
        for file in self._memory:
            with contextlib.suppress(OSError):
                sizes.append(file.stat().st_blocks * 512)
        return len(sizes), sum(sizes)

    def close(self) -> None:
        """End all processes."""
        with contextlib.suppress(RuntimeError, psutil.Error):
            for name in WORKERS:
                self.worker(name).resume()
        if self._children:
            self.shared_memory()
        last = ("daemon", "roscore")
        groups: list[Iterable[str]] = [[n for n in self._children if n not in last], *([n] for n in last)]
        for group in groups:
            children = [self._children[name] for name in group if name in self._children]
            for child in children:
                child.begin_stop()
            for child in children:
                child.finish_stop(9.0)
        sweep(self.place.folder)
        remove_unused(self._memory)
        self.place.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.close()


def _side(name: str) -> str:
    return name.partition("_")[0]


def _tree(pid: int) -> list[psutil.Process]:
    try:
        process = psutil.Process(pid)
        return [*process.children(recursive=True), process]
    except psutil.Error:
        return []
