"""Leaks of the daemon after thousands of endpoints have been created and closed on each side.

Real rospy, rclpy and zenoh programs create and close publishers and subscriptions in batches of a hundred. Each
endpoint carries a message before it is closed, and is closed with a last message in flight. The result is the growth
of each process's memory per endpoint, and the threads, descriptors, routes, hub tokens and ROS 1 registrations that are
left at the end.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.endurance.deployment import SIDES, Census, Deployment
from benchmarks.endurance.slope import slope
from benchmarks.rows import Row, add_json_option, report

KINDS = ("string", "twist", "scan", "tf", "grid", "image1")
LATCHED_KINDS = ("string", "scan", "grid")
FRESH, KEPT = 50, 10
"""Number of publishers per batch: on topics with new names, and on topics that all batches use."""
FED, STREAMED = 30, 10
"""Number of subscriptions per batch to another side's latched topics, and to its streams."""
BATCH = FRESH + KEPT + FED + STREAMED
WARM = 3
"""Number of batches before the measurement."""
SETTLE_SECONDS, IDLE_SECONDS = 40.0, 12.0
FLOW = 4.0
"""Messages per second of a stream: so few that a route without subscribers stays subscribed (`hub_end.QUICK`)."""
FEEDER = {"ros1": "ros2", "ros2": "ros1", "zenoh": "ros1"}
"""The side to which each side's programs subscribe."""


@dataclass(slots=True)
class Churned:
    """One side's result.

    Attributes:
        endpoints: number of created and closed endpoints, without the first batches.
        before: the daemon's census after the first batches.
        after: the daemon's census at the end.
        slopes: bytes of memory per endpoint, by process.
        seconds: duration.
    """

    side: str
    endpoints: int
    before: Census
    after: Census
    slopes: dict[str, float]
    seconds: float
    memory: dict[str, list[tuple[int, float]]] = field(default_factory=dict)


class Churn:
    """Creates and closes endpoints of one side, while its feeder publishes; the programs of both already run."""

    def __init__(self, deployment: Deployment, side: str) -> None:
        self._deployment, self._side = deployment, side
        self._numbers = itertools.count()
        feeder, prefix = FEEDER[side], f"/feed_{side}"
        fed = [(f"{prefix}/l{i}", LATCHED_KINDS[i % len(LATCHED_KINDS)], True) for i in range(FED)]
        streams = [(f"{prefix}/s{i}", "string", False) for i in range(STREAMED)]
        make = [deployment.topic(feeder, name, kind, latched=latched) for name, kind, latched in fed + streams]
        deployment.ask(feeder, "publish", topics=make)
        deployment.ask(feeder, "put", topics=[name for name, _, _ in fed])
        deployment.ask(feeder, "flow", rates={name: FLOW for name, _, _ in streams})
        self._feeds = [deployment.topic(side, name, kind, latched=latched) for name, kind, latched in fed + streams]

    def run(self, endpoints: int, warm: int = WARM) -> Churned:
        """Create and close endpoints, after ``warm`` batches before the measurement."""
        deployment = self._deployment
        for _ in range(warm):
            self.batch()
        before, began = self.settled(), time.monotonic()
        memory: dict[str, list[tuple[int, float]]] = {name: [] for name in before.used}
        for number in range(0, endpoints, BATCH):
            self.batch()
            census = deployment.census()
            for name, usage in census.used.items():
                memory[name].append((number + BATCH, usage.rss * 1e6))
            if number // BATCH % 10 == 9:
                print(f"{self._side}: {number + BATCH}: {_memory(census)}", file=sys.stderr, flush=True)
        seconds = time.monotonic() - began
        after = self.settled()
        slopes = {name: slope(points) for name, points in memory.items()}
        return Churned(self._side, len(range(0, endpoints, BATCH)) * BATCH, before, after, slopes, seconds, memory)

    def batch(self) -> None:
        """Create a batch of endpoints, wait until all are bridged, and close them."""
        deployment, side, number = self._deployment, self._side, next(self._numbers)
        prefix = f"/churn_{side}_{number}"
        fresh = [(f"{prefix}/t{i}", KINDS[i % len(KINDS)]) for i in range(FRESH)]
        kept = [(f"/kept_{side}/t{i}", KINDS[i % len(KINDS)]) for i in range(KEPT)]
        topics: list[dict[str, Any]] = [
            deployment.topic(side, name, kind, latched=kind in LATCHED_KINDS and i % 2 == 0)
            for i, (name, kind) in enumerate(fresh + kept)
        ]
        names, feeds = [t["topic"] for t in topics], [t["topic"] for t in self._feeds]
        deployment.ask(side, "publish", topics=topics)
        deployment.ask(side, "subscribe", topics=self._feeds)
        deployment.ask(side, "put", topics=names)
        far = [s for s in ("ros1", "ros2") if s != side]
        deployment.until(lambda: all(deployment.routes(prefix).get(s) == FRESH for s in far), f"{prefix} is bridged")
        deployment.until(self._all_received, f"{prefix}: all feeds are received")
        deployment.ask(side, "drop", publish=names, subscribe=feeds)

    def _all_received(self) -> bool:
        received = self._deployment.ask(self._side, "report")["received"]
        return all(ear["count"] for ear in received.values())

    def settled(self) -> Census:
        """Return the daemon's census once it is stable, because idle threads end only after ten seconds."""
        last, since = self._deployment.census(), time.monotonic()
        end = since + SETTLE_SECONDS
        while time.monotonic() < min(since + IDLE_SECONDS, end):
            time.sleep(1.0)
            census = self._deployment.census()
            if _counts(census) != _counts(last):
                since = time.monotonic()
            last = census
        return last


def _counts(census: Census) -> list[Any]:
    used = [(name, u.threads, u.descriptors) for name, u in sorted(census.used.items())]
    return [used, dict(census.routes), census.tokens, census.registrations]


def _memory(census: Census) -> str:
    return ", ".join(
        f"{name} {u.rss:.1f} MB {u.threads} threads {u.descriptors} fds" for name, u in census.used.items()
    )


def rows(churned: Churned) -> list[Row]:
    """Return a side's figures; the peer is a daemon that retains nothing."""
    case = f"{churned.endpoints} endpoints on {churned.side}"
    before, after = churned.before, churned.after
    result = [Row(f"{case}, memory of {n}", s / 1000, 0.0, "kB each") for n, s in churned.slopes.items()]
    for resource in ("threads", "descriptors"):
        left = sum(getattr(u, resource) - getattr(before.used[n], resource) for n, u in after.used.items())
        result.append(Row(f"{case}, {resource} left", left, 0.0, "count"))
    result.append(Row(f"{case}, routes left", sum(after.routes.values()) - sum(before.routes.values()), 0.0, "count"))
    result.append(Row(f"{case}, hub tokens left", after.tokens - before.tokens, 0.0, "count"))
    result.append(Row(f"{case}, registrations left", after.registrations - before.registrations, 0.0, "count"))
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--endpoints", type=int, default=10_000, metavar="N", help="endpoints on each side (default %(default)s)"
    )
    parser.add_argument("--sides", nargs="+", choices=SIDES, default=list(SIDES), help="sides to measure (default all)")
    add_json_option(parser)
    args = parser.parse_args(arguments)
    results: list[Row] = []
    for side in args.sides:
        with Deployment() as deployment:
            for program in {side, FEEDER[side]}:
                deployment.program(program)
            churned = Churn(deployment, side).run(args.endpoints)
        print(f"{side}: {churned.endpoints / churned.seconds:.0f} endpoints/s", file=sys.stderr)
        results += rows(churned)
    report(results, args.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
