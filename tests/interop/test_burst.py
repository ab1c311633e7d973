"""Many nodes join one side at once, like a fleet's programs after a restart (zenoh-plugin-ros2dds #690)."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.contract.side import CUSTOM_FOLDER, PeerLike
from tests.peers.daemon.deployment import Deployment
from tests.peers.peer import Peer
from tests.peers.yarp.programs import Definitions, Names, YarpProgram
from tests.support.wait import until

pytestmark = [pytest.mark.long, pytest.mark.alone, pytest.mark.timeout(300)]

STRING, TF = "std_msgs/String", "tf2_msgs/TFMessage"
NODES, PUBLISHED, SUBSCRIBED = 13, 8, 7
SECONDS = 90.0
"""Seconds within which everything arrives, even if the machine is so busy that links have to be restored."""

PAUSE = 1.0
"""Seconds that /tf may pause between two sides."""

FLOOD, ROUNDS = 1000, 4
HEARTBEAT = 3.0
"""Seconds between heartbeats of a ROS 2 program's writers."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Deployment, Names]]:
    """A deployment with all sides."""
    names = Names()
    try:
        with Deployment(tmp_path_factory.mktemp("burst")) as deployment:
            deployment.start(yarp={"enabled": True, "nameserver": "site", "address": names.endpoint, "poll": 0.1})
            yield deployment, names
    finally:
        names.stop()


@dataclass
class Joined:
    """One node of the burst: the topics that it publishes, and its subscriptions by topic."""

    node: PeerLike
    published: list[str]
    subscriptions: dict[str, int]


def join(make: Callable[[], Any], topics: str) -> Joined:
    """Start a node with all its endpoints; each message is its topic's name."""
    node = make()
    published = [f"{topics}/out{number}" for number in range(PUBLISHED)]
    for topic in published:
        node.publish(node.advertise(topic, STRING, latched=True), {"data": topic})
    inwards = [f"{topics}/in{number}" for number in range(SUBSCRIBED)]
    return Joined(node, published, {topic: node.subscribe(topic, STRING, latched=True) for topic in inwards})


def assert_received(deployment: Deployment, node: PeerLike, end: int, topic: str) -> None:
    """Check that only the topic's name arrives, and once, unless a restored link repeats latched messages."""
    messages = node.wait(end, 1, SECONDS)
    most = len(messages) if "restored the direct link" in deployment.daemon.output() else 1
    assert messages == [{"data": topic}] * max(1, most)


class Transforms:
    """``/tf`` from a rospy to an rclpy program, and to another rospy program to measure pauses of the machine."""

    def __init__(self, site: Deployment) -> None:
        self._sender, self._across, self._beside = site.ros1(), site.ros2(), site.ros1()
        self._ends = self._across.subscribe("/tf", TF, depth=1000), self._beside.subscribe("/tf", TF)
        self._id = self._sender.advertise("/tf", TF)
        self._sender.ask("broadcast", id=self._id, child="base_link", rate=50)
        self.until_arriving(time.monotonic())

    @property
    def across(self) -> Peer:
        """The rclpy program that receives the transforms."""
        return self._across

    def until_arriving(self, since: float) -> None:
        """Wait until transforms that were sent after ``since`` arrive."""
        until(lambda: all(last > since for last, _ in self._arrivals(since)), "transforms arrive", every=0.1)

    def pauses(self, since: float) -> tuple[float, float]:
        """Return the longest pauses since a time, across the bridge and within ROS 1."""
        (_, across), (_, beside) = self._arrivals(since)
        return across, beside

    def _arrivals(self, since: float) -> list[tuple[float, float]]:
        ends: list[tuple[Peer, int]] = list(zip((self._across, self._beside), self._ends, strict=True))
        answers = [peer.ask("silence", id=end, since=since) for peer, end in ends]
        return [(answer["last"], answer["silence"]) for answer in answers]


@pytest.mark.parametrize("side", ["ros1", "ros2", "yarp", "zenoh"])
def test_all_routes_work_after_a_burst_and_tf_continues(
    site: tuple[Deployment, Names], tmp_path: Path, side: str
) -> None:
    deployment, names = site
    try:
        make: dict[str, Callable[[], Any]] = {
            "ros1": deployment.ros1,
            "ros2": deployment.ros2,
            "zenoh": deployment.rmw,
            "yarp": lambda: deployment.keep(YarpProgram(names, "/burst", Definitions((CUSTOM_FOLDER,)))),
        }
        transforms = Transforms(deployment)
        far = deployment.ros1() if side == "ros2" else deployment.ros2()
        topics = [f"/burst_{side}/n{number}" for number in range(NODES)]
        for topic in (f"{item}/in{number}" for item in topics for number in range(SUBSCRIBED)):
            far.publish(far.advertise(topic, STRING, latched=True), {"data": topic})
        begun = time.monotonic()
        with ThreadPoolExecutor(NODES) as pool:
            nodes = list(pool.map(lambda topic: join(make[side], topic), topics))
        ends = {t: far.subscribe(t, STRING, latched=True) for node in nodes for t in node.published}
        for topic, end in ends.items():
            assert_received(deployment, far, end, topic)
        for node in nodes:
            for topic, end in node.subscriptions.items():
                assert_received(deployment, node.node, end, topic)
        transforms.until_arriving(time.monotonic())
        across, beside = transforms.pauses(begun)
        assert across < PAUSE + beside
    finally:
        deployment.stop_programs()


def test_tf_continues_after_the_queue_of_a_ros2_program_was_full(site: tuple[Deployment, Names]) -> None:
    """A ROS 2 program's shared memory holds 512 messages by default, and a reader waits for those that are lost."""
    deployment, _ = site
    try:
        transforms, sender, other = Transforms(deployment), deployment.ros1(), deployment.ros2()
        flood = sender.advertise("/flood", STRING)
        ends = [(node, node.subscribe("/flood", STRING, depth=FLOOD)) for node in (transforms.across, other)]

        def received(node: Peer, end: int) -> int:
            sender.publish(flood, {"data": "0"})
            return int(node.ask("tally", id=end)["distinct"])

        until(lambda: all(received(*end) for end in ends), "the flood's topic crosses", every=0.1)
        for number in range(ROUNDS):
            transforms.across.signal(signal.SIGSTOP)
            sender.ask("count", id=flood, first=1 + number * FLOOD, count=FLOOD, rate=2000)
            sender.ask("counted", id=flood)
            until(lambda: received(*ends[1]) > (number + 1) * FLOOD, "the flood has crossed", every=0.1)  # noqa: B023
            transforms.across.signal(signal.SIGCONT)
            begun = time.monotonic()
            transforms.until_arriving(begun + HEARTBEAT)
            across, beside = transforms.pauses(begun)
            assert across < PAUSE + beside
    finally:
        deployment.stop_programs()
