"""One-way latency of topics between ROS 1 and ROS 2 through the daemon, and the floor of the same hops without it.

The floor is rospy to rospy plus zenoh to zenoh plus rclpy to rclpy. All send raw bytes; zenoh uses a direct link with
the daemon's own shared-memory setting, rclpy a loop that does not slow down with subscriptions. The floor is measured
in the same run, in turns with the whole path; each round has new processes, and each message is measured hop by hop and
in both directions.
"""

from __future__ import annotations

import argparse
import logging
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.latency.cases import CASES, Case
from benchmarks.latency.figures import Figures, figures, floor, over_rounds
from benchmarks.latency.network import BACK, THERE, Network
from benchmarks.processes import add_realtime_option
from benchmarks.rows import Row, add_json_option, report

HOPS = ("ros1", "zenoh", "ros2")
WAYS = {THERE: "ROS 1 to ROS 2", BACK: "ROS 2 to ROS 1"}
TURNS = 5
"""Turns per round of each hop of the floor and each direction, with one kind of message."""

LIMITS = {"small": (1.15, 1.5), "tf": (1.2, 1.5), "large": (1.25, 1.5)}
"""The project's limits for the ratio to the floor, of p50 and p99, by kind of message."""


@dataclass(frozen=True, slots=True)
class Condition:
    """The other routes during a measurement."""

    key: str
    name: str
    idle: int = 0
    busy: int = 0


CONDITIONS = (
    Condition("alone", ""),
    Condition("idle", ", 200 idle routes", idle=200),
    Condition("busy", ", 50 routes at 20 Hz", busy=50),
)


LANES = {"on": (True,), "off": (False,), "both": (True, False)}


class Samples:
    """Figures of every round, by case and measurement."""

    def __init__(self, lane: bool = True) -> None:
        self.lane = lane
        self._floors: dict[str, list[Figures]] = defaultdict(list)
        self._hops: dict[tuple[str, str], list[Figures]] = defaultdict(list)
        self.lost = 0
        self.sent = 0

    def round(self, network: Network, number: int) -> None:
        """Measure every case once, the floor and Midspan in turns."""
        for key, prepared in network.messages.items():
            latencies: dict[str, list[int]] = defaultdict(list)
            for _ in range(TURNS):
                for hop in ("ros1", THERE, "zenoh", BACK, "ros2"):
                    ages = network.measure(prepared, hop, prepared.case.count // TURNS)
                    latencies[hop] += ages
                    self.sent += prepared.case.count // TURNS
                    self.lost += prepared.case.count // TURNS - len(ages)
            for hop, ages in latencies.items():
                self._hops[key, hop].append(figures(ages))
            self._floors[key].append(floor([latencies[hop] for hop in HOPS], number))

    def rows(self, cases: Sequence[Case], suffix: str, off: Samples | None = None) -> list[Row]:
        """Return a row for each case, direction and figure, and if measured, another against the lane off."""
        suffix += "" if self.lane else ", lane off"
        rows = []
        for case in cases:
            peer = over_rounds(self._floors[case.key])
            for direction, name in WAYS.items():
                ours = over_rounds(self._hops[case.key, direction])
                for figure in ("p50", "p99"):
                    row = Row(
                        f"{case.name}, {name}, {figure}{suffix}", getattr(ours, figure), getattr(peer, figure), "us"
                    )
                    rows.append(row)
                    if off is not None:
                        without = getattr(over_rounds(off._hops[case.key, direction]), figure)
                        rows.append(Row(f"{case.name}, {name}, {figure}{suffix}, to lane off", row.ours, without, "us"))
        return rows

    def hops_text(self, cases: Sequence[Case]) -> str:
        """Return the floor's hops as text."""
        lines = ["hops in us (p50 / p99), whose sum is the floor:"]
        for case in cases:
            hop_figures = (over_rounds(self._hops[case.key, hop]) for hop in HOPS)
            lines.append(
                f"  {case.name:<24}"
                + "".join(f"  {h} {f.p50:7.0f} /{f.p99:7.0f}" for h, f in zip(HOPS, hop_figures, strict=True))
            )
        return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; return 1 if a limit is exceeded and ``--check`` is given."""
    args = _parser().parse_args(arguments)
    logging.basicConfig(level=logging.WARNING)
    cases = _chosen(args.cases, quick=args.quick)
    rounds = args.rounds or (2 if args.quick else 5)
    rows: list[Row] = []
    for condition in CONDITIONS:
        if condition.key in (args.conditions or (["alone"] if args.quick else [c.key for c in CONDITIONS])):
            rows += _measure(condition, cases, rounds, args)
    report(rows, args.json)
    missed = [row for row in rows if "lane off" not in row.case and row.ratio > _limit(row, cases)]
    for row in missed:
        print(f"above its limit of {_limit(row, cases):g}: {row.case}: {row.ratio:.2f}")
    return 1 if missed and args.check else 0


def _measure(condition: Condition, cases: Sequence[Case], rounds: int, args: argparse.Namespace) -> list[Row]:
    series = [Samples(lane) for lane in LANES[args.lane]]
    for number in range(rounds):
        for samples in series if number % 2 else reversed(series):
            topic = f"{condition.key}, lane {'on' if samples.lane else 'off'}"
            print(f"{topic}: round {number + 1} of {rounds}", file=sys.stderr, flush=True)
            _round(samples, condition, cases, number, args)
    for samples in series:
        print(
            f"{condition.key}, lane {'on' if samples.lane else 'off'}: {samples.hops_text(cases)}\n"
            f"{samples.lost} of {samples.sent} messages lost",
            file=sys.stderr,
        )
    first = series[0].rows(cases, condition.name, series[1] if len(series) > 1 else None)
    return first + [row for samples in series[1:] for row in samples.rows(cases, condition.name)]


def _round(
    samples: Samples, condition: Condition, cases: Sequence[Case], number: int, args: argparse.Namespace
) -> None:
    memory = not args.no_shared_memory
    with Network(cases, idle=condition.idle, busy=condition.busy, shared_memory=memory, lane=samples.lane) as network:
        if args.realtime:
            network.prefer()
        samples.round(network, number)
        if condition.busy:
            print(f"background: {network.background_rate():.0f} messages/s arrive", file=sys.stderr)


def _limit(row: Row, cases: Sequence[Case]) -> float:
    kind = next(case.kind for case in cases if row.case.startswith(f"{case.name},"))
    return LIMITS[kind][1 if ", p99" in row.case else 0]


def _chosen(names: Sequence[str] | None, *, quick: bool) -> list[Case]:
    known = {case.key: case for case in CASES}
    if not names:
        return [known[k] for k in ("string", "tf", "image1")] if quick else list(CASES)
    return [known[name] for name in names]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--cases", nargs="+", choices=[case.key for case in CASES], help="messages to send (default all)"
    )
    parser.add_argument(
        "--conditions", nargs="+", choices=[c.key for c in CONDITIONS], help="conditions to measure (default all)"
    )
    parser.add_argument("--rounds", type=int, metavar="N", help="rounds, each with new processes (default 5)")
    parser.add_argument(
        "--quick", action="store_true", help="measure only three messages in two rounds, with nothing else bridged"
    )
    parser.add_argument("--no-shared-memory", action="store_true", help="without shared memory on the hub")
    parser.add_argument("--lane", choices=LANES, default="on", help="the hub's lane: on, off, or both in turns")
    add_realtime_option(parser)
    parser.add_argument("--check", action="store_true", help="exit with code 1 if a ratio is above its limit")
    add_json_option(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
