"""A subscriber that reads one message per second from a fast stream: its cost for the daemon, and others' delays.

On each side a program's callback takes a second for each message of a large stream from another side. A second program
on the same side reads the same stream, and a small one, without such a pause. The results are the peak memory of each
of the daemon's processes, and the second program's lost messages and latency, with the slow program and (the peer's
column) before it started.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.endurance.deployment import SIDES, Deployment
from benchmarks.endurance.ear import behind
from benchmarks.rows import Row, add_json_option, report

SOURCE = {"ros1": "ros2", "ros2": "ros1", "zenoh": "ros2"}
"""The side that publishes for each side's subscribers."""

BIG, SMALL = "/big", "/small"
SMALL_RATE = 100.0  # messages per second
PAUSE = 1.0  # seconds for which the slow program pauses after each message


@dataclass(frozen=True, slots=True)
class Reception:
    """The messages of one topic that the second program received in a period.

    Attributes:
        sent: number of sent messages.
        lost: number of lost messages.
        repeated: number of duplicates.
        p50: median latency in milliseconds.
        p99: the latency that one in a hundred exceeds.
        latest: the maximum latency.
    """

    sent: int
    lost: int
    repeated: int
    p50: float
    p99: float
    latest: float


@dataclass(frozen=True, slots=True)
class Slow:
    """One side's result.

    Attributes:
        side: the subscribers' side.
        before: reception by topic, without the slow subscriber.
        beside: reception by topic, with the slow subscriber.
        read: number of messages that the slow subscriber read.
        drops: the routes' drops with the slow subscriber, by reason.
        memory_before: peak memory of each process without the slow subscriber, in MB.
        memory_beside: peak memory of each process with the slow subscriber, in MB.
    """

    side: str
    before: dict[str, Reception]
    beside: dict[str, Reception]
    read: int
    drops: dict[str, int]
    memory_before: dict[str, float]
    memory_beside: dict[str, float]


def measure(
    deployment: Deployment, sides: Sequence[str], rate: float, seconds: float, alone: float | None = None
) -> list[Slow]:
    """Measure several sides at once. Their other programs must already run; the slow programs are started here.

    Args:
        deployment: the daemon.
        sides: the subscribers' sides.
        rate: images of 1 MB per second on each side.
        seconds: duration with the slow programs.
        alone: duration of the measurement before they start; by default ``seconds``.
    """
    streams = [Stream(deployment, side, rate) for side in sides]
    for stream in streams:
        stream.open()
    before, memory_before = _watch(deployment, streams, seconds if alone is None else alone)
    for stream in streams:
        stream.slow_down()
    drops = _drops(deployment)
    beside, memory_beside = _watch(deployment, streams, seconds)
    result = []
    for stream in streams:
        side = stream.side
        read = deployment.ask(f"{side} slow", "report")["received"][stream.names[BIG]]["count"]
        more = {r: n - drops.get((side, r), 0) for (s, r), n in _drops(deployment).items() if s == side}
        dropped = {reason: count for reason, count in more.items() if count}
        result.append(Slow(side, before[side], beside[side], read, dropped, memory_before, memory_beside))
    return result


class Stream:
    """The large and the small topic of one side's subscribers."""

    def __init__(self, deployment: Deployment, side: str, rate: float) -> None:
        self.side, self.source = side, SOURCE[side]
        self.names = {topic: f"{topic}_{side}" for topic in (BIG, SMALL)}
        self.rates = {self.names[BIG]: rate, self.names[SMALL]: SMALL_RATE}
        self._deployment = deployment

    def open(self) -> None:
        """Create the publishers, and the subscriptions of the fast program; wait until both topics are bridged."""
        deployment, kinds = self._deployment, {self.names[BIG]: "image1", self.names[SMALL]: "string"}
        for side, do in ((self.source, "publish"), (self.side, "subscribe")):
            deployment.ask(side, do, topics=[deployment.topic(side, name, kind) for name, kind in kinds.items()])

        def crosses() -> bool:
            deployment.ask(self.source, "put", topics=list(kinds))
            return all(ear["count"] for ear in self.received().values())

        deployment.until(crosses, f"the streams are bridged to {self.side}")

    def slow_down(self) -> None:
        """Start the slow subscriber."""
        slow = self._deployment.program(self.side, f"{self.side} slow")
        topic = self._deployment.topic(self.side, self.names[BIG], "image1")
        self._deployment.ask(slow, "subscribe", topics=[topic], pause=PAUSE)

    def received(self) -> dict[str, dict[str, Any]]:
        """Return what the fast program has received, by topic."""
        report = self._deployment.ask(self.side, "report")["received"]
        return {topic: report[name] for topic, name in self.names.items()}


