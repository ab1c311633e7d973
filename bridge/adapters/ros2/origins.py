"""Which ROS 2 origins on the hub are the very DDS network that this worker is on.

DDS networks have no identity: two of "domain 0" are one only if their participants see each other. So a Midspan
participant that is seen here is on our network. One that is not seen yet may still come: for a moment its origin
counts as ours, since nothing may cross while it is unknown where it comes from.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from pathlib import Path

from bridge.adapters.keep import keep
from bridge.adapters.ros2.mark import PREFIX_BYTES

DISCOVERY_SECONDS = 1.5
"""A participant announces itself each half second; see `bridge.adapters.ros2.profile`."""

_KEPT = 64
_PREDECESSORS = 4
"""Each one that started has told of those before it, unless it died at once."""
_MAX_SEEN = 1000
"""Origins whose moment is remembered; the oldest is forgotten, and would have its moment again."""
_FILE = "prefixes"


class Origins:
    """Tells own origins from foreign ones.

    Args:
        own: our participant's GUID prefix.
        folder: where the prefixes of this daemon's past participants are kept: a hub session may outlive its dead
            worker for some seconds, and its origin is ours.
        participants: the GUID prefixes that are on our DDS network now.
        settled: called when an origin's moment is over.

    Attributes:
        past: the prefixes of this daemon's participants, dead ones and ours.
        predecessors: the newest of the dead ones.
    """

    def __init__(
        self, own: bytes, folder: Path, participants: Callable[[], frozenset[bytes]], settled: Callable[[], None]
    ) -> None:
        self._participants, self._settled = participants, settled
        kept = _remember(own, folder)
        self.past = frozenset(kept)
        self.predecessors = kept[:-1][-_PREDECESSORS:]
        self._lock = threading.Lock()
        self._first_seen: dict[bytes, float] = {}
        self._timers: list[threading.Timer] = []

    def is_own(self, network: str) -> bool:
        """Whether the origin with this network identity (24 hex digits) is ours."""
        try:
            prefix = bytes.fromhex(network)
        except ValueError:
            return False
        if prefix in self.past or prefix in self._participants():
            return True
        now = time.monotonic()
        with self._lock:
            first = self._first_seen.get(prefix)
            if first is None:
                if len(self._first_seen) >= _MAX_SEEN:
                    del self._first_seen[next(iter(self._first_seen))]
                first = self._first_seen[prefix] = now
                timer = threading.Timer(DISCOVERY_SECONDS, self._settled)
                timer.daemon = True
                timer.start()
                self._timers = [t for t in self._timers if t.is_alive()] + [timer]
        return now - first < DISCOVERY_SECONDS

    def close(self) -> None:
        """End the timers."""
        with self._lock:
            timers, self._timers = self._timers, []
        for timer in timers:
            timer.cancel()
            timer.join()


def kept_prefixes(folder: Path) -> list[bytes]:
    """The prefixes of this daemon's past participants, the newest last."""
    found = []
    try:
        lines = (folder / _FILE).read_text(errors="replace").split()
    except OSError:
        return []
    for line in lines:
        with contextlib.suppress(ValueError):
            found.append(bytes.fromhex(line))
    return [prefix for prefix in found if len(prefix) == PREFIX_BYTES]


def _remember(own: bytes, folder: Path) -> list[bytes]:
    """Add our prefix to those kept, and return them all, ours last."""
    prefixes = [*(p for p in kept_prefixes(folder) if p != own), own][-_KEPT:]
    text = "".join(f"{prefix.hex()}\n" for prefix in prefixes)
    keep(folder / _FILE, text, "for some seconds after a crash, topics of its own may come back")
    return prefixes
