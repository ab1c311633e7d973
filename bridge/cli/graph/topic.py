"""``midspan topic``: list, info, echo, hz and pub on any topic, on whichever side it is."""

from __future__ import annotations

import argparse
import math
import statistics
import sys
import threading
import time
from collections import deque
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

from typing_extensions import override

from bridge.cli.arguments import add_verb, add_verbs, number_in, seconds, span
from bridge.cli.client import open_client, warn_of_refusals
from bridge.cli.graph import listing
from bridge.cli.messages import message_text, yaml_fields
from bridge.cli.output import CliError, json_line, print_json
from bridge.client.feed import Arrival, TopicFeed
from bridge.client.graph import absolute, all_topics, ask_decisions
from bridge.client.publishing import Publisher, await_subscribers, encode
from bridge.client.session import Client
from bridge.client.types import Types
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.errors import ConversionError
from bridge.text import clean, side_name, size
from yarp_compat.interruptible import interruptible


def register(parser: argparse.ArgumentParser) -> None:
    verbs = add_verbs(
        parser,
        "Shows the topics of all sides and publishes on them. It receives bridged topics on the hub; the side's worker"
        " taps the others (private to a side, or denied by a rule).",
    )
    listing.register(verbs, "topic", all_topics)
    _register_echo(verbs)
    _register_hz(verbs)
    _register_pub(verbs)


