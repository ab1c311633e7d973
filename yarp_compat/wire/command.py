"""The word to a port that every message begins with: data, an administrative message, a request to connect, and so on.

In binary: int32 length of a text (with its NUL), ``~``, the key, 0, 1, and that text where there is one; a text's
first character is then the key. As text: one line, whose first character is the key.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from yarp_compat.wire.errors import WireError

_HEAD = struct.Struct("<isBBB")

LONGEST_TEXT = 4096
"""Bytes of the longest envelope or command."""


@dataclass(frozen=True, slots=True)
class PortCommand:
    """One word to a port.

    Attributes:
        key: its first character, which tells what it is: ``d``, ``D`` (data), ``a``, ``q``, ``*``, ``/``, ``!``,
            ``~``, ``r``, ``?``, ``i``.
        text: all of it, where it is longer than its key.
    """

    key: str
    text: str = ""

    @property
    def envelope(self) -> str:
        """The envelope of a message of data."""
        return self.text[2:]


def binary(key: str, text: str = "") -> bytes:
    """A command's bytes; ``text`` must begin with the key (``D 12 1795143618.02``)."""
    if not text:
        return _HEAD.pack(0, b"~", ord(key), 0, 1)
    told = text.encode()
    return _HEAD.pack(len(told) + 1, b"~", 0, 0, 1) + told + b"\0"


def with_envelope(key: str, envelope: str) -> bytes:
    """A command for data with an envelope; without one where that is empty."""
    return binary(key, f"{key} {envelope}") if envelope else binary(key)


def parse(data: bytes | bytearray | memoryview, offset: int = 0, end: int | None = None) -> tuple[PortCommand, int]:
    """Read a command in binary; returns it and where the data behind it begin.

    Raises:
        WireError: where there is none, or its text is too long or no text.
    """
    end = len(data) if end is None else end
    if end - offset < _HEAD.size:
        msg = f"a port command takes 8 bytes and {end - offset} came"
        raise WireError(msg)
    length, mark, key, _, _ = _HEAD.unpack_from(data, offset)
    if mark != b"~":
        msg = f"no port command: {bytes(data[offset : offset + 8])!r}"
        raise WireError(msg)
    offset += _HEAD.size
    if key:
        return PortCommand(chr(key)), offset
    told = bytes(data[offset : min(end, offset + LONGEST_TEXT)])
    stop = told.find(b"\0")
    if stop < 0:
        msg = f"a port command's text of {length} bytes has no end within its message, or within {LONGEST_TEXT} bytes"
        raise WireError(msg)
    text = _text(told[:stop])
    return PortCommand(text[:1], text), offset + stop + 1


def parse_line(line: bytes) -> PortCommand:
    """Read a command in text."""
    text = _text(line)
    return PortCommand(text[:1], text)


def _text(data: bytes) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        msg = f"a port command is no text: {data[:60]!r}"
        raise WireError(msg) from error


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
