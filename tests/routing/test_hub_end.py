"""The parts of a hub-to-side route at the route's end on the hub."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import pytest
import zenoh

from bridge.hub.endpoints.subscription import HubSample, HubSubscription
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import EndpointKind, Origin
from bridge.hub.lane.lent import LentPayload
from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.routing import hub_end
from bridge.routing.hub_end import DEMAND, Demand, HeldSamples, HubSources, RouteSubscription, StreamDemand
from tests.support.clock import Clock

WORKER = Origin("ros1", "net", "robot")
LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL)


def publisher(name: str, zid: str = "z", origin: Origin | None = WORKER, qos: Qos = LATCHED) -> HubEndpoint:
    return HubEndpoint(
        zid, name, "/", EndpointKind.PUBLISHER, "/t", "std_msgs/msg/String", "h", qos, name.encode(), origin,
        pending=False, own=False,
    )  # fmt: skip


def sample(gid: str, zid: str = "z") -> HubSample:
    return HubSample(zenoh.ZBytes(b""), 1, 1, gid.encode(), zid)


@pytest.mark.parametrize("latched", [False, True])
def test_held_samples_do_not_occupy_the_memory_of_their_sender(*, latched: bool) -> None:
    """A worker on standby may hold them for hours; the sender lends only a few messages of a topic at a time."""
    given_back: list[bool] = []
    held = HeldSamples(lambda: None)
    lent = LentPayload(memoryview(b"payload"), lambda: given_back.append(True))
    held_sample = HubSample(lent, 1, 1, b"a", "z")
    del lent
    if latched:
        held.add_latched(held_sample, publisher("a"))
    else:
        held.add_unknown(held_sample)
    assert given_back == [True]
    assert held_sample.data() == b"payload"


def latches(qos: Qos) -> bool:
    return qos.latched


def source_of(sources: HubSources, gid: str, zid: str = "z") -> str:
    source = sources.of(sample(gid, zid))
    return "" if source is None else source.endpoint.node


def test_only_samples_of_allowed_publishers_have_a_source() -> None:
    sources = HubSources().updated([publisher("a")], [publisher("r")], [publisher("w")], latches)
    assert {gid: source_of(sources, gid) for gid in "arwu"} == {"a": "a", "r": "", "w": "", "u": ""}
    assert sources.allowed[b"a"].latched


def test_invented_gid_belongs_to_the_native_program_of_its_session() -> None:
    native, other = publisher("n", "y", origin=None), publisher("m", "x", origin=None)
    sources = HubSources().updated([publisher("a"), native, other], [publisher("r", "y")], [], latches)
    assert source_of(sources, "invented", "y") == "n"
    assert source_of(sources, "invented", "x") == "m"
    assert source_of(sources, "invented", "z") == "", "workers do not invent GIDs"
    assert source_of(sources, "invented", "") == "n", "the session of the sample is unknown"
    assert source_of(sources, "r", "y") == "", "r is a refused publisher in the same session"


def test_update_keeps_the_age_of_a_remaining_source_and_the_earlier_snapshot() -> None:
    first = HubSources().updated([publisher("a"), publisher("b")], [], [], latches)
    second = first.updated([publisher("a")], [publisher("b")], [], latches)
    assert second.allowed[b"a"] is first.allowed[b"a"]
    assert (set(first.allowed), set(second.allowed)) == ({b"a", b"b"}, {b"a"})
    assert (source_of(first, "b"), source_of(second, "b")) == ("b", "")


@dataclass
class FakeSubscription:
    """Stands in for a subscription on the hub."""

    qos: Qos
    lost: int = 0
    by_lane: int = 0
    way: str = "lane"
    why: str = ""
    closed: bool = False

    def losses(self) -> str:
        return f"{self.lost} lost"

    def close(self) -> None:
        self.closed = True


def test_counts_continue_over_reopened_subscriptions() -> None:
    opened: list[FakeSubscription] = []

    def subscribe(qos: Qos) -> HubSubscription:
        opened.append(FakeSubscription(qos))
        return cast("HubSubscription", opened[-1])

    subscription = RouteSubscription(subscribe)
    assert (subscription.open, subscription.status(), subscription.losses()) == (False, (("", ""), 0), None)
    assert subscription.request(Qos(depth=10))
    opened[0].lost, opened[0].by_lane = 3, 5
    assert not subscription.request(Qos(Reliability.BEST_EFFORT, depth=20)), (
        "the existing subscription also receives from such publishers"
    )
    assert subscription.request(LATCHED), "only a latched subscription receives the history"
    assert [item.closed for item in opened] == [True, False]
    opened[1].lost, opened[1].by_lane = 1, 2
    losses = subscription.losses()
    assert losses is not None
    assert (losses[0], losses[1](), subscription.status()) == (4, "1 lost", (("lane", ""), 7))
    subscription.close()
    subscription.close()
    assert (subscription.open, subscription.status(), subscription.losses()) == (False, (("", ""), 7), None)
    assert subscription.request(LATCHED), "after a close, the previous durability does not matter"


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(hub_end, "time", clock)
    return clock


FAST = int(hub_end.QUICK * 100)


CHECKS: list[tuple[Demand, dict[str, Any], Demand]] = [
    (Demand.UNWANTED, {"wanted": True}, Demand.WANTED),
    (Demand.UNWANTED, {"seconds": 9.0}, Demand.UNWANTED),
    (Demand.UNWANTED, {"messages": 40}, Demand.UNWANTED),
    (Demand.UNWANTED, {"subscribed": False}, Demand.UNWANTED),
    (Demand.UNWANTED, {}, Demand.PAUSED),
    (Demand.WANTED, {"wanted": True}, Demand.WANTED),
    (Demand.WANTED, {}, Demand.UNWANTED),
    (Demand.PAUSED, {"subscribed": False}, Demand.PAUSED),
    (Demand.PAUSED, {"subscribed": False, "wanted": True}, Demand.WANTED),
]
"""Rows of a state, what a check sees in it, and the state that follows."""


@pytest.mark.parametrize(("begin", "check", "end"), CHECKS)
def test_each_transition_leads_to_its_demand(clock: Clock, begin: Demand, check: dict[str, Any], end: Demand) -> None:
    demand = StreamDemand()
    if begin is Demand.WANTED:
        assert demand.update(0, wanted=True, subscribed=True) is begin
    if begin is Demand.PAUSED:
        clock.now += 11.0
        assert demand.update(FAST, wanted=False, subscribed=True) is begin
    clock.now += check.get("seconds", 11.0)
    crossed = check.get("messages", FAST) + (FAST if begin is Demand.PAUSED else 0)
    state = demand.update(crossed, wanted=check.get("wanted", False), subscribed=check.get("subscribed", True))
    assert state is demand.state is end


def test_the_checks_walk_every_row_of_the_table() -> None:
    rows = {(state, following) for state, row in DEMAND.items() for following in row.values()}
    assert {(begin, end) for begin, _, end in CHECKS if begin is not end} == rows


def test_the_rate_is_that_of_the_time_without_a_subscriber(clock: Clock) -> None:
    demand = StreamDemand()
    demand.update(0, wanted=True, subscribed=True)
    clock.now += 1000.0
    demand.update(100_000, wanted=False, subscribed=True)
    clock.now += 11.0
    assert demand.update(100_010, wanted=False, subscribed=True) is Demand.UNWANTED, "the stream has become slow by now"
    clock.now += 11.0
    assert demand.update(100_100, wanted=False, subscribed=True) is Demand.PAUSED


def test_replaced_publisher_is_another_source() -> None:
    first = HubSources().updated([publisher("a")], [], [], latches)
    moved = replace(publisher("a"), gid=b"new")
    second = first.updated([moved], [], [], latches)
    assert set(second.allowed) == {b"new"}
    assert second.allowed[b"new"].age is not first.allowed[b"a"].age
