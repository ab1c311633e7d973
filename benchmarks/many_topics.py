"""Hundreds of topics between ROS 1 and ROS 2 through the daemon: their cost when idle and busy, and losses.

Half of the topics go from ROS 1 to ROS 2, half back. There are four parts:
- ``idle``: nothing is sent;
- ``fast``: one more topic runs at 250 Hz: by itself, then together with the idle topics, then by itself again;
- ``busy``: ten messages per second are sent on each topic, all numbered, and counted at the receiver;
- ``tf``: one topic of TF with 20 transforms runs at 2,000 Hz.

If the project has a limit for a figure, the limit is in the row's column ``peer``. Since the cost depends on the
machine, the busy topics also run through two bare relays (`benchmarks.latency.relay`). The relays do not convert TF,
so the peer of TF is a topic of strings at 2,000 Hz through the relays.
"""

from __future__ import annotations

import argparse
import logging
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from typing_extensions import override

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.latency.cases import NUMBERED, NUMBERED_TF, Prepared, prepare
from benchmarks.latency.figures import figures
from benchmarks.latency.network import BACK, THERE
from benchmarks.latency.stage import Stage
from benchmarks.latency.usage import DAEMON, WORKERS, Meter, Usage, text, total
from benchmarks.processes import add_realtime_option
from benchmarks.rows import Row, add_json_option, report

WAYS = {THERE: ("ros1", "ros2", "ROS 1 to ROS 2"), BACK: ("ros2", "ros1", "ROS 2 to ROS 1")}
IDLE_CPU, BUSY_CPU, BUSY_P99 = 1.0, 70.0, 3000.0
"""The project's limits: CPU of all idle daemon processes, and of both busy workers, in percent of a core; p99 in us."""
FAST = 250.0  # messages per second on the fast topic
KINDS = ("ros1", "ros2")
LANES = {"on": (True,), "off": (False,), "both": (True, False)}
LATEST_SECONDS = 2.0
"""Seconds without another message after which the missing ones count as lost."""


class Crowd(Stage):
    """The daemon with a number of topics in each direction, and one more in each direction for fast messages."""

    def __init__(self, topics: int, *, realtime: bool, lane: bool = True, tf: bool = False) -> None:
        super().__init__({
            "hub": {"lane": lane}, "ros2": {"transport": "shared_memory"}, "log": {"level": "warning"},
        })  # fmt: skip
        try:
            string, transforms = (prepare(case, self.place.folder) for case in (NUMBERED, NUMBERED_TF))
            self._topics = {direction: [f"/many/{direction}_{i}" for i in range(topics)] for direction in WAYS}
            self.start_bridge()
            self._ends("fast", {direction: [f"/fast/{direction}"] for direction in WAYS}, string)
            if topics:
                self._ends("many", self._topics, string)
            if tf:
                self._ends("tf", {direction: [f"/tf/{direction}"] for direction in WAYS}, transforms)
            self.meter = Meter(self.process_ids())
            if realtime:
                self.prefer()
        except BaseException:
            self.close()
            raise

    def _ends(self, part: str, topics: Mapping[str, Sequence[str]], message: Prepared) -> None:
        """Start the senders and listeners of some topics, and wait until a message has arrived on each."""
        self.start_ends({f"{kind} {part} {role}": kind for kind in KINDS for role in ("listener", "sender")})
        for direction, (source, target, _) in WAYS.items():
            subscribed = [message.topic(name, ros1=target == "ros1") for name in topics[direction]]
            sent = [message.topic(name, ros1=source == "ros1") for name in topics[direction]]
            self.command(f"{target} {part} listener", "count", "counting", topics=subscribed)
            self.command(f"{source} {part} sender", "advertise", "advertised", topics=sent)
        for direction, (source, target, _) in WAYS.items():
            self._wait_until_all_cross(f"{source} {part} sender", f"{target} {part} listener", topics[direction])

    def _wait_until_all_cross(self, sender: str, listener: str, topics: Sequence[str]) -> None:
        def all_cross() -> bool:
            self.command(sender, "drum", "drumming", topics=topics, rate=1.0, seconds=1.0)
            self.wait_for(sender, "drummed")
            return not self._tally(listener, len(topics), 0.5)["silent"]

        self.until(all_cross, f"a message arrives on all {len(topics)} topics from {sender} to {listener}")

    def _tally(self, listener: str, sent: int, seconds: float) -> dict[str, Any]:
        """Return a listener's counts, once all messages have arrived, or none arrives any longer."""
        return self.command(listener, "tally", "tallied", sent=sent, seconds=seconds)

    def idle(self, seconds: float) -> dict[str, Usage]:
        """Return the processes' use while nothing is sent."""
        time.sleep(2.0)  # wait for the end of the work that the last messages caused
        self.meter.start()
        time.sleep(seconds)
        return self.meter.read()

    def drum(
        self, part: str, directions: Sequence[str], rate: float, seconds: float
    ) -> tuple[dict[str, dict[str, Any]], dict[str, Usage]]:
        """Send on the topics of some directions; return the arrived messages by direction, and the processes' use."""
        topics = {
            direction: self._topics[direction] if part == "many" else [f"/{part}/{direction}"]
            for direction in directions
        }
        self.meter.start()
        for direction in directions:
            sender = f"{WAYS[direction][0]} {part} sender"
            self.command(sender, "drum", "drumming", topics=topics[direction], rate=rate, seconds=seconds)
        time.sleep(seconds)
        for direction in directions:
            self.wait_for(f"{WAYS[direction][0]} {part} sender", "drummed")  # on a busy machine, later than planned
        used = self.meter.read()
        sent = {direction: round(rate * seconds) * len(topics[direction]) for direction in directions}
        tallies = {
            direction: self._tally(f"{WAYS[direction][1]} {part} listener", sent[direction], LATEST_SECONDS)
            for direction in directions
        }
        return {direction: t | {"sent": sent[direction]} for direction, t in tallies.items()}, used


