"""Topic routes: held messages, retained state, pauses, counters and errors."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest
import zenoh

from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import EndpointKind
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion, SideType
from bridge.routing import hub_end
from bridge.routing.counters import Counters
from bridge.routing.decision import RouteKey
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.edge import Endpoint, Kind, MadeBy
from bridge.routing.hub_to_side import HubToSideRoute
from bridge.routing.limits import Priority
from bridge.routing.peer_watch import Lease
from bridge.routing.route import EngineContext
from bridge.routing.rules import RoutePolicy
from bridge.routing.side_publishers import MAX_INVENTED, SidePublishers
from bridge.routing.side_to_hub import SideToHubRoute
from bridge.routing.stall import StallDetector
from tests.peers.fake import FakeEdge, FakeNetwork
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until


def test_urgent_work_goes_first() -> None:
    dispatcher = Dispatcher("test")
    done: list[str] = []
    dispatcher.submit(Priority.STREAM, lambda: done.append("stream"))
    dispatcher.submit(Priority.STATE, lambda: done.append("state"))
    dispatcher.submit(Priority.COMMAND, lambda: done.append("command"))
    dispatcher.start()
    try:
        until(lambda: len(done) == 3, "all work is done")
        assert done == ["command", "state", "stream"]
    finally:
        dispatcher.stop()


STRING = "std_msgs/msg/String"
GID = b"g" * 16


def line(text: str) -> bytes:
    return b"\0\1\0\0" + (len(text) + 1).to_bytes(4, "little") + text.encode() + b"\0"


@pytest.mark.parametrize("latched", [True, False])
@pytest.mark.parametrize("standby", [True, False])
def test_messages_of_an_unknown_publisher_are_bridged_once_it_is_known(latched: bool, standby: bool) -> None:
    registry, network = Registry(), FakeNetwork()
    type_ = registry.ros2(STRING)
    durability = Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE
    qos = Qos(Reliability.RELIABLE, durability, depth=1)
    endpoint = HubEndpoint(
        "z", "n", "/", EndpointKind.PUBLISHER, "/state", STRING, type_.type_id, qos, GID, None, pending=False, own=False
    )
    native = replace(endpoint, zid="y", gid=b"n" * 16)
    with HubNetwork() as hubs, Hub.open(hubs.settings("waiting")) as hub:
        idle, lease = Dispatcher("idle"), Lease()
        lease.extend(-math.inf if standby else math.inf)
        context = EngineContext(
            hub, FakeEdge(network, registry), StallDetector(), lease, cast("Any", None), idle, idle, lambda: None
        )
        policy = RoutePolicy(allowed=True, why="", name="/state")
        route = HubToSideRoute(
            RouteKey("/state", STRING, type_.type_id), "/state", None, Conversion(type_, type_, None), policy, context
        )
        route.update(*([native, endpoint], []) if standby else ([native], [], [endpoint]))
        for number, text in enumerate(("old", "new"), 1):
            route.handle(HubSample(zenoh.ZBytes(line(text)), number, number, GID, "z"))
        assert route.counters.messages == 0
        lease.extend(math.inf)
        route.update([native, endpoint], [])
        assert route.counters.messages == (1 if latched else 0)
        assert network.retained() == ([line("new")] if latched else [])
        route.update([native, endpoint], [])
        assert route.counters.messages == (1 if latched else 0), "bridged only once"
        route.close()


@pytest.mark.parametrize("latched", [True, False])
def test_state_received_without_a_lease_is_bridged_with_the_next_lease(latched: bool) -> None:
    registry, topic = Registry(), "/state"
    type_ = registry.ros2(STRING)
    conversion, policy = Conversion(type_, type_, None), RoutePolicy(allowed=True, why="", name=topic)
    qos = Qos(durability=Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE, depth=1)
    publishers = [Endpoint("known", Kind.PUBLISHER, topic, STRING, qos, MadeBy.NATIVE)]
    with HubNetwork() as hubs, Hub.open(hubs.settings("leased")) as hub:
        idle, lease = Dispatcher("idle"), Lease()
        lease.extend(math.inf)
        context = EngineContext(
            hub, FakeEdge(FakeNetwork(), registry), StallDetector(), lease, cast("Any", None), idle, idle, lambda: None
        )
        route = SideToHubRoute(RouteKey(topic, STRING, type_.type_id), topic, conversion, policy, context)
        route.update(publishers)
        lease.end()
        for text in ("old", "new"):
            route.deliver(line(text), "known", None)
        route.update(publishers)
        assert route.counters.messages == 0
        lease.extend(math.inf)
        route.update(publishers)
        assert route.counters.messages == (1 if latched else 0), "only the newest latched message is bridged, once"
        assert route.counters.drops["standby"] == (1 if latched else 2)
        route.close()


@pytest.mark.parametrize("count", [0, 200])
def test_fast_stream_is_unsubscribed_ten_seconds_after_its_last_subscriber(
    monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    now = [100.0]
    monkeypatch.setattr(hub_end, "time", SimpleNamespace(monotonic=lambda: now[0]))
    registry, network, topic = Registry(), FakeNetwork(), "/stream"
    type_ = registry.ros2(STRING)
    publisher = HubEndpoint(
        "z", "n", "/", EndpointKind.PUBLISHER, topic, STRING, type_.type_id, Qos(), GID, None, pending=False, own=False
    )
    with HubNetwork() as hubs, Hub.open(hubs.settings("stream")) as hub:
        idle, lease = Dispatcher("idle"), Lease()
        lease.extend(math.inf)
        context = EngineContext(
            hub, FakeEdge(network, registry), StallDetector(), lease, cast("Any", None), idle, idle, lambda: None
        )
        policy = RoutePolicy(allowed=True, why="", name=topic)
        key, conversion = RouteKey(topic, STRING, type_.type_id), Conversion(type_, type_, None)
        route = HubToSideRoute(key, topic, None, conversion, policy, context)

        def state_after(seconds: float) -> object:
            now[0] += seconds
            for number in range(count):
                route.handle(HubSample(zenoh.ZBytes(line("x")), number + 1, 1, GID, "z"))
            route.update([publisher], [])
            return route.status().state

        listener = network.read_from(topic, STRING, Qos(), MadeBy.NATIVE, "/listener", lambda *_: None)
        assert [state_after(0.1), state_after(30.0)] == ["active", "active"], "there is a subscriber"
        network.remove(listener)
        assert [state_after(30.0), state_after(9.0)] == ["active", "active"], (
            "the ten seconds begin at the first check without a listener"
        )
        assert state_after(2.0) == ("unheard" if count else "active")
        network.read_from(topic, STRING, Qos(), MadeBy.NATIVE, "/listener", lambda *_: None)
        assert state_after(0.1) == "active"
        route.close()


def hub_publisher(topic: str, type_hash: str, qos: Qos) -> HubEndpoint:
    """Return a native publisher of strings on the hub."""
    place, name = ("z", "n", "/", EndpointKind.PUBLISHER), (topic, STRING, type_hash)
    return HubEndpoint(*place, *name, qos, GID, None, pending=False, own=False)


class LatchedRoute:
    """A route from two latched publishers on the hub; its hub subscription is disabled."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        registry, self.network, self.wakes = Registry(), FakeNetwork(), 0
        type_, topic = registry.ros2(STRING), "/state"
        qos = Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL, depth=1)
        self.publisher = hub_publisher(topic, type_.type_id, qos)
        self.other = replace(self.publisher, zid="y", gid=b"n" * 16)
        idle, lease = Dispatcher("idle"), Lease()
        self.lease = lease
        lease.extend(math.inf)
        hub = cast("Hub", SimpleNamespace(max_payload=1000))
        context = EngineContext(
            hub, FakeEdge(self.network, registry), StallDetector(), lease, cast("Any", None), idle, idle, self._wake
        )
        monkeypatch.setattr(HubToSideRoute, "_receive_from", lambda *_: None)
        self.route = HubToSideRoute(
            RouteKey(topic, STRING, type_.type_id), topic, None, Conversion(type_, type_, self.convert),
            RoutePolicy(allowed=True, why="", name=topic), context,
        )  # fmt: skip
        self.during_conversion: Callable[[], object] = lambda: None

    def _wake(self) -> None:
        self.wakes += 1

    def convert(self, data: bytes) -> bytes:
        self.during_conversion()
        return data

    def receive(self, text: str) -> None:
        self.route.queue.receive(HubSample(zenoh.ZBytes(line(text)), 1, 1, GID, "z"))


