"""Many nodes join one side at once, like a fleet's programs after a restart (zenoh-plugin-ros2dds #690)."""
# parameters are named as in the commands of `tests.peers.peer`

from __future__ import annotations

import contextlib
import itertools
import signal
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.peers.daemon.deployment import Deployment
from tests.peers.daemon.midspan import MIDSPAN
from tests.peers.hub.network import ROOT
from tests.peers.peer import Peer
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.processor_share import ProcessorShare, ProcessorShares
from tests.support.wait import until
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.ports.naming import NamingError

pytestmark = [pytest.mark.long, pytest.mark.alone, pytest.mark.timeout(300)]

YARP_PEER = ROOT / "tests" / "peers" / "yarp" / "peer.py"
STRING, TF = "std_msgs/String", "tf2_msgs/TFMessage"
NODES, PUBLISHED, SUBSCRIBED = 13, 8, 7
JOIN, SLOWER, LONGEST = 2.0, 4.0, 8.0
"""Seconds within which all endpoints are created, or else the test is not one of a burst.

On a slower machine this is four times as long as YARP programs need, up to 8 s: those create the same number of
endpoints on a network without Midspan before (`seconds_without_midspan`), where no bridge adds routes meanwhile.
"""

SECONDS = 90.0
"""Seconds within which everything arrives, even if the machine is so busy that links have to be restored."""

PAUSE = 1.0
"""Seconds that /tf may pause longer between two sides than within ROS 1, without Midspan.

This limit and `JOIN` are for an otherwise idle machine; both are divided by the share of the processors that is left
meanwhile. The mean share of a whole test says nothing about a pause of a second or two in it.
"""

FLOOD, ROUNDS = 1000, 4
HEARTBEAT = 3.0
"""Seconds between heartbeats of a ROS 2 program's writers."""


@contextlib.contextmanager
def name_server() -> Iterator[Address]:
    """Run a YARP name server in a separate process."""
    address = Address("127.0.0.1", free_port(room=20))
    command = [*MIDSPAN, "yarp", "server", "--host", address.host, "--port", str(address.port), "--forget"]
    with Process(command):
        until(lambda: responds(NameClient(address)), "the name server responds", every=0.1)
        yield address


def responds(names: NameClient) -> bool:
    try:
        return names.list() is not None
    except NamingError:
        return False


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Deployment, Address]]:
    """A deployment with all sides, and the YARP name server's address."""
    with name_server() as address, Deployment(tmp_path_factory.mktemp("burst")) as deployment:
        endpoint = f"{address.host}:{address.port}"
        deployment.start(yarp={"enabled": True, "nameserver": "site", "address": endpoint})
        yield deployment, address


def yarp_program(address: Address, name: str) -> Peer:
    """Start a YARP program in a separate process, like the other programs."""
    return Peer(YARP_PEER, Path(sys.executable), {"PYTHONPATH": str(ROOT)}, address.host, str(address.port), name)


@pytest.fixture(scope="module")
def seconds_without_midspan() -> float:
    """How long YARP programs take to join a network without Midspan: eight requests for each of 195 ports."""
    with name_server() as address, contextlib.ExitStack() as stack:
        nodes = [stack.enter_context(yarp_program(address, f"/node{number}")) for number in range(NODES)]
        return join(nodes, "/topics")[1]


def join(nodes: list[Peer], topics: str) -> tuple[list[dict[str, Any]], float]:
    """Let all nodes, which run, create their endpoints at once; return their answers and the seconds that it took."""
    for node in nodes:
        node.ask("join", type=STRING, published=[], subscribed=[])  # it answers once it runs
    with ThreadPoolExecutor(len(nodes)) as pool:
        joining = [
            pool.submit(node.ask, "join", type=STRING, published=published, subscribed=subscribed)
            for node, (published, subscribed) in zip(nodes, topics_of(nodes, topics), strict=True)
        ]
        joined = [future.result() for future in joining]
    return joined, max(j["ended"] for j in joined) - min(j["begun"] for j in joined)


def topics_of(nodes: list[Peer], topics: str) -> list[tuple[list[str], list[str]]]:
    """Return the topics that each node publishes and subscribes to."""
    return [
        tuple(
            [f"{topics}/n{at}/{way}{number}" for number in range(n)]
            for way, n in (("out", PUBLISHED), ("in", SUBSCRIBED))
        )
        for at in range(len(nodes))
    ]


