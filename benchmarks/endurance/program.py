"""Base of the programs of all sides, which create endpoints, send, receive and count. Standard library only.

Commands are JSON lines, each answered by one line: ``{"event": "done", ...}``. A topic in a command is ``{"topic",
"type", "file", "offset", "form", "latched"}``: a prepared message in ``file``, with a ticket at ``offset``.
"""

from __future__ import annotations

import heapq
import json
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Protocol

from benchmarks.endurance.ear import Ear, ticket
from benchmarks.latency.stamps import Stamped

DEPTH = 200
"""History depth of the programs' endpoints, so that a program that is not scheduled for a second loses nothing."""

OnMessage = Callable[[bytes], None]
Close = Callable[[], None]


class Publisher(Protocol):
    """A publisher of the middleware."""

    def put(self, payload: bytes) -> None:
        """Publish raw bytes."""

    def close(self) -> None:
        """Close the publisher."""


class Program(ABC):
    """Endpoints of one middleware."""

    def __init__(self) -> None:
        self._out: dict[str, Source] = {}
        self._in: dict[str, tuple[Ear, Close]] = {}
        self._flow = Flow()
        self._rates: dict[str, float] = {}

    @abstractmethod
    def publisher(self, topic: str, type_: str, *, latched: bool) -> Publisher:
        """Return a raw publisher of a type spelled ``package/msg/Name``."""

    @abstractmethod
    def listen(self, topic: str, type_: str, *, latched: bool, on_message: OnMessage) -> Close:
        """Create a raw subscription; return a function that closes it."""

    @abstractmethod
    def close(self) -> None:
        """Leave the network."""

    def run(self) -> None:
        """Execute commands until the input ends."""
        commands: dict[str, Callable[..., dict[str, Any]]] = {
            "publish": self._publish,
            "subscribe": self._subscribe,
            "put": self._put,
            "drop": self._drop,
            "flow": self._start_flow,
            "still": self._still,
            "report": self._report,
            "count": self._count,
        }
        _reply()
        try:
            for line in sys.stdin:
                command = json.loads(line)
                _reply(**commands[command.pop("do")](**command))
        except KeyboardInterrupt:
            pass
        finally:
            self._flow.stop()
            self.close()

    def _publish(self, topics: list[dict[str, Any]]) -> dict[str, Any]:
        for topic in topics:
            name = topic["topic"]
            publisher = self.publisher(name, topic["type"], latched=topic["latched"])
            self._out[name] = Source(_load(topic["file"], topic["offset"], topic["form"]), publisher)
        return {}

    def _subscribe(self, topics: list[dict[str, Any]], pause: float = 0.0) -> dict[str, Any]:
        """Create subscriptions, whose callbacks sleep ``pause`` seconds per message."""
        for topic in topics:
            name, ear = topic["topic"], Ear()
            stamped = _load(topic["file"], topic["offset"], topic["form"])
            close = self.listen(
                name, topic["type"], latched=topic["latched"], on_message=_receiver(stamped, ear, pause)
            )
            self._in[name] = ear, close
        return {}

    def _put(self, topics: list[str]) -> dict[str, Any]:
        """Send a message on each of these topics."""
        for topic in topics:
            self._out[topic].send()
        return {}

    def _drop(self, publish: list[str], subscribe: list[str]) -> dict[str, Any]:
        """Close endpoints, with a last message of each publisher in flight."""
        for topic in publish:
            source = self._out.pop(topic)
            source.send()
            source.close()
        for topic in subscribe:
            self._in.pop(topic)[1]()
        return {}

    def _start_flow(self, rates: dict[str, float]) -> dict[str, Any]:
        """Also send on these topics, each at its rate, until `_still` is called."""
        self._flow.stop()
        self._rates |= rates
        self._flow.start({topic: (self._out[topic].send, rate) for topic, rate in self._rates.items()})
        return {}

    def _still(self) -> dict[str, Any]:
        """Stop sending; return the number of messages sent on each topic."""
        self._flow.stop()
        self._rates.clear()
        return {"sent": {topic: source.sent for topic, source in self._out.items()}}

    def _count(self) -> dict[str, Any]:
        """Return the number of messages received so far on all topics."""
        return {"count": sum(ear.count for ear, _ in self._in.values())}

    def _report(self) -> dict[str, Any]:
        """Return the counts of sent and received messages so far."""
        received = {topic: ear.report() for topic, (ear, _) in self._in.items()}
        return {"sent": {topic: source.sent for topic, source in self._out.items()}, "received": received}


class Source:
    """A publisher whose messages are numbered."""

    def __init__(self, stamped: Stamped, publisher: Publisher) -> None:
        self.sent = 0
        self._stamped, self._publisher = stamped, publisher
        self._lock = threading.Lock()

    def send(self) -> None:
        """Send the next message."""
        with self._lock:
            fresh = self._stamped.fresh()
            self._stamped.write(fresh, ticket(self.sent))
            self.sent += 1
            self._publisher.put(fresh)

    def close(self) -> None:
        self._publisher.close()


class Flow:
    """A thread that sends each message when it is due, and skips messages that are more than a second late."""

    def __init__(self) -> None:
        self._due: list[tuple[float, int, float, Callable[[], None]]] = []
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, sends: dict[str, tuple[Callable[[], None], float]]) -> None:
        """Call these functions, each at its rate and evenly spread."""
        now = time.monotonic()
        self._due = [(now + i / len(sends) / rate, i, 1 / rate, send) for i, (send, rate) in enumerate(sends.values())]
        heapq.heapify(self._due)
        self._stopping.clear()
        self._thread = threading.Thread(target=self._run, name="flow", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _run(self) -> None:
        while self._due:
            due, i, period, send = self._due[0]
            wait = due - time.monotonic()
            if self._stopping.wait(max(wait, 0.0)):
                return
            send()
            heapq.heapreplace(self._due, (max(due + period, time.monotonic() - 1.0), i, period, send))


def _receiver(stamped: Stamped, ear: Ear, pause: float) -> OnMessage:
    def on_message(payload: bytes) -> None:
        ear.receive(stamped.read(payload))
        if pause:
            time.sleep(pause)

    return on_message


def _reply(**values: Any) -> None:
    sys.stdout.write(json.dumps({"event": "done", **values}) + "\n")
    sys.stdout.flush()


@cache
def _load(file: str, offset: int, form: str) -> Stamped:
    return Stamped(Path(file).read_bytes(), offset, form)
