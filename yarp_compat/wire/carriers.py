"""The carriers: how a connection introduces itself, and what is then said on it.

Facts: measured on YARP 3.12.3 and 4.0; ``TcpCarrier``, ``UdpCarrier``, ``TextCarrier`` and others of the YARP sources.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from yarp_compat.wire.errors import WireError

_MAGIC = struct.Struct("<2si2s")
_BASE = 7777
_ACK = 128
_SPECIFIERS = 16


class CarrierError(WireError):
    """A carrier of YARP that is not offered here; the text names it, and those that are."""


@dataclass(frozen=True, slots=True, eq=False)
class Carrier:
    """One way of carrying messages; there is one object of each.

    Attributes:
        name: as in ``tcp://port``.
        opening: the first 8 bytes that the initiator sends.
        ack: each message is acknowledged.
        reply: a message may be answered.
        text: messages are lines of text.
        connectionless: datagrams; the acceptor does not notice when the sender goes.
    """

    name: str
    opening: bytes
    ack: bool = False
    reply: bool = True
    text: bool = False
    connectionless: bool = False


def frame(value: int) -> bytes:
    """The 8 bytes ``YA <int32> RP``: they open a connection, answer its opening, begin a message, acknowledge it."""
    return _MAGIC.pack(b"YA", value, b"RP")


def framed(data: bytes | bytearray | memoryview, offset: int = 0) -> int | None:
    """The number in 8 bytes of :func:`frame`, or None where they are something else."""
    head, value, tail = _MAGIC.unpack_from(data, offset)
    return value if head == b"YA" and tail == b"RP" else None


def _yarp(specifier: int) -> bytes:
    return frame(_BASE + specifier)


TCP = Carrier("tcp", _yarp(3 + _ACK), ack=True)
FAST_TCP = Carrier("fast_tcp", _yarp(3))
UDP = Carrier("udp", _yarp(0), reply=False, connectionless=True)
TEXT = Carrier("text", b"CONNECT ", text=True, reply=False)
TEXT_ACK = Carrier("text_ack", b"CONNACK ", ack=True, text=True)
NAME_SER = Carrier("name_ser", b"NAME_SER", text=True)
LOCAL = Carrier("local", b"LOCALITY")
HTTP = Carrier("http", b"GET /", text=True)

CARRIERS = {c.name: c for c in (HTTP, NAME_SER, LOCAL, TCP, FAST_TCP, UDP, TEXT, TEXT_ACK)}
"""By name, in the order in which YARP announces them."""

OUTPUTS = (TCP, FAST_TCP, UDP, TEXT, TEXT_ACK, LOCAL)
"""What an output connection can be made with."""

_UNKNOWN_HERE = {1: "mcast", 14: "shmem"}
_OTHERS = frozenset(
    ["bayer", "depthimage", "depthimage2", "h264", "human", "mcast", "mjpeg", "mpi", "mpibcast", "portmonitor",
     "priority", "rossrv", "rtsp", "shmem", "tcpros", "unix_stream", "websocket", "xmlrpc", "zfp"]
)  # fmt: skip


def parse(text: str) -> tuple[Carrier, str]:
    """The carrier of ``tcp`` or ``tcp+recv.portmonitor+type.dll``, and its qualifiers (``recv.portmonitor+type.dll``).

    Raises:
        WireError: for a carrier that is not offered here.
    """
    name, _, qualifiers = text.partition("+")
    carrier = CARRIERS.get(name)
    if carrier is None or carrier not in OUTPUTS:
        known = ", ".join(c.name for c in OUTPUTS)
        what = "a YARP carrier that is not offered here" if name in _OTHERS or carrier else "unknown"
        msg = f"carrier {name[:60]!r} is {what}; use one of {known}"
        raise CarrierError(msg)
    return carrier, qualifiers


def recognise(opening: bytes | bytearray | memoryview) -> Carrier:
    """The carrier that a connection's first 8 bytes choose.

    Raises:
        WireError: for openings of a carrier that is not offered here (it is named), and for anything else.
    """
    first = bytes(opening[:8])
    value = framed(first)
    if value is not None:
        specifier = (value - _BASE) % _SPECIFIERS
        acknowledged = bool((value - _BASE) & _ACK)
        if value >= _BASE and specifier == 3:
            return TCP if acknowledged else FAST_TCP
        if value >= _BASE and specifier == 0:
            return UDP
        other = _UNKNOWN_HERE.get(specifier, f"number {specifier}") if value >= _BASE else f"number {value}"
        msg = f"carrier {other} is not offered here; use one of {', '.join(CARRIERS)}"
        raise CarrierError(msg)
    for carrier in (TEXT, TEXT_ACK, NAME_SER, LOCAL):
        if first == carrier.opening:
            return carrier
    if first.startswith(b"GET /") or first == b"POST /fo":
        return HTTP
    msg = f"no carrier begins with {first!r}; use one of {', '.join(CARRIERS)}"
    raise WireError(msg)
