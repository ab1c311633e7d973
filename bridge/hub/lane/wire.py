"""Records on a lane, each a packet of a Unix SEQPACKET socket.

A record begins with its kind and the number that the reader assigned to the key. A ``DATA`` record has one or several
messages, each with kind, number, size of the payload, attachment of the zenoh sample, payload. A ``BLOCK`` record lends
a larger message (`bridge.hub.lane.blocks`): attachment, size of the payload, numbers of the loan and of the block, and
the block's file; the reader ends the loan with ``FREE`` and the loan's number. Without a block, a large message is sent
as ``PART`` records: attachment, total size, offset of the fragment, the fragment. A ``MARK`` record has an attachment,
whose publisher sends all messages after the attachment's number on this lane. The reader requests a key with ``ON`` and
the key in UTF-8, and releases it with ``OFF``. It sends a ``FENCE``, which the writer returns after everything that it
sent before.
"""

from __future__ import annotations

import struct

from bridge.hub.wire.keys import ATTACHMENT_SIZE, GID_SIZE

VERSION = 3
"""Part of a socket's name, so that workers of different versions do not connect."""

BOUND = 64 * 1024
"""Maximum size in bytes of a payload in one record; larger messages are lent, or sent in parts."""

DATA, PART, MARK, FENCE, ON, OFF, BLOCK, FREE = range(1, 9)

HEAD = struct.Struct("<BI")
PIECE = struct.Struct("<II")
LOAN = struct.Struct("<III")
TOKEN = struct.Struct("<Q")
SIZE = struct.Struct("<I")
SAMPLE = struct.Struct(f"<BIIqqx{GID_SIZE}s")
"""The bytes before the payload of a message in a ``DATA`` record: head, payload size, and the attachment's number, time
and GID (`bridge.hub.wire.keys`); the byte with the GID's length is skipped."""

BODY = HEAD.size + ATTACHMENT_SIZE
"""Offset of the data after the attachment in other records."""

ROOM = BODY + PIECE.size + BOUND
"""Maximum size of a record in bytes."""

MAX_KEYS = 100_000
MAX_KEY = 4096


def prefix(key: str) -> str:
    """Return a key without its last part, the type's hash."""
    return key.rpartition("/")[0]


def fits(wanted: str, key: str) -> bool:
    """Return whether the key of a subscription matches the key of a publisher."""
    return wanted == key or (wanted.endswith("/*") and prefix(wanted) == prefix(key))