class Burst:
    """Nodes that run, and then create all their endpoints at once; each message is its topic's name.

    Attributes:
        begun: when they began (``time.monotonic()``).
        seconds: how long it took, as measured in the nodes, and ``limit``: the longest permitted time.
    """

    def __init__(self, deployment: Deployment, topics: str, nodes: list[Peer], far: Peer) -> None:
        self._deployment, self._nodes, self._far = deployment, nodes, far
        for topic in itertools.chain(*(inward for _, inward in topics_of(nodes, topics))):
            far.publish(far.advertise(topic, STRING, latched=True), {"data": topic})
        share, self.begun = ProcessorShare(), time.monotonic()
        self._joined, self.seconds = join(nodes, topics)
        self.limit = JOIN / share.least()

    def check(self) -> None:
        """Check that every route works."""
        outward = itertools.chain(*(joined["publishers"] for joined in self._joined))
        for topic, end in {topic: self._far.subscribe(topic, STRING, latched=True) for topic in outward}.items():
            assert_received(self._deployment, self._far, end, topic)
        for node, joined in zip(self._nodes, self._joined, strict=True):
            for topic, end in joined["subscriptions"].items():
                assert_received(self._deployment, node, end, topic)


def assert_received(deployment: Deployment, node: Peer, end: int, topic: str) -> None:
    """Check that only the topic's name arrives, and once, unless a restored link repeats latched messages."""
    messages = node.ask("wait", id=end, count=1, seconds=SECONDS)["messages"]
    most = len(messages) if "restored the direct link" in deployment.daemon.output() else 1
    assert messages == [{"data": topic}] * max(1, most)


class Pause(NamedTuple):
    """A time without a message: when it began (``time.monotonic()``), and how long it was."""

    begun: float
    seconds: float


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
        until(lambda: all(answer["last"] > since for answer in self._arrivals(since)), "transforms arrive", every=0.1)

    def pauses(self, since: float) -> tuple[Pause, Pause]:
        """Return the longest pauses since a time, across the bridge and within ROS 1."""
        across, beside = (Pause(answer["begun"], answer["silence"]) for answer in self._arrivals(since))
        return across, beside

    def _arrivals(self, since: float) -> list[dict[str, Any]]:
        ends: list[tuple[Peer, int]] = list(zip((self._across, self._beside), self._ends, strict=True))
        return [peer.ask("silence", id=end, since=since) for peer, end in ends]


@pytest.mark.parametrize("side", ["ros1", "ros2", "yarp", "zenoh"])
def test_all_routes_work_after_a_burst_and_tf_continues(
    site: tuple[Deployment, Address], seconds_without_midspan: float, side: str
) -> None:
    deployment, address = site
    numbers = itertools.count(1)
    try:
        make: dict[str, Callable[[], Peer]] = {
            "ros1": deployment.ros1,
            "ros2": deployment.ros2,
            "zenoh": deployment.rmw,
            "yarp": lambda: deployment.keep(yarp_program(address, f"/burst{next(numbers)}")),
        }
        far = deployment.ros1() if side == "ros2" else deployment.ros2()
        nodes = [make[side]() for _ in range(NODES)]
        transforms = Transforms(deployment)
        with ProcessorShares() as shares:
            burst = Burst(deployment, f"/burst_{side}", nodes, far)
            burst.check()
            transforms.until_arriving(time.monotonic())
            across, beside = transforms.pauses(burst.begun)
            share = shares.during(across.begun, across.begun + across.seconds)
        assert burst.seconds < max(burst.limit, min(SLOWER * seconds_without_midspan, LONGEST))
        assert across.seconds < PAUSE / share + beside.seconds
    finally:
        deployment.stop_programs()


def test_tf_continues_after_the_queue_of_a_ros2_program_was_full(site: tuple[Deployment, Address]) -> None:
    """A ROS 2 program's shared memory holds 512 messages by default, and a reader waits for lost messages."""
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
            share, begun = ProcessorShare(), time.monotonic()
            transforms.until_arriving(begun + HEARTBEAT)
            across, beside = transforms.pauses(begun)
            assert across.seconds < PAUSE / share.least() + beside.seconds
    finally:
        deployment.stop_programs()