def test_message_of_a_publisher_that_leaves_during_its_conversion_is_not_retained(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    latched = LatchedRoute(monkeypatch)
    latched.route.update([latched.publisher, latched.other], [])
    latched.receive("first")
    assert latched.network.retained() == [line("first")]
    latched.during_conversion = lambda: latched.route.update([latched.other], [])
    latched.receive("last")
    assert latched.network.retained() == []


def test_message_with_an_invented_gid_is_retained_until_its_publisher_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    """As from zenoh-ros2-sdk, whose GIDs are not those of its tokens."""
    latched = LatchedRoute(monkeypatch)
    latched.route.update([latched.publisher, latched.other], [])
    latched.route.queue.receive(HubSample(zenoh.ZBytes(line("map")), 0, 1, b"i" * 16, latched.publisher.zid))
    assert latched.network.retained() == [line("map")]
    latched.route.update([latched.other], [])
    assert latched.network.retained() == []


def test_messages_with_many_invented_gids_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    latched = LatchedRoute(monkeypatch)
    latched.route.update([latched.publisher], [])
    for number in range(MAX_INVENTED + 2):
        gid = number.to_bytes(16, "big")
        latched.route.queue.receive(HubSample(zenoh.ZBytes(line(str(number))), number, 1, gid, latched.publisher.zid))
    retained = latched.network.retained()
    assert len(retained) <= MAX_INVENTED
    assert line(str(MAX_INVENTED + 1)) in retained
    assert line("0") not in retained


def test_a_message_before_its_publisher_is_known_stays_with_that_publisher(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until its token arrives, the message counts as that of another publisher of the same session."""
    latched = LatchedRoute(monkeypatch)
    second = replace(latched.publisher, gid=b"2" * 16)
    latched.route.update([latched.publisher], [])
    latched.receive("first")
    latched.route.queue.receive(HubSample(zenoh.ZBytes(line("second")), 1, 1, second.gid, second.zid))
    latched.route.update([latched.publisher, second], [])
    latched.route.update([second], [])
    assert latched.network.retained() == [line("second")]


def test_stored_message_does_not_replace_a_newer_one(monkeypatch: pytest.MonkeyPatch) -> None:
    latched = LatchedRoute(monkeypatch)
    latched.route.update([latched.other], [], [latched.publisher])
    latched.receive("old")
    monkeypatch.setattr(latched.route, "_follow_demand", lambda _: latched.receive("new"))
    latched.route.update([latched.other, latched.publisher], [])
    assert latched.network.retained() == [line("new")]


def test_message_stored_without_a_lease_does_not_replace_a_newer_one(monkeypatch: pytest.MonkeyPatch) -> None:
    latched = LatchedRoute(monkeypatch)
    endpoints = [latched.other, latched.publisher]
    latched.route.update(endpoints, [])
    latched.lease.end()
    latched.receive("oldest")
    latched.receive("old")
    assert latched.wakes == 0, "no wake-up: without a lease, a check could not publish the message"
    latched.lease.extend(math.inf)
    latched.receive("new")
    assert latched.wakes == 1, "a check is due"
    latched.route.update(endpoints, [])
    assert latched.network.retained() == [line("new")]
    latched.receive("newest")
    assert latched.network.retained() == [line("newest")]


def test_message_stored_while_its_publisher_becomes_allowed_is_published(monkeypatch: pytest.MonkeyPatch) -> None:
    latched = LatchedRoute(monkeypatch)
    route, endpoints = latched.route, [latched.other, latched.publisher]
    route.update([latched.other], [], [latched.publisher])
    keep = route.held.latched.keep
    monkeypatch.setattr(route.held.latched, "keep", lambda *message: (route.update(endpoints, []), keep(*message)))
    latched.receive("only")
    assert latched.wakes == 1, "a check is due"
    route.update(endpoints, [])
    assert latched.network.retained() == [line("only")]


class FailingOnce:
    """A hub whose second subscription fails."""

    max_payload = 1000

    def __init__(self) -> None:
        self.subscriptions = 0

    def subscription(self, *_: object) -> SimpleNamespace:
        self.subscriptions += 1
        if self.subscriptions == 2:
            raise OSError("no room")
        return SimpleNamespace(close=lambda: None, lost=0, by_lane=0, hand_to=lambda _: None)


def test_paused_stream_is_subscribed_again_after_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    now, hub = [100.0], FailingOnce()
    monkeypatch.setattr(hub_end, "time", SimpleNamespace(monotonic=lambda: now[0]))
    registry, network, topic = Registry(), FakeNetwork(), "/stream"
    type_ = registry.ros2(STRING)
    publisher = HubEndpoint(
        "z", "n", "/", EndpointKind.PUBLISHER, topic, STRING, type_.type_id, Qos(), GID, None, pending=False, own=False
    )
    idle, lease = Dispatcher("idle"), Lease()
    lease.extend(math.inf)
    context = EngineContext(
        cast("Hub", hub),
        FakeEdge(network, registry),
        StallDetector(),
        lease,
        cast("Any", None),
        idle,
        idle,
        lambda: None,
    )
    policy = RoutePolicy(allowed=True, why="", name=topic)
    key, conversion = RouteKey(topic, STRING, type_.type_id), Conversion(type_, type_, None)
    route = HubToSideRoute(key, topic, None, conversion, policy, context)
    route.update([publisher], [])
    for number in range(200):
        route.handle(HubSample(zenoh.ZBytes(line("x")), number + 1, 1, GID, "z"))
    now[0] += 30.0
    route.update([publisher], [])
    assert route._subscription.paused
    network.read_from(topic, STRING, Qos(), MadeBy.NATIVE, "/listener", lambda *_: None)
    with pytest.raises(OSError, match="no room"):
        route.update([publisher], [])
    route.update([publisher], [])
    assert hub.subscriptions == 3
    route.update([publisher], [])
    assert hub.subscriptions == 3
    route.close()


TWIST = "geometry_msgs/msg/Twist"


@pytest.mark.parametrize(("topic", "kept"), [("/cmd_vel", 0), ("/odom_twist", 1)])
def test_commands_do_not_wait_for_their_source(topic: str, kept: int) -> None:
    registry, network = Registry(), FakeNetwork()
    type_: SideType = registry.ros2(TWIST)
    conversion, policy = Conversion(type_, type_, None), RoutePolicy(allowed=True, why="", name=topic)
    key = RouteKey(topic, TWIST, type_.type_id)
    with HubNetwork() as hubs, Hub.open(hubs.settings("commands")) as hub:
        idle = Dispatcher("idle")
        lease = Lease()
        lease.extend(math.inf)
        context = EngineContext(
            hub, FakeEdge(network, registry), StallDetector(), lease, cast("Any", None), idle, idle, lambda: None
        )
        to_hub = SideToHubRoute(key, topic, conversion, policy, context)
        to_hub.update([Endpoint("known", Kind.PUBLISHER, topic, TWIST, Qos(), MadeBy.NATIVE)])
        to_hub.deliver(b"payload", "unknown", None)
        assert (len(to_hub.pending), to_hub.counters.drops["unknown"]) == (kept, 1 - kept)
        to_hub.close()
        to_side = HubToSideRoute(key, topic, None, conversion, policy, context)
        to_side.update([], [])
        to_side.handle(HubSample(zenoh.ZBytes(b"payload"), 1, 1, b"g" * 16, "nobody"))
        assert (len(to_side.held.unknown), to_side.counters.drops["unknown"]) == (kept, 1 - kept)
        to_side.close()


@pytest.mark.parametrize(
    ("priority", "latched", "thinned"),
    [("", False, True), ("stream", False, True), ("", True, False), ("stream", True, False), ("state", False, False)],
)
def test_a_rate_applies_alike_in_both_directions(priority: str, latched: bool, thinned: bool) -> None:
    registry, network = Registry(), FakeNetwork()
    type_, topic = registry.ros2(STRING), "/state"
    qos = Qos(durability=Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE, depth=10)
    policy = RoutePolicy(allowed=True, why="", name=topic, rate=0.001, priority=priority)
    key, conversion = RouteKey(topic, STRING, type_.type_id), Conversion(type_, type_, None)
    volatile, latching = Qos(), Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
    other = latching if not latched else volatile  # another publisher does not change whether the rate applies
    with HubNetwork() as hubs, Hub.open(hubs.settings("rates")) as hub:
        idle, lease = Dispatcher("idle"), Lease()
        lease.extend(math.inf)
        context = EngineContext(
            hub, FakeEdge(network, registry), StallDetector(), lease, cast("Any", None), idle, idle, lambda: None
        )
        to_hub = SideToHubRoute(key, topic, conversion, policy, context)
        to_hub.update([
            Endpoint(name, Kind.PUBLISHER, topic, STRING, offered, MadeBy.NATIVE)
            for name, offered in (("this", qos), ("other", other))
        ])  # fmt: skip
        for _ in range(3):
            to_hub.deliver(line("here"), "this", None)
        to_hub.close()
        to_side = HubToSideRoute(key, topic, None, conversion, policy, context)
        this = hub_publisher(topic, type_.type_id, qos)
        to_side.update([this, replace(this, gid=b"o" * 16, qos=other)], [])
        for number in range(3):
            to_side.queue.receive(HubSample(zenoh.ZBytes(line("here")), number, number, GID, "z"))
        to_side.close()
    for route in (to_hub, to_side):
        assert (route.counters.messages, route.counters.drops["rate"]) == ((1, 2) if thinned else (3, 0))


TWIST = "geometry_msgs/msg/Twist"
MOVING, ZERO = (b"\0\1\0\0" + struct.pack("<6d", x, 0.0, 0.0, 0.0, 0.0, 0.0) for x in (0.5, 0.0))


@pytest.mark.parametrize(("reason", "how", "moving"), [("rate", "rate", 1), ("stale", "old", 1), ("stale", "stall", 0)])
def test_neither_rate_nor_age_drops_the_zero_that_stops_a_base(
    monkeypatch: pytest.MonkeyPatch, reason: str, how: str, moving: int
) -> None:
    registry, network, topic = Registry(), FakeNetwork(), "/cmd_vel"
    type_ = registry.ros2(TWIST)
    policy = RoutePolicy(allowed=True, why="", name=topic, rate=0.001 if how == "rate" else None)
    key, conversion = RouteKey(topic, TWIST, type_.type_id), Conversion(type_, type_, None)
    received: list[bytes] = []
    network.read_from(topic, TWIST, Qos(), MadeBy.NATIVE, "/base", lambda data, *_: received.append(data))
    detector = StallDetector()
    monkeypatch.setattr(detector, "stood_still", lambda _: how == "stall")
    with HubNetwork() as hubs, Hub.open(hubs.settings("zeros")) as hub:
        idle, lease = Dispatcher("idle"), Lease()
        lease.extend(math.inf)
        context = EngineContext(
            hub, FakeEdge(network, registry), detector, lease, cast("Any", None), idle, idle, lambda: None
        )
        now = time.time_ns()
        sent = [(MOVING, now), *((data, now - (how == "old") * 10**10) for data in (MOVING, ZERO, ZERO))]
        to_hub = SideToHubRoute(key, topic, conversion, policy, context)
        to_hub.update([Endpoint("this", Kind.PUBLISHER, topic, TWIST, Qos(), MadeBy.NATIVE)])
        for data, time_ns in sent:
            to_hub.deliver(data, "this", time_ns)
        to_hub.close()
        to_side = HubToSideRoute(key, topic, None, conversion, policy, context)
        to_side.update([replace(hub_publisher(topic, type_.type_id, Qos()), type_name=TWIST)], [])
        for number, (data, time_ns) in enumerate(sent, 1):
            to_side.queue.receive(HubSample(zenoh.ZBytes(data), number, time_ns, GID, "z"))
        to_side.close()
    assert received == [MOVING] * moving + [ZERO] * 2
    for route in (to_hub, to_side):
        assert (route.counters.messages, route.counters.drops[reason]) == (moving + 2, 2 - moving)


def test_lost_messages_are_reported_with_where_they_were_lost() -> None:
    counters = Counters()
    counters.missed(0, lambda: "nowhere")
    assert counters.as_dict()["error"] == ""
    counters.missed(3, lambda: "3 from yarp")
    assert (counters.as_dict()["drops"]["lost"], counters.as_dict()["error"]) == (3, "3 from yarp")
    counters.failed("something else")
    counters.missed(3, lambda: "3 from yarp")  # the total is unchanged, so it is not reported again
    assert counters.as_dict()["error"] == "something else"


def test_error_is_logged_once_per_change(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1000.0
    monkeypatch.setattr("bridge.routing.counters.time", SimpleNamespace(monotonic=lambda: now))
    counters = Counters()

    def logged(*errors: str) -> int:
        nonlocal now
        lines = 0
        for error in errors:
            now += 1.5
            lines += counters.failed(error)
        return lines

    assert logged(*["no server of /a"] * 20) == 1
    assert logged(*[f"message of {size} bytes, 100 allowed" for size in range(200, 220)]) == 1
    assert logged("no server of /a", "no server of /a") == 1
    assert [counters.failed("another"), counters.failed("a third")] == [True, False], (
        "at most one error is logged per second"
    )
    assert logged("a third", "a third") == 1
    now += 61.0
    assert logged("a third") == 1


@pytest.mark.parametrize("hours", [-1, 1])
def test_latency_is_measured_after_the_system_clock_was_set(monkeypatch: pytest.MonkeyPatch, hours: int) -> None:
    registry, network, topic = Registry(), FakeNetwork(), "/chat"
    type_ = registry.ros2(STRING)
    qos = Qos(Reliability.RELIABLE, Durability.VOLATILE, depth=10)
    publisher = HubEndpoint(
        "z", "n", "/", EndpointKind.PUBLISHER, topic, STRING, type_.type_id, qos, GID, None, pending=False, own=False
    )
    with HubNetwork() as hubs, Hub.open(hubs.settings("latency")) as hub:
        idle, lease = Dispatcher("idle"), Lease()
        lease.extend(math.inf)
        context = EngineContext(
            hub, FakeEdge(network, registry), StallDetector(), lease, cast("Any", None), idle, idle, lambda: None
        )
        policy = RoutePolicy(allowed=True, why="", name=topic)
        key, conversion = RouteKey(topic, STRING, type_.type_id), Conversion(type_, type_, None)
        route = HubToSideRoute(key, topic, None, conversion, policy, context)
        latencies: list[int] = []
        monkeypatch.setattr(Counters, "add_latency", lambda _counters, latency: latencies.append(latency))
        route.update([publisher], [])
        real = time.time_ns

        def receive(number: int, age: float = 0.0) -> None:
            stamp = time.time_ns() - round(age * 1e9)
            route.handle(HubSample(zenoh.ZBytes(line("x")), number, stamp, GID, "z"))

        receive(1, age=100.0)  # cached before the route subscribed
        assert not latencies
        receive(2)
        monkeypatch.setattr(time, "time_ns", lambda: real() + hours * 3_600_000_000_000)
        receive(3)
        receive(4, age=100.0)
        route.close()
    assert len(latencies) == 2
    assert all(0 <= latency < 10e9 for latency in latencies)


class OpenedPublisher:
    """A publisher that the route opened on the side."""

    def __init__(self, qos: Qos) -> None:
        self.qos, self.dropped, self.departed, self.closed = qos, 0, list[str](), False
        self.has_subscribers = True

    def send(self, payload: bytes, source: str) -> None:
        raise AssertionError(payload, source)

    def drop_source(self, source: str) -> None:
        self.departed.append(source)

    def close(self) -> None:
        self.closed = True


def test_side_publishers_open_once_each_and_report_the_slowest_subscriber() -> None:
    opened: list[OpenedPublisher] = []

    def advertise(qos: Qos) -> OpenedPublisher:
        opened.append(OpenedPublisher(qos))
        return opened[-1]

    publishers = SidePublishers(advertise)
    publishers.drop_source(GID)
    assert (publishers.latched, publishers.volatile, publishers.dropped) == (None, None, 0)
    for depth in (0, 5):
        publishers.open_latched(depth)
        publishers.open_volatile(100 * depth + 5000)
    assert [(p.qos.durability, p.qos.depth) for p in opened] == [
        (Durability.TRANSIENT_LOCAL, 1), (Durability.VOLATILE, 1000)
    ]  # fmt: skip
    opened[0].dropped, opened[1].dropped = 3, 2
    publishers.drop_source(GID)
    assert (publishers.dropped, opened[0].departed, opened[1].departed) == (3, [GID.hex()], [])
    publishers.close()
    assert [p.closed for p in opened] == [True, True]
    assert (publishers.latched, publishers.volatile) == (None, None)
