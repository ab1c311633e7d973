"""Two daemons share a YARP network, and one of them stalls for a while, as on a machine that is short of memory."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest

from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from tests.adapters.yarp.conftest import Place
from tests.contract.hubside import HubSide
from tests.contract.side import WorkerProcess
from tests.peers.hub.quick import QuickHub
from tests.peers.yarp.programs import YarpProgram
from tests.support.process import is_stopped
from tests.support.wait import until

pytestmark = pytest.mark.thorough

STRING, TWIST = "std_msgs/String", "geometry_msgs/Twist"
COUNT = 20
OLD = 9.0


@contextmanager
def stalled(worker: WorkerProcess, seconds: float) -> Iterator[None]:
    """Stall a worker for ``seconds``, or for as long as the body takes."""
    began = time.monotonic()
    worker.process.signal(signal.SIGSTOP)
    until(lambda: is_stopped(worker.process.pid), "the worker is stalled")
    yield
    time.sleep(max(0.0, began + seconds - time.monotonic()))  # the stall must last this long
    worker.process.signal(signal.SIGCONT)


class Pair:
    """Two workers, on one hub or two."""

    def __init__(self, place: Place, stack: ExitStack, *, joined: bool) -> None:
        self.far = [place.far]
        hubs = [place.hubs, place.hubs if joined else stack.enter_context(QuickHub())]
        if not joined:
            hub = Hub.open(hubs[1].settings("far"))
            stack.callback(hub.close)
            self.far.append(HubSide(hub, Registry()))
        self.workers: dict[str, WorkerProcess] = {}
        for name, quick_hub in zip(("one", "two"), hubs, strict=True):
            state = place.folder / name
            config = place.config(name).model_copy(update={"state": state})
            config = config.model_copy(update={"hub": config.hub.model_copy(update={"listen": quick_hub.endpoint})})
            worker = WorkerProcess("yarp", config, dict(os.environ), ("running", "standby"))
            stack.callback(self._end, worker)
            self.workers[name] = worker
        self.program: YarpProgram = place.program("/program")

    @staticmethod
    def _end(worker: WorkerProcess) -> None:
        worker.process.signal(signal.SIGCONT)
        worker.stop()

    def states(self) -> dict[str, str]:
        """Return the state of each worker that responds."""
        answers = [a for far in self.far for a in far.hub.ask("status", {}, timeout=0.5)]
        return {a.daemon: a.value["state"] for a in answers if isinstance(a.value, dict) and a.worker == "yarp"}

    def active(self) -> str:
        """Return the active worker; with two hubs, where both may be active, the first by name."""

        def running() -> list[str]:
            return sorted(name for name, state in self.states().items() if state == "running")

        return until(running, "a worker is active", 20)[0]


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    """An exit stack that stops the test's objects."""
    with ExitStack() as stack:
        yield stack


class Talk:
    """Numbered messages between a YARP program and programs on the hubs; each message must arrive once."""

    def __init__(self, pair: Pair) -> None:
        self._states = pair.states
        self._ends: list[Any] = [pair.program, *pair.far]
        self._out = [end.advertise("/both", STRING) for end in self._ends]
        self._subscriptions = [end.subscribe("/both", STRING) for end in self._ends]
        self._probes = 0

    def _texts(self, end: int) -> list[str]:
        return [m["data"] for m in self._ends[end].wait(self._subscriptions[end], 0)]

    def until_open(self) -> None:
        """Wait until probes from the YARP program reach every hub, and probes from each hub reach the YARP program."""

        def through() -> bool:
            self._probes += 1
            for number, end in enumerate(self._ends):
                end.publish(self._out[number], {"data": f"probe {number} {mark} {self._probes}"})
            at_program, hubs = self._texts(0), range(1, len(self._ends))
            return all(
                any(t.startswith(f"probe {number} {mark} ") for t in at_program)
                and any(t.startswith(f"probe 0 {mark} ") for t in self._texts(number))
                for number in hubs
            )

        mark = self._probes
        until(through, "probes are bridged", 30, every=0.1)

    def exchange(self, label: str) -> None:
        """Publish messages at all ends, and check that each arrives at the other side."""
        for number in range(COUNT):
            for end in range(len(self._ends)):
                self._ends[end].publish(self._out[end], {"data": f"{label} {end} {number}"})
        hubs = range(1, len(self._ends))
        wanted = {0: {f"{label} {hub} {n}" for hub in hubs for n in range(COUNT)}}
        wanted |= {hub: {f"{label} 0 {n}" for n in range(COUNT)} for hub in hubs}

        def missing() -> dict[int, list[str]]:
            return {end: lost for end, lines in wanted.items() if (lost := sorted(lines - set(self._texts(end))))}

        with contextlib.suppress(AssertionError):  # the next assertion shows which messages are missing
            until(lambda: not missing(), f"{label} arrives", 30)
        assert not missing(), self._states()

    def duplicates(self) -> dict[str, int]:
        """Return the messages that an end received more than once, after all have arrived."""
        before: list[int] = []

        def quiet() -> bool:
            nonlocal before
            now = [len(self._texts(end)) for end in range(len(self._ends))]
            same, before = now == before, now
            return same

        until(quiet, "all messages have arrived", 20, every=0.5)
        counts = [Counter(self._texts(end)) for end in range(len(self._ends))]
        return {text: count for counted in counts for text, count in counted.items() if count > 1}


