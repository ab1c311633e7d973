"""``midspan topic pub``: publish on a topic, for whichever side listens."""

from __future__ import annotations

import argparse
import math
import sys
import threading
import time
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from bridge.cli.decode import Types
from bridge.cli.errors import CliError
from bridge.cli.hubclient import Client, add_hub_arguments, open_client
from bridge.cli.text import clean, side_name
from bridge.cli.topic_view import absolute, ask_decisions
from bridge.hub.publisher import HubPublisher
from bridge.hub.qos import Durability, Qos
from bridge.messages.errors import ConversionError
from bridge.messages.json import from_json
from bridge.routing.priority import default_priority

DEFAULT_RATE = 1.0
_MATCH_SECONDS = 2.0
_LINGER_SECONDS = 0.5
"""How long a single message's publisher stays, so that it gets through before it is gone."""


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "pub",
        help="publish messages",
        description="Publishes messages on the hub; they cross to every side as the rules say. The message is checked"
        " against its type; fields that are left out are zero or empty.",
        epilog="Example: midspan topic pub /cmd_vel geometry_msgs/Twist '{linear: {x: 0.2}}' --rate 10",
    )
    parser.add_argument("topic", help="the topic's name")
    parser.add_argument("type", help="its type, as ROS 1 (std_msgs/String) or ROS 2 (std_msgs/msg/String) spells it")
    parser.add_argument("message", nargs="?", default="{}", help="the fields as YAML or JSON, for example '{data: hi}'")
    how = parser.add_mutually_exclusive_group()
    how.add_argument(
        "--rate", type=_rate, metavar="HZ", help=f"publish so often a second until Ctrl-C (default {DEFAULT_RATE:g})"
    )
    how.add_argument("--once", action="store_true", help="publish one message, as soon as somebody listens")
    parser.add_argument("--count", type=int, metavar="N", help="end after so many messages")
    parser.add_argument(
        "--latch",
        action="store_true",
        help="late joiners get the last message (transient local); without --rate one is published, and kept until"
        " Ctrl-C",
    )
    parser.add_argument(
        "--settle", type=float, default=1.0, metavar="SECONDS",
        help="time that listeners on the sides get to connect before the first message (default 1)",
    )  # fmt: skip
    add_hub_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Publish as often as told."""
    topic, fields = absolute(args.topic), yaml_fields(args.message)
    with open_client(args) as client:
        types = Types(client)
        name = types.name(args.type)
        type_hash = types.hash_of(name)
        try:
            cdr = from_json(types.registry, name, fields)
        except ConversionError as err:
            raise CliError(f"{name}: {err}") from None
        client.settle()
        _warn_of_other_types(client, topic, name)
        durability = Durability.TRANSIENT_LOCAL if args.latch else Durability.VOLATILE
        priority = default_priority(topic, name, latched=args.latch)
        qos = Qos(durability=durability, depth=1 if args.latch else 10)
        publisher = client.hub.publisher(topic, name, type_hash, qos, priority=priority.value)
        try:
            _await_listeners(client, publisher, topic, args.settle)
            _publish(args, publisher, cdr)
        except KeyboardInterrupt:
            pass
        finally:
            publisher.close()
    return 0


def _publish(args: argparse.Namespace, publisher: HubPublisher, cdr: bytes) -> None:
    never = threading.Event()
    kept = args.latch and args.rate is None
    count = 1 if args.once or kept else args.count if args.count is not None else math.inf
    period = 1.0 / (args.rate or DEFAULT_RATE)
    due = time.monotonic()
    sent = 0
    while sent < count:
        publisher.put(cdr)
        sent += 1
        due += period
        if sent < count:
            never.wait(max(0.0, due - time.monotonic()))
    if kept and not args.once and args.count is None:
        print("published; kept for late joiners until Ctrl-C", file=sys.stderr)
        never.wait()
    never.wait(_LINGER_SECONDS)


def _await_listeners(client: Client, publisher: HubPublisher, topic: str, settle: float) -> None:
    end = time.monotonic() + _MATCH_SECONDS
    while not publisher.matched() and time.monotonic() < end:
        time.sleep(0.02)
    if publisher.matched():
        # the workers listen; those on their sides are still connecting to the publishers that the workers made
        time.sleep(settle)
    else:
        print(f"nobody listens to {topic} on the hub yet", file=sys.stderr)
    for decision in ask_decisions(client, topic):
        if decision.direction == "out" and decision.decision in ("denied", "private", "refused"):
            why = f"{decision.decision}: {decision.why}"
            print(f"it does not reach {side_name(decision.worker)}: {clean(why)}", file=sys.stderr)


def _warn_of_other_types(client: Client, topic: str, name: str) -> None:
    graph = client.hub.graph
    others = {e.type_name for e in [*graph.publishers(topic), *graph.subscriptions(topic)]} - {name}
    if others:
        print(f"{topic} is {clean(', '.join(sorted(others)))} elsewhere, not {name}", file=sys.stderr)


def yaml_fields(text: str) -> dict[str, Any]:
    """A message's fields from YAML 1.2 or JSON; raises `CliError`."""
    try:
        value = YAML(typ="safe", pure=True).load(text)
    except (RecursionError, TypeError, ValueError, YAMLError) as err:
        raise CliError(f"the message is neither YAML nor JSON: {err}") from None
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise CliError(f"the message must be a map of fields, for example '{{data: hi}}', not {value!r}")
    return value


def _rate(text: str) -> float:
    value = float(text)
    if not 0 < value <= 1000:
        msg = f"{text} is not between 0 and 1000"
        raise argparse.ArgumentTypeError(msg)
    return value
