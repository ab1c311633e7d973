"""Base of the programs at both ends, controlled by JSON lines. Standard library only."""

from __future__ import annotations

import gc
import itertools
import json
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.latency.stamps import Stamped

MATCH_SECONDS = 20.0


class End(ABC):
    """A program that publishes or subscribes, for one middleware.

    A topic in a command is ``{"topic", "type", "file", "offset", "form"}``: a prepared message in ``file``.
    """

    def __init__(self) -> None:
        self._prepared: dict[str, Stamped] = {}
        self._put: dict[str, Callable[[bytes], None]] = {}
        self._matched: dict[str, Callable[[], bool]] = {}
        self._ages: dict[str, list[int]] = {}
        self._numbers: dict[str, list[int]] = {}

    @abstractmethod
    def publisher(self, topic: str, type_: str) -> tuple[Callable[[bytes], None], Callable[[], bool]]:
        """Return a raw publisher's functions: one publishes, one returns whether it has subscribers."""

    @abstractmethod
    def listen(self, topic: str, type_: str, on_message: Callable[[bytes], None]) -> None:
        """Create a raw subscription."""

    @abstractmethod
    def close(self) -> None:
        """Leave the network."""

    def run(self) -> None:
        """Execute commands until the input ends."""
        gc.collect()
        gc.disable()  # pauses of these programs must not count
        reply("ready")
        commands: dict[str, Callable[..., None]] = {
            "advertise": self._advertise,
            "subscribe": self._subscribe,
            "send": self._send,
        }
        commands |= {"matched": self._is_matched, "clear": self._clear, "collect": self._collect}
        commands |= {"drum": self._drum, "idle": self._idle, "count": self._count, "tally": self._tally}
        try:
            for line in sys.stdin:
                command = json.loads(line)
                commands[command.pop("do")](**command)
        finally:
            self.close()

    def _advertise(self, topics: list[dict[str, Any]]) -> None:
        for topic in topics:
            name = topic["topic"]
            self._prepared[name] = _load(topic)
            self._put[name], self._matched[name] = self.publisher(name, topic["type"])
        reply("advertised")

    def _subscribe(self, topics: list[dict[str, Any]]) -> None:
        for topic in topics:
            name = topic["topic"]
            self.listen(name, topic["type"], _collector(_load(topic), self._ages.setdefault(name, [])))
        reply("subscribed")

    def _idle(self, topics: list[str], type_: str) -> None:
        for topic in topics:
            self.publisher(topic, type_)
        reply("idle")

    def _is_matched(self, topic: str) -> None:
        end = time.monotonic() + MATCH_SECONDS
        while not self._matched[topic]() and time.monotonic() < end:
            time.sleep(0.02)
        reply("matched", ok=self._matched[topic]())

    def _send(self, topic: str, count: int, period: float) -> None:
        put, prepared = self._put[topic], self._prepared[topic]
        due = time.monotonic()
        for _ in range(count):
            fresh = prepared.fresh()
            due += period
            time.sleep(max(0.0, due - time.monotonic()))
            prepared.stamp(fresh)
            put(fresh)
        reply("sent")

    def _drum(self, topics: list[str], rate: float, seconds: float = 0.0) -> None:
        """Send on all these topics, each at its rate and evenly spread, for a time or until the program exits."""
        total = round(rate * seconds) * len(topics)

        def beat() -> None:
            period, due, number = 1 / rate / len(topics), time.monotonic(), 0
            while not total or number < total:
                topic = topics[number % len(topics)]
                fresh = self._prepared[topic].fresh()
                self._prepared[topic].stamp(fresh)
                self._put[topic](fresh)
                number += 1
                due = max(due + period, time.monotonic() - 1.0)
                time.sleep(max(0.0, due - time.monotonic()))
            reply("drummed")

        threading.Thread(target=beat, name="drum", daemon=True).start()
        reply("drumming")

    def _count(self, topics: list[dict[str, Any]]) -> None:
        """Count numbered messages, for `_tally`."""
        for topic in topics:
            name = topic["topic"]
            ages, numbers = self._ages.setdefault(name, []), self._numbers.setdefault(name, [])
            self.listen(name, topic["type"], _counter(_load(topic), ages, numbers))
        reply("counting")

    def _tally(self, sent: int, seconds: float) -> None:
        """Report the numbered messages since the last tally, and topics without messages.

        Until ``sent`` messages have arrived, it waits as long as another one arrives within ``seconds``.
        """
        self._wait_for(lambda: sum(map(len, self._numbers.values())), sent, seconds)
        ages, got, distinct, silent, disorder = list[int](), 0, 0, 0, 0
        for name, numbers in self._numbers.items():
            ages += self._ages[name]
            got += len(numbers)
            distinct += len(set(numbers))
            silent += not numbers
            disorder += sum(1 for earlier, later in itertools.pairwise(numbers) if later < earlier)
            self._ages[name].clear()
            numbers.clear()
        reply("tallied", ages=ages, got=got, distinct=distinct, silent=silent, disorder=disorder)

    def _clear(self) -> None:
        for ages in self._ages.values():
            ages.clear()
        reply("cleared")

    def _collect(self, topic: str, count: int, seconds: float) -> None:
        ages = self._ages[topic]
        self._wait_for(lambda: len(ages), count, seconds)
        reply("collected", ages=list(ages))

    @staticmethod
    def _wait_for(come: Callable[[], int], count: int, seconds: float) -> None:
        """Wait until ``count`` messages have arrived, or no message arrives for ``seconds``."""
        last, since = come(), time.monotonic()
        while last < count and time.monotonic() < since + seconds:
            time.sleep(0.02)
            now = come()
            if now != last:
                last, since = now, time.monotonic()


def _collector(prepared: Stamped, ages: list[int]) -> Callable[[bytes], None]:
    return lambda payload: ages.append(prepared.age(payload))


def _counter(prepared: Stamped, ages: list[int], numbers: list[int]) -> Callable[[bytes], None]:
    def on_message(payload: bytes) -> None:
        ages.append(prepared.age(payload))
        numbers.append(prepared.number(payload))

    return on_message


def reply(event: str, **values: Any) -> None:
    """Write an answer as one line."""
    sys.stdout.write(json.dumps({"event": event, **values}) + "\n")
    sys.stdout.flush()


def _load(topic: dict[str, Any]) -> Stamped:
    return Stamped(Path(topic["file"]).read_bytes(), topic["offset"], topic["form"])
