"""A 100 MB/s stream of images through the daemon, and its effect on the small messages of /cmd_vel and /tf.

The stream and the small topics have the same direction, from ROS 1 to ROS 2 and then back. The stream runs in every
other turn; the peer is the latency without it. Separate processes send and receive the images, so that the programs of
the small topics are not involved.
"""

from __future__ import annotations

import argparse
import logging
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.latency.cases import CASES, prepare
from benchmarks.latency.figures import figures
from benchmarks.latency.stage import Stage
from benchmarks.latency.usage import Meter, text
from benchmarks.processes import add_realtime_option
from benchmarks.rows import Row, add_json_option, report

WAYS = {("ros1", "ros2"): "ROS 1 to ROS 2", ("ros2", "ros1"): "ROS 2 to ROS 1"}
SMALL = {"/cmd_vel": "twist", "/tf": "tf"}
STREAM, IMAGE = "/camera/image", "image1"
FLOW = 100e6
"""Bytes per second of the stream."""
RATE = 100.0
"""Messages per second on each small topic."""
LATEST_SECONDS = 2.0
"""Seconds without another message after which the missing ones count as lost."""


class Flood(Stage):
    """The daemon, and two pairs of programs for one direction: one for the small topics, and one for the stream."""

    def __init__(self, source: str, target: str, *, realtime: bool) -> None:
        super().__init__({"ros2": {"transport": "shared_memory"}, "log": {"level": "warning"}})
        try:
            messages = {case.key: prepare(case, self.place.folder) for case in CASES}
            self.topics = {"small": {t: messages[key] for t, key in SMALL.items()}, "stream": {STREAM: messages[IMAGE]}}
            self.image_rate = FLOW / messages[IMAGE].cdr.stat().st_size
            self.start_bridge()
            self._open(source, target)
            self.meter = Meter(self.process_ids())
            if realtime:
                self.prefer()
        except BaseException:
            self.close()
            raise

    def _open(self, source: str, target: str) -> None:
        roles = {"listener": target, "sender": source}
        self.start_ends({f"{part} {role}": kind for part in self.topics for role, kind in roles.items()})
        for part, topics in self.topics.items():
            subscribed = [message.topic(name, ros1=target == "ros1") for name, message in topics.items()]
            sent = [message.topic(name, ros1=source == "ros1") for name, message in topics.items()]
            self.command(f"{part} listener", "subscribe", "subscribed", topics=subscribed)
            self.command(f"{part} sender", "advertise", "advertised", topics=sent)
        for part, topics in self.topics.items():
            for name in topics:
                self.until_crosses(f"{part} sender", f"{part} listener", name)

    def turn(self, seconds: float, *, flooded: bool) -> dict[str, list[int]]:
        """Send on the small topics, and on the stream if ``flooded``; return the received ages by topic."""
        for part in self.topics:
            self.command(f"{part} listener", "clear", "cleared")
        lead = 1.0
        if flooded:
            self._drum("stream", self.image_rate, seconds + 2 * lead)
        time.sleep(lead)
        self.meter.start()
        self._drum("small", RATE, seconds)
        time.sleep(seconds)
        name = "with the stream" if flooded else "without"
        print(text(name, self.meter.read()), file=sys.stderr, flush=True)
        self.wait_for("small sender", "drummed")
        if flooded:
            self.wait_for("stream sender", "drummed")
        sent = dict.fromkeys(SMALL, round(RATE * seconds))
        if flooded:
            sent[STREAM] = round(self.image_rate * (seconds + 2 * lead))
        return {topic: self._arrived(topic, count) for topic, count in sent.items()}

    def _arrived(self, topic: str, sent: int) -> list[int]:
        """Return the ages received on a topic, once all messages have arrived or no more arrive."""
        listener = "stream listener" if topic == STREAM else "small listener"
        reply = self.command(listener, "collect", "collected", topic=topic, count=sent, seconds=LATEST_SECONDS)
        ages: list[int] = reply["ages"]
        return ages

    def _drum(self, part: str, rate: float, seconds: float) -> None:
        topics = list(self.topics[part])
        self.command(f"{part} sender", "drum", "drumming", topics=topics, rate=rate, seconds=seconds)


def measure(source: str, target: str, args: argparse.Namespace) -> list[Row]:
    """Return the rows of one direction."""
    direction = WAYS[source, target]
    ages: dict[tuple[str, bool], list[int]] = defaultdict(list)
    with Flood(source, target, realtime=args.realtime) as flood:
        flood.turn(min(args.seconds, 1.0), flooded=True)  # the first images allocate their memory
        for _ in range(args.turns):
            for flooded in (False, True):
                for topic, received in flood.turn(args.seconds, flooded=flooded).items():
                    ages[topic, flooded] += received
        sent = round(flood.image_rate * (args.seconds + 2)) * args.turns
    rows = []
    for topic in SMALL:
        (p50, p99), (plain50, plain99) = figures(ages[topic, True]), figures(ages[topic, False])
        case = f"{topic} with {FLOW / 1e6:.0f} MB/s, {direction}"
        rows += [
            Row(f"{case}, p50, against no stream", p50, plain50, "us"),
            Row(f"{case}, p99, against no stream", p99, plain99, "us"),
        ]
        arrived = len(ages[topic, True])
        rows.append(Row(f"{case}, arrived of sent", arrived, round(RATE * args.seconds) * args.turns, "msgs", "more"))
    rows.append(Row(f"the stream, {direction}, arrived of sent", len(ages[STREAM, True]), sent, "msgs", "more"))
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    args = _parser().parse_args(arguments)
    logging.basicConfig(level=logging.WARNING)
    pairs = [pair for pair in WAYS if args.way in (None, pair[0])]
    report([row for pair in pairs for row in measure(*pair, args)], args.json)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--way", choices=["ros1", "ros2"], help="only the direction from this side (default both)")
    parser.add_argument("--turns", type=int, default=3, metavar="N", help="turns with and without the stream (3)")
    parser.add_argument("--seconds", type=float, default=6.0, metavar="S", help="length of each turn (6)")
    add_realtime_option(parser)
    add_json_option(parser)
    return parser


if __name__ == "__main__":
    main()
