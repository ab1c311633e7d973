"""A quick stream stays on the hub while nobody on the side listens."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.routing import engine, hub_to_side
from tests.contract.hubside import HubSide
from tests.contract.side import Bridge, Side
from tests.support.wait import until

STRING = "std_msgs/String"
SOON = 2.0
"""Seconds in place of `bridge.routing.hub_to_side.UNHEARD`, and between looks, where the worker is in this process."""

PERIOD = 0.05
"""Seconds between two messages: far quicker than `bridge.routing.hub_to_side.QUICK`."""


def _route(far: HubSide, topic: str) -> dict[str, Any]:
    found: list[dict[str, Any]] = [
        r for r in far.status()["routes"] if r["hub_topic"] == topic and r["direction"] == "out"
    ]
    return found[0] if found else {"state": "not there"}


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hub_to_side, "UNHEARD", SOON)
    monkeypatch.setattr(engine, "_POLL", SOON)


def test_a_quick_stream_is_taken_up_with_its_first_listener(side: Side, bridge: Bridge, far: HubSide) -> None:
    if not side.tells_listeners:
        pytest.skip("this side does not tell who listens; its streams cross all the time")
    quick, slow = far.advertise("/quick", STRING), far.advertise("/slow", STRING)
    seen: dict[str, Any] = {}

    def unheard() -> bool:
        far.publish(quick, {"data": "nobody hears"})
        seen["count"] = seen.get("count", 0) + 1
        if seen["count"] % 20 == 0:
            far.publish(slow, {"data": "event"})
            seen.update(_route(far, "/quick"))
        return bool(seen.get("state") == "unheard")

    until(unheard, "the quick stream is left on the hub", 60, every=PERIOD)
    assert _route(far, "/slow")["state"] == "active", "an event crosses for whoever comes"
    assert not [e for e in far.hub.graph.subscriptions("/quick") if not e.own], "nothing is sent to the worker"
    before = _route(far, "/quick")["messages"]
    for _ in range(10):
        far.publish(quick, {"data": "nobody hears"})
    assert _route(far, "/quick")["messages"] == before
    peer = side.peer()
    heard = peer.subscribe("/quick", STRING, depth=100)
    far.hub_publish_until(quick, {"data": "heard"}, lambda: {"data": "heard"} in peer.wait(heard, 1, 0.2))
    for n in range(20):
        far.publish(quick, {"data": f"number {n}"})
    until(lambda: {"data": "number 19"} in peer.wait(heard, 21, 0.2), "the last one")
    got = [m["data"] for m in peer.wait(heard, 21) if m["data"].startswith("number")]
    assert got == [f"number {n}" for n in range(20)]
    assert _route(far, "/quick")["state"] == "active"
