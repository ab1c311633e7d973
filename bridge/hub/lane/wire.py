"""Records on a lane, each a packet of a Unix SEQPACKET socket.

A record begins with its kind and the number that the reader assigned to the key. A ``DATA`` record has one or several
messages, each with kind, number, size of the payload, attachment of the zenoh sample, payload. ``PART`` is a fragment
of a message that is too large for one record: attachment, total size, offset of the fragment, the fragment. ``MARK``:
the publisher of its attachment sends the messages after this number here. The reader requests a key with ``ON`` and its
UTF-8, and releases it with ``OFF``; the writer returns a ``FENCE`` after everything that it sent before.
"""

from __future__ import annotations

import struct

from bridge.hub.wire.keys import ATTACHMENT_SIZE, GID_SIZE

VERSION = 2
"""Part of a socket's name, so that workers of different versions do not connect."""

BOUND = 64 * 1024
"""Bytes of the largest payload in one record; topics with larger ones stay on zenoh."""

DATA, PART, MARK, FENCE, ON, OFF = range(1, 7)

HEAD = struct.Struct("<BI")
PIECE = struct.Struct("<II")
TOKEN = struct.Struct("<Q")
SIZE = struct.Struct("<I")
SAMPLE = struct.Struct(f"<BIIqqx{GID_SIZE}s")
"""What precedes the payload of a message in a ``DATA`` record: a head, the size of the payload, and the attachment:
number, time and GID, whose length is skipped (`bridge.hub.wire.keys`)."""

BODY = HEAD.size + ATTACHMENT_SIZE
"""Offset of what follows the attachment in other records."""

ROOM = BODY + PIECE.size + BOUND
"""Bytes of the largest record."""

MAX_KEYS = 100_000
MAX_KEY = 4096


def prefix(key: str) -> str:
    """Return a key without its last part, the type's hash."""
    return key.rpartition("/")[0]


def fits(wanted: str, key: str) -> bool:
    """Return whether the key of a subscription matches the key of a publisher."""
    return wanted == key or (wanted.endswith("/*") and prefix(wanted) == prefix(key))
