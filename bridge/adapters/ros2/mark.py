"""The mark by which Midspan's own DDS participants are known: part of their GUID prefix.

A GUID prefix has 12 bytes (DDSI-RTPS 2.5, 9.3.1.5). Fast DDS makes bytes 0 to 3 of vendor and host; ours keep them, so
that neighbours are still taken for neighbours. Bytes 4 to 7 are random, 8 to 11 are the mark. Each message and each
endpoint carries its GUID, so who made it is known at once, whatever the nodes are called.
"""

from __future__ import annotations

import os

PREFIX_BYTES = 12
_MARK = b"MSPN"


def new_prefix(host: bytes) -> bytes:
    """A fresh marked prefix; ``host`` is the four bytes that Fast DDS gives to participants of this host."""
    return host + os.urandom(4) + _MARK


def is_marked(gid: bytes) -> bool:
    """Whether a GUID, or its prefix, is a Midspan participant's."""
    return gid[8:PREFIX_BYTES] == _MARK
