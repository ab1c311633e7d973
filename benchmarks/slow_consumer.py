"""A subscriber that reads one message a second from a fast stream: what it costs the daemon, and whom it delays.

On each side a program's callback takes a second for each message of a large stream that another side publishes. Beside
it another program of the same side reads the same stream, and a small one, without such a pause. Printed are the
daemon's memory at its highest, and of the other program's messages those that were lost and the latency, with the slow
one there and (the peer's column) before it came.
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
SMALL_RATE = 100.0
PAUSE = 1.0
DRAIN_SECONDS = 2.0


@dataclass(frozen=True, slots=True)
class Heard:
    """What the other program heard of one topic in a while.

    Attributes:
        sent: messages that were sent.
        lost: how many of them did not come.
        repeated: how many came twice.
        p50: median latency in milliseconds.
        p99: the latency that one in a hundred exceeds.
    """

    sent: int
    lost: int
    repeated: int
    p50: float
    p99: float


@dataclass(frozen=True, slots=True)
class Slow:
    """One side's result: the topics before the slow subscriber came and beside it, and the daemon's memory in MB.

    Attributes:
        side: where the subscribers are.
        before: by topic, without the slow subscriber.
        beside: by topic, with it.
        read: messages that the slow subscriber read.
        drops: what the routes counted beside it, by reason.
        memory_before: of each process at its highest.
        memory_beside: the same beside the slow subscriber.
    """

    side: str
    before: dict[str, Heard]
    beside: dict[str, Heard]
    read: int
    drops: dict[str, int]
    memory_before: dict[str, float]
    memory_beside: dict[str, float]


def measure(deployment: Deployment, side: str, rate: float, seconds: float) -> Slow:
    """Measure one side. Its program and its source's run already; the slow one is started.

    Args:
        deployment: the daemon.
        side: where the subscribers are.
        rate: images of 1 MB a second.
        seconds: with and without the slow one, each.
    """
    source, names = SOURCE[side], {topic: f"{topic}_{side}" for topic in (BIG, SMALL)}
    kinds = {names[BIG]: "image1", names[SMALL]: "string"}
    deployment.ask(source, "publish", topics=[deployment.topic(source, name, kind) for name, kind in kinds.items()])
    deployment.ask(side, "subscribe", topics=[deployment.topic(side, name, kind) for name, kind in kinds.items()])

    def crosses() -> bool:
        deployment.ask(source, "put", topics=list(kinds))
        heard = deployment.ask(side, "report")["heard"]
        return all(heard[name]["count"] for name in kinds)

    deployment.until(crosses, f"the streams cross to {side}")
    rates = {names[BIG]: rate, names[SMALL]: SMALL_RATE}
    before, memory_before = _watch(deployment, side, source, rates, seconds)
    slow = deployment.program(side, f"{side} slow")
    deployment.ask(slow, "subscribe", topics=[deployment.topic(side, names[BIG], "image1")], pause=PAUSE)
    drops = _drops(deployment)
    beside, memory_beside = _watch(deployment, side, source, rates, seconds)
    read = deployment.ask(slow, "report")["heard"][names[BIG]]["count"]
    more = {reason: count - drops.get(reason, 0) for reason, count in _drops(deployment).items()}
    topics = {name: topic for topic, name in names.items()}
    return Slow(
        side,
        {topics[n]: h for n, h in before.items()},
        {topics[n]: h for n, h in beside.items()},
        read,
        {reason: count for reason, count in more.items() if count},
        memory_before,
        memory_beside,
    )


def _watch(
    deployment: Deployment, side: str, source: str, rates: dict[str, float], seconds: float
) -> tuple[dict[str, Heard], dict[str, float]]:
    """Send for so long; what was heard, and each process's highest memory in MB."""
    told, start = deployment.ask(side, "report")["heard"], deployment.ask(source, "still")["sent"]
    memory: dict[str, float] = {}
    deployment.ask(source, "flow", rates=rates)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for name, usage in deployment.usage().items():
            memory[name] = max(memory.get(name, 0.0), usage.rss)
        time.sleep(0.1)
    sent = deployment.ask(source, "still")["sent"]
    time.sleep(DRAIN_SECONDS)
    heard = deployment.ask(side, "report")["heard"]
    return {name: _heard(sent[name], start[name], told[name], heard[name]) for name in rates}, memory


def _heard(sent: int, start: int, told: dict[str, Any], heard: dict[str, Any]) -> Heard:
    lost = heard["lost"] - told["lost"] + behind(sent, heard["last"]) - behind(start, told["last"])
    repeated = heard["repeated"] - told["repeated"]
    return Heard(sent - start, lost, repeated, heard["ages"]["p50"], heard["ages"]["p99"])


def _drops(deployment: Deployment) -> dict[str, int]:
    drops: dict[str, int] = {}
    for worker in deployment.status().values():
        for route in worker["routes"]:
            for reason, count in route["drops"].items():
                drops[reason] = drops.get(reason, 0) + count
    return drops


def rows(slow: Slow) -> list[Row]:
    """A side's figures beside the slow subscriber; the peer's are those before it came."""
    made = []
    for topic, beside in slow.beside.items():
        before, case = slow.before[topic], f"slow on {slow.side}, {topic[1:]} topic"
        made.append(Row(f"{case}, lost of {beside.sent}", beside.lost, before.lost, "count"))
        made.append(Row(f"{case}, p50", beside.p50, before.p50, "ms"))
        made.append(Row(f"{case}, p99", beside.p99, before.p99, "ms"))
    for name, most in slow.memory_beside.items():
        made.append(Row(f"slow on {slow.side}, most memory of {name}", most, slow.memory_before[name], "MB"))
    return made


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sides", nargs="+", choices=SIDES, default=list(SIDES), help="default all")
    parser.add_argument("--rate", type=float, default=50.0, help="images of 1 MB a second (default %(default)s)")
    parser.add_argument("--seconds", type=float, default=20.0, help="with and without, each (default %(default)s)")
    add_json_option(parser)
    args = parser.parse_args(arguments)
    found: list[Row] = []
    for side in args.sides:
        with Deployment() as deployment:
            for program in (side, SOURCE[side]):
                deployment.program(program)
            slow = measure(deployment, side, args.rate, args.seconds)
        print(f"slow on {side}: it read {slow.read} messages; dropped: {slow.drops}", file=sys.stderr, flush=True)
        found += rows(slow)
    report(found, args.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
