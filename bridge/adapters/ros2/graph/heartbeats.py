"""Heartbeats that prepare readers on Cyclone DDS for the first message of a writer.

A reliable, volatile reader on Cyclone DDS skips everything before the first HEARTBEAT that it receives from a writer
(``handle_Heartbeat`` in its q_receive.c). Fast DDS sends no HEARTBEAT before the writer's first sample, and after that
only with a sample. So what is written before the reader has matched is lost although Fast DDS keeps it, and so is the
first sample that consists of fragments: its HEARTBEAT arrives before it is whole. A HEARTBEAT that announces only what
was written before (first 1, last the number of samples) prevents both.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence

from bridge.adapters.ros2.graph import spdp, vendors
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.adapters.ros2.participant import Participant
from bridge.routing.edge import Endpoint

COUNT = 6
PAUSE_SECONDS = 0.05
"""Number of heartbeats after a match, and the seconds between them: the reader matches soon after the writer, and
ignores heartbeats until then. DDS does not report when it has."""

SETTLE_SECONDS = 3.5
"""Seconds from the discovery of a participant until it knows all endpoints here: Fast DDS repeats an announcement that
the other was not yet ready to receive after up to 3 s (the heartbeat period of its discovery writers)."""


class Heartbeats:
    """Sends heartbeats in the name of this participant's writers.

    Args:
        prefix: the GUID prefix of this participant.
        send_all: sends RTPS messages to all participants.
    """

    def __init__(self, participant: Participant, prefix: bytes, send_all: Callable[[Sequence[bytes]], None]) -> None:
        self._participant, self._prefix, self._send_all = participant, prefix, send_all
        self._discovered: dict[bytes, float] = {}

    def follow(self, endpoints: Iterable[Endpoint]) -> None:
        """Record when each participant on Cyclone DDS was discovered."""
        gids = (bytes.fromhex(endpoint.id) for endpoint in endpoints)
        prefixes = {gid[:PREFIX_BYTES] for gid in gids if vendors.is_cyclone(gid)}
        now = time.monotonic()
        self._discovered = {prefix: self._discovered.get(prefix, now) for prefix in prefixes}

    def settled_at(self, gids: Iterable[bytes]) -> float:
        """Return the monotonic time from which the participants of these GIDs know all endpoints here."""
        now = time.monotonic()
        discovered = (self._discovered.setdefault(gid[:PREFIX_BYTES], now) for gid in gids)
        return max(discovered, default=now) + SETTLE_SECONDS

    def send(self, dds_topic: str, last: int) -> None:
        """Announce to all readers of a DDS topic that its writer here has written ``last`` samples."""
        gids = [bytes(info["endpoint_gid"]) for info in self._participant.writers(dds_topic, dds=True)]
        own = [gid for gid in gids if gid[:PREFIX_BYTES] == self._prefix]
        if own:
            self._send_all([spdp.heartbeat(gid, last) for gid in own])
