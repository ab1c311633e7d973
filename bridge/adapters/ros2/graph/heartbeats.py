"""Heartbeats that prepare readers on Cyclone DDS for the first message of a writer.

A reliable, volatile reader on Cyclone DDS skips everything before the first HEARTBEAT that it receives from a writer
(``handle_Heartbeat`` in its q_receive.c). Fast DDS sends no HEARTBEAT before the writer's first sample, and after that
only with a sample. So what is written before the reader has matched is lost although Fast DDS keeps it. The first
sample that consists of fragments is lost, too, because its HEARTBEAT arrives before the sample is whole. A HEARTBEAT
that announces only what was written before (first 1, last the number of samples) prevents both losses.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from bridge.adapters.ros2.graph import spdp, vendors
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.concurrency import DelayedCalls
from bridge.routing.edge import Endpoint, Kind

PAUSE_SECONDS = 0.05
MATCH_SECONDS = 0.3
"""Seconds until a new endpoint has surely matched at a participant that was discovered before; milliseconds usually
suffice. Until then a reader ignores heartbeats, and DDS does not report the match, so heartbeats are repeated."""

_SETTLE_SECONDS = 3.5
"""Seconds from the discovery of a participant until it knows all endpoints here. If the participant was not ready for
an announcement, Fast DDS repeats it after up to 3 s (the heartbeat period of its discovery writers)."""


class _Preparation(NamedTuple):
    """The number of samples that a writer had written, and the end of its heartbeats on the monotonic clock."""

    last: int
    end: float


class Heartbeats:
    """Sends heartbeats in the name of this participant's writers.

    Args:
        send_all: sends RTPS messages to all participants.
        later: the thread that sends them.
    """

    def __init__(self, send_all: Callable[[Sequence[bytes]], None], later: DelayedCalls) -> None:
        self._send_all, self._later = send_all, later
        self._lock = threading.Lock()
        self._discovered: dict[bytes, float] = {}
        self._readers: dict[str, frozenset[bytes]] = {}
        self._pending: dict[bytes, _Preparation] = {}

    def follow(self, endpoints: Iterable[Endpoint]) -> None:
        """Record the participants and subscriptions on Cyclone DDS, and when each participant was discovered."""
        readers: dict[str, set[bytes]] = {}
        prefixes: set[bytes] = set()
        for endpoint in endpoints:
            gid = bytes.fromhex(endpoint.id)
            if vendors.is_cyclone(gid):
                prefixes.add(gid[:PREFIX_BYTES])
                if endpoint.kind is Kind.SUBSCRIPTION:
                    readers.setdefault(endpoint.topic, set()).add(gid)
        now = time.monotonic()
        with self._lock:
            self._discovered = {prefix: self._discovered.get(prefix, now) for prefix in prefixes}
            self._readers = {topic: frozenset(gids) for topic, gids in readers.items()}

    def readers(self, topic: str) -> frozenset[bytes]:
        """Return the GIDs of a ROS topic's subscriptions on Cyclone DDS."""
        return self._readers.get(topic, frozenset())

    def prepare(self, writer: bytes, last: int, peers: Iterable[bytes]) -> float:
        """Announce to new readers that a writer has written ``last`` samples; return when they are prepared.

        Args:
            writer: the GID of a writer of this participant.
            last: the number of samples that the writer has written.
            peers: a GID of any endpoint of each participant to prepare.

        Returns:
            A time on the monotonic clock.
        """
        with self._lock:
            now = time.monotonic()
            discovered = (self._discovered.setdefault(gid[:PREFIX_BYTES], now) for gid in peers)
            end = max(max(discovered, default=now) + _SETTLE_SECONDS, now) + MATCH_SECONDS
            earlier = self._pending.get(writer)
            if earlier is not None:  # its readers may still have to match; announcing fewer samples costs a request
                end, last = max(end, earlier.end), min(last, earlier.last)
            self._pending[writer] = _Preparation(last, end)
        self._later.after(0.0, self._send, once=True)
        return end

    def _send(self) -> None:
        now = time.monotonic()
        with self._lock:
            pending = self._pending  # even if the time is over: this thread may not have run before
            self._pending = {writer: prepared for writer, prepared in pending.items() if now < prepared.end}
            again = bool(self._pending)
        try:
            if pending:
                self._send_all(spdp.heartbeats({writer: prepared.last for writer, prepared in pending.items()}))
        finally:
            if again:
                self._later.after(PAUSE_SECONDS, self._send, once=True)
