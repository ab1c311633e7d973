"""The mark by which Midspan's own DDS participants are known: part of their GUID prefix.

A GUID prefix has 12 bytes (DDSI-RTPS 2.5, 9.3.1.5). Fast DDS makes bytes 0 to 3 of vendor and host; ours keep them, so
that neighbours are still taken for neighbours. Bytes 4 to 7 are random, 8 to 11 are the mark. Each message and each
endpoint carries its GUID, so who made it is known at once, whatever the nodes are called.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

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
