"""The announcements of other DDS participants, which contain the version of their middleware.

Fast DDS hides them from rmw, so two sockets receive them once more: the multicast that most participants repeat every
few seconds, and the responses to a prompt (`bridge.adapters.ros2.graph.spdp`), which participants without multicast
send, too. Behind a discovery server neither arrives, and the versions remain unknown.

Observed on the wire: Fast DDS 3.2 announces its version (parameter 0x8000, as RTI Connext does), Fast DDS 2.14 does
not; Cyclone DDS 0.10 and 11.0 announce a text ``host/version/system/machine`` (parameter 0x8007). Wireshark's
``packet-rtps.c`` lists these parameters by vendor.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from bridge.adapters.ros2.graph import spdp
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.concurrency import DelayedCalls

_PERIOD = 2.0
"""Seconds between two reads; the kernel buffers some 150 announcements."""
_PROMPTS = 3
"""Maximum number of prompts for one participant that has not announced itself."""
_MAX_PARTICIPANTS = 2000
_BATCH = 1000
_DATAGRAM = 65536

_HEADER = 20
_DATA, _LITTLE_ENDIAN, _INLINE_QOS, _PAYLOAD = 0x15, 0x01, 0x02, 0x04
_SPDP_WRITER = b"\x00\x01\x00\xc2"
_PL_CDR_BE, _PL_CDR_LE = b"\x00\x02", b"\x00\x03"
_SENTINEL, _PRODUCT, _CYCLONE_TEXT = 0x0001, 0x8000, 0x8007
_RTI, _FAST, _CYCLONE = b"\x01\x01", b"\x01\x0f", b"\x01\x10"
_TEXT = 24
"""Offset of the text in Cyclone DDS's parameter: five words and its length."""


class Announcement(NamedTuple):
    """One participant; ``version`` is its middleware's version, "" if it announces none."""

    prefix: bytes
    version: str


def parse(message: bytes) -> Announcement | None:
    """Read an RTPS message; None if it is not the announcement of a participant."""
    if len(message) < _HEADER or not message.startswith(b"RTPS"):
        return None
    prefix = message[_HEADER - PREFIX_BYTES : _HEADER]
    try:
        for parameters in _spdp_parameters(message):
            return Announcement(prefix, _version(message[6:8], parameters))
    except (struct.error, IndexError):
        pass
    return None


def _spdp_parameters(message: bytes) -> Iterator[Mapping[int, bytes]]:
    """Yield the parameters of each DATA submessage of an SPDP writer (DDSI-RTPS 2.5, 9.4.5)."""
    offset = _HEADER
    while offset + 4 <= len(message):
        kind, flags = message[offset], message[offset + 1]
        order = "<" if flags & _LITTLE_ENDIAN else ">"
        (length,) = struct.unpack_from(f"{order}H", message, offset + 2)
        body = message[offset + 4 : offset + 4 + length if length else None]
        offset += 4 + len(body)
        if kind == _DATA and flags & _PAYLOAD and body[8:12] == _SPDP_WRITER:
            start = 4 + struct.unpack_from(f"{order}H", body, 2)[0]
            if flags & _INLINE_QOS:
                _, start = _parameters(body, start, order)
            encapsulation = body[start : start + 2]
            if encapsulation in (_PL_CDR_LE, _PL_CDR_BE):
                yield _parameters(body, start + 4, "<" if encapsulation == _PL_CDR_LE else ">")[0]


def _parameters(data: bytes, offset: int, order: str) -> tuple[dict[int, bytes], int]:
    """Return a parameter list (9.4.2.11), and its end."""
    parameters: dict[int, bytes] = {}
    while True:
        number, length = struct.unpack_from(f"{order}HH", data, offset)
        offset += 4
        if number == _SENTINEL:
            return parameters, offset
        parameters[number] = data[offset : offset + length]
        offset += length


def _version(vendor: bytes, parameters: Mapping[int, bytes]) -> str:
    product = parameters.get(_PRODUCT, b"")
    if vendor in (_RTI, _FAST) and len(product) >= 4:
        return ".".join(map(str, product[:3]))
    if vendor == _CYCLONE:
        parts = parameters.get(_CYCLONE_TEXT, b"")[_TEXT:].split(b"\0")[0].split(b"/")
        text = parts[1].decode("ascii", "replace") if len(parts) > 1 else ""
        return text if len(text) <= 20 and text.isprintable() else ""
    return ""


class Announcements:
    """Receives the announcements on one domain; `versions` returns the versions in them.

    Args:
        own: the GUID prefix of this process's participant.
        present: returns the GUID prefixes of the other participants on the graph.
        prompt: has all participants announce themselves to a port of the loopback interface.
        later: the thread that reads the sockets.
    """

    def __init__(
        self, own: bytes, domain: int, present: Callable[[], frozenset[bytes]], prompt: Callable[[int], None],
        later: DelayedCalls, *, localhost_only: bool,
    ) -> None:  # fmt: skip
        self._own, self._present, self._prompt = own, present, prompt
        self._lock = threading.Lock()
        self._versions: dict[bytes, str] = {}
        self._prompts: dict[bytes, int] = {}
        self._sockets: list[socket.socket] = []
        self.port = 0
        with contextlib.suppress(OSError):  # a host without loopback or multicast: versions remain unknown
            responses = self._open_socket(("127.0.0.1", 0))
            self.port = int(responses.getsockname()[1])
        with contextlib.suppress(OSError):
            multicast = self._open_socket((spdp.MULTICAST, spdp.multicast_port(domain)))
            _join(multicast, localhost_only=localhost_only)
        later.every(_PERIOD, self._poll)

    def _open_socket(self, address: tuple[str, int]) -> socket.socket:
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sockets.append(sock)
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(address)
        return sock

    def versions(self) -> dict[bytes, str]:
        """Return the version of each participant that has announced itself, by GUID prefix; "" if it announced none."""
        with self._lock:
            self._drain()
            return dict(self._versions)

    def close(self) -> None:
        with self._lock:
            while self._sockets:
                self._sockets.pop().close()

    def _poll(self) -> None:
        with self._lock:
            if not self._sockets:
                return
            self._drain()
            present = self._present()
            unknown = present - self._versions.keys() - {self._own}
            self._prompts = {prefix: self._prompts.get(prefix, 0) + 1 for prefix in unknown}
            wanted = any(count <= _PROMPTS for count in self._prompts.values())
        if wanted and self.port:
            self._prompt(self.port)

    def _drain(self) -> None:
        for sock in self._sockets:
            for _ in range(_BATCH):
                try:
                    message = sock.recv(_DATAGRAM)
                except OSError:
                    break
                prefix = message[_HEADER - PREFIX_BYTES : _HEADER]
                if prefix in self._versions or prefix == self._own or (announcement := parse(message)) is None:
                    continue
                if len(self._versions) >= _MAX_PARTICIPANTS:
                    del self._versions[next(iter(self._versions))]
                self._versions[prefix] = announcement.version


def _join(sock: socket.socket, *, localhost_only: bool) -> None:
    for number, name in socket.if_nameindex():
        if name == "lo" or not localhost_only:
            request = struct.pack("@4s4si", socket.inet_aton(spdp.MULTICAST), bytes(4), number)
            with contextlib.suppress(OSError):  # an interface without multicast
                sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, request)
