"""Decides which ROS 2 origins on the hub are on this worker's DDS network.

DDS networks have no identity: two networks with "domain 0" are one only if their participants discover each other. So a
Midspan participant that is discovered here is on this network. A participant that has not been discovered yet may
still appear. Its origin counts as being on this network for `DISCOVERY_SECONDS`, because nothing may be bridged while
an origin is unknown.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from bridge.concurrency import DelayedCalls
from bridge.state_file import keep

DISCOVERY_SECONDS = 1.5
"""A participant announces itself every half second; see `bridge.adapters.ros2.profile`."""

_MAX_STORED = 64
_PREDECESSORS = 4
"""More are not needed, because each participant disposed its predecessors when it started, unless it died at once."""
_MAX_SEEN = 1000
"""Number of origins whose first sight is remembered; the oldest is dropped, and would count as own again."""
_FILE = "prefixes"


class Origins:
    """Distinguishes own origins from foreign ones.

    ``own`` is this participant's GUID prefix. ``folder`` stores the prefixes of this daemon's participants: ``past``
    has all of them, ``predecessors`` the newest dead ones. Their origins count as own, because a hub session may
    outlive its dead worker for a few seconds. ``participants`` returns the GUID prefixes on this DDS network now;
    ``settled`` is called, through ``later``, when an origin's `DISCOVERY_SECONDS` are over.
    """

    def __init__(
        self, own: bytes, folder: Path, participants: Callable[[], frozenset[bytes]], settled: Callable[[], None],
        later: DelayedCalls,
    ) -> None:  # fmt: skip
        self._participants, self._settled, self._later = participants, settled, later
        kept = remember(own, folder)
        self.past = frozenset(kept)
        self.predecessors = kept[:-1][-_PREDECESSORS:]
        self._lock = threading.Lock()
        self._first_seen: dict[bytes, float] = {}

    def is_own(self, network: str) -> bool:
        """Return whether the origin with this network identity (24 hex digits) counts as own."""
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
                self._later.after(DISCOVERY_SECONDS, self._settled)
        return now - first < DISCOVERY_SECONDS


def stored_prefixes(folder: Path) -> list[bytes]:
    """Return the stored prefixes of this daemon's past participants, the newest last."""
    prefixes = []
    try:
        lines = (folder / _FILE).read_text(encoding="utf-8", errors="replace").split()
    except OSError:
        return []
    for line in lines:
        with contextlib.suppress(ValueError):
            prefixes.append(bytes.fromhex(line))
    return [prefix for prefix in prefixes if len(prefix) == PREFIX_BYTES]


def remember(own: bytes, folder: Path) -> list[bytes]:
    """Store this participant's prefix, and return all stored ones, the new one last."""
    prefixes = [*(p for p in stored_prefixes(folder) if p != own), own][-_MAX_STORED:]
    text = "".join(f"{prefix.hex()}\n" for prefix in prefixes)
    keep(folder / _FILE, text, "for a few seconds after a crash, its own topics may loop back")
    return prefixes


# -- the mark ----------------------------------------------------------------------------------------------------------
# A GUID prefix has 12 bytes (DDSI-RTPS 2.5, 9.3.1.5). Fast DDS derives bytes 0 to 3 from vendor and host; Midspan keeps
# them, so that participants still recognize neighbors. Bytes 4 to 7 are random, 8 to 11 are the mark. Each message and
# each endpoint carries its GUID, so its creator is known at once, independently of node names. In a secured domain DDS
# replaces the prefix: its first bit is 1, 47 bits are a hash of the subject of the participant's certificate, and 48 a
# hash of the GUID that the participant asked for (DDS-Security 1.1, 9.3.3; Fast DDS 2.14.5, ``PKIDH.cpp``).

PREFIX_BYTES = 12
_MARK = b"MSPN"


_FIRST_NUMBER, _NUMBERS = 32, 30
"""Other participants on a host count up from 0 and do not reach the first of these numbers. The ports of the last
number are below 65536 even in domain 232, the highest; Fast DDS ends the process if they are not."""
ALL_NUMBERS = _FIRST_NUMBER + _NUMBERS
"""The numbers of all participants on a host, including Midspan's, are below this."""
_RECENT = 8


def new_prefix(host: bytes, past: Sequence[bytes] = ()) -> bytes:
    """Return a new marked prefix; ``host`` is the four bytes that Fast DDS gives to participants of this host.

    A participant's ports follow from its number. If it reused a predecessor's ports, others would continue to write
    into the predecessor's shared memory, and their first messages would be lost until their heartbeats, up to 3 s
    later. So the numbers of the newest ``past`` participants are excluded.
    """
    taken = {participant_number(prefix) for prefix in [*filter(is_marked, past)][-_RECENT:]}
    while participant_number(prefix := host + os.urandom(4) + _MARK) in taken:
        pass
    return prefix


def participant_number(prefix: bytes) -> int:
    """Return the participant's number on its host for a marked prefix."""
    return _FIRST_NUMBER + prefix[4] % _NUMBERS


def is_secured(gid: bytes) -> bool:
    """Return whether a GUID, or its prefix, is of a participant in a secured domain, without its vendor and host."""
    return gid[:1] >= b"\x80"


def is_marked(gid: bytes) -> bool:
    """Return whether a GUID, or its prefix, has the mark of Midspan's participants on Fast DDS."""
    return gid[8:PREFIX_BYTES] == _MARK