class Bare(Crowd):
    """The same ends and topics, with two bare relays instead of the daemon."""

    @override
    def start_bridge(self) -> None:
        """Start roscore and the relays."""
        self.start_master()
        endpoint, master = f"tcp/127.0.0.1:{self.place.router_port}", f"http://127.0.0.1:{self.place.master_port}/"
        topics = {direction: [*names, f"/fast/{direction}"] for direction, names in self._topics.items()}
        for kind, inward, outward in (("ros1", THERE, BACK), ("ros2", BACK, THERE)):
            self.launch(kind, "benchmarks.latency.relay", kind, endpoint, master)
            self.wait_for(kind, "ready")
            self.command(kind, "relay", "relaying", inward=topics[inward], outward=topics[outward])

    @override
    def process_ids(self) -> dict[str, int]:
        """Return process ids by name: of the relays ``ros1`` and ``ros2``, and of the senders and receivers."""
        return {name: child.pid for name, child in self._children.items()}


class Samples:
    """Figures of the fast topic, by direction and condition."""

    def __init__(self) -> None:
        self._all: dict[tuple[str, str, str], list[float]] = defaultdict(list)

    def measure(self, crowd: Crowd, condition: str, seconds: float) -> None:
        """Send in each direction, one after the other."""
        for direction in WAYS:
            tallies, used = crowd.drum("fast", [direction], FAST, seconds)
            p50, p99 = figures(tallies[direction]["ages"])
            for figure, value in (("p50", p50), ("p99", p99), ("CPU", total(used, WORKERS))):
                self._all[direction, condition, figure].append(value)
            lost = tallies[direction]["sent"] - tallies[direction]["distinct"]
            report_progress(text(f"one topic at {FAST:g} Hz, {WAYS[direction][2]}, {condition}, {lost} lost", used))

    def rows(self, count: int, suffix: str) -> list[Row]:
        """Return a row for each direction and figure: medians, with and without idle topics."""
        rows = []
        for direction, (_, _, name) in WAYS.items() if self._all else ():
            for figure, unit in (("CPU", "%"), ("p50", "us"), ("p99", "us")):
                ours, alone = (statistics.median(self._all[direction, which, figure]) for which in ("beside", "alone"))
                label = "CPU of both workers" if figure == "CPU" else figure
                rows.append(
                    Row(f"{FAST:g} Hz with {count} idle, {name}, {label}, to without{suffix}", ours, alone, unit)
                )
        return rows