class Commands:
    """Velocity commands between a hub and the YARP program, in both directions."""

    def __init__(self, pair: Pair) -> None:
        far, program = pair.far[0], pair.program
        routes = ((far, program, "/base/cmd_vel"), (program, far, "/joy/cmd_vel"))
        self._routes = [(a, a.advertise(topic, TWIST), b, b.subscribe(topic, TWIST)) for a, b, topic in routes]

    def send(self, speed: float) -> None:
        """Send ten commands in both directions."""
        none = {"x": 0.0, "y": 0.0, "z": 0.0}
        for source, out, _, _ in self._routes:
            for _ in range(10):
                source.publish(out, {"linear": {**none, "x": speed}, "angular": none})

    def until_open(self, speed: float) -> None:
        """Send commands in both directions until one arrives in each."""

        def through() -> bool:
            self.send(speed)
            return all(speed in self._speeds(sink, id_) for _, _, sink, id_ in self._routes)

        until(through, f"commands of {speed} are bridged", 30, every=0.1)

    def received(self) -> set[float]:
        """Return all received speeds."""
        return {speed for _, _, sink, id_ in self._routes for speed in self._speeds(sink, id_)}

    @staticmethod
    def _speeds(sink: Any, subscription: int) -> list[float]:
        return [m["linear"]["x"] for m in sink.wait(subscription, 0)]


def test_two_second_stall_on_one_hub_delays_no_commands_and_causes_no_duplicates(
    place: Place, stack: ExitStack
) -> None:
    pair = Pair(place, stack, joined=True)
    talk, commands = Talk(pair), Commands(pair)
    talk.until_open()
    commands.until_open(0.1)
    talk.exchange("before")
    with stalled(pair.workers[pair.active()], 2.0):
        commands.send(OLD)
    talk.until_open()
    commands.until_open(0.2)
    talk.exchange("after")
    until(lambda: len(pair.states()) == 2, "both workers respond", 20)
    commands.until_open(0.3)
    assert not talk.duplicates()
    assert OLD not in commands.received()


def test_two_second_stall_on_two_hubs_causes_no_duplicates(place: Place, stack: ExitStack) -> None:
    pair = Pair(place, stack, joined=False)
    talk = Talk(pair)
    talk.until_open()
    talk.exchange("before")
    with stalled(pair.workers["one"], 2.0):
        pass
    talk.until_open()
    talk.exchange("after")
    assert not talk.duplicates()


def test_another_daemon_takes_over_after_a_ten_second_stall_without_duplicates(place: Place, stack: ExitStack) -> None:
    pair = Pair(place, stack, joined=True)
    talk = Talk(pair)
    talk.until_open()
    talk.exchange("before")
    first = pair.active()
    (second,) = set(pair.workers) - {first}
    with stalled(pair.workers[first], 10.0):
        until(lambda: pair.states().get(second) == "running", "the other worker takes over", 9)
        talk.until_open()
        talk.exchange("meanwhile")
    until(lambda: pair.states() == {first: "standby", second: "running"}, "the stalled worker is on standby", 20)
    talk.until_open()
    talk.exchange("after")
    assert not talk.duplicates()


def test_manual_connection_survives_a_stall(place: Place, stack: ExitStack) -> None:
    rule = {"topic": "/said", "type": "std_msgs/msg/String", "as": "natural", "direction": "out"}
    config = place.config("one", yarp={"topics": [rule]})
    worker = WorkerProcess("yarp", config, dict(os.environ), ("running",))
    stack.callback(worker.stop)
    out, reader = place.far.advertise("/said", STRING), place.port("/reader")
    reader.listen_to("/midspan/said:o")
    place.far.hub_publish_until(out, {"data": "before"}, lambda: reader.messages(1, 0.2))
    with stalled(worker, 2.5):
        pass
    place.far.hub_publish_until(out, {"data": "after"}, lambda: ["after"] in reader.bottles(1, 0.2))
