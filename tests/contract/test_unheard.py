"""A high-rate topic stays on the hub while it has no subscriber on the side."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.routing import check_loop, hub_end
from tests.contract.hubside import HubSide
from tests.contract.side import Bridge, Side
from tests.support.wait import until

STRING = "std_msgs/String"
SOON = 2.0
"""Seconds; replaces `hub_end.UNSUBSCRIBE_SECONDS` and the engine's poll period if the worker is in this process."""

PERIOD = 0.05
"""Seconds between two messages: 20 messages per second, well above `bridge.routing.hub_end.QUICK`."""


def _route(far: HubSide, topic: str) -> dict[str, Any]:
    routes: list[dict[str, Any]] = [
        r for r in far.status()["routes"] if r["hub_topic"] == topic and r["direction"] == "out"
    ]
    return routes[0] if routes else {"state": "missing"}


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hub_end, "UNSUBSCRIBE_SECONDS", SOON)
    monkeypatch.setattr(check_loop, "POLL", SOON)


def test_a_high_rate_topic_is_bridged_once_the_side_has_a_subscriber(side: Side, bridge: Bridge, far: HubSide) -> None:
    if not side.lists_subscribers:
        pytest.skip("this side's graph does not list subscribers, so its topics are always bridged")
    quick, slow = far.advertise("/quick", STRING), far.advertise("/slow", STRING)
    route: dict[str, Any] = {}
    published = 0

    def paused() -> bool:
        nonlocal published
        far.publish(quick, {"data": "without subscriber"})
        published += 1
        if published % 20 == 0:
            far.publish(slow, {"data": "event"})
            route.update(_route(far, "/quick"))
        return bool(route.get("state") == "unheard")

    until(paused, "the route of the high-rate topic pauses", 60, every=PERIOD)
    assert _route(far, "/slow")["state"] == "active", "rare messages are bridged without a subscriber"
    until(lambda: not [e for e in far.hub.graph.subscriptions("/quick") if not e.own], "the worker has unsubscribed")
    count = _route(far, "/quick")["messages"]
    for _ in range(10):
        far.publish(quick, {"data": "without subscriber"})
    assert _route(far, "/quick")["messages"] == count
    peer = side.peer()
    subscription = peer.subscribe("/quick", STRING, depth=100)
    first = {"data": "first"}
    far.hub_publish_until(quick, first, lambda: first in peer.wait(subscription, 1, 0.2))
    for n in range(20):
        far.publish(quick, {"data": f"number {n}"})
    until(lambda: {"data": "number 19"} in peer.wait(subscription, 21, 0.2), "the last message arrives")
    received = [m["data"] for m in peer.wait(subscription, 21) if m["data"].startswith("number")]
    assert received == [f"number {n}" for n in range(20)]
    assert _route(far, "/quick")["state"] == "active"