def main(arguments: Sequence[str] | None = None) -> None:
    args = _parser().parse_args(arguments)
    logging.basicConfig(level=logging.WARNING)
    needed = {"idle", "busy", "fast"} & set(args.parts)
    measurements = [_measure(args, lane=lane) for lane in LANES[args.lane]] if needed else []
    rows: list[Row] = []
    if "tf" in args.parts:
        rows += _tf_rows(args)
    count = 2 * (args.topics // 2)
    if "busy" in args.parts:
        with Bare(count // 2, realtime=args.realtime) as crowd:
            title = f"{count} topics at {args.rate:g} Hz by bare relays"
            bare = _busy(crowd, "many", list(WAYS), args.rate, args.seconds, title)
        for measurement in measurements:
            rows += _busy_rows(f"{count} at {args.rate:g} Hz{measurement.suffix}", measurement.busy[0], bare)
        if len(measurements) > 1:
            ours, off = (measurement.busy[0].cpu for measurement in measurements)
            rows.append(Row(f"{count} at {args.rate:g} Hz, CPU of both workers, to lane off", ours, off, "%"))
    for measurement in measurements:
        rows += _idle(measurement.quiet, count, measurement.suffix) + measurement.samples.rows(
            count, measurement.suffix
        )
    report(rows, args.json)


class Measurement:
    """The measurements with the lane on, or with it off."""

    def __init__(self, *, lane: bool) -> None:
        self.suffix = "" if lane else ", lane off"
        self.samples = Samples()
        self.quiet: dict[str, list[float]] = defaultdict(list)
        self.busy: list[Busy] = []


def _measure(args: argparse.Namespace, *, lane: bool) -> Measurement:
    count, measurement = 2 * (args.topics // 2), Measurement(lane=lane)
    for condition in ("alone", "beside", "alone") if "fast" in args.parts else ("beside",):
        topics = count // 2 if condition == "beside" else 0
        with Crowd(topics, realtime=args.realtime, lane=lane) as crowd:
            if "idle" in args.parts:
                idle = crowd.idle(args.seconds)
                report_progress(text(f"{condition}, nothing sent{measurement.suffix}", idle))
                measurement.quiet[condition].append(total(idle, DAEMON))
            if "fast" in args.parts:
                measurement.samples.measure(crowd, condition, args.seconds / (2 if condition == "alone" else 1))
            if condition == "beside" and "busy" in args.parts:
                title = f"{count} topics at {args.rate:g} Hz{measurement.suffix}"
                measurement.busy.append(_busy(crowd, "many", list(WAYS), args.rate, args.seconds, title))
    return measurement


def _tf_rows(args: argparse.Namespace) -> list[Row]:
    """Return rows of one topic of TF at a high rate, compared with strings at the same rate through the bare relays."""
    rate, rows = NUMBERED_TF.rate, []
    with Bare(0, realtime=args.realtime) as crowd:
        bare = {direction: _busy(crowd, "fast", [direction], rate, args.seconds) for direction in WAYS}
    for lane in LANES[args.lane]:
        with Crowd(0, realtime=args.realtime, lane=lane, tf=True) as crowd:
            for direction, (_, _, name) in WAYS.items():
                ours, case = _busy(crowd, "tf", [direction], rate, args.seconds), f"TF of 20 at {rate:g} Hz, {name}"
                case += "" if lane else ", lane off"
                rows += [
                    Row(f"{case}, CPU per message, to strings by bare relays", ours.cost, bare[direction].cost, "us"),
                    Row(f"{case}, arrived of sent", ours.arrived[direction], ours.sent[direction], "msgs", "more"),
                    Row(
                        f"{case}, p50, to strings by bare relays",
                        ours.p50[direction],
                        bare[direction].p50[direction],
                        "us",
                    ),
                ]
    return rows


def _idle(quiet: dict[str, list[float]], count: int, suffix: str) -> list[Row]:
    """Return rows of the daemon's idle processor time, with and without idle routes."""
    case = f"{count} idle, CPU of the daemon, to the limit{suffix}"
    rows = [Row(case, load, IDLE_CPU, "%") for load in quiet.get("beside", ())]
    if quiet.get("alone"):
        added = quiet["beside"][0] - statistics.median(quiet["alone"])
        rows.append(Row(f"{count} idle, CPU beyond that without routes, to the limit{suffix}", added, IDLE_CPU, "%"))
    return rows


@dataclass(frozen=True, slots=True)
class Busy:
    """The cost of the busy topics.

    Attributes:
        cpu: processor time of both workers or relays, in percent of a core.
        cost: the same in microseconds for each message that arrived.
        sent: sent messages by direction.
        arrived: arrived messages by direction, without duplicates.
        p50: median latency by direction, microseconds.
        p99: 99th percentile by direction, microseconds.
    """

    cpu: float
    cost: float
    sent: Mapping[str, int]
    arrived: Mapping[str, int]
    p50: Mapping[str, float]
    p99: Mapping[str, float]


def _busy(crowd: Crowd, part: str, directions: Sequence[str], rate: float, seconds: float, title: str = "") -> Busy:
    tallies, used = crowd.drum(part, directions, rate, seconds)
    report_progress(text(title or f"{part} {' and '.join(directions)} at {rate:g} Hz", used))
    for direction, tally in tallies.items():
        doubled, name = tally["got"] - tally["distinct"], WAYS[direction][2]
        report_progress(f"{name}: {doubled} doubled, {tally['disorder']} out of order")
    if warnings := crowd.words():
        report_progress(f"the daemon's warnings:\n{warnings}")
    ages = {direction: figures(tally["ages"]) for direction, tally in tallies.items()}
    cpu, arrived = total(used, WORKERS), sum(tally["distinct"] for tally in tallies.values())
    return Busy(
        cpu,
        1e4 * cpu * crowd.meter.seconds / max(arrived, 1),
        {direction: tally["sent"] for direction, tally in tallies.items()},
        {direction: tally["distinct"] for direction, tally in tallies.items()},
        {direction: figure.p50 for direction, figure in ages.items()},
        {direction: figure.p99 for direction, figure in ages.items()},
    )


def _busy_rows(case: str, ours: Busy, bare: Busy) -> list[Row]:
    """Return rows that compare with the project's limits, and with the bare relays."""
    label = "CPU of both workers"
    rows = [
        Row(f"{case}, {label}, to the limit", ours.cpu, BUSY_CPU, "%"),
        Row(f"{case}, {label}, to bare relays", ours.cpu, bare.cpu, "%"),
        Row(f"{case}, CPU per message, to bare relays", ours.cost, bare.cost, "us"),
    ]
    for direction, (_, _, name) in WAYS.items():
        rows += [
            Row(f"{case}, {name}, arrived of sent", ours.arrived[direction], ours.sent[direction], "msgs", "more"),
            Row(f"{case}, {name}, p99, to the limit", ours.p99[direction], BUSY_P99, "us"),
            Row(f"{case}, {name}, p99, to bare relays", ours.p99[direction], bare.p99[direction], "us"),
            Row(f"{case}, {name}, p50, to bare relays", ours.p50[direction], bare.p50[direction], "us"),
        ]
    return rows


def report_progress(message: str) -> None:
    """Print progress to standard error."""
    print(message, file=sys.stderr, flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = ("idle", "busy", "fast", "tf")
    parser.add_argument("--parts", nargs="+", choices=parts, default=parts, help="parts to measure (default all)")
    parser.add_argument(
        "--topics", type=int, default=500, metavar="N", help="topics, half of them in each direction (500)"
    )
    parser.add_argument("--rate", type=float, default=10.0, metavar="HZ", help="messages per second on each (10)")
    parser.add_argument(
        "--seconds", type=float, default=20.0, metavar="S", help="duration of each measurement, seconds (20)"
    )
    parser.add_argument("--lane", choices=LANES, default="on", help="the hub's lane: on, off, or one after the other")
    add_realtime_option(parser)
    add_json_option(parser)
    return parser


if __name__ == "__main__":
    main()
