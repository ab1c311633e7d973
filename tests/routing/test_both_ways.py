"""A route with a doorway publishes the same messages, in the same order, as a route without one."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import pytest

from bridge.hub.lane.blocks import Blocks
from bridge.hub.lane.joining import Joining
from bridge.hub.lane.links import Epoch, Sender
from bridge.hub.lane.outlet import Outlet, ReaderLink
from bridge.hub.lane.wire import BLOCK, BODY, DATA, LOAN, SIZE
from bridge.hub.wire.keys import pack_attachment
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.transcode.conversion import Conversion, SideType
from bridge.routing import side_to_hub
from bridge.routing.decision import RouteKey
from bridge.routing.edge import Endpoint, Kind, MadeBy
from bridge.routing.limits import BULK
from bridge.routing.peer_watch import Lease
from bridge.routing.rules import RoutePolicy
from bridge.routing.side_to_hub import SideToHubRoute
from tests.peers.hub.lane import LaneMessage, RecordedLane, lane_messages
from tests.routing.test_doorway_conversion import CHECK, TO_HUB, battery, damaged, joints
from tests.support.wait import until

TYPE, TOPIC = "a_msgs/msg/A", "/t"
SIDE = SideType(TYPE, "RIHS01_0", "")
SOURCES = ("a", "b", "c", "latched")
EVENTS = 1000


class Publisher:
    """A hub publisher of one lane, which lists the messages that it would put on zenoh."""

    def __init__(self, outlet: Outlet, gid: bytes, epoch: Epoch, *, latched: bool) -> None:
        self.gid, self.sender, self._outlet = gid, Sender(gid, epoch), outlet
        assert outlet.link.fast is not None
        self.sender.send_to(((outlet.link.fast, outlet.number),))
        self.sender.direct = not latched
        self.on_zenoh: list[tuple[int, bytes]] = []

    @property
    def by_lane(self) -> int:
        return self.sender.by_lane

    def put(self, payload: bytes, time_ns: int | None) -> None:
        number = self.sender.next()
        self.sender.by_lane += 1
        self._outlet.send(pack_attachment(number, time_ns or 0, self.gid), payload)
        if not self.sender.is_quiet():
            self.on_zenoh.append((number, payload))

    def blocks(self) -> None:
        """Return None: every message is put as bytes."""

    def close(self) -> None:
        self.sender.direct = False


class Outcome(NamedTuple):
    """What a route has published and counted."""

    on_lane: list[LaneMessage | bytes]  # bytes: another record
    on_zenoh: list[list[tuple[int, bytes]]]
    counters: dict[str, Any]
    waits: list[bool]
    wakes: int


class RouteToLane:
    """A route to a hub whose publishers share a lane."""

    def __init__(self, convert: Callable[[bytes], bytes] | None) -> None:
        self.lane, self.epoch, self.lease, self.wakes = RecordedLane(), Epoch(), Lease(), 0
        self.waits: list[bool] = []
        self.link = ReaderLink(self.lane.near, self.waits.append, Blocks(lambda *_: None), lambda *_: None)
        self.outlet = self.link.outlets[1] = Outlet(self.link, 1, "key")
        self.outlet.depth = 50
        self.publishers: list[Publisher] = []
        self.deliver: Callable[[bytes, str, int | None], None] = pytest.fail
        self.received: list[LaneMessage | bytes] = []
        context = SimpleNamespace(
            small=None, bulk=None, hold=None, lease=self.lease, stall_detector=None, wake=self.wake,
            hub=SimpleNamespace(max_payload=2 * BULK, publisher=self.publisher),
            edge=SimpleNamespace(
                clock=SimpleNamespace(simulated=False), subscribe=self.subscribe, own_threads=False
            ),
        )  # fmt: skip
        self.route = SideToHubRoute(
            RouteKey(TOPIC, TYPE, SIDE.type_id), TOPIC, Conversion(SIDE, SIDE, convert),
            RoutePolicy(allowed=True, why="", name=TOPIC), cast("Any", context),
        )  # fmt: skip

    def wake(self) -> None:
        self.wakes += 1

    def publisher(self, _topic: str, _type: str, _hash: str, qos: Qos, **_: object) -> Publisher:
        gid = bytes([len(self.publishers)]) * 16
        self.publishers.append(Publisher(self.outlet, gid, self.epoch, latched=qos.latched))
        return self.publishers[-1]

    def subscribe(self, _topic: str, _type: SideType, _qos: Qos, deliver: Callable[..., None]) -> SimpleNamespace:
        self.deliver = deliver
        return SimpleNamespace(close=lambda: None, lost=0)

    def update(self, sources: Sequence[str]) -> None:
        self.route.update(
            [
                Endpoint(name, Kind.PUBLISHER, TOPIC, TYPE, LATCHED if name == "latched" else Qos(), MadeBy.NATIVE)
                for name in sources
            ]
        )

    def message(self, payload: bytes, source: str, time_ns: int | None) -> None:
        self.deliver(payload, source, time_ns)
        until(lambda: not self.route._large.busy, "large messages are published", every=0.001)

    def rest(self) -> None:
        for publisher in self.publishers:
            publisher.sender.rest(self.epoch.value, publisher.sender.matches)

    def match(self) -> None:
        self.publishers[-1].sender.match()

    def drain(self) -> None:
        for record in self.lane.received():
            if record[0] == DATA:
                # messages without a time have the system's
                self.received += [
                    m._replace(time_ns=m.time_ns if m.time_ns <= EVENTS else 0) for m in lane_messages(record)
                ]
            elif record[0] == BLOCK:
                size, loan, _ = LOAN.unpack_from(record, BODY)
                self.received.append(record[:BODY] + SIZE.pack(size))
                self.link.on_free(loan)
            else:
                self.received.append(record)

    def catch_up(self) -> None:
        self.drain()
        while self.outlet.queue:
            self.link.flush()
            self.drain()

    def outcome(self) -> Outcome:
        self.catch_up()
        counters = self.route.counters.as_dict()
        return Outcome(
            self.received,
            [publisher.on_zenoh for publisher in self.publishers],
            {name: counters[name] for name in ("messages", "bytes", "drops", "error")},
            self.waits,
            self.wakes,
        )

    def close(self) -> None:
        self.route.close()
        self.link.close()
        self.lane.close()


Event = Callable[[RouteToLane, Joining], object]


def draw_event(draw: random.Random, number: int, make: Callable[[random.Random], bytes]) -> Event:
    """Return a random message, or a random change of the route, the graph or the reader."""
    step = draw.random()
    if step < 0.80:
        payload, source = make(draw), draw.choice((*SOURCES[:3], *SOURCES))
        time_ns = draw.choice((None, number))
        return lambda route, _: route.message(payload, source, time_ns)
    sources = draw.sample(SOURCES, draw.randrange(1, 5))
    until_ = draw.choice((0.0, math.inf, math.inf))
    changes: list[Event] = [
        lambda route, _: route.update(sources),
        lambda route, _: setattr(route.lease, "until", until_),
        lambda route, _: setattr(route.lease, "until", math.inf),
        lambda route, _: route.epoch.renew(),
        lambda route, _: route.match(),
        lambda _, joining: joining.flush(),
        lambda route, _: route.link.flush(),
        lambda route, _: route.drain(),
    ]
    common: list[Event] = [
        lambda route, _: route.rest(),
        lambda route, _: route.catch_up(),
        lambda route, _: route.update(SOURCES),
    ]
    return draw.choice(changes + 3 * common)


def run(events: Sequence[Event], convert: Callable[[bytes], bytes] | None) -> tuple[Outcome, int]:
    """Return the outcome of events, and the number of messages that were sent in C."""
    route, joining = RouteToLane(convert), Joining()
    route.lease.until = math.inf
    route.update(SOURCES)
    try:
        for event in events:
            event(route, joining)
        joining.end()
        doorway = route.route._doorway
        return route.outcome(), 0 if doorway is None else doorway.messages
    finally:
        joining.end()
        route.close()


def joint_states(draw: random.Random) -> bytes:
    message = joints(draw)
    return damaged(draw, message) if draw.random() < 0.2 else message


def batteries(draw: random.Random) -> bytes:
    message = battery(draw)
    return damaged(draw, message) if draw.random() < 0.3 else message


def any_bytes(draw: random.Random) -> bytes:
    return draw.randbytes(draw.choice((0, 10, 4096, 4097, BULK, 10)))


def sometimes_bulk(draw: random.Random) -> bytes:
    return bytes(draw.choice((BULK + 1, 3 * BULK))) if draw.random() < 0.02 else draw.randbytes(10)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(
    ("make", "convert", "least"),
    [(any_bytes, None, 50), (joint_states, TO_HUB, 50), (batteries, CHECK, 50), (sometimes_bulk, None, 0)],
)
def test_both_ways_publish_the_same(
    monkeypatch: pytest.MonkeyPatch,
    seed: int,
    make: Callable[[random.Random], bytes],
    convert: Callable[[bytes], bytes] | None,
    least: int,
) -> None:
    draw = random.Random(seed)
    events = [draw_event(draw, number, make) for number in range(1, EVENTS + 1)]
    with_doorway, in_c = run(events, convert)
    monkeypatch.setattr(side_to_hub, "Doorway", None)
    without, none = run(events, convert)
    assert with_doorway == without
    assert none == 0
    assert in_c >= least, "messages are sent in C"
    assert with_doorway.counters["drops"]["standby"], "the lease expires"
    assert any(with_doorway.on_zenoh), "some messages are put on zenoh"
