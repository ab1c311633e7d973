"""Receives frames for a command."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from bridge.cli.arguments import add_hub_arguments
from bridge.cli.client import open_client
from bridge.client.session import Client
from bridge.client.transforms import TransformListener


def add_tf_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of commands that receive frames."""
    parser.add_argument(
        "--namespace", default="", metavar="NAME", help="use NAME/tf and NAME/tf_static instead of /tf and /tf_static"
    )
    parser.add_argument("--side", metavar="SIDE", help="only from this side: ros1, ros2, zenoh (the hub itself)")
    add_hub_arguments(parser)


@contextmanager
def open_listener(args: argparse.Namespace) -> Iterator[TransformListener]:
    """Join the hub and subscribe; raises `ClientError` if no router answers."""
    with open_client(args, watches=True) as client, listening(client, args.namespace, args.side) as listener:
        yield listener


@contextmanager
def listening(client: Client, namespace: str = "", side: str | None = None) -> Iterator[TransformListener]:
    """Subscribe to the frames; at the end, report problems with them on stderr."""
    listener = TransformListener(client, namespace, side)
    try:
        listener.open()
        yield listener
    finally:
        listener.close()
        for line in listener.troubles():
            print(line, file=sys.stderr)