def add_feed_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of commands that subscribe to one topic."""
    parser.add_argument("topic", help="the topic's name")
    parser.add_argument(
        "--side",
        metavar="SIDE",
        help="only from this side: ros1, ros2, yarp, zenoh (the hub itself), zenoh_ros2dds, zenoh_ros1, zenoh_json",
    )


def _register_echo(verbs: Any) -> None:
    parser = add_verb(
        verbs, "echo", _echo, "print a topic's messages",
        "Prints each message of a topic until Ctrl-C, latched ones at once. Cuts long arrays and texts unless --full.",
    )  # fmt: skip
    add_feed_arguments(parser)
    parser.add_argument("--count", type=int, metavar="N", help="exit after this number of messages")
    parser.add_argument(
        "--timeout", type=seconds, metavar="SECONDS",
        help="exit with code 1 after this time without a message; also limits the wait for the topic",
    )  # fmt: skip
    parser.add_argument("--full", action="store_true", help="print arrays and texts in full")
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object per line: topic, type, side, time_ns, message"
    )
    parser.add_argument("--raw", action="store_true", help="print the bytes (CDR) in hex instead of the fields")


def _echo(args: argparse.Namespace) -> int:
    patience = math.inf if args.timeout is None else args.timeout
    with open_client(args, watches=True) as client:
        feed, types = TopicFeed(client, args.topic, args.side), Types(client)
        shown = 0
        try:
            feed.open(0.0 if args.timeout is None else args.timeout)
            while args.count is None or shown < args.count:
                arrival = feed.next(time.monotonic() + patience)
                if arrival is None:
                    raise CliError(f"no message of {feed.topic} for {args.timeout:g} s")
                print(_text(args, feed.topic, types, arrival), flush=True)
                shown += 1
        except KeyboardInterrupt:
            pass
        finally:
            feed.close()
            _report_losses(feed)
    return 0


def _text(args: argparse.Namespace, topic: str, types: Types, arrival: Arrival) -> str:
    assert arrival.sample is not None
    cdr = arrival.sample.data()
    if args.raw and not args.json:
        return cdr.hex()
    document: dict[str, Any] = {
        "topic": topic, "type": arrival.type_name, "side": arrival.side, "time_ns": arrival.source_time_ns,
    }  # fmt: skip
    if args.raw:
        return json_line({**document, "cdr": cdr.hex()})
    try:
        message = types.decode(arrival.type_name, arrival.type_hash, cdr)
    except ConversionError as err:
        if args.json:
            return json_line({**document, "error": str(err)})
        return f"# {clean(err)}\n---"
    if args.json:
        return json_line({**document, "message": message})
    return f"{message_text(message, full=args.full)}---"


def _report_losses(feed: TopicFeed) -> None:
    if feed.overrun:
        print(f"{feed.overrun} messages were not shown: they arrive faster than they can be printed", file=sys.stderr)
    if feed.lost:
        print(f"{feed.lost} messages were lost on the hub", file=sys.stderr)


DEFAULT_RATE = 1.0
_LINGER_SECONDS = 0.5
"""Seconds for which the publisher stays open after its last message, so that the message is delivered."""


def _register_pub(verbs: Any) -> None:
    parser = add_verb(
        verbs, "pub", _pub, "publish messages",
        "Publishes messages on the hub; the rules decide which sides they reach. Checks the message against its"
        " type; missing fields are zero or empty. Exit code 1 if another machine refuses them (hub.open.trusted).",
        example="midspan topic pub /cmd_vel geometry_msgs/Twist '{linear: {x: 0.2}}' --rate 10",
    )  # fmt: skip
    parser.add_argument("topic", help="the topic's name")
    parser.add_argument("type", help="its type, as ROS 1 (std_msgs/String) or ROS 2 (std_msgs/msg/String) spells it")
    parser.add_argument("message", nargs="?", default="{}", help="the fields as YAML or JSON, for example '{data: hi}'")
    how = parser.add_mutually_exclusive_group()
    how.add_argument(
        "--rate", type=number_in(0, 1000), metavar="HZ", help=f"repeat until Ctrl-C (default {DEFAULT_RATE:g})"
    )
    how.add_argument("--once", action="store_true", help="publish one message, once there is a subscriber")
    parser.add_argument("--count", type=int, metavar="N", help="exit after this number of messages")
    parser.add_argument(
        "--latch", action="store_true",
        help="late joiners receive the last message (transient local); without --rate, publish once and keep it until"
        " Ctrl-C",
    )  # fmt: skip
    parser.add_argument(
        "--settle", type=span, default=1.0, metavar="SECONDS", help="time for subscribers to connect first (default 1)"
    )


def _pub(args: argparse.Namespace) -> int:
    topic, fields = absolute(args.topic), yaml_fields(args.message)
    with open_client(args) as client:
        types = Types(client)
        name = types.name(args.type)
        cdr = encode(types, name, fields)
        client.settle()
        _warn_of_other_types(client, topic, name)
        durability = Durability.TRANSIENT_LOCAL if args.latch else Durability.VOLATILE
        qos = Qos(durability=durability, depth=1 if args.latch else 10)
        publisher = Publisher(client, types, topic, name, qos)
        refused = False
        try:
            if not await_subscribers(publisher.end, args.settle):
                print(f"{topic} has no subscriber on the hub yet", file=sys.stderr)
            _warn_of_sides(client, topic)
            refused = warn_of_refusals(client, [publisher.kind])
            _publish(args, publisher, cdr)
        except KeyboardInterrupt:
            pass
        finally:
            publisher.close()
    return 1 if refused else 0


def _publish(args: argparse.Namespace, publisher: Publisher, cdr: bytes) -> None:
    never = threading.Event()
    kept = args.latch and args.rate is None
    count = 1 if args.once or kept else args.count if args.count is not None else math.inf
    period = 1.0 / (args.rate or DEFAULT_RATE)
    due = time.monotonic()
    sent = 0
    while sent < count:
        publisher.end.put(cdr)
        sent += 1
        due += period
        if sent < count:
            interruptible(never.wait, max(0.0, due - time.monotonic()))
    if kept and not args.once and args.count is None:
        print("published; stored for late joiners until Ctrl-C", file=sys.stderr)
        interruptible(never.wait)
    never.wait(_LINGER_SECONDS)


def _warn_of_sides(client: Client, topic: str) -> None:
    for decision in ask_decisions(client, topic):
        if decision.direction == "out" and decision.decision in ("denied", "private", "refused"):
            reason = f"{decision.decision}: {decision.why}"
            print(f"the messages do not reach {side_name(decision.worker)}: {clean(reason)}", file=sys.stderr)


def _warn_of_other_types(client: Client, topic: str, name: str) -> None:
    used = {e.type_name for e in client.endpoints() if e.topic == topic and e.kind in ("publisher", "subscription")}
    if used and name not in used:
        print(f"{topic} is {clean(', '.join(sorted(used)))} elsewhere, not {name}", file=sys.stderr)


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

    @override
    def __str__(self) -> str:
        times = f"between {self.least * 1e3:.1f} and {self.most * 1e3:.1f} ms, deviation {self.deviation * 1e3:.1f} ms"
        lost = f", {self.lost} lost" if self.lost else ""
        return f"{self.rate:.2f} msg/s ({times}, window {self.window}), {size(self.bytes_per_second)}/s{lost}"


def _register_hz(subparsers: Any) -> None:
    parser = add_verb(
        subparsers, "hz", _hz, "measure a topic's rate",
        "Measures how often messages arrive at this command over the hub: all publishers together, after the rate limit"
        " of a rule. Prints once a second until Ctrl-C.",
    )  # fmt: skip
    add_feed_arguments(parser)
    parser.add_argument("--window", type=int, default=1000, metavar="N", help="use the last N messages (default 1000)")
    parser.add_argument("--count", type=int, metavar="N", help="exit after this number of messages")
    parser.add_argument(
        "--duration", type=seconds, metavar="SECONDS", help="exit after this time; exit code 1 without a message"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object per line")


def _hz(args: argparse.Namespace) -> int:
    """Measure until the count, the duration or Ctrl-C; the last figures are printed at the end."""
    with open_client(args, watches=True) as client:
        feed = TopicFeed(client, args.topic, args.side, payloads=False, option="--duration")
        meter = _Meter(feed.topic, max(args.window, 2))
        try:
            feed.open(args.duration or 0.0)
            _measure(args, feed, meter)
        except KeyboardInterrupt:
            pass
        finally:
            feed.close()
    if meter.messages == 0:
        raise CliError(f"no message of {feed.topic} arrived")
    _print_rate(args, meter.rate(feed.lost))
    return 0


class _Meter:
    def __init__(self, topic: str, window: int) -> None:
        self.topic = topic
        self.messages = 0
        self._arrivals: deque[tuple[float, int]] = deque(maxlen=window)

    def add(self, arrived: float, size: int) -> None:
        self.messages += 1
        self._arrivals.append((arrived, size))

    def rate(self, lost: int) -> Rate | None:
        """Return the figures; None with fewer than two arrivals."""
        if len(self._arrivals) < 2:
            return None
        gaps = [later[0] - earlier[0] for earlier, later in pairwise(self._arrivals)]
        duration = max(self._arrivals[-1][0] - self._arrivals[0][0], 1e-9)
        sizes = sum(size for _, size in self._arrivals) - self._arrivals[0][1]
        return Rate(
            self.topic, self.messages, len(self._arrivals), len(gaps) / duration,
            min(gaps), max(gaps), statistics.pstdev(gaps), sizes / duration, lost,
        )  # fmt: skip


def _measure(args: argparse.Namespace, feed: TopicFeed, meter: _Meter) -> None:
    end = time.monotonic() + args.duration if args.duration is not None else math.inf
    report = time.monotonic() + _REPORT_SECONDS
    while time.monotonic() < end and (args.count is None or meter.messages < args.count):
        arrival = feed.next(min(end, report))
        if arrival is not None:
            meter.add(arrival.arrived, arrival.size)
        if time.monotonic() >= report:
            report += _REPORT_SECONDS
            if meter.messages:
                _print_rate(args, meter.rate(feed.lost))
            elif not args.json:
                print(f"no message of {feed.topic} yet", flush=True)


def _print_rate(args: argparse.Namespace, rate: Rate | None) -> None:
    if rate is None:
        if not args.json:
            print("1 message so far", flush=True)
    elif args.json:
        print_json(asdict(rate), lines=True)
    else:
        print(rate, flush=True)
