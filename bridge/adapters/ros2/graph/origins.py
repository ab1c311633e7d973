"""Which ROS 2 origins on the hub are the very DDS network that this worker is on.

DDS networks have no identity: two of "domain 0" are one only if their participants see each other. So a Midspan
participant that is seen here is on our network. One that is not seen yet may still come: for a moment its origin
counts as ours, since nothing may cross while it is unknown where it comes from.
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
"""A participant announces itself each half second; see `bridge.adapters.ros2.profile`."""

_KEPT = 64
_PREDECESSORS = 4
"""Each one that started has told of those before it, unless it died at once."""
_MAX_SEEN = 1000
"""Origins whose moment is remembered; the oldest is forgotten, and would have its moment again."""
_FILE = "prefixes"


class Origins:
    """Tells own origins from foreign ones.

    ``own`` is our participant's GUID prefix. ``folder`` keeps those of this daemon's participants: ``past`` are all,
    ours last, ``predecessors`` the newest of the dead; a hub session may outlive its dead worker for some seconds, and
    its origin is ours. ``participants`` gives the GUID prefixes on our DDS network now; ``settled`` is called, by
    ``later``, when an origin's moment is over.
    """

    def __init__(
        self, own: bytes, folder: Path, participants: Callable[[], frozenset[bytes]], settled: Callable[[], None],
        later: DelayedCalls,
    ) -> None:  # fmt: skip
        self._participants, self._settled, self._later = participants, settled, later
        kept = _remember(own, folder)
        self.past = frozenset(kept)
        self.predecessors = kept[:-1][-_PREDECESSORS:]
        self._lock = threading.Lock()
        self._first_seen: dict[bytes, float] = {}

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
                self._later.after(DISCOVERY_SECONDS, self._settled)
        return now - first < DISCOVERY_SECONDS


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
    keep(folder / _FILE, text, "for some seconds after a crash, its own topics may loop back")
    return prefixes


# -- the mark ----------------------------------------------------------------------------------------------------------
# A GUID prefix has 12 bytes (DDSI-RTPS 2.5, 9.3.1.5). Fast DDS makes bytes 0 to 3 of vendor and host; ours keep them,
# so that neighbours are still taken for neighbours. Bytes 4 to 7 are random, 8 to 11 are the mark. Each message and
# each endpoint carries its GUID, so who made it is known at once, whatever the nodes are called.

PREFIX_BYTES = 12
_MARK = b"MSPN"


_FIRST_NUMBER, _NUMBERS = 32, 30
"""Above those that participants have which count up from 0; the last one's ports fit below 65536 in domain 232 too, the
highest: Fast DDS ends the process where they do not."""
_LATELY = 8


def new_prefix(host: bytes, past: Sequence[bytes] = ()) -> bytes:
    """A fresh marked prefix; ``host`` is the four bytes that Fast DDS gives to participants of this host.

    A participant's ports follow from its number. If it took those of a predecessor, others would go on writing into the
    dead one's shared memory: what they say first would be lost, and come again with their heartbeats, up to 3 s later.
    So its number is none that the last of the ``past`` ones had.
    """
    taken = {participant_number(prefix) for prefix in past[-_LATELY:]}
    while participant_number(prefix := host + os.urandom(4) + _MARK) in taken:
        pass
    return prefix


def participant_number(prefix: bytes) -> int:
    """The participant's number on its host that goes with a prefix of ours."""
    return _FIRST_NUMBER + prefix[4] % _NUMBERS


def is_marked(gid: bytes) -> bool:
    """Whether a GUID, or its prefix, is a Midspan participant's."""
    return gid[8:PREFIX_BYTES] == _MARK
