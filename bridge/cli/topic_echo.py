"""``midspan topic echo``: the messages of a topic as they come."""

from __future__ import annotations

import argparse
import math
import sys
import time
from typing import Any

from bridge.cli.decode import Types
from bridge.cli.errors import CliError
from bridge.cli.hubclient import add_hub_arguments, open_client
from bridge.cli.text import clean
from bridge.cli.topic_feed import Arrival, Feed, add_feed_arguments
from bridge.cli.yaml_text import json_line, message_text
from bridge.messages.errors import ConversionError


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "echo",
        help="print a topic's messages",
        description="Prints each message of a topic until Ctrl-C; what is latched comes at once. Long arrays and texts"
        " are shortened unless --full is given.",
    )
    add_feed_arguments(parser)
    parser.add_argument("--count", type=int, metavar="N", help="end after so many messages")
    parser.add_argument(
        "--timeout", type=float, metavar="SECONDS",
        help="end with exit code 1 when no message came for so long; also how long to wait for the topic to appear",
    )  # fmt: skip
    parser.add_argument("--full", action="store_true", help="write arrays and texts whole")
    parser.add_argument(
        "--json", action="store_true", help="one JSON object a line: topic, type, side, time_ns, message"
    )
    parser.add_argument("--raw", action="store_true", help="print the bytes (CDR) in hex instead of the fields")
    add_hub_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Print messages until the count, the time-out or Ctrl-C."""
    patience = math.inf if args.timeout is None else args.timeout
    with open_client(args) as client:
        feed, types = Feed(client, args.topic, args.side), Types(client)
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
            _tell_losses(feed)
    return 0


def _text(args: argparse.Namespace, topic: str, types: Types, arrival: Arrival) -> str:
    assert arrival.payload is not None
    cdr = arrival.payload.to_bytes()
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


def _tell_losses(feed: Feed) -> None:
    if feed.overrun:
        print(f"{feed.overrun} messages were not shown: they come faster than they can be printed", file=sys.stderr)
    if feed.lost:
        print(f"{feed.lost} messages were lost on the way", file=sys.stderr)
