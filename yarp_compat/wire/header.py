"""How a connection opens: who calls, on which carrier, and what the acceptor answers."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from yarp_compat.wire import carriers
from yarp_compat.wire.carriers import Carrier, frame
from yarp_compat.wire.errors import WireError

LONGEST_NAME = 2048
"""Bytes of the longest sender name that is taken, its qualifiers among them."""
_LENGTH = struct.Struct("<i")


@dataclass(frozen=True, slots=True)
class Opening:
    """An initiator's introduction.

    Attributes:
        carrier: chosen by the first 8 bytes.
        sender: the name that the initiator gave.
        qualifiers: what followed the name, such as ``(recv portmonitor) (type dll)``.
        size: bytes of the introduction; what follows is the first message.
    """

    carrier: Carrier
    sender: str
    qualifiers: str
    size: int


def opening(carrier: Carrier, sender: str, qualifiers: str = "") -> bytes:
    """The bytes with which an initiator introduces itself.

    Args:
        carrier: the connection's.
        sender: the initiating port's name.
        qualifiers: ``recv.portmonitor+type.dll``, as in the carrier's name; told behind the sender's name.
    """
    name = " ".join([sender, *(f"({key} {value})" for key, _, value in (q.partition(".") for q in _split(qualifiers)))])
    text = name.encode()
    if carrier.text:
        return carrier.opening + text + b"\r\n"
    return carrier.opening + _LENGTH.pack(len(text) + 1) + text + b"\0"


def _split(qualifiers: str) -> list[str]:
    return [q for q in qualifiers.split("+") if q]


def parse_opening(data: bytes | bytearray) -> Opening | None:
    """Read an initiator's introduction.

    The carriers ``http`` and ``name_ser`` have none beyond their first bytes: all of these belong to the request, and
    ``size`` is 0.

    Returns:
        None while bytes are missing.

    Raises:
        WireError: for a carrier that is not offered here, a bad length, a name that is too long or no text.
    """
    if len(data) < 8:
        return None
    carrier = carriers.recognise(data)
    if carrier is carriers.HTTP or carrier is carriers.NAME_SER:
        return Opening(carrier, "web" if carrier is carriers.HTTP else "anon", "", 0)
    return _text_opening(carrier, data) if carrier.text else _binary_opening(carrier, data)


def _text_opening(carrier: Carrier, data: bytes | bytearray) -> Opening | None:
    end = data.find(b"\n", 8, 8 + LONGEST_NAME)
    if end < 0:
        if len(data) >= 8 + LONGEST_NAME:
            msg = f"the sender's name is longer than {LONGEST_NAME} bytes"
            raise WireError(msg)
        return None
    return _opening(carrier, bytes(data[8:end]).rstrip(b"\r"), end + 1)


def _binary_opening(carrier: Carrier, data: bytes | bytearray) -> Opening | None:
    if len(data) < 12:
        return None
    (length,) = _LENGTH.unpack_from(data, 8)
    if not 0 < length <= LONGEST_NAME:
        msg = f"the sender's name is announced with {length} bytes; 1 to {LONGEST_NAME} are possible"
        raise WireError(msg)
    if len(data) < 12 + length:
        return None
    return _opening(carrier, bytes(data[12 : 12 + length]).rstrip(b"\0"), 12 + length)


def _opening(carrier: Carrier, text: bytes, size: int) -> Opening:
    try:
        name = text.decode()
    except UnicodeDecodeError as error:
        msg = f"the sender's name is no text: {text[:60]!r}"
        raise WireError(msg) from error
    sender, _, qualifiers = name.partition(" (")
    if any(ord(c) < 32 for c in name):
        msg = f"the sender's name holds control characters: {name[:60]!r}"
        raise WireError(msg)
    return Opening(carrier, sender, f"({qualifiers}" if qualifiers else "", size)


def answer(opened: Opening, port: int) -> bytes:
    """What the acceptor says to an introduction.

    Args:
        opened: the introduction.
        port: the acceptor's TCP port, or with udp the port for the datagrams.
    """
    if opened.carrier in (carriers.TEXT, carriers.TEXT_ACK):
        return f"Welcome {opened.sender}\r\n".encode()
    if opened.carrier in (carriers.TCP, carriers.FAST_TCP, carriers.UDP):
        return frame(port)
    return b""


PROTOCOL_ERROR = (
    b"* Error. Protocol not found.\r\n"
    b"* Hello. You appear to be trying to communicate with a YARP Port.\r\n"
    b"* The first 8 bytes sent to a YARP Port are critical for identifying the\r\n"
    b"* protocol you wish to speak.\r\n"
    b"* The first 8 bytes you sent were not associated with any particular protocol.\r\n"
    b'* If you are a human, try typing "CONNECT foo" followed by a <RETURN>.\r\n'
    b'* The 8 bytes "CONNECT " correspond to a simple text-mode protocol.\r\n'
    b"* Goodbye.\r\n"
)
"""What a YARP port answers to an unknown opening, before it closes."""
