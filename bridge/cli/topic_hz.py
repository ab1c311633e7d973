"""``midspan topic hz``: how often messages of a topic arrive here."""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections import deque
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

from bridge.cli.console import print_json
from bridge.cli.errors import CliError
from bridge.cli.hubclient import add_hub_arguments, open_client
from bridge.cli.text import size
from bridge.cli.topic_feed import Feed, add_feed_arguments

_REPORT_SECONDS = 1.0


@dataclass(frozen=True, slots=True)
class Rate:
    """Arrivals in a window: their rate, and the times between them in seconds.

    ``messages`` counts all arrivals so far, ``window`` those that the figures are made of.
    """

    topic: str
    messages: int
    window: int
    rate: float
    least: float
    most: float
    deviation: float
    bytes_per_second: float
    lost: int

    def __str__(self) -> str:
        """For people."""
        times = f"between {self.least * 1e3:.1f} and {self.most * 1e3:.1f} ms, deviation {self.deviation * 1e3:.1f} ms"
        lost = f", {self.lost} lost" if self.lost else ""
        return f"{self.rate:.2f} msg/s ({times}, window {self.window}), {size(self.bytes_per_second)}/s{lost}"


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "hz",
        help="measure a topic's rate",
        description="Measures how often messages arrive at this very command, over the hub: all publishers of the topic"
        " together, after the rate limit that a rule may set where they enter the hub. Prints once a second until"
        " Ctrl-C.",
    )
    add_feed_arguments(parser)
    parser.add_argument("--window", type=int, default=1000, metavar="N", help="use the last N messages (default 1000)")
    parser.add_argument("--count", type=int, metavar="N", help="end after so many messages")
    parser.add_argument(
        "--duration", type=float, metavar="SECONDS", help="end after so long; exit code 1 where none came"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    add_hub_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Measure until the count, the duration or Ctrl-C; the last figures are printed at the end."""
    with open_client(args) as client:
        feed = Feed(client, args.topic, args.side, payloads=False)
        meter = _Meter(feed.topic, max(args.window, 2))
        try:
            feed.open(args.duration or 0.0)
            _measure(args, feed, meter)
        except KeyboardInterrupt:
            pass
        finally:
            feed.close()
    if meter.messages == 0:
        raise CliError(f"no message of {feed.topic} came")
    _print(args, meter.rate(feed.lost))
    return 0


class _Meter:
    """Times and sizes of the last arrivals."""

    def __init__(self, topic: str, window: int) -> None:
        self.topic = topic
        self.messages = 0
        self._arrivals: deque[tuple[float, int]] = deque(maxlen=window)

    def add(self, arrived: float, size: int) -> None:
        self.messages += 1
        self._arrivals.append((arrived, size))

    def rate(self, lost: int) -> Rate | None:
        """The figures; None with fewer than two arrivals."""
        if len(self._arrivals) < 2:
            return None
        gaps = [later[0] - earlier[0] for earlier, later in pairwise(self._arrivals)]
        whole = max(self._arrivals[-1][0] - self._arrivals[0][0], 1e-9)
        sizes = sum(size for _, size in self._arrivals) - self._arrivals[0][1]
        return Rate(
            self.topic, self.messages, len(self._arrivals), len(gaps) / whole,
            min(gaps), max(gaps), statistics.pstdev(gaps), sizes / whole, lost,
        )  # fmt: skip


def _measure(args: argparse.Namespace, feed: Feed, meter: _Meter) -> None:
    end = time.monotonic() + args.duration if args.duration is not None else math.inf
    report = time.monotonic() + _REPORT_SECONDS
    while time.monotonic() < end and (args.count is None or meter.messages < args.count):
        arrival = feed.next(min(end, report))
        if arrival is not None:
            meter.add(arrival.arrived, arrival.size)
        if time.monotonic() >= report:
            report += _REPORT_SECONDS
            if meter.messages:
                _print(args, meter.rate(feed.lost))
            elif not args.json:
                print(f"no message of {feed.topic} yet", flush=True)


def _print(args: argparse.Namespace, rate: Rate | None) -> None:
    if rate is None:
        if not args.json:
            print("1 message so far", flush=True)
    elif args.json:
        print_json(asdict(rate), lines=True)
    else:
        print(rate, flush=True)
