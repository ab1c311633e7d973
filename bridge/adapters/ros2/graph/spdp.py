"""Hand-written RTPS messages: dispose a dead participant, prompt all others to announce themselves, and heartbeats.

**Disposal.** Other participants notice a crash only when the lease expires, after 20 s. A short lease does not help:
after a longer suspension or disconnection, the others have dropped the participant, but it has not dropped them, and
such participants match again without ever completing their discovery (observed with Fast DDS 2.14.5: no data is
exchanged any longer). So the lease keeps its default, and the successor of a killed worker sends what a clean exit
would send: a ``DATA`` submessage with the status "disposed and unregistered" (DDSI-RTPS 2.5, 8.5.5.1, 9.4.5.4,
9.6.4.9).

**Prompt.** A new participant announces itself, and every other participant responds once, immediately. Fast DDS
receives only after its first announcement, so responses within a millisecond are lost, and their senders announce
themselves again up to 3 s later (this happened at every second start). So once Midspan's participant receives, it
announces and disposes a pseudo-participant with its own address, to which all others respond.
"""

from __future__ import annotations

import logging
import socket
import struct
from collections.abc import Iterable, Mapping, Sequence

from bridge.adapters.ros2.graph.origins import ALL_NUMBERS

MULTICAST = "239.255.0.1"
"""The SPDP multicast address (DDSI-RTPS 2.5, 9.6.1.4.1)."""

PARTICIPANTS = 32
"""Number of participants per machine and domain that are addressed by unicast, as in rmw_fastrtps for LOCALHOST."""

_log = logging.getLogger(__name__)

_LOOPBACK = "127.0.0.1"
_UDP_V4 = 1
_VERSION = b"\x02\x03"
_PARTICIPANT = b"\x00\x00\x01\xc1"
_SPDP_WRITER, _SPDP_READER = b"\x00\x01\x00\xc2", b"\x00\x01\x00\xc7"
_ANY_READER = bytes(4)
_DATA, _LITTLE_ENDIAN, _INLINE_QOS, _PAYLOAD, _KEY = 0x15, 0x01, 0x02, 0x04, 0x08
_HEARTBEAT, _FINAL = 0x07, 0x02
_BATCH = 40
"""Heartbeats in one message of 1.3 kB, which fits into an Ethernet frame."""

_TO_INLINE_QOS = 16
"""The submessage field octetsToInlineQos: the bytes from the end of this field to the inline QoS."""
_LAST = 0x7FFFFFFF
"""A sequence number above all that the dead participant used."""
_PID_SENTINEL, _PID_LEASE, _PID_VERSION, _PID_VENDOR = 0x0001, 0x0002, 0x0015, 0x0016
_PID_UNICAST, _PID_MULTICAST, _PID_GUID, _PID_ENDPOINTS = 0x0032, 0x0033, 0x0050, 0x0058
_PID_KEY_HASH, _PID_STATUS_INFO = 0x0070, 0x0071
_DISPOSED_AND_UNREGISTERED = b"\x00\x00\x00\x03"
_ANNOUNCER_AND_DETECTOR = struct.pack("<I", 0b11)
_LEASE = struct.pack("<iI", 1, 0)
_PL_CDR_LE = b"\x00\x03\x00\x00"


def disposal(prefix: bytes) -> bytes:
    """Return the RTPS message that disposes the participant with this GUID prefix (12 bytes)."""
    guid = prefix + _PARTICIPANT
    qos = _parameters((_PID_KEY_HASH, guid), (_PID_STATUS_INFO, _DISPOSED_AND_UNREGISTERED))
    return _message(prefix, _INLINE_QOS | _KEY, _LAST, qos + _PL_CDR_LE + _parameters((_PID_GUID, guid)))


def announcement(prefix: bytes, domain: int, number: int, also: int = 0) -> bytes:
    """Return the RTPS message that announces a participant without endpoints, at the address of another participant.

    ``prefix`` is the GUID prefix of the announced participant, ``number`` the number of the participant at the address;
    ``also`` is a further port for responses, 0 for none.
    """
    ports = [_unicast_port(domain, number), *([also] if also else [])]
    payload = _PL_CDR_LE + _parameters(
        (_PID_VERSION, _VERSION + bytes(2)),
        (_PID_VENDOR, prefix[:2] + bytes(2)),
        (_PID_GUID, prefix + _PARTICIPANT),
        *((_PID_UNICAST, _locator(_LOOPBACK, port)) for port in ports),
        (_PID_MULTICAST, _locator(MULTICAST, multicast_port(domain))),
        (_PID_LEASE, _LEASE),
        (_PID_ENDPOINTS, _ANNOUNCER_AND_DETECTOR),
    )
    return _message(prefix, _PAYLOAD, 1, payload)


