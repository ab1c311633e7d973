"""Workers that write down what is done to them, and misbehave when a file tells them to.

They run in real processes of the real daemon, put there by ``$MIDSPAN_WORKERS``. Files in ``$FAKE_FOLDER``:
``<worker>.events`` is written, one event a line; ``<worker>.do`` is read before each start and heartbeat.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import ClassVar

from bridge.config.model import Config
from bridge.worker import Health, Worker

FOREVER = 1000.0


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
            msg = "there is no such robot"
            raise RuntimeError(msg)
        if "crash-at-start" in orders:
            msg = "broken on purpose"
            raise ValueError(msg)
        if "child" in orders:
            child = subprocess.Popen(["sleep", "1000"])
            self._note(f"child {child.pid}")
        if "print" in orders:
            print("a line on standard output")
            sys.stderr.write("a line on standard error\n")

    def reload(self, config: Config) -> bool:
        self._note(f"reload {config.routing.default}")
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
        if "unanswered" in orders:
            self._note("unanswered")
            msg = "the engine does not answer"
            raise TimeoutError(msg)
        return Health("waiting" if "wait" in orders else "running", f"{self.name} fine")

    def stop(self) -> None:
        self._note(f"stop {os.getpid()}")
        if "hang-at-stop" in self._orders():
            time.sleep(FOREVER)


class Router(Fake):
    """In the router's place."""

    name = "router"


class Ros1(Fake):
    """In the ros1 worker's place."""

    name = "ros1"


class Ros2(Fake):
    """In the ros2 worker's place."""

    name = "ros2"
