"""The frame of messages on a connection: the index, the command to the port, the payload, the acknowledgment.

A message on tcp is ``YA 10 RP``, the numbers of its blocks and of the reply's (1 byte each), 8 bytes of 0xff, an int32
length for each block (0 for the reply's), then the message's blocks, which are joined: the command, then the payload.

A command is data, an administrative message, a request to connect, and so on. In binary, a command that is only a key:
int32 0, ``~``, the key, 0, 1. A longer one: int32 size of its text with NUL, ``~``, 0, 0, 1, and the text with NUL,
whose first character is the key. As text: one line, whose first character is the key.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from yarp_compat.wire.carriers import frame, framed
from yarp_compat.wire.errors import TooLargeError, WireError

_HEAD = struct.Struct("<isBBB")

LONGEST_TEXT = 4096  # maximum bytes of an envelope or command


@dataclass(frozen=True, slots=True)
class PortCommand:
    """A command to a port: its first character, the key, is its type (``d``, ``D``: data, ``a``, ``q``, ``*``...).

    ``text`` is the whole command; it is empty for a binary command without a text.
    """

    key: str
    text: str = ""

    @property
    def envelope(self) -> str:
        """The envelope of a data message."""
        return self.text[2:]


def command_bytes(key: str, text: str = "") -> bytes:
    """Encode a command; ``text`` must begin with the key (``D 12 1795143618.02``)."""
    if not text:
        return _HEAD.pack(0, b"~", ord(key), 0, 1)
    encoded = text.encode()
    return _HEAD.pack(len(encoded) + 1, b"~", 0, 0, 1) + encoded + b"\0"


def with_envelope(key: str, envelope: str) -> bytes:
    """Encode a data command with an envelope, which may be empty."""
    return command_bytes(key, f"{key} {envelope}") if envelope else command_bytes(key)


def parse_command(data: Buffer, offset: int = 0, end: int | None = None) -> tuple[PortCommand, int]:
    """Decode a binary command; return it and the start of the data. Raises `WireError` if invalid or too long."""
    end = len(data) if end is None else end
    if end - offset < _HEAD.size:
        raise WireError(f"a port command needs 8 bytes, not {end - offset}")
    length, mark, key, _, _ = _HEAD.unpack_from(data, offset)
    if mark != b"~":
        raise WireError(f"invalid port command: {bytes(data[offset : offset + 8])!r}")
    offset += _HEAD.size
    if key:
        return PortCommand(chr(key)), offset
    encoded = bytes(data[offset : min(end, offset + LONGEST_TEXT)])
    stop = encoded.find(b"\0")
    if stop < 0:
        raise WireError(
            f"a port command's text of {length} bytes is not terminated in its message, or in {LONGEST_TEXT} bytes"
        )
    text = _text(encoded[:stop])
    return PortCommand(text[:1], text), offset + stop + 1


def parse_command_line(line: bytes) -> PortCommand:
    """Decode a text command."""
    text = _text(line)
    return PortCommand(text[:1], text)


def _text(data: bytes) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise WireError(f"a port command is not text: {data[:60]!r}") from error


HELP = (
    "This is a YARP port.  Here are the commands it responds to:",
    "*       Gives a description of this port",
    "d       Signals the beginning of input for the port's owner",
    'do      The same as "d" except replies should be suppressed ("data-only")',
    "q       Disconnects",
    "r       Reverse connection type to be a reader",
    "/port   Requests to send output to /port",
    "!/port  Requests to stop sending output to /port",
    "~/port  Requests to stop receiving input from /port",
    "a       Signals the beginning of an administrative message",
    "?       Gives this help",
)
NOT_UNDERSTOOD = ("Port command not understood.", "Type d to send data to the port's owner.", "Type ? for help.")


Buffer = bytes | bytearray | memoryview

INDEX = frame(10)
ACK = frame(0)
DEFAULT_LIMIT = 64 << 20  # maximum bytes of a message by default

_FILL = b"\xff" * 8
_START = INDEX + b"\x02\x01" + _FILL
HEAD_SIZE = 18
_TWO_BLOCKS = struct.Struct("<18sIIi")
_QUIT = command_bytes("", "q")
QUIT = INDEX + b"\x01\x01" + _FILL + struct.pack("<ii", len(_QUIT), 0) + _QUIT
"""The message that closes a connection."""

JOINED = 1 << 14  # buffers up to this size are joined, which is cheaper than sending several

_DATA = {key: command_bytes(key) for key in "dDa"}


def acknowledgment(slack: int) -> bytes:
    """Return an acknowledgment followed by ``slack`` bytes, which it asks its reader to skip."""
    return frame(slack) + bytes(slack)


def size(payload: Buffer | Sequence[Buffer]) -> int:
    """Return the size in bytes of a payload in one or several buffers."""
    if isinstance(payload, (bytes, bytearray)):
        return len(payload)
    if isinstance(payload, memoryview):
        return payload.nbytes
    return sum(len(b) if isinstance(b, (bytes, bytearray)) else b.nbytes for b in payload)


def prefix(length: int, key: str = "D", envelope: str = "") -> bytes:
    """Return the index and command for a payload of ``length`` bytes."""
    command = with_envelope(key, envelope) if envelope else _DATA.get(key) or command_bytes(key)
    return _TWO_BLOCKS.pack(_START, len(command), length, 0) + command


def words(text: str) -> bytes:
    """Return a message with only a command, such as ``q`` or ``/reader``."""
    command = command_bytes("", text)
    return INDEX + b"\x01\x01" + _FILL + struct.pack("<ii", len(command), 0) + command


def index_size(head: Buffer, offset: int = 0) -> int:
    """Return the size of the index, given its first 18 bytes at ``offset``; raises `WireError` if invalid."""
    value = framed(head, offset)
    if value != 10:
        raise WireError(f"invalid message header {bytes(head[offset : offset + 8])!r}")
    return HEAD_SIZE + 4 * (head[offset + 8] + head[offset + 9])


def body_size(index: Buffer, offset: int = 0, limit: int = DEFAULT_LIMIT) -> int:
    """Return the number of bytes after an index; raises `WireError` for a negative length, or beyond ``limit``."""
    blocks = index[offset + 8]
    lengths = struct.unpack_from(f"<{blocks}i", index, offset + HEAD_SIZE)
    total: int = sum(lengths)
    if lengths and min(lengths) < 0:
        raise WireError(f"a message announces a block of {min(lengths)} bytes")
    if total > limit:
        raise TooLargeError(f"a message announces {total} bytes; the limit is {limit}")
    return total


def parse(data: Buffer, limit: int = DEFAULT_LIMIT) -> tuple[PortCommand, Buffer]:
    """Decode exactly one message into command and payload; raises `WireError` for anything else."""
    if len(data) < HEAD_SIZE or len(data) < (start := index_size(data)):
        raise WireError(f"incomplete index in {len(data)} bytes")
    total = body_size(data, 0, limit)
    if len(data) != start + total:
        raise WireError(f"a message announces {start + total} bytes, not {len(data)}")
    command, body = parse_command(data, start, start + total)
    return command, data[body:]
