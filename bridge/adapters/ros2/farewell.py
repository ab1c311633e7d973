"""Tells a DDS network that a participant of ours is dead, when it could not say so itself.

Stock participants notice a death without a word after its lease, 20 s. A short lease is no way out: who only stood
still or was cut off for longer is forgotten by the others and does not forget them, and two such participants match
again without ever completing their discovery (seen with Fast DDS 2.14.5: nothing crosses, for good). So the lease is
the default one, and the successor of a killed worker says what its own clean end would have said: a ``DATA`` submessage
of the participant's writer with the status "disposed and unregistered" (DDSI-RTPS 2.5, 8.5.5.1, 9.4.5.4, 9.6.4.9).
"""

from __future__ import annotations

import logging
import socket
import struct
from collections.abc import Iterable, Iterator

MULTICAST = "239.255.0.1"
"""The SPDP multicast address (DDSI-RTPS 2.5, 9.6.1.4.1)."""

PARTICIPANTS = 32
"""Participants of one machine and domain that are told by unicast; as rmw_fastrtps does it for LOCALHOST."""

_log = logging.getLogger(__name__)

_LOOPBACK = "127.0.0.1"
_PARTICIPANT = b"\x00\x00\x01\xc1"
_SPDP_WRITER, _SPDP_READER = b"\x00\x01\x00\xc2", b"\x00\x01\x00\xc7"
_DATA, _LITTLE_ENDIAN, _INLINE_QOS, _KEY = 0x15, 0x01, 0x02, 0x08
_TO_INLINE_QOS = 16
"""Bytes from after this very field to the inline QoS."""
_LAST = 0x7FFFFFFF
"""A sequence number above all that the dead one used."""
_PID_SENTINEL, _PID_PARTICIPANT_GUID, _PID_KEY_HASH, _PID_STATUS_INFO = 0x0001, 0x0050, 0x0070, 0x0071
_DISPOSED_AND_UNREGISTERED = b"\x00\x00\x00\x03"
_PL_CDR_LE = b"\x00\x03\x00\x00"


def packet(prefix: bytes) -> bytes:
    """The RTPS message by which the participant with this GUID prefix (12 bytes) leaves."""
    guid = prefix + _PARTICIPANT
    body = struct.pack("<HH", 0, _TO_INLINE_QOS) + _SPDP_READER + _SPDP_WRITER + struct.pack("<iI", 0, _LAST)
    body += _parameters((_PID_KEY_HASH, guid), (_PID_STATUS_INFO, _DISPOSED_AND_UNREGISTERED))
    body += _PL_CDR_LE + _parameters((_PID_PARTICIPANT_GUID, guid))
    header = b"RTPS" + b"\x02\x03" + prefix[:2] + prefix
    return header + struct.pack("<BBH", _DATA, _LITTLE_ENDIAN | _INLINE_QOS | _KEY, len(body)) + body


def _parameters(*parameters: tuple[int, bytes]) -> bytes:
    """A parameter list (DDSI-RTPS 2.5, 9.4.2.11)."""
    listed = b"".join(struct.pack("<HH", pid, len(value)) + value for pid, value in parameters)
    return listed + struct.pack("<HH", _PID_SENTINEL, 0)


def say(prefixes: Iterable[bytes], domain: int, *, localhost_only: bool) -> None:
    """Tell everybody in reach that the participants with these prefixes have left."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for prefix in prefixes:
            message = packet(prefix)
            for interface in _interfaces(localhost_only=localhost_only):
                _send_by(sender, interface, message, domain)
            for number in range(PARTICIPANTS):
                _send(sender, message, (_LOOPBACK, _port(domain, 10 + 2 * number)))


def _port(domain: int, offset: int) -> int:
    """A well-known port (DDSI-RTPS 2.5, 9.6.2.3)."""
    return 7400 + 250 * domain + offset


def _interfaces(*, localhost_only: bool) -> Iterator[int]:
    """Indices of network interfaces; the loopback one has 1 on Linux."""
    for index, name in socket.if_nameindex():
        if name == "lo" or not localhost_only:
            yield index


def _send_by(sender: socket.socket, interface: int, message: bytes, domain: int) -> None:
    chosen = struct.pack("@4s4si", b"", b"", interface)  # struct ip_mreqn
    try:
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, chosen)
    except OSError as err:  # one without an IPv4 address
        _log.debug("interface %d is not told of dead participants: %s", interface, err)
        return
    _send(sender, message, (MULTICAST, _port(domain, 0)))


def _send(sender: socket.socket, message: bytes, address: tuple[str, int]) -> None:
    try:
        sender.sendto(message, address)
    except OSError as err:  # nobody there, or no way there
        _log.debug("%s:%d is not told of dead participants: %s", *address, err)
