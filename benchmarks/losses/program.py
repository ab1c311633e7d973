"""Base of the programs on each side, which publish continuously and subscribe to each other, controlled by JSON lines.

Every program has a name and publishes ``/<name>/stream`` (a number every 20 ms), ``/<name>/cmd_vel`` (every 40 ms) and
one latched line on ``/state``, which all programs share. Times are CLOCK_MONOTONIC, which all processes of a
machine share. Standard library only.

Commands (``do``), each answered by an event:

- ``listen`` sources -> listening;
- ``state`` number -> stated; ``states`` -> states: the newest line of each program;
- ``late`` count, seconds -> joined: the lines that a new subscription received;
- ``received`` since -> sounds: by topic, arrival, time of sending, number;
- ``large`` on -> enlarged: also a megabyte five times per second;
- ``clock`` start -> ticking: also ``/clock``, from this second on;
- ``nodes`` -> nodes: their names.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any

from benchmarks.latency.end import reply

PERIOD = 0.02
KEPT = 20_000
"""Number of stored messages per topic: more than six minutes of a stream."""
MEGABYTE = "x" * 1_000_000
_LARGE_EVERY = 10

_READ: dict[str, Callable[[Any], tuple[float, float]]] = {
    "stream": lambda m: (m.x, m.y),
    "cmd_vel": lambda m: (m.linear.x, m.linear.y),
    "large": lambda _m: (0.0, 0.0),
}
"""Reads the time of sending and the number from a message of each kind."""


class Program(ABC):
    """A program on one middleware."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._sounds: dict[str, deque[tuple[float, float, float]]] = {}
        self._states: dict[str, str] = {}
        self._large = False
        self._clock: float | None = None
        self._ended = threading.Event()

    @abstractmethod
    def open(self) -> None:
        """Create the publishers and the subscription to ``/state``."""

    @abstractmethod
    def publish(self, kind: str, sent: float, number: int) -> None:
        """Publish on ``stream``, ``cmd_vel``, ``large`` or, with ``sent`` as the time, ``clock``."""

    @abstractmethod
    def publish_state(self, line: str) -> None:
        """Publish the latched line."""

    @abstractmethod
    def listen(self, source: str) -> None:
        """Subscribe to another program's stream and commands, or to the clock."""

    @abstractmethod
    def late(self, take: Callable[[str], None]) -> Callable[[], None]:
        """Subscribe to ``/state`` as a late joiner; return a function that unsubscribes."""

    @abstractmethod
    def nodes(self) -> list[str]:
        """Return the names of all nodes on the network."""

    @abstractmethod
    def close(self) -> None:
        """Leave the network."""

    def run(self, *, silent: bool) -> None:
        """Publish (unless silent), and execute commands until the input ends."""
        if not silent:
            self.open()
            threading.Thread(target=self._beat, name="beat", daemon=True).start()
        reply("ready")
        commands: dict[str, Callable[..., None]] = {
            "listen": self._listen_to,
            "state": self._state,
            "states": self._report_states,
            "late": self._late,
            "received": self._report_received,
            "large": self._set_large,
            "clock": self._set_clock,
            "nodes": lambda: reply("nodes", names=self.nodes()),
        }
        try:
            for line in sys.stdin:
                command = json.loads(line)
                commands[command.pop("do")](**command)
        finally:
            self._ended.set()
            self.close()

    def record_message(self, topic: str, sent: float, number: float) -> None:
        """Record a received message."""
        sounds = self._sounds.get(topic)
        if sounds is None:
            sounds = self._sounds.setdefault(topic, deque(maxlen=KEPT))
        sounds.append((time.monotonic(), sent, number))

    def recorder(self, source: str, kind: str) -> Callable[[Any], None]:
        """Return a callback for another program's messages of a kind."""
        topic, read = f"/{source}/{kind}", _READ[kind]
        return lambda message: self.record_message(topic, *read(message))

    def record_line(self, line: str) -> None:
        """Record a received latched line."""
        self._states[line.partition(" ")[0]] = line

    def _beat(self) -> None:
        number, due = 0, time.monotonic()
        while not self._ended.is_set():
            number += 1
            self.publish("stream", time.monotonic(), number)
            if number % 2:
                self.publish("cmd_vel", time.monotonic(), number)
                if self._clock is not None:
                    self._clock += 2 * PERIOD
                    self.publish("clock", self._clock, number)
            if self._large and number % _LARGE_EVERY == 0:
                self.publish("large", time.monotonic(), number)
            due = max(due + PERIOD, time.monotonic() - 0.1)
            time.sleep(max(0.0, due - time.monotonic()))

    def _listen_to(self, sources: list[str]) -> None:
        for source in sources:
            self.listen(source)
        reply("listening")

    def _state(self, number: int) -> None:
        self.publish_state(f"{self.name} {number}")
        reply("stated")

    def _report_states(self) -> None:
        reply("states", lines=dict(self._states))

    def _late(self, count: int, seconds: float) -> None:
        lines: list[str] = []
        arrived = threading.Condition()

        def on_line(line: str) -> None:
            with arrived:
                lines.append(line)
                arrived.notify()

        end = self.late(on_line)
        with arrived:
            arrived.wait_for(lambda: len(lines) >= count, seconds)
        end()
        reply("joined", lines=sorted(lines))

    def _report_received(self, since: float) -> None:
        sounds: dict[str, Any] = {
            t: [s for s in list(received) if s[0] >= since] for t, received in self._sounds.copy().items()
        }
        reply("sounds", sounds=sounds)

    def _set_large(self, on: bool) -> None:
        self._large = on
        reply("enlarged")

    def _set_clock(self, start: float) -> None:
        self._clock = start
        reply("ticking")
