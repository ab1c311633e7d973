"""Workers that record their events, and that misbehave as ordered by a file.

They run in real processes of the real daemon, configured by ``$MIDSPAN_WORKERS``. Files in ``$FAKE_FOLDER``:
``<worker>.events`` is written, one event per line; ``<worker>.do`` is read at each start, heartbeat, reload and stop.
"""

from __future__ import annotations

import ctypes
import gc
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import ClassVar

from bridge.config.model import Config
from bridge.progress import working
from bridge.worker import Health, Worker

FOREVER = 1000.0


def _compute() -> None:
    end = time.thread_time() + 0.05
    while time.thread_time() < end:
        pass


def _heaps() -> int:
    """Return how many heaps glibc has after twelve threads have allocated at once."""
    libc = ctypes.CDLL(None)
    libc.open_memstream.restype = ctypes.c_void_p
    together = threading.Barrier(12)

    def allocate() -> None:
        together.wait()
        block = bytearray(100_000)
        together.wait()
        block.clear()

    threads = [threading.Thread(target=allocate) for _ in range(12)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    text, size = ctypes.c_char_p(), ctypes.c_size_t()
    stream = ctypes.c_void_p(libc.open_memstream(ctypes.byref(text), ctypes.byref(size)))
    libc.malloc_info(0, stream)
    libc.fclose(stream)
    return (text.value or b"").count(b"<heap ")


class Fake(Worker):
    """One worker that misbehaves on demand."""

    name: ClassVar[str]

    def __init__(self) -> None:
        self._folder = Path(os.environ["FAKE_FOLDER"])
        self._beats = 0

    def _note(self, event: str) -> None:
        with (self._folder / f"{self.name}.events").open("a") as file:
            file.write(f"{event}\n")

    def _orders(self) -> list[str]:
        file = self._folder / f"{self.name}.do"
        return file.read_text().split() if file.exists() else []

    def start(self, config: Config) -> None:
        self._note(f"start {os.getpid()} {config.routing.default} {os.environ.get('ROS_MASTER_URI', '')}")
        orders = self._orders()
        if "never" in orders:
            msg = "unknown robot"
            raise RuntimeError(msg)
        if "crash-at-start" in orders:
            msg = "broken on purpose"
            raise ValueError(msg)
        if "hang-at-start" in orders:
            time.sleep(FOREVER)
        if "compute-at-start" in orders:
            working.at("computing on purpose")
        while "compute-at-start" in self._orders():
            _compute()
        if "child" in orders:
            child = subprocess.Popen(["sleep", "1000"])
            self._note(f"child {child.pid}")
        if "collector" in orders:
            self._note(f"collector {gc.isenabled()}")
        if "heaps" in orders:
            self._note(f"heaps {_heaps()}")
        if "print" in orders:
            print("a line on standard output")
            sys.stderr.write("a line on standard error\n")

    def reload(self, config: Config) -> bool:
        self._note(f"reload {config.routing.default}")
        while "compute-at-reload" in self._orders():
            _compute()
        return "refuse-reload" not in self._orders()

    def health(self) -> Health:
        self._beats += 1
        orders = self._orders()
        if "crash" in orders:
            msg = "crashed on purpose"
            raise ValueError(msg)
        if "hang" in orders:
            self._note("hang")
            time.sleep(FOREVER)
        if "compute" in orders:
            self._computes()
        if "unanswered" in orders:
            self._note("unanswered")
            msg = "the engine does not respond"
            raise TimeoutError(msg)
        return Health("waiting" if "wait" in orders else "running", f"{self.name} fine")

    def _computes(self) -> None:
        self._note("computes")
        while "compute" in self._orders():
            _compute()
        self._note("computed")

    def stop(self) -> None:
        self._note(f"stop {os.getpid()}")
        if "hang-at-stop" in self._orders():
            time.sleep(FOREVER)
        while "wait-at-stop" in self._orders():
            time.sleep(0.01)


class Router(Fake):
    """Replaces the router."""

    name = "router"


class Ros1(Fake):
    """Replaces the ros1 worker."""

    name = "ros1"


class Ros2(Fake):
    """Replaces the ros2 worker."""

    name = "ros2"


class Sim(Fake):
    """Replaces the simulator, which is enabled by ``sim: {enabled: true}``."""

    name = "sim"
