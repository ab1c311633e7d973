"""How a program of the demo tells what it heard: JSON lines on its output, and commands as JSON lines on its input.

Standard library only, since the ROS 1 program runs on the system's Python. The end of the input ends the program, so
that none is left when the demo dies: also one that waits for ever for what died with it, as rospy for its master.
"""

from __future__ import annotations

import json
import queue
import signal
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, Protocol

EVERY = 0.5
"""Seconds between two reports."""

LAST_SECONDS = 4
"""A program that has not ended by itself so long after its input is ended by the system, wherever it hangs."""

_REMEMBERED = 2000


class Ear:
    """What a program heard on one topic."""

    def __init__(self) -> None:
        self.count = 0
        self.repeated = 0
        self.detail = ""
        self._lock = threading.Lock()
        self._keys: OrderedDict[Hashable, None] = OrderedDict()

    def hear(self, key: Hashable, detail: str) -> None:
        """One message came.

        Args:
            key: tells messages apart; one that comes twice was duplicated on its way. None where nothing can tell.
            detail: what it was, for people and for the checks.
        """
        with self._lock:
            self.count += 1
            self.detail = detail
            if key is None:
                return
            if key in self._keys:
                self.repeated += 1
            self._keys[key] = None
            if len(self._keys) > _REMEMBERED:
                self._keys.popitem(last=False)

    def as_dict(self) -> dict[str, Any]:
        """As it stands in a report."""
        with self._lock:
            return {"count": self.count, "repeated": self.repeated, "detail": self.detail}


class Program(Protocol):
    """A program that says hello, drives, and joins late."""

    voice: Voice

    def drive(self, linear: float, angular: float, seconds: float) -> None:
        """Publish a velocity for some seconds."""

    def join_late(self) -> None:
        """Listen to what was published once, long ago."""

    def say_hello(self, ended: threading.Event) -> None:
        """Say hello once in a while until the event is set."""

    def close(self) -> None:
        """Leave the network."""


def serve(program: Program) -> None:
    """Run a program until the standard input ends."""
    ended = threading.Event()
    hello = threading.Thread(target=program.say_hello, args=(ended,), name="hello", daemon=True)
    hello.start()
    try:
        program.voice.tell("ready")
        program.voice.attend({"drive": program.drive, "join_late": program.join_late})
    finally:
        ended.set()
        hello.join(2.0)
        program.close()


class Voice:
    """One program's ears and its line to the demo; made before anything that may wait for others.

    Args:
        more: what else stands in each report.
    """

    def __init__(self, more: Callable[[], dict[str, Any]] | None = None) -> None:
        self._ears: dict[str, Ear] = {}
        self._more = more
        self._write_lock = threading.Lock()
        self._ended = threading.Event()
        self._commands: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        threading.Thread(target=self._read, name="commands", daemon=True).start()

    def ear(self, topic: str) -> Ear:
        """The ear for a topic."""
        return self._ears.setdefault(topic, Ear())

    def heard(self, topic: str) -> int:
        """Messages heard on a topic so far."""
        return self._ears[topic].count if topic in self._ears else 0

    def tell(self, event: str, **values: Any) -> None:
        """Write one line."""
        with self._write_lock:
            sys.stdout.write(json.dumps({"event": event, **values}) + "\n")
            sys.stdout.flush()

    def attend(self, commands: dict[str, Callable[..., None]]) -> None:
        """Report every while and obey commands until the input ends; each command runs on this thread."""
        reporter = threading.Thread(target=self._report, name="report", daemon=True)
        reporter.start()
        try:
            while (line := self._commands.get()) is not None:
                command = json.loads(line)
                commands[command.pop("do")](**command)
        finally:
            self._ended.set()
            reporter.join(2.0)

    def _read(self) -> None:
        # unbuffered: a thread that reads sys.stdin holds its lock as Python ends
        with open(0, "rb", buffering=0, closefd=False) as lines:
            for line in lines:
                self._commands.put(line)
        self._commands.put(None)
        signal.alarm(LAST_SECONDS)

    def _report(self) -> None:
        while not self._ended.is_set():
            more = self._more() if self._more is not None else {}
            try:
                self.tell("report", heard={topic: ear.as_dict() for topic, ear in list(self._ears.items())}, **more)
            except OSError:
                return  # nobody reads any more
            self._ended.wait(EVERY)
