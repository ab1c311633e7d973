"""The topic on which the Midspan participants of a DDS network announce themselves, with one writer each.

The topic is hidden by ROS 2's rule (``/_midspan/presence``) and carries JSON in a ``std_msgs/msg/String``. It is
latched, so that a new participant receives the records of all others at once; each record replaces the last.
Participants are known before their first record, by their marks (`bridge.adapters.ros2.graph.marks`). A crashed
participant stays listed, without new records, until its successor disposes it or its lease expires (20 s).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from typing_extensions import override

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.graph.marks import PRESENCE as TOPIC
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.adapters.ros2.loop import EndpointReader, ReadLoop
from bridge.adapters.ros2.participant import Participant
from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.routing.edge import MadeBy, Sighting

TYPE = "std_msgs/msg/String"

DISCOVERY_SECONDS = 0.8
"""Seconds within which participants of one network discover each other. A new participant announces itself five times
in the first half second, and others respond at once (measured: 20 ms)."""

_MAX_RECORD = 1 << 18
_WRITERS = 64
_HEADER = b"\x00\x01\x00\x00"
_LENGTH = slice(4, 8)
_TEXT = 8


class PresenceTopic(EndpointReader):
    """The writer and reader of this topic.

    ``message_class`` is the raw class of `TYPE`; ``seen`` returns the GUID prefixes of the other participants on the
    network now; ``past`` are the prefixes of this daemon's dead participants; ``changed`` is called when another
    participant has sent a record.
    """

    def __init__(
        self, participant: Participant, loop: ReadLoop, message_class: Any, seen: Callable[[], frozenset[bytes]],
        past: frozenset[bytes], changed: Callable[[], None],
    ) -> None:  # fmt: skip
        self._loop, self._seen, self._past, self._changed = loop, seen, past, changed
        self._made_by = participant.marks.made_by
        self._since = time.monotonic()
        self._lock = threading.Lock()
        self._received: dict[bytes, Sighting] = {}
        self._first: dict[bytes, float] = {}
        self._writer: Any = participant.make_writer(message_class, TOPIC, _qos(1))
        super().__init__(participant, participant.make_reader(message_class, TOPIC, _qos(_WRITERS)))
        loop.add(self)

    def announce(self, record: bytes) -> None:
        """Publish a record."""
        length = len(record) + 1
        with self._lock:
            if self._writer is not None:
                rcl.publish(int(self._writer.pointer), _HEADER + length.to_bytes(4, "little") + record + b"\0")

    def sightings(self) -> Sequence[Sighting]:
        """Return the marked participants that are on the network, and those whose last record is recent."""
        now, seen = time.monotonic(), self._seen()
        with self._lock:
            for prefix, sighting in list(self._received.items()):
                if prefix not in seen and now - sighting.received > DISCOVERY_SECONDS:
                    del self._received[prefix]
            marked = {p for p in seen if self._made_by(p) is MadeBy.MIDSPAN} - self._past
            self._first = {p: self._first.get(p, now) for p in marked}
            silent = marked - self._received.keys()
            received = [
                sighting for prefix, sighting in self._received.items() if self._made_by(prefix) is MadeBy.MIDSPAN
            ]
            return [*received, *(Sighting(p.hex(), None, self._first[p]) for p in silent)]

    def settled(self, since: float) -> bool:
        """Return whether all participants that existed at ``since`` are discovered by now."""
        return time.monotonic() > max(since, self._since) + DISCOVERY_SECONDS

    @override
    def drain(self, taker: rcl.Taker, limit: int) -> None:
        for _ in range(limit):
            taken = taker.take(self.pointer, large=False)
            if taken is None:
                return
            payload, gid, _, _ = taken
            length = int.from_bytes(payload[_LENGTH], "little")
            prefix = gid[:PREFIX_BYTES]
            known = self._made_by(gid) is not MadeBy.NATIVE
            if known and prefix not in self._past and 0 < length <= min(_MAX_RECORD, len(payload) - _TEXT):
                record = payload[_TEXT : _TEXT + length - 1]
                with self._lock:
                    self._received[prefix] = Sighting(prefix.hex(), record, time.monotonic())
                self._changed()

    def close(self) -> None:
        """Destroy the writer and the reader."""
        with self._lock:
            writer, self._writer = self._writer, None
        if writer is not None:
            self._participant.destroy(writer)
            self._loop.remove(self)


def _qos(depth: int) -> Qos:
    return Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL, depth=depth)
