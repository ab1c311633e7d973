"""The network between the external listeners of two machines is bad: late messages, recovery, effects on others."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.node import Hub
from bridge.hub.security.certificates import Authority
from bridge.hub.wire.qos import Qos, Reliability
from bridge.messages.registry import Registry
from bridge.routing.edge import MadeBy
from tests.peers.daemon.workers import EngineWorker
from tests.peers.hub.endpoints import HASH, LATCHED, Subscriber, advertise, see_each_other
from tests.peers.hub.network import HubNetwork
from tests.support.faults import FaultProxy
from tests.support.ports import free_port
from tests.support.wait import until

pytestmark = pytest.mark.thorough

TWIST, IMAGE = "geometry_msgs/msg/Twist", "sensor_msgs/msg/Image"
TIMEOUT = 0.3
LATE = 0.6
"""Maximum delay of a delivered command, in seconds: twice the rule's timeout, to allow for a busy machine."""


@dataclass
class Link:
    """A robot whose engine drives a base, an operator's session, and the network between their external listeners."""

    proxy: FaultProxy
    robot: HubNetwork
    engine: EngineWorker
    operator: Hub
    driven: list[tuple[float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        registry = Registry()
        type_hash = registry.ros2(TWIST).type_id
        self.engine.side.read_from("/cmd_vel", TWIST, Qos(), MadeBy.NATIVE, "/base", self._drive)
        qos = Qos(depth=10)
        self.sticks = self.operator.publisher("/cmd_vel", TWIST, type_hash, qos, priority="command")

    def _drive(self, payload: bytes, _source: str, _time: int | None) -> None:
        (stamp,) = struct.unpack_from("<d", payload, 4)
        self.driven.append((stamp, time.monotonic()))

    def command(self, seconds: float) -> None:
        """Send the time as a command, 50 times per second."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.sticks.put(b"\0\1\0\0" + struct.pack("<6d", time.monotonic(), 0, 0, 0, 0, 0))
            time.sleep(0.02)

    def drives(self) -> bool:
        """Return whether commands arrive."""
        before = len(self.driven)
        self.command(0.1)
        return len(self.driven) > before

    def latest(self) -> float:
        """Return the longest delay of a delivered command in seconds."""
        return max(arrived - stamp for stamp, arrived in self.driven)

    def dropped(self) -> int:
        """Return the number of commands that the robot dropped as too old."""
        routes = self.engine.engine.status().routes
        return sum(route.drops["stale"] for route in routes if route.topic == "/cmd_vel")


@pytest.fixture
def link(tmp_path: Path) -> Iterator[Link]:
    authority = Authority(tmp_path)
    authority.make()
    authority.issue("test", ["127.0.0.1"])
    port = free_port()
    keys: dict[str, Any] = {"keys": str(tmp_path), "trusted": ["test"]}
    rules = [{"topic": "/cmd_vel", "type": TWIST, "priority": "command", "timeout": TIMEOUT}]
    with (
        FaultProxy(port) as proxy,
        HubNetwork(external={"listen": [f"tls/127.0.0.1:{port}"], **keys}) as robot,
        HubNetwork(external={"connect": [f"tls/127.0.0.1:{proxy.port}"], **keys}) as operator,
        Hub.open(operator.settings("operator")) as sticks,
    ):
        engine = EngineWorker(robot, Registry(), rules=rules)
        try:
            link = Link(proxy, robot, engine, sticks)
            until(link.drives, "commands arrive")
            yield link
        finally:
            engine.close()


@pytest.mark.alone
def test_commands_from_a_stalled_link_are_not_executed(link: Link) -> None:
    subscription, mouth = Subscriber(link.engine.hub, "/chat"), advertise(link.operator, "/chat")
    until(mouth.matched, "the other topic has a subscriber")
    link.command(0.5)
    for seconds in (0.2, 1.0):
        link.proxy.freeze()
        link.command(seconds)
        mouth.put(b"%g" % seconds)
        link.proxy.thaw()
        until(link.drives, "commands arrive again")
    assert link.latest() < LATE
    assert link.dropped() > 10
    subscription.expect("0.2", "1")


def test_a_lossy_link_delivers_state_but_no_late_commands(link: Link) -> None:
    subscription, mouth = Subscriber(link.engine.hub, "/chat"), advertise(link.operator, "/chat")
    until(mouth.matched, "the other topic has a subscriber")
    link.proxy.loss = 0.05
    texts = [str(number) for number in range(10)]
    for name in texts:
        mouth.put(name.encode())
        link.command(0.2)
    until(lambda: link.proxy.lost or link.command(0.1), "a segment is lost")
    link.proxy.loss = 0.0
    until(link.drives, "commands arrive")
    subscription.expect(*texts)
    assert link.latest() < LATE


def test_a_link_that_becomes_slow_delivers_no_late_commands(link: Link) -> None:
    for delay in (0.0, 0.05, 0.2, 0.5, 0.8):
        link.proxy.delay = delay
        link.command(0.3)
    link.proxy.delay = 0.0
    until(link.drives, "commands arrive again")
    assert link.latest() < LATE
    assert link.dropped()


@pytest.mark.parametrize("direction", ["up", "down"])
def test_a_half_open_connection_is_closed_and_reconnected(link: Link, direction: str) -> None:
    see_each_other(link.engine.hub, link.operator)
    link.proxy.freeze(direction)
    started = time.monotonic()
    deaf = link.engine.hub if direction == "up" else link.operator
    other = link.operator if direction == "up" else link.engine.hub
    until(lambda: other.zid not in {node.zid for node in deaf.graph.nodes()}, "the disconnection is detected")
    noticed = time.monotonic() - started
    link.command(0.5)
    link.proxy.thaw()
    thawed = time.monotonic()
    until(link.drives, "commands arrive again")
    print(f"half-open ({direction}): noticed after {noticed:.1f} s, back {time.monotonic() - thawed:.1f} s after it")
    assert link.latest() < LATE


def test_cut_connections_are_restored_with_all_state(link: Link) -> None:
    advertise(link.engine.hub, "/map", LATCHED, "first")
    subscription = Subscriber(link.operator, "/map", LATCHED)
    subscription.expect("first")
    changing = advertise(link.engine.hub, "/plan", LATCHED, "old")
    plan = Subscriber(link.operator, "/plan", LATCHED)
    plan.expect("old")
    started = time.monotonic()
    for _ in range(3):
        link.proxy.cut()
        changing.put(b"newer")
        until(link.drives, "commands arrive again")
    print(f"cut three times: {time.monotonic() - started:.1f} s")
    changing.put(b"newest")
    until(lambda: plan.texts()[-1] == "newest", "the last state has arrived")
    assert set(subscription.texts()) == {"first"}
    Subscriber(link.operator, "/map", LATCHED).expect("first")
    assert link.latest() < LATE


def test_a_link_cut_again_as_soon_as_it_is_back_delivers_commands(link: Link) -> None:
    """A router of zenoh sends its subscriptions again only if it has noticed the loss before the link is back."""
    map_ = advertise(link.engine.hub, "/map", LATCHED, "first")
    for _ in range(3):
        link.proxy.cut()
        link.driven.clear()
        until(lambda: link.command(0.02) or link.driven, "a command arrives", 10)
    link.proxy.cut()
    until(link.drives, "commands arrive again", 10)
    Subscriber(link.operator, "/map", LATCHED).expect("first")
    map_.put(b"second")
    Subscriber(link.operator, "/map", LATCHED).expect("second")
    assert link.latest() < LATE


@pytest.mark.alone
def test_a_slow_link_does_not_delay_other_subscribers(link: Link) -> None:
    """The link carries 50 kB/s of a 3 MB/s stream: local subscribers receive all of it, and commands stay fresh."""
    qos = Qos(Reliability.RELIABLE, depth=5)
    arrived: list[float] = []

    def on_sample(sample: HubSample) -> None:
        arrived.append(time.monotonic() - struct.unpack_from("<d", sample.payload.to_bytes())[0])

    far: list[HubSample] = []
    with Hub.open(link.robot.settings("local")) as local:
        local.subscription("/image", IMAGE, HASH, qos, on_sample)
        link.operator.subscription("/image", IMAGE, HASH, qos, far.append)
        camera = link.engine.hub.publisher("/image", IMAGE, HASH, qos)
        see_each_other(local, link.engine.hub, link.operator)
        until(camera.matched, "the image has a subscriber")
        link.proxy.rate = 50e3
        longest, end = 0.0, time.monotonic() + 2
        sent = 0
        while time.monotonic() < end:
            before = time.monotonic()
            camera.put(struct.pack("<d", before) + bytes(100_000))
            longest = max(longest, time.monotonic() - before)
            sent += 1
            link.command(0.02)
        until(lambda: len(arrived) == sent, "everything arrives on this machine")
        link.proxy.rate = None
    arrived.sort()
    print(
        f"slow link: put took up to {longest * 1e3:.1f} ms, here {arrived[len(arrived) // 2] * 1e3:.1f} ms (median), "
        f"{len(far)} of {sent} got to the other machine"
    )
    assert arrived[len(arrived) // 2] < 0.1
    assert link.latest() < LATE
    assert len(far) < sent
    until(link.drives, "commands arrive")


def test_state_arrives_over_a_slow_link(link: Link) -> None:
    link.proxy.rate = 200e3
    big = advertise(link.engine.hub, "/map", LATCHED)
    big.put(b"m" * 400_000)
    subscription = Subscriber(link.operator, "/map", LATCHED)
    until(lambda: subscription.texts() == ["m" * 400_000], "the map arrives", 30)
