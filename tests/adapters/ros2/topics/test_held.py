"""Messages of new latched writers, which wait until subscriptions on Cyclone DDS have matched."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.ros2 import rcl, rmw
from bridge.adapters.ros2.graph.heartbeats import MATCH_SECONDS, Heartbeats
from bridge.adapters.ros2.topics.publisher import Ros2Publisher
from bridge.concurrency import DelayedCalls
from bridge.hub.wire.qos import Durability, Qos
from bridge.routing.edge import Endpoint, Kind, MadeBy
from tests.adapters.ros2.graph.test_interfaces import Calls
from tests.support.wait import until

LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=2)
READER = Endpoint("0110" + "ab" * 14, Kind.SUBSCRIPTION, topic="/map", type="t", qos=Qos(), made_by=MadeBy.NATIVE)


@pytest.fixture
def later() -> Iterator[DelayedCalls]:
    calls = DelayedCalls("test-held")
    yield calls
    calls.close()


@pytest.fixture
def published(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """Collect the payloads instead of publishing them."""
    messages: list[bytes] = []
    monkeypatch.setattr(rcl, "publish", lambda _pointer, payload: messages.append(payload))
    monkeypatch.setattr(rmw, "publisher_gid", lambda _pointer: b"\1\x0f" + bytes(14))
    return messages


def advertise(later: DelayedCalls, qos: Qos = LATCHED, *, cyclone: bool = True) -> Ros2Publisher:
    participant = SimpleNamespace(make_writer=lambda *_: SimpleNamespace(pointer=1), destroy=lambda _: None)
    heartbeats = Heartbeats(lambda _: None, later)
    heartbeats.follow([READER] if cyclone else [])
    context: Any = SimpleNamespace(participant=participant, heartbeats=heartbeats, later=later)
    return Ros2Publisher("/map", SimpleNamespace(type_name="t"), qos, context, lambda _: None, lambda _: True)


def test_latched_messages_wait_and_keep_their_order(published: list[bytes]) -> None:
    later = Calls()
    maps = advertise(later)
    for payload in (b"1", b"2", b"3"):
        maps.send(payload, "source")
    assert published == []
    later.pass_period()
    assert published == [b"2", b"3"], "the newest messages, up to the history depth, are published"
    maps.send(b"4", "source")
    assert published == [b"2", b"3", b"4"]


@pytest.mark.parametrize(("qos", "cyclone"), [(LATCHED, False), (Qos(depth=2), True)], ids=["no reader", "volatile"])
def test_other_messages_do_not_wait(later: DelayedCalls, published: list[bytes], qos: Qos, cyclone: bool) -> None:
    advertise(later, qos, cyclone=cyclone).send(b"1", "source")
    assert published == [b"1"]


@pytest.mark.parametrize("by", ["source", "publisher"])
def test_waiting_messages_are_published_when_their_source_or_publisher_ends(
    later: DelayedCalls, published: list[bytes], by: str
) -> None:
    maps = advertise(later)
    maps.send(b"1", "source")
    if by == "source":
        maps.drop_source("source")
    else:
        maps.close()
    assert published == [b"1"]


def test_closed_publisher_publishes_nothing_later(later: DelayedCalls, published: list[bytes]) -> None:
    maps = advertise(later)
    maps.close()
    maps.send(b"1", "source")
    done = []
    later.after(MATCH_SECONDS, lambda: done.append(True))
    until(lambda: done, "the wait is over")
    assert published == []
