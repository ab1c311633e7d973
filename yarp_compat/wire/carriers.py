"""The carriers, and the opening of a connection: the caller's introduction and the acceptor's answer.

Facts: measured on YARP 3.12.3 and 4.0; ``TcpCarrier``, ``UdpCarrier``, ``TextCarrier`` and others of the YARP sources.
"""

from __future__ import annotations

import ipaddress
import struct
from dataclasses import dataclass

from yarp_compat.wire.errors import WireError

_MAGIC = struct.Struct("<2si2s")
_BASE = 7777
_ACK = 128
_SPECIFIERS = 16


class CarrierError(WireError):
    """A carrier of YARP that is not offered here; the text names it and the offered ones."""


@dataclass(frozen=True, slots=True, eq=False)
class Carrier:
    """One way of carrying messages; there is one object of each."""

    name: str  # as in ``tcp://port``
    opening: bytes  # the first 8 bytes that the initiator sends
    ack: bool = False  # each message is acknowledged
    reply: bool = True  # a message may be answered
    text: bool = False  # messages are lines of text
    connectionless: bool = False  # datagrams; the acceptor does not notice when the sender goes


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
MCAST = Carrier("mcast", _yarp(1), reply=False, connectionless=True)
TEXT = Carrier("text", b"CONNECT ", text=True, reply=False)
TEXT_ACK = Carrier("text_ack", b"CONNACK ", ack=True, text=True)
NAME_SER = Carrier("name_ser", b"NAME_SER", text=True)
LOCAL = Carrier("local", b"LOCALITY")
HTTP = Carrier("http", b"GET /", text=True)

CARRIERS = {c.name: c for c in (HTTP, NAME_SER, LOCAL, TCP, FAST_TCP, MCAST, UDP, TEXT, TEXT_ACK)}
"""By name, in the order in which YARP announces them."""

OUTPUTS = (TCP, FAST_TCP, UDP, MCAST, TEXT, TEXT_ACK, LOCAL)  # the carriers of output connections

_UNKNOWN_HERE = {14: "shmem"}
_OTHERS = frozenset(
    ["bayer", "depthimage", "depthimage2", "h264", "human", "mjpeg", "mpi", "mpibcast", "portmonitor",
     "priority", "rossrv", "rtsp", "shmem", "tcpros", "unix_stream", "websocket", "xmlrpc", "zfp"]
)  # fmt: skip


def parse(text: str) -> tuple[Carrier, str]:
    """The carrier and qualifiers of ``tcp+recv.portmonitor+type.dll``; raises `CarrierError` for others."""
    name, _, qualifiers = text.partition("+")
    carrier = CARRIERS.get(name)
    if carrier is None or carrier not in OUTPUTS:
        known = ", ".join(c.name for c in OUTPUTS)
        what = "a YARP carrier that is not offered here" if name in _OTHERS or carrier else "unknown"
        raise CarrierError(f"carrier {name[:60]!r} is {what}; use one of {known}")
    return carrier, qualifiers


def recognise(opening: bytes | bytearray | memoryview) -> Carrier:
    """The carrier that 8 first bytes choose; raises `CarrierError` for one not offered here, `WireError` for else."""
    first = bytes(opening[:8])
    value = framed(first)
    if value is not None:
        specifier = (value - _BASE) % _SPECIFIERS
        acknowledged = bool((value - _BASE) & _ACK)
        if value >= _BASE and specifier == 3:
            return TCP if acknowledged else FAST_TCP
        if value >= _BASE and specifier in (0, 1):
            return MCAST if specifier else UDP
        other = _UNKNOWN_HERE.get(specifier, f"number {specifier}") if value >= _BASE else f"number {value}"
        raise CarrierError(f"carrier {other} is not offered here; use one of {', '.join(CARRIERS)}")
    for carrier in (TEXT, TEXT_ACK, NAME_SER, LOCAL):
        if first == carrier.opening:
            return carrier
    if first.startswith(b"GET /") or first == b"POST /fo":
        return HTTP
    raise WireError(f"no carrier begins with {first!r}; use one of {', '.join(CARRIERS)}")


LONGEST_NAME = 2048  # bytes of the longest sender name that is taken, its qualifiers among them
_LENGTH = struct.Struct("<i")
_PORT = struct.Struct(">H")
_GROUP_SIZE = 6

Group = tuple[str, int]