def heartbeats(written: Mapping[bytes, int]) -> list[bytes]:
    """Return the RTPS messages that announce to all readers how many samples each writer has written.

    ``written`` has these numbers by the writers' GUIDs, all of one participant. The heartbeats are final: no reader
    responds to them (DDSI-RTPS 2.5, 9.4.5.7). Their count is 0, so that readers on Fast DDS ignore them.
    """
    submessages = [_heartbeat(guid[12:16], last) for guid, last in written.items()]
    prefix = next(iter(written), bytes(16))[:12]
    batches = [submessages[start : start + _BATCH] for start in range(0, len(submessages), _BATCH)]
    return [_header(prefix) + b"".join(batch) for batch in batches]


def _heartbeat(writer: bytes, last: int) -> bytes:
    body = _ANY_READER + writer + struct.pack("<iIiIi", 0, 1, last >> 32, last & 0xFFFFFFFF, 0)
    return struct.pack("<BBH", _HEARTBEAT, _LITTLE_ENDIAN | _FINAL, len(body)) + body


def send_all(messages: Sequence[bytes], domain: int, *, localhost_only: bool) -> None:
    """Send messages to all reachable participants, on loopback only or on all interfaces."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for interface, name in socket.if_nameindex():
            if name == "lo" or not localhost_only:
                _send_by(sender, interface, messages, domain)
        for number in range(PARTICIPANTS):
            _send(sender, messages, (_LOOPBACK, _unicast_port(domain, number)))


def send_to(addresses: Iterable[str], messages: Sequence[bytes], domain: int) -> None:
    """Send messages to all participants on other machines, which multicast may not reach."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for address in addresses:
            for number in range(ALL_NUMBERS):
                _send(sender, messages, (address, _unicast_port(domain, number)))


def _message(prefix: bytes, flags: int, number: int, content: bytes) -> bytes:
    """Return a header and one ``DATA`` submessage from an SPDP writer to all SPDP readers."""
    body = struct.pack("<HH", 0, _TO_INLINE_QOS) + _SPDP_READER + _SPDP_WRITER + struct.pack("<iI", 0, number) + content
    return _header(prefix) + struct.pack("<BBH", _DATA, _LITTLE_ENDIAN | flags, len(body)) + body


def _header(prefix: bytes) -> bytes:
    return b"RTPS" + _VERSION + prefix[:2] + prefix


def _parameters(*parameters: tuple[int, bytes]) -> bytes:
    """Return a parameter list (DDSI-RTPS 2.5, 9.4.2.11)."""
    listed = b"".join(struct.pack("<HH", pid, len(value)) + value for pid, value in parameters)
    return listed + struct.pack("<HH", _PID_SENTINEL, 0)


def _locator(address: str, port: int) -> bytes:
    return struct.pack("<iI", _UDP_V4, port) + bytes(12) + socket.inet_aton(address)


def multicast_port(domain: int) -> int:
    """Return the port of SPDP multicast (DDSI-RTPS 2.5, 9.6.2.3)."""
    return 7400 + 250 * domain


def _unicast_port(domain: int, number: int) -> int:
    return multicast_port(domain) + 10 + 2 * number


def discovery_ports(domain: int) -> range:
    """Return the well-known ports of a domain; each participant has one of them (DDSI-RTPS 2.5, 9.6.2.3)."""
    return range(_unicast_port(domain, 0), multicast_port(domain + 1), 2)


def unicast_ports(domain: int, number: int) -> tuple[int, int]:
    """Return a participant's well-known unicast ports, for discovery and for data (DDSI-RTPS 2.5, 9.6.2.3)."""
    port = _unicast_port(domain, number)
    return port, port + 1


def _send_by(sender: socket.socket, interface: int, messages: Iterable[bytes], domain: int) -> None:
    chosen = struct.pack("@4s4si", b"", b"", interface)  # struct ip_mreqn
    try:
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, chosen)
    except OSError as err:  # an interface without an IPv4 address
        _log.debug("cannot send on interface %d: %s", interface, err)
        return
    _send(sender, messages, (MULTICAST, multicast_port(domain)))


def _send(sender: socket.socket, messages: Iterable[bytes], address: tuple[str, int]) -> None:
    for message in messages:
        try:
            sender.sendto(message, address)
        except OSError as err:  # no receiver, or no route
            _log.debug("cannot send to %s:%d: %s", *address, err)
            return
