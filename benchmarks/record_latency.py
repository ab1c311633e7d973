"""Latency of bridged topics with the recorder: ROS 1 to ROS 2 and back, while images and small messages are recorded.

On the daemon's hub a sender publishes 200 MB/s of images and 5,000 small messages per second, as in `record.py`. In
every other turn `midspan record` records these and the bridged topics; in all turns a rospy program and an rclpy
program send small messages to each other through the daemon. The rows compare p50 and p99 with the recorder with those
without it (the aim is a ratio of 1.1). The file is written into memory, as in `record.py`.
"""

from __future__ import annotations

import argparse
import contextlib
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks import record
from benchmarks.latency.cases import CASES
from benchmarks.latency.figures import figures
from benchmarks.latency.network import BACK, THERE, Network
from benchmarks.rows import Row, add_json_option, report
from bridge.hub.node import Hub

WAYS = {THERE: "ROS 1 to ROS 2", BACK: "ROS 2 to ROS 1"}
WARM_SECONDS = 1.0
_CASE = next(case for case in CASES if case.key == "string")


class Bench:
    """A deployment with ROS 1 and ROS 2, and sender and listener of the recorded topics."""

    def __init__(self, args: argparse.Namespace, stack: contextlib.ExitStack) -> None:
        self.args = args
        apart = [record.IMAGE, *record.SMALL]
        self.network = stack.enter_context(Network([_CASE], idle=0, busy=0, shared_memory=True, apart=apart))
        place = self.network.place
        endpoint, self.config = f"tcp/127.0.0.1:{place.router_port}", place.config_file
        memory = Path("/dev/shm")
        folder = stack.enter_context(tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None))
        self.file = Path(folder) / "turn.mcap"
        where = ["--endpoint", endpoint, "--domain", str(place.domain)]
        self.watch = stack.enter_context(Hub.open(record.settings(endpoint, "watch", place.domain)))
        self.listener = stack.enter_context(record.running(record.__file__, "--role", "listen", *where))
        self.sender = stack.enter_context(
            record.running(record.__file__, "--role", "send", *where, "--flow", str(args.flow))
        )
        self.listener.receive()
        self.image = self.sender.receive()["image"]

    def turn(self, *, recorded: bool) -> dict[str, list[int]]:
        """Return latencies in nanoseconds by direction while everything is sent, with or without the recorder."""
        count = max(1, int(self.args.seconds * _CASE.rate / len(WAYS)))
        with contextlib.ExitStack() as stack:
            if recorded:
                stack.enter_context(record.running(*self._recorder()))
            record.until_subscribed(self.watch, [record.IMAGE, *record.SMALL], 2 if recorded else 1)
            self.sender.send(str(WARM_SECONDS + self.args.seconds * 1.5))
            time.sleep(WARM_SECONDS)  # wait until messages flow, and the file's channels are written
            prepared = self.network.messages[_CASE.key]
            latencies = {direction: self.network.measure(prepared, direction, count) for direction in WAYS}
            sent = self.sender.receive()
        self.file.unlink(missing_ok=True)
        megabytes = sent["images"] * self.image / sent["seconds"] / 1e6
        summary = ", ".join(
            f"{direction} {figures(ages)}, {count - len(ages)} lost" for direction, ages in latencies.items()
        )
        print(f"{'midspan' if recorded else 'nobody':8} {megabytes:.0f} MB/s: {summary}", file=sys.stderr, flush=True)
        return latencies

    def _recorder(self) -> list[str | Path]:
        topics = [record.IMAGE, "/small_*", *(f"/{direction}/{_CASE.key}" for direction in WAYS)]
        where: list[str | Path] = ["-o", self.file, "--config", self.config]
        return ["-m", "bridge.cli.main", "record", *topics, "--compression", "none", "--queue", "512MB", *where]


def measure(args: argparse.Namespace) -> list[Row]:
    """Run all turns, with and without the recorder; return the medians as rows."""
    values: dict[tuple[bool, str, str], list[float]] = defaultdict(list)
    with contextlib.ExitStack() as stack:
        bench = Bench(args, stack)
        for number in range(args.rounds):
            for recorded in (False, True) if number % 2 == 0 else (True, False):
                for direction, ages in bench.turn(recorded=recorded).items():
                    result = figures(ages)
                    values[recorded, direction, "p50"].append(result.p50)
                    values[recorded, direction, "p99"].append(result.p99)

    def row(direction: str, figure: str) -> Row:
        ours, peer = (statistics.median(values[recorded, direction, figure]) for recorded in (True, False))
        return Row(f"{WAYS[direction]}, {figure}, with the recorder, against without", ours, peer, "us")

    return [row(direction, figure) for direction in WAYS for figure in ("p50", "p99")]


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=8.0, help="seconds of each turn (default 8)")
    parser.add_argument("--rounds", type=int, default=4, help="turns of each (default 4)")
    parser.add_argument("--flow", type=float, default=record.FLOW, help="bytes per second of images (default 200e6)")
    add_json_option(parser)
    args = parser.parse_args(argv)
    report(measure(args), args.json)


if __name__ == "__main__":
    main()
