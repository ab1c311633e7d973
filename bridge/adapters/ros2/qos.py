"""Quality of service between ours and rclpy's, and which offers meet which requests.

DDS announces no history, so the depth of a remote writer is unknown (Fast DDS reports history ``UNKNOWN``, depth 0).
"""

from __future__ import annotations

from typing import Any

from rclpy.duration import Duration, Infinite
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from bridge.hub.qos import Durability, History, Qos, Reliability

UNKNOWN_DEPTH = 10
"""Depth taken for a volatile remote endpoint; a latched one counts as 1, its last message."""

_INFINITE_NS = int(Infinite.nanoseconds)


def from_rclpy(profile: QoSProfile) -> Qos:
    """A remote endpoint's QoS as discovery tells it."""
    best_effort = profile.reliability == ReliabilityPolicy.BEST_EFFORT
    latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return Qos(
        Reliability.BEST_EFFORT if best_effort else Reliability.RELIABLE,
        Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE,
        History.KEEP_ALL if profile.history == HistoryPolicy.KEEP_ALL else History.KEEP_LAST,
        profile.depth or (1 if latched else UNKNOWN_DEPTH),
        _finite(profile.deadline),
        _finite(profile.lifespan),
    )


def _finite(duration: Duration) -> int | None:
    nanoseconds = int(duration.nanoseconds)
    return nanoseconds if 0 < nanoseconds < _INFINITE_NS else None


def to_rclpy(qos: Qos) -> QoSProfile:
    """The profile of an endpoint of our own: always a bounded history, never a deadline that could miss a peer."""
    profile: Any = QoSProfile
    made: QoSProfile = profile(
        reliability=ReliabilityPolicy.BEST_EFFORT
        if qos.reliability is Reliability.BEST_EFFORT
        else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.latched else DurabilityPolicy.VOLATILE,
        history=HistoryPolicy.KEEP_LAST,
        depth=max(1, qos.depth),
    )
    return made


def mismatch(offered: Qos, requested: Qos) -> str:
    """Why a reader does not hear a writer, "" where it does (DDS 1.4, section 2.2.3, request against offer)."""
    reasons = []
    if offered.reliability is Reliability.BEST_EFFORT and requested.reliability is Reliability.RELIABLE:
        reasons.append("best effort is offered, reliable is asked for")
    if offered.durability is Durability.VOLATILE and requested.durability is Durability.TRANSIENT_LOCAL:
        reasons.append("volatile is offered, transient local is asked for")
    if requested.deadline_ns is not None and (
        offered.deadline_ns is None or offered.deadline_ns > requested.deadline_ns
    ):
        reasons.append("a longer deadline is offered than is asked for")
    return " and ".join(reasons)
