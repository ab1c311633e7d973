"""The carriers, and the opening of a connection: the initiator's introduction and the acceptor's answer.

Sources: measurements on YARP 3.12.3 and 4.0; ``TcpCarrier``, ``UdpCarrier``, ``TextCarrier`` and others in YARP's code.
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
    """Raised if a carrier is not supported; the message names it and the supported ones."""


@dataclass(frozen=True, slots=True, eq=False)
class Carrier:
    """A carrier of messages; each is a singleton."""

    name: str  # as in ``tcp://port``
    opening: bytes  # the first bytes that the initiator sends, 8 except for http
    ack: bool = False  # each message is acknowledged
    reply: bool = True  # a message can have a reply
    text: bool = False  # messages are lines of text
    connectionless: bool = False  # datagrams; the acceptor cannot detect that the sender has left


def frame(value: int) -> bytes:
    """Return the 8 bytes ``YA <int32> RP``, used in openings, answers, message headers and acknowledgments."""
    return _MAGIC.pack(b"YA", value, b"RP")


def framed(data: bytes | bytearray | memoryview, offset: int = 0) -> int | None:
    """Return the number in 8 bytes of `frame`, or None for other bytes."""
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
"""The carriers by name, in YARP's order of announcement."""

OUTPUTS = (TCP, FAST_TCP, UDP, MCAST, TEXT, TEXT_ACK, LOCAL)  # the carriers of output connections

_UNKNOWN_HERE = {14: "shmem"}
_OTHERS = frozenset(
    ["bayer", "depthimage", "depthimage2", "h264", "human", "mjpeg", "mpi", "mpibcast", "portmonitor",
     "priority", "rossrv", "rtsp", "shmem", "tcpros", "unix_stream", "websocket", "xmlrpc", "zfp"]
)  # fmt: skip


def parse(text: str) -> tuple[Carrier, str]:
    """Parse ``tcp+recv.portmonitor+type.dll`` into carrier and qualifiers; raises `CarrierError` if unsupported."""
    name, _, qualifiers = text.partition("+")
    carrier = CARRIERS.get(name)
    if carrier is None or carrier not in OUTPUTS:
        known = ", ".join(c.name for c in OUTPUTS)
        problem = "not supported" if name in _OTHERS or carrier else "unknown"
        raise CarrierError(f"carrier {name[:60]!r} is {problem}; use one of {known}")
    return carrier, qualifiers


def recognize(opening: bytes | bytearray | memoryview) -> Carrier:
    """Return the carrier of the first 8 bytes; raises `CarrierError` if unsupported, `WireError` for other bytes."""
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
        raise CarrierError(f"carrier {other} is not supported; use one of {', '.join(CARRIERS)}")
    for carrier in (TEXT, TEXT_ACK, NAME_SER, LOCAL):
        if first == carrier.opening:
            return carrier
    if first.startswith(b"GET /") or first == b"POST /fo":
        return HTTP
    raise WireError(f"unknown carrier {first!r}; use one of {', '.join(CARRIERS)}")


LONGEST_NAME = 2048  # maximum bytes of a sender's name with its qualifiers
_LENGTH = struct.Struct("<i")
_PORT = struct.Struct(">H")
_GROUP_SIZE = 6

Group = tuple[str, int]


@dataclass(frozen=True, slots=True)
class Opening:
    """An initiator's introduction."""

    carrier: Carrier  # from the first 8 bytes
    sender: str  # the initiator's name
    qualifiers: str  # what followed the name, such as ``(recv portmonitor) (type dll)``
    size: int  # bytes of the introduction; the first message follows
    group: Group | None = None  # for mcast, the group's IPv4 address and UDP port

    @property
    def modifiers(self) -> set[str]:
        """The keys of the qualifiers: ``recv`` and ``send`` select the end that modifies messages."""
        return {part.strip("() ").partition(" ")[0] for part in self.qualifiers.split(") (") if part}


def opening(carrier: Carrier, sender: str, qualifiers: str = "", group: Group | None = None) -> bytes:
    """Return a port's introduction, for mcast with the group.

    ``qualifiers``, as in the carrier's name (``recv.portmonitor+type.dll``), follow the sender's name.
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

    The carriers ``http`` and ``name_ser`` have no introduction: their first bytes belong to the request, and ``size``
    is 0. Raises `WireError` for an unsupported carrier, an invalid length, or a name that is too long or not text.
    """
    if len(data) < 8:
        return None
    carrier = recognize(data)
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
        raise WireError(f"invalid length {length} of the sender's name; expected 1 to {LONGEST_NAME} bytes")
    size = 12 + length + (_GROUP_SIZE if carrier is MCAST else 0)
    if len(data) < size:
        return None
    group = _group(bytes(data[12 + length : size])) if carrier is MCAST else None
    return _opening(carrier, bytes(data[12 : 12 + length]).rstrip(b"\0"), size, group)


def _group(data: bytes) -> Group:
    """Parse the multicast group after the sender's name: its address and its port, big-endian (`McastCarrier.cpp`)."""
    address, (port,) = ipaddress.IPv4Address(data[:4]), _PORT.unpack_from(data, 4)
    if not address.is_multicast or port == 0:
        raise WireError(f"{address} port {port} is not a multicast group")
    return str(address), port


def _opening(carrier: Carrier, text: bytes, size: int, group: Group | None = None) -> Opening:
    try:
        name = text.decode()
    except UnicodeDecodeError as error:
        raise WireError(f"the sender's name is not text: {text[:60]!r}") from error
    sender, _, qualifiers = name.partition(" (")
    if any(ord(c) < 32 for c in name):
        raise WireError(f"the sender's name contains control characters: {name[:60]!r}")
    return Opening(carrier, sender, f"({qualifiers}" if qualifiers else "", size, group)


def answer(opened: Opening, port: int) -> bytes:
    """Return the answer to an introduction: a line for text, ``port`` for tcp, fast_tcp and udp, else nothing.

    ``port`` is the number of the TCP port, or for udp of the UDP port.
    """
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
