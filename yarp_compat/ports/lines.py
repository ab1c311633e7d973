"""Bottles as lines of text, for the carriers that carry such."""

from __future__ import annotations

from yarp_compat.ports.message import Payload
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text, to_text


def to_line(payload: Payload, profile: Profile | None = None, *, plain: bool = False) -> bytes:
    """A Bottle's line, with its end.

    Args:
        payload: the Bottle.
        profile: its dialect; None: recognised.
        plain: it is text already, and stays as it is.

    Raises:
        WireError: it is no Bottle.
    """
    data = payload if isinstance(payload, (bytes, bytearray, memoryview)) else b"".join(payload)
    if plain:
        return bytes(data)
    return to_text(decode(data, profile)).encode(errors="surrogateescape") + b"\r\n"


def from_line(line: bytes, profile: Profile) -> bytes:
    """The Bottle of a line."""
    return encode(from_text(line.decode(errors="surrogateescape")), profile)
