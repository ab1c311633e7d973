"""Conversion of QoS to rclpy, and compatibility of offers and requests."""

from __future__ import annotations

import pytest

from bridge.adapters.ros2.participant import mismatch, to_rclpy
from bridge.hub.wire.qos import Durability, History, Qos, Reliability

RELIABLE, BEST_EFFORT = Reliability.RELIABLE, Reliability.BEST_EFFORT
VOLATILE, LATCHED = Durability.VOLATILE, Durability.TRANSIENT_LOCAL


@pytest.mark.parametrize(
    ("offered", "requested", "why"),
    [
        (Qos(RELIABLE, LATCHED), Qos(BEST_EFFORT, VOLATILE), ""),
        (Qos(RELIABLE, VOLATILE), Qos(RELIABLE, VOLATILE), ""),
        (Qos(BEST_EFFORT, VOLATILE), Qos(RELIABLE, VOLATILE), "best effort"),
        (Qos(RELIABLE, VOLATILE), Qos(RELIABLE, LATCHED), "volatile"),
        (Qos(deadline_ns=10**9), Qos(deadline_ns=10**9), ""),
        (Qos(deadline_ns=2 * 10**9), Qos(deadline_ns=10**9), "deadline"),
        (Qos(), Qos(deadline_ns=10**9), "deadline"),
        (Qos(), Qos(manual=True), "manual by topic"),
        (Qos(manual=True, lease_ns=10**9), Qos(lease_ns=10**9), ""),
        (Qos(), Qos(lease_ns=10**9), "lease"),
    ],
)
def test_incompatible_policies_are_named(offered: Qos, requested: Qos, why: str) -> None:
    result = mismatch(offered, requested)
    assert why in result
    assert bool(result) == bool(why)


def test_endpoints_of_the_edge_have_a_bounded_history() -> None:
    profile = to_rclpy(Qos(BEST_EFFORT, LATCHED, History.KEEP_ALL, depth=0)).to_dict()
    assert (int(profile["history"]), profile["depth"]) == (int(History.KEEP_LAST), 1)
    assert int(profile["reliability"]) == int(BEST_EFFORT)
    assert int(profile["durability"]) == int(LATCHED)