def _watch(
    deployment: Deployment, streams: Sequence[Stream], seconds: float
) -> tuple[dict[str, dict[str, Reception]], dict[str, float]]:
    """Send for a time; return the reception on each side, and each process's peak memory in MB."""
    rates: dict[str, dict[str, float]] = {}
    for stream in streams:
        rates.setdefault(stream.source, {}).update(stream.rates)
    deployment.drained(*(stream.side for stream in streams))
    start = {name: n for source in rates for name, n in deployment.ask(source, "still")["sent"].items()}
    before = {stream.side: stream.received() for stream in streams}
    memory: dict[str, float] = {}
    for source, topics in rates.items():
        deployment.ask(source, "flow", rates=topics)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for name, usage in deployment.usage().items():
            memory[name] = max(memory.get(name, 0.0), usage.rss)
        time.sleep(0.1)
    sent = {name: n for source in rates for name, n in deployment.ask(source, "still")["sent"].items()}
    deployment.drained(*(stream.side for stream in streams))
    result = {}
    for stream in streams:
        received = stream.received()
        result[stream.side] = {
            topic: _reception(sent[name], start[name], before[stream.side][topic], received[topic])
            for topic, name in stream.names.items()
        }
    return result, memory


def _reception(sent: int, start: int, earlier: dict[str, Any], received: dict[str, Any]) -> Reception:
    lost = received["lost"] - earlier["lost"] + behind(sent, received["last"]) - behind(start, earlier["last"])
    repeated = received["repeated"] - earlier["repeated"]
    ages = received["ages"]
    return Reception(sent - start, lost, repeated, ages["p50"], ages["p99"], ages["max"])


def _drops(deployment: Deployment) -> dict[tuple[str, str], int]:
    """Return the drops so far of the routes of each side's large topic, by side and reason."""
    drops: dict[tuple[str, str], int] = {}
    for worker in deployment.status().values():
        for route in worker.routes:
            topic, _, side = route.topic.rpartition("_")
            for reason, count in route.drops.items() if topic == BIG else ():
                drops[side, reason] = drops.get((side, reason), 0) + count
    return drops


def rows(slow: Slow) -> list[Row]:
    """Return a side's figures with the slow subscriber; the peer's are the figures before it started."""
    result = []
    for topic, beside in slow.beside.items():
        before, case = slow.before[topic], f"slow on {slow.side}, {topic[1:]} topic"
        result.append(Row(f"{case}, lost of {beside.sent}", beside.lost, before.lost, "count"))
        result.append(Row(f"{case}, p50", beside.p50, before.p50, "ms"))
        result.append(Row(f"{case}, p99", beside.p99, before.p99, "ms"))
        result.append(Row(f"{case}, latest", beside.latest, before.latest, "ms"))
    for name, most in slow.memory_beside.items():
        result.append(Row(f"slow on {slow.side}, peak memory of {name}", most, slow.memory_before[name], "MB"))
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sides", nargs="+", choices=SIDES, default=list(SIDES), help="sides to measure (default all)")
    parser.add_argument("--rate", type=float, default=50.0, help="images of 1 MB per second (default %(default)s)")
    parser.add_argument(
        "--seconds",
        type=float,
        default=20.0,
        help="seconds with and without the slow program, each (default %(default)s)",
    )
    add_json_option(parser)
    args = parser.parse_args(arguments)
    results: list[Row] = []
    for side in args.sides:
        with Deployment() as deployment:
            for program in {side, SOURCE[side]}:
                deployment.program(program)
            (slow,) = measure(deployment, [side], args.rate, args.seconds)
        print(f"slow on {side}: it read {slow.read} messages; dropped: {slow.drops}", file=sys.stderr, flush=True)
        results += rows(slow)
    report(results, args.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
