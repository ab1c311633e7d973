"""Records on a lane, each a packet of a Unix SEQPACKET socket.

A record begins with its kind and the number that the reader gave the key. ``DATA`` carries on with the attachment that
zenoh would carry, and the payload. ``PART`` is a piece of a message that is too large for one record: attachment, bytes
of the whole, where this piece begins, the piece. ``MARK`` says that the publisher of its attachment sends what follows
that number here. The reader asks for a key with ``ON`` and its UTF-8, gives it up with ``OFF``, and has a ``FENCE``
come back behind all that was sent before it.
"""

from __future__ import annotations

import struct

from bridge.hub.wire.keys import ATTACHMENT_SIZE

VERSION = 1
"""Stands in a socket's name: workers of two versions do not find each other."""

BOUND = 64 * 1024
"""Bytes of the largest payload in one record; topics with larger ones stay on zenoh."""

DATA, PART, MARK, FENCE, ON, OFF = range(1, 7)

HEAD = struct.Struct("<BI")
PIECE = struct.Struct("<II")
TOKEN = struct.Struct("<Q")
BODY = HEAD.size + ATTACHMENT_SIZE
"""Where the payload of a ``DATA`` record begins."""

ROOM = BODY + PIECE.size + BOUND
"""Bytes of the largest record."""

MAX_KEYS = 100_000
MAX_KEY = 4096


def prefix(key: str) -> str:
    """A key without its last part, the type's hash."""
    return key.rpartition("/")[0]


def fits(wanted: str, key: str) -> bool:
    """Whether a subscription's key means a publisher's."""
    return wanted == key or (wanted.endswith("/*") and prefix(wanted) == prefix(key))
