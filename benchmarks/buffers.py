"""What a publisher of images on Lyrical's rmw_zenoh pays for a subscription of Midspan.

Midspan joins the group of subscriptions that share one message in memory of the CPU (`bridge.hub.wire.buffers`), so
the peer is a second subscription of Lyrical in the group. The subscriptions are in separate processes. The publisher
only publishes bytes, so the figures do not contain what the real one pays for serializing, which is once for the group.
"""

from __future__ import annotations

import argparse
import multiprocessing
import statistics
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from multiprocessing.connection import Connection
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.rows import Row, add_json_option, report
from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry
from tests.peers.hub.network import HubNetwork
from tests.peers.zenoh.releases import LYRICAL, Received, ReleaseNode, ReleasePublisher, ReleaseSubscription, Topic
from tests.support.wait import until

IMAGE = "sensor_msgs/msg/Image"
BYTES = 1_000_000
LINK_SECONDS = 2.0
"""Time in which direct links replace those over the router; zenoh may drop a message meanwhile."""

SECONDS = 30.0


def image_topic() -> Topic:
    """Return the topic."""
    return Topic("/image", IMAGE, Registry().ros2(IMAGE).type_id, Qos(depth=10), array=True)


def subscribe(kind: str, settings: HubSettings, answers: Connection) -> None:
    """Subscribe, and report the size of each message, until ``answers`` is closed at the other end."""
    if kind == "midspan":
        hub, topic = Hub.open(settings), image_topic()
        hub.subscription(
            topic.name, IMAGE, topic.type_hash, topic.qos, lambda sample: answers.send(len(sample.payload))
        )
    else:
        assert settings.router is not None
        node = ReleaseNode(settings.router, settings.domain, kind, LYRICAL)
        subscription = ReleaseSubscription(node, image_topic())
        subscription.samples = _Sizes(answers)  # type: ignore[assignment]
    try:
        answers.recv()
    except EOFError:
        return


class _Sizes:
    """In place of a subscription's list of messages: sends their sizes."""

    def __init__(self, answers: Connection) -> None:
        self._answers = answers

    def append(self, sample: Received) -> None:
        """Send the size of a message."""
        self._answers.send(len(sample.payload))


def processor_time(hubs: HubNetwork, kinds: Sequence[str], images: int) -> float:
    """Return the publisher's milliseconds of processor time for an image that all subscriptions receive."""
    context = multiprocessing.get_context("spawn")
    with ExitStack() as stack:
        ends: list[Connection] = []
        for number, kind in enumerate(kinds):
            own, other = context.Pipe()
            process = context.Process(
                target=subscribe, args=(kind, hubs.settings(f"{kind}{number}"), other), daemon=True
            )
            process.start()
            stack.callback(process.terminate)
            ends.append(own)
        node = ReleaseNode(hubs.endpoint, hubs.domain, "camera", LYRICAL)
        stack.callback(node.close)
        publisher, payload = ReleasePublisher(node, image_topic()), b"\0\1\0\0" + bytes(BYTES)
        _connect(publisher, ends)
        began = time.process_time()
        for _ in range(images):
            publisher.put(payload)
            for end in ends:
                if not end.poll(SECONDS):
                    raise SystemExit(f"an image did not arrive within {SECONDS:g} s")
                end.recv()
        return (time.process_time() - began) / images * 1000


def _connect(publisher: ReleasePublisher, ends: Sequence[Connection]) -> None:
    """Publish until each subscription receives, and until all of these messages have arrived."""

    def received() -> bool:
        publisher.put(b"\0\1\0\0first")
        return all(end.poll() for end in ends)

    until(received, "messages arrive", every=0.2)
    time.sleep(LINK_SECONDS)
    for end in ends:
        while end.poll():
            end.recv()


def measure(images: int, rounds: int) -> list[Row]:
    """Measure in turns; return the medians."""
    cases = {
        "one": ["lyrical"],
        "midspan": ["lyrical", "midspan"],
        "lyrical": ["lyrical"] * 2,
    }
    found: dict[str, list[float]] = {name: [] for name in cases}
    with HubNetwork() as hubs:
        for _ in range(rounds):
            for name, kinds in cases.items():
                found[name].append(processor_time(hubs, kinds, images))
    cost = {name: statistics.median(values) for name, values in found.items()}
    ours, words = cost["midspan"], "1 MB: Lyrical's subscription and Midspan's"
    return [
        Row(f"{words}; only Lyrical's", ours, cost["one"], "ms"),
        Row(f"{words}; two of Lyrical", ours, cost["lyrical"], "ms"),
    ]


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=200, metavar="N", help="images of each round (default: 200)")
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="rounds of each case (default: 5)")
    add_json_option(parser)
    options = parser.parse_args()
    report(measure(options.images, options.rounds), options.json)


if __name__ == "__main__":
    main()
