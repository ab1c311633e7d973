"""Quality of service between ours and rclpy's, and which offers meet which requests.

DDS announces no history, so the depth of a remote writer is unknown (Fast DDS reports history ``UNKNOWN``, depth 0).
Our enumerations carry rmw's numbers, as rclpy's inner module does.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rclpy.qos import QoSProfile

from bridge.hub.qos import Durability, History, Qos, Reliability

UNKNOWN_DEPTH = 10
"""Depth taken for a volatile remote endpoint; a latched one counts as 1, its last message."""

_LONGEST_NS = 2**62
"""DDS's infinite durations come as the largest number; no finite one comes near."""


def from_rclpy(profile: Mapping[str, Any]) -> Qos:
    """A remote endpoint's QoS as discovery tells it."""
    latched = int(profile["durability"]) == Durability.TRANSIENT_LOCAL
    return Qos(
        Reliability.BEST_EFFORT if int(profile["reliability"]) == Reliability.BEST_EFFORT else Reliability.RELIABLE,
        Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE,
        History.KEEP_ALL if int(profile["history"]) == History.KEEP_ALL else History.KEEP_LAST,
        int(profile["depth"]) or (1 if latched else UNKNOWN_DEPTH),
        _finite(profile["deadline"].nanoseconds),
        _finite(profile["lifespan"].nanoseconds),
    )


def _finite(nanoseconds: int) -> int | None:
    return nanoseconds if 0 < nanoseconds < _LONGEST_NS else None


def to_rclpy(qos: Qos) -> Any:
    """The inner profile of an endpoint of our own: always a bounded history, never a deadline that misses a peer."""
    profile: Any = QoSProfile
    return profile(
        reliability=int(qos.reliability),
        durability=int(qos.durability),
        history=int(History.KEEP_LAST),
        depth=max(1, qos.depth),
    ).get_c_qos_profile()


def mismatch(offered: Qos, requested: Qos) -> str:
    """Why a reader does not hear a writer, "" where it does (DDS 1.4, section 2.2.3, request against offer)."""
    reasons = []
    if offered.reliability is Reliability.BEST_EFFORT and requested.reliability is Reliability.RELIABLE:
        reasons.append("best effort is offered, reliable is asked for")
    if offered.durability is Durability.VOLATILE and requested.durability is Durability.TRANSIENT_LOCAL:
        reasons.append("volatile is offered, transient local is asked for")
    if requested.deadline_ns is not None and (offered.deadline_ns or _LONGEST_NS) > requested.deadline_ns:
        reasons.append("a longer deadline is offered than is asked for")
    return " and ".join(reasons)


SERVICE = Qos(depth=20_000)
"""Of our clients and servers: a peer sees ROS 2's own profile for services, and we have room for more calls than
may be under way. It costs no memory before it is used."""
