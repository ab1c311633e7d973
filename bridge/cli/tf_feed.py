"""The frames that a verb hears: a buffer of its own, filled from the two topics of transforms."""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from bridge.cli.errors import CliError
from bridge.cli.hubclient import Client, add_hub_arguments, open_client
from bridge.cli.text import clean, side_name
from bridge.cli.tf_meter import Meter
from bridge.cli.topic_feed import Feed
from bridge.cli.topic_view import absolute
from bridge.clock import RunClock
from bridge.hub.clock import follow
from bridge.hub.subscription import HubSample
from bridge.tf.buffer import TransformBuffer
from bridge.tf.stamped import TF, TF_STATIC, TF_TYPE, read

PATIENCE = 5.0
"""Seconds within which the first transform is to come."""

_LOOK_SECONDS = 0.5
_FIRST_LOOK_SECONDS = 0.05


class TransformFeed(Feed):
    """One topic's transforms, which go into a buffer; see `Heard`."""

    def __init__(self, heard: Heard, topic: str, *, static: bool, side: str | None) -> None:
        super().__init__(heard.client, topic, side)
        self._heard, self._static = heard, static

    def take(self, sample: HubSample, type_name: str, type_hash: str, side: str) -> None:  # noqa: ARG002
        """Take up a message, on a thread of zenoh."""
        if type_name == TF_TYPE:
            self._heard.take(sample, side, static=self._static)


class Heard:
    """All that was heard of frames since the verb began. Safe to use from any thread.

    Args:
        client: the session on the hub.
        namespace: of the topics: `/robot` for `/robot/tf`.
        side: only what comes from this side.

    Attributes:
        buffer: the frames.
        clock: the run's time.
    """

    def __init__(self, client: Client, namespace: str = "", side: str | None = None) -> None:
        self.client = client
        self.buffer = TransformBuffer()
        self.clock = RunClock(simulated=client.config.clock.simulated)
        self._meters: dict[str, Meter] = {}
        self._authorities: dict[bytes, str] = {}
        self._lock = threading.Lock()
        self._bad = ""
        namespace = absolute(namespace).rstrip("/") if namespace else ""
        self._feeds = [
            TransformFeed(self, namespace + TF, static=False, side=side),
            TransformFeed(self, namespace + TF_STATIC, static=True, side=side),
        ]

    def open(self) -> None:
        """Begin to hear."""
        follow(self.clock, self.client.hub)
        self.client.settle()
        self.look()

    def listen(self, seconds: float) -> None:
        """Hear for so long."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            time.sleep(min(left, _LOOK_SECONDS))
            self.look()

    def look(self) -> None:
        """Take up publishers that came."""
        for feed in self._feeds:
            feed.look()

    def take(self, sample: HubSample, side: str, *, static: bool) -> None:
        """Take up a message."""
        cdr, now = sample.data(), self.clock.now_ns()
        authority = self._authority(sample.gid, side)
        try:
            self.buffer.set_message(cdr, authority, static=static)
        except ValueError as err:
            self._bad = f"{authority}: {err}"
            return
        arrived = time.monotonic()
        with self._lock:
            for transform in read(cdr):
                name = transform.child_frame_id.lstrip("/")
                meter = self._meters.get(name)
                if meter is None:
                    meter = self._meters[name] = Meter()
                meter.add(arrived, None if static else now - transform.stamp)

    def meters(self) -> dict[str, Meter]:
        """What was counted of each frame, by its name."""
        with self._lock:
            return {name: meter.copy() for name, meter in self._meters.items()}

    def wait(self) -> None:
        """Wait for the first transform; raises `CliError` where none comes."""
        end = time.monotonic() + PATIENCE
        while not self.buffer.changes:
            if time.monotonic() > end:
                raise CliError(self._nothing())
            self.listen(_FIRST_LOOK_SECONDS)

    def close(self) -> None:
        """Hear no more, and tell what was wrong."""
        for feed in self._feeds:
            feed.close()
        if refused := self.buffer.refused:  # the first of each kind was logged in words
            print("refused: " + ", ".join(f"{why} {count}" for why, count in refused.items()), file=sys.stderr)
        if self._bad:
            print(clean(self._bad), file=sys.stderr)
        if lost := sum(feed.lost for feed in self._feeds):
            print(f"{lost} messages were lost on the way", file=sys.stderr)

    def _nothing(self) -> str:
        topics = [feed.topic for feed in self._feeds]
        publishers = self.client.hub.graph.publishers()
        others = {e.topic for e in publishers if e.type_name == TF_TYPE and not e.own}.difference(topics)
        hint = f"; there is {clean(', '.join(sorted(others)))}: see --namespace" if others else ""
        return f"no transform came on {' or '.join(topics)} for {PATIENCE:g} s{hint}"

    def _authority(self, gid: bytes, side: str) -> str:
        """Who published: a node of the hub, or the side that a bridge worker speaks for."""
        known = self._authorities.get(gid)
        if known is None:
            endpoint = self.client.hub.graph.endpoint(gid)
            if endpoint is None:
                return side_name(side)
            origin = endpoint.origin
            node = f"{endpoint.namespace.rstrip('/')}/{endpoint.node}"
            known = node if origin is None else f"{side_name(origin.side)} by {origin.daemon}"
            self._authorities[gid] = known
        return known


def add_tf_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments by which every verb finds the frames."""
    parser.add_argument(
        "--namespace", default="", metavar="NAME", help="hear NAME/tf and NAME/tf_static instead of /tf and /tf_static"
    )
    parser.add_argument(
        "--side", metavar="SIDE", help="only what comes from this side: ros1, ros2, zenoh (made on the hub itself)"
    )
    add_hub_arguments(parser)


@contextmanager
def open_heard(args: argparse.Namespace) -> Iterator[Heard]:
    """Join the hub and begin to hear; raises `CliError` where no router answers."""
    with open_client(args) as client:
        heard = Heard(client, args.namespace, args.side)
        try:
            heard.open()
            yield heard
        finally:
            heard.close()
