"""Making a connection: calling another port and introducing oneself."""

from __future__ import annotations

import contextlib
import socket
import time

from yarp_compat.ports.sending import tune
from yarp_compat.wire import carriers, header
from yarp_compat.wire.carriers import Carrier, framed
from yarp_compat.wire.contact import Contact

PATIENCE = 5.0
"""Seconds that a port has to answer a call."""


def dial(
    contact: Contact, carrier: Carrier, sender: str, qualifiers: str = "", seconds: float = PATIENCE
) -> socket.socket:
    """Connect to a port; returns the socket on which messages can be sent (for udp: datagrams).

    Raises:
        OSError: it cannot be reached, or does not answer as a port does.
    """
    end = time.monotonic() + seconds
    sock = socket.create_connection((contact.host, contact.port), seconds)
    try:
        tune(sock)
        sock.sendall(header.opening(carrier, sender, qualifiers))
        if carrier is carriers.TEXT_ACK:
            _line(sock, end)
        elif not carrier.text:
            number = _number(_exactly(sock, 8, end))
            if carrier is carriers.UDP:
                return _datagrams(sock, contact.host, number)
    except BaseException:
        sock.close()
        raise
    return sock


def _number(answer: bytes) -> int:
    found = framed(answer)
    if found is None:
        msg = "what listens there does not answer as a YARP port"
        raise ConnectionRefusedError(msg)
    return found


def say_farewell(contact: Contact, sender: str, seconds: float = 1.0) -> None:
    """Tell a port that no datagrams will come any more, which it does not notice.

    Raises:
        OSError: it cannot be reached.
    """
    end = time.monotonic() + seconds
    with socket.create_connection((contact.host, contact.port), seconds) as sock:
        sock.sendall(header.opening(carriers.TEXT, "admin") + f"~{sender}\r\nq\r\n".encode())
        with contextlib.suppress(ConnectionRefusedError):
            while True:
                _some(sock, 4096, end)


def _datagrams(sock: socket.socket, host: str, number: int) -> socket.socket:
    family, address = sock.family, sock.getpeername()[:1]
    sock.close()
    made = socket.socket(family, socket.SOCK_DGRAM)
    try:
        made.connect((*address, number))
    except (OSError, OverflowError) as error:
        made.close()
        msg = f"{host} offers no usable UDP port ({number})"
        raise ConnectionRefusedError(msg) from error
    return made


def _exactly(sock: socket.socket, size: int, end: float) -> bytes:
    came = b""
    while len(came) < size:
        came += _some(sock, size - len(came), end)
    return came


def _line(sock: socket.socket, end: float) -> bytes:
    came = b""
    while not came.endswith(b"\n"):
        came += _some(sock, 1, end)
        if len(came) > header.LONGEST_NAME + 16:
            msg = "the port answers with a line without end"
            raise ConnectionRefusedError(msg)
    return came


def _some(sock: socket.socket, size: int, end: float) -> bytes:
    sock.settimeout(max(0.001, end - time.monotonic()))
    part = sock.recv(size)
    if not part:
        msg = "the port closed the connection at once"
        raise ConnectionRefusedError(msg)
    return part
