"""A mixed load over all sides of any duration, in which every message is counted.

Topics of many kinds and rates go from each side to both others; every message is numbered, and lost, duplicate and
misordered messages are reported. Periodically a late joiner on each side subscribes to each latched topic. At the end,
or after Ctrl-C, the slope of each process's memory, the change of threads and descriptors, and the drift of the latency
are printed. Midspan delivers only the newest command (Twist), so losses of commands are reported separately.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.endurance.deployment import SIDES, Census, Deployment
from benchmarks.endurance.ear import behind
from benchmarks.endurance.slope import slope
from benchmarks.rows import Row, add_json_option, report

MIX = (
    ("string", 20.0),
    ("scan", 10.0),
    ("tf", 20.0),
    ("string", 5.0),
    ("twist", 20.0),
    ("string", 50.0),
    ("scan", 10.0),
    ("image1", 1.0),
)
"""Kind and messages per second of the topics; the topics use these entries in turn."""
LATCHED = (("grid", 0.1), ("string", 0.1))
"""Kind and messages per second of each side's latched topics."""
COMMAND = "twist"
JOIN_SECONDS = 10.0


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of the load."""

    name: str
    kind: str
    rate: float
    source: str
    latched: bool = False


@dataclass(slots=True)
class Sums:
    """The total counts of all receivers."""

    received: int = 0
    lost: int = 0
    commands_lost: int = 0
    repeated: int = 0
    disordered: int = 0


@dataclass(slots=True)
class Course:
    """The course of a soak test.

    Attributes:
        seconds: time of each sample, from the start.
        censuses: the daemon's census at each sample.
        p99: the median over the topics of the 99th percentile of the latency at each sample, in ms.
        unanswered: late joiners that received nothing within `JOIN_SECONDS`.
        joins: total number of late joiners.
    """

    seconds: list[float] = field(default_factory=list)
    censuses: list[Census] = field(default_factory=list)
    p99: list[float] = field(default_factory=list)
    unanswered: int = 0
    joins: int = 0


def load(count: int) -> list[Topic]:
    """Return a number of topics, which come from the sides in turn, and the latched topics."""
    topics = [
        Topic(f"/soak/{kind}_{i}", kind, rate, SIDES[i % len(SIDES)])
        for i, (kind, rate) in ((i, MIX[i // len(SIDES) % len(MIX)]) for i in range(count))
    ]
    latched = [Topic(f"/soak/state_{s}_{k}", k, rate, s, latched=True) for s in SIDES for k, rate in LATCHED]
    return topics + latched


class Soak:
    """The load between two programs of each side: one sends, the other subscribes to the other sides' topics."""

    def __init__(self, deployment: Deployment, topics: Sequence[Topic]) -> None:
        self._deployment, self._topics = deployment, topics
        self.course = Course()
        self.sent: dict[str, int] = {}
        self._sums = Sums()
        for side in SIDES:
            deployment.program(side)
            deployment.program(side, _ear(side))
            deployment.ask(side, "publish", topics=self._described(side, [t for t in topics if t.source == side]))
        for side in SIDES:
            subscribed = [t for t in topics if t.source != side]
            deployment.ask(_ear(side), "subscribe", topics=self._described(side, subscribed))
        deployment.until(self._crosses, "every topic is bridged", every=0.3)

    def _described(self, side: str, topics: Sequence[Topic]) -> list[dict[str, Any]]:
        return [self._deployment.topic(side, t.name, t.kind, latched=t.latched) for t in topics]

    def _crosses(self) -> bool:
        for side in SIDES:
            self._deployment.ask(side, "put", topics=[t.name for t in self._topics if t.source == side])
        return not any(self._silent_topics(_ear(side)) for side in SIDES)

    def run(self, seconds: float, every: float) -> None:
        """Send and count for a time, with periodic samples; Ctrl-C ends the run early, but in an orderly manner."""
        deployment = self._deployment
        self._at_first = {side: deployment.ask(_ear(side), "report")["received"] for side in SIDES}
        for side in SIDES:
            deployment.ask(side, "flow", rates={t.name: t.rate for t in self._topics if t.source == side})
        began = time.monotonic()
        try:
            while time.monotonic() - began < seconds:
                time.sleep(min(every, max(0.1, began + seconds - time.monotonic())))
                self._sample(time.monotonic() - began)
        except KeyboardInterrupt:
            print("ended early", file=sys.stderr)
        for side in SIDES:
            self.sent |= deployment.ask(side, "still")["sent"]
        deployment.drained(*map(_ear, SIDES))
        self._sums = self._count()

    def _sample(self, seconds: float) -> None:
        course = self.course
        self._join()
        reports = [self._deployment.ask(_ear(side), "report")["received"] for side in SIDES]
        ages = [ear["ages"]["p99"] for report_ in reports for ear in report_.values() if ear["ages"]]
        course.seconds.append(seconds)
        course.censuses.append(self._deployment.census())
        course.p99.append(median(ages) if ages else 0.0)
        lost, twice = (sum(ear[w] for report_ in reports for ear in report_.values()) for w in ("lost", "repeated"))
        report_ = sum(ear["count"] for report_ in reports for ear in report_.values())
        used = ", ".join(f"{n} {u.rss:.0f} MB {u.threads}/{u.descriptors}" for n, u in course.censuses[-1].used.items())
        print(
            f"{seconds:7.0f} s: {report_} received, {lost} lost, {twice} twice, p99 {course.p99[-1]:.1f} ms,"
            f" {course.unanswered} of {course.joins} late joiners unanswered; {used}",
            file=sys.stderr,
            flush=True,
        )

    def _join(self) -> None:
        """On each side, let the sender, which has no other subscriptions, join the other sides' latched topics late."""
        deployment = self._deployment
        for side in SIDES:
            topics = [t for t in self._topics if t.latched and t.source != side]
            deployment.ask(side, "subscribe", topics=self._described(side, topics))
            end = time.monotonic() + JOIN_SECONDS
            while (missing := self._silent_topics(side)) and time.monotonic() < end:
                time.sleep(0.05)
            deployment.ask(side, "drop", publish=[], subscribe=[t.name for t in topics])
            self.course.joins += len(topics)
            self.course.unanswered += missing

    def _silent_topics(self, program: str) -> int:
        """Return the number of a program's topics without messages."""
        return sum(not ear["count"] for ear in self._deployment.ask(program, "report")["received"].values())

    def _count(self) -> Sums:
        sums, kinds = Sums(), {t.name: t.kind for t in self._topics}
        for side in SIDES:
            for name, ear in self._deployment.ask(_ear(side), "report")["received"].items():
                first = self._at_first[side][name]
                lost = ear["lost"] - first["lost"] + behind(self.sent[name], ear["last"])
                sums.received += ear["count"] - first["count"]
                sums.repeated += ear["repeated"] - first["repeated"]
                sums.disordered += ear["disordered"] - first["disordered"]
                if kinds[name] == COMMAND:
                    sums.commands_lost += lost
                else:
                    sums.lost += lost
        return sums

    def rows(self) -> list[Row]:
        """Return the rows; the peer is a daemon without losses and leaks, or the latency at the start of the run."""
        sums, course = self._sums, self.course
        result = [
            Row(f"lost, with {sums.received} received", sums.lost, 0.0, "count"),
            Row("commands dropped", sums.commands_lost, 0.0, "count"),
            Row("came twice", sums.repeated, 0.0, "count"),
            Row("out of order", sums.disordered, 0.0, "count"),
            Row(f"unanswered of {course.joins} late joiners", course.unanswered, 0.0, "count"),
        ]
        third = max(1, len(course.p99) // 3)
        if course.p99:
            result.append(
                Row("p99, last third to first", median(course.p99[-third:]), median(course.p99[:third]), "ms")
            )
        points: dict[str, list[tuple[float, float]]] = defaultdict(list)
        for second, census in zip(course.seconds, course.censuses, strict=True):
            for name, usage in census.used.items():
                points[name].append((second, usage.rss))
        # without the beginning, when one-time allocations happen
        result += [Row(f"memory of {n}", slope(p[len(p) // 3 :]) * 3600, 0.0, "MB/h") for n, p in points.items()]
        for resource in ("threads", "descriptors") if course.censuses else ():
            first, last = course.censuses[min(1, len(course.censuses) - 1)], course.censuses[-1]
            for name, usage in last.used.items():
                result.append(
                    Row(f"{resource} of {name}", getattr(usage, resource), getattr(first.used[name], resource), "count")
                )
        return result


def _ear(side: str) -> str:
    return f"{side} ear"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0, metavar="N", help="duration (default %(default)s)")
    parser.add_argument(
        "--topics",
        type=int,
        default=48,
        metavar="M",
        help="number of topics without the latched ones (default %(default)s)",
    )
    parser.add_argument(
        "--every", type=float, default=10.0, metavar="S", help="seconds between two samples (default 10)"
    )
    add_json_option(parser)
    args = parser.parse_args(arguments)
    with Deployment() as deployment:
        soak = Soak(deployment, load(args.topics))
        soak.run(args.minutes * 60, args.every)
        results = soak.rows()
    report(results, args.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