@dataclass(frozen=True, slots=True)
class Opening:
    """An initiator's introduction."""

    carrier: Carrier  # chosen by the first 8 bytes
    sender: str  # the name that the initiator gave
    qualifiers: str  # what followed the name, such as ``(recv portmonitor) (type dll)``
    size: int  # bytes of the introduction; what follows is the first message
    group: Group | None = None  # with mcast the group's IPv4 address and UDP port

    @property
    def modifiers(self) -> set[str]:
        """The keys of the qualifiers: ``recv`` and ``send`` say whose modifier of messages is wanted."""
        return {part.strip("() ").partition(" ")[0] for part in self.qualifiers.split(") (") if part}


def opening(carrier: Carrier, sender: str, qualifiers: str = "", group: Group | None = None) -> bytes:
    """The bytes with which a port introduces itself, with mcast with the group.

    ``qualifiers`` as in the carrier's name (``recv.portmonitor+type.dll``) go behind the sender's name.
    """
    name = " ".join([sender, *(f"({key} {value})" for key, _, value in (q.partition(".") for q in _split(qualifiers)))])
    text = name.encode()
    if carrier.text:
        return carrier.opening + text + b"\r\n"
    tail = b"" if group is None else ipaddress.IPv4Address(group[0]).packed + _PORT.pack(group[1])
    return carrier.opening + _LENGTH.pack(len(text) + 1) + text + b"\0" + tail


def _split(qualifiers: str) -> list[str]:
    return [q for q in qualifiers.split("+") if q]


def parse_opening(data: bytes | bytearray) -> Opening | None:
    """Read an initiator's introduction; None while bytes are missing.

    The carriers ``http`` and ``name_ser`` have none beyond their first bytes: all of these belong to the request, and
    ``size`` is 0. Raises `WireError` for a carrier that is not offered here, a bad length, a name too long or no text.
    """
    if len(data) < 8:
        return None
    carrier = recognise(data)
    if carrier is HTTP or carrier is NAME_SER:
        return Opening(carrier, "web" if carrier is HTTP else "anon", "", 0)
    return _text_opening(carrier, data) if carrier.text else _binary_opening(carrier, data)


def _text_opening(carrier: Carrier, data: bytes | bytearray) -> Opening | None:
    end = data.find(b"\n", 8, 8 + LONGEST_NAME)
    if end < 0:
        if len(data) >= 8 + LONGEST_NAME:
            raise WireError(f"the sender's name is longer than {LONGEST_NAME} bytes")
        return None
    return _opening(carrier, bytes(data[8:end]).rstrip(b"\r"), end + 1)


def _binary_opening(carrier: Carrier, data: bytes | bytearray) -> Opening | None:
    if len(data) < 12:
        return None
    (length,) = _LENGTH.unpack_from(data, 8)
    if not 0 < length <= LONGEST_NAME:
        raise WireError(f"the sender's name is announced with {length} bytes; 1 to {LONGEST_NAME} are possible")
    size = 12 + length + (_GROUP_SIZE if carrier is MCAST else 0)
    if len(data) < size:
        return None
    group = _group(bytes(data[12 + length : size])) if carrier is MCAST else None
    return _opening(carrier, bytes(data[12 : 12 + length]).rstrip(b"\0"), size, group)


def _group(said: bytes) -> Group:
    """The multicast group behind the sender's name: its address and, big-endian, its port (`McastCarrier.cpp`)."""
    address, (port,) = ipaddress.IPv4Address(said[:4]), _PORT.unpack_from(said, 4)
    if not address.is_multicast or port == 0:
        raise WireError(f"{address} port {port} is no multicast group, which mcast needs")
    return str(address), port


def _opening(carrier: Carrier, text: bytes, size: int, group: Group | None = None) -> Opening:
    try:
        name = text.decode()
    except UnicodeDecodeError as error:
        raise WireError(f"the sender's name is no text: {text[:60]!r}") from error
    sender, _, qualifiers = name.partition(" (")
    if any(ord(c) < 32 for c in name):
        raise WireError(f"the sender's name holds control characters: {name[:60]!r}")
    return Opening(carrier, sender, f"({qualifiers}" if qualifiers else "", size, group)


def answer(opened: Opening, port: int) -> bytes:
    """The acceptor's answer to an introduction, with its TCP port, with udp that for datagrams; with mcast nothing."""
    if opened.carrier in (TEXT, TEXT_ACK):
        return f"Welcome {opened.sender}\r\n".encode()
    if opened.carrier in (TCP, FAST_TCP, UDP):
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
"""A YARP port's answer to an unknown opening, before it closes."""
