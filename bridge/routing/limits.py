"""Priority classes of routes, and their limits: queue depths, rates and sizes."""

from __future__ import annotations

import re
import time
from enum import Enum

from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.messages.velocities import COMMAND_NAME, VELOCITIES


class Priority(Enum):
    """The priority class of a route.

    STATE messages are exempt from a rule's rate. Of COMMAND messages only the newest is queued by default; they are
    never latched or delivered late. A full queue drops the oldest messages.
    """

    STATE = "state"
    COMMAND = "command"
    STREAM = "stream"


def default_priority(topic: str, type_name: str, *, latched: bool) -> Priority:
    """Return the class of a topic if no rule sets it; type and name show whether it is a velocity command."""
    if type_name in VELOCITIES and COMMAND_NAME.search(topic):
        return Priority.COMMAND
    return Priority.STATE if latched else Priority.STREAM


_ARREARS = 0.1
"""Seconds of silence that are compensated, because sources jitter, and send bursts on a busy machine."""


class RateLimit:
    """Passes at most ``rate`` messages per second; the caller drops the others.

    A jittering source still reaches the mean rate: messages pass earlier after a short silence, but never two of them
    within half a period.
    """

    __slots__ = ("_due", "_gap", "_least", "_period")

    def __init__(self, rate: float) -> None:
        self._period = 1.0 / rate
        self._least = self._period - max(self._period / 2, _ARREARS)
        self._due = 0.0
        self._gap = 0.0

    def passes(self) -> bool:
        """Return whether a message that arrives now may pass."""
        now = time.monotonic()
        if now < self._due or now < self._gap:
            return False
        self._due = max(self._due + self._period, now + self._least)
        self._gap = now + self._period / 2
        return True


QUEUE_DEPTH = {Priority.COMMAND: 1, Priority.STATE: 1000, Priority.STREAM: 1000}
"""Depth of a route's queue to the side, unless a rule sets it."""

STREAM_DEPTH = 1000
"""Minimum history depth of the bridge's endpoints on a stream, to absorb bursts."""

BULK_DEPTH = 50
"""Minimum history depth for types with unbounded byte arrays, such as images, clouds and maps."""

BULK = 64 * 1024
"""Size in bytes above which separate threads handle a message, so that it does not delay small ones."""

QUEUE_BYTES = 64 * 1024 * 1024
"""Maximum number of bytes in one route's queue, not counting the newest message."""

MAX_PENDING = 64
"""Maximum number of messages held for unknown publishers; their limit in bytes is `QUEUE_BYTES`."""

_BYTES = re.compile(r"^[ \t]*(?:u?int8|byte|char|octet)\[\][ \t]", re.MULTILINE)


def stream_depth(definition: str) -> int:
    """Return the history depth of the bridge's endpoints for a stream of a type, given by its full definition."""
    return BULK_DEPTH if _BYTES.search(definition) else STREAM_DEPTH


def combined_qos(qualities: list[Qos]) -> Qos:
    """Return the QoS of a subscription to several publishers: best effort if any of them is, and latched if any is."""
    best_effort = any(q.reliability is Reliability.BEST_EFFORT for q in qualities)
    latched = [q for q in qualities if q.latched]
    return Qos(
        Reliability.BEST_EFFORT if best_effort else Reliability.RELIABLE,
        Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE,
        depth=max(sum(max(q.depth, 1) for q in latched), *(q.depth for q in qualities), 10),
    )


def qos_text(qos: Qos) -> str:
    """Format a QoS for people, as ``reliable transient_local 1``."""
    return f"{qos.reliability.name.lower()} {qos.durability.name.lower()} {qos.depth}"
