"""One message on a tcp connection: its index, its command, its payload, and the acknowledgement.

A message is ``YA 10 RP``, the number of blocks to the acceptor and back (1 byte each), 8 bytes of 0xff, an int32
length for each block (back: 0), then the blocks, which belong together.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from yarp_compat.wire import command
from yarp_compat.wire.carriers import frame, framed
from yarp_compat.wire.errors import WireError

Buffer = bytes | bytearray | memoryview

INDEX = frame(10)
ACK = frame(0)
DEFAULT_LIMIT = 64 << 20
"""Bytes of the largest message that is taken unless another limit is given."""

_FILL = b"\xff" * 8
_START = INDEX + b"\x02\x01" + _FILL
HEAD_SIZE = 18
_TWO_BLOCKS = struct.Struct("<18sIIi")
_QUIT = command.binary("", "q")
QUIT = INDEX + b"\x01\x01" + _FILL + struct.pack("<ii", len(_QUIT), 0) + _QUIT
"""The message that ends a connection politely."""

JOINED = 1 << 14
"""Bytes up to which buffers are put together: cheaper than to hand the system several."""

_DATA = {key: command.binary(key) for key in "dDa"}


def size(payload: Buffer | Sequence[Buffer]) -> int:
    """Bytes of a payload in one or several buffers."""
    if isinstance(payload, (bytes, bytearray)):
        return len(payload)
    if isinstance(payload, memoryview):
        return payload.nbytes
    return sum(len(b) if isinstance(b, (bytes, bytearray)) else b.nbytes for b in payload)


def prefix(length: int, key: str = "D", envelope: str = "") -> bytes:
    """All that comes before a payload of ``length`` bytes."""
    word = command.with_envelope(key, envelope) if envelope else _DATA.get(key) or command.binary(key)
    return _TWO_BLOCKS.pack(_START, len(word), length, 0) + word


def words(text: str) -> bytes:
    """A message that is only a command, such as ``q`` or ``/reader``."""
    word = command.binary("", text)
    return INDEX + b"\x01\x01" + _FILL + struct.pack("<ii", len(word), 0) + word


def index_size(head: Buffer, offset: int = 0) -> int:
    """How long the index is whose first 18 bytes stand at ``offset``.

    Raises:
        WireError: where no index stands there.
    """
    value = framed(head, offset)
    if value != 10:
        msg = f"no message begins with {bytes(head[offset : offset + 8])!r}"
        raise WireError(msg)
    return HEAD_SIZE + 4 * (head[offset + 8] + head[offset + 9])


def body_size(index: Buffer, offset: int = 0, limit: int = DEFAULT_LIMIT) -> int:
    """How many bytes follow a whole index: the sum of its blocks.

    Raises:
        WireError: for a negative length, or more than ``limit`` bytes.
    """
    blocks = index[offset + 8]
    lengths = struct.unpack_from(f"<{blocks}i", index, offset + HEAD_SIZE)
    total: int = sum(lengths)
    if lengths and min(lengths) < 0:
        msg = f"a message announces a block of {min(lengths)} bytes"
        raise WireError(msg)
    if total > limit:
        msg = f"a message announces {total} bytes; at most {limit} are taken"
        raise WireError(msg)
    return total


def parse(data: Buffer, limit: int = DEFAULT_LIMIT) -> tuple[command.PortCommand, Buffer]:
    """Read exactly one whole message: its command and its payload.

    Raises:
        WireError: for anything else.
    """
    if len(data) < HEAD_SIZE or len(data) < (start := index_size(data)):
        msg = f"{len(data)} bytes hold no whole index"
        raise WireError(msg)
    total = body_size(data, 0, limit)
    if len(data) != start + total:
        msg = f"a message announces {start + total} bytes and {len(data)} came"
        raise WireError(msg)
    word, body = command.parse(data, start, start + total)
    return word, data[body:]
