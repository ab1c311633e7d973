"""Sessions of the hub find each other with each setting of gossip that the configuration accepts."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.config.model import Config
from bridge.config.zenoh_effects import ROUTER, WORKERS, unusable
from bridge.hub.node import Hub
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until


@pytest.mark.parametrize(
    ("workers", "router"),
    [
        ({"autoconnect": {"peer": ["peer"]}}, {}),
        ({"target": {"peer": ["router"]}}, {"target": {"router": ["peer"]}}),
        ({"multihop": True}, {"multihop": True}),
    ],
)
def test_sessions_find_each_other(workers: dict[str, Any], router: dict[str, Any]) -> None:
    ours, theirs = ({"scouting": {"gossip": gossip}} for gossip in (workers, router))
    config = Config.model_validate({"hub": {"zenoh": ours, "router_zenoh": theirs}})
    assert not [*unusable(ours, WORKERS, config), *unusable(theirs, ROUTER, config)]
    with (
        HubNetwork(0, ours, theirs) as network,
        Hub.open(network.settings("one")) as one,
        Hub.open(network.settings("two", "two")) as two,
        Hub.open(network.settings("three", "three", "other", zenoh=None)) as three,  # of a daemon without settings
    ):
        hubs = one, two, three
        until(lambda: all(b.zid in a.neighbors() for a in hubs for b in hubs if a is not b), "all sessions are linked")
