"""Connects a port to other ports, and introduces it to them."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable

from yarp_compat.ports.sockets import closed_on_failure, open_connection, tune
from yarp_compat.wire import carriers
from yarp_compat.wire.carriers import Carrier, Group, framed
from yarp_compat.wire.contact import PortContact

PATIENCE = 5.0  # seconds for a port to answer the introduction
_FAREWELL = 1.0  # seconds for a port to accept a farewell
_JOINING = 1.0
"""Seconds to wait until a port has joined a multicast group; it would miss messages sent earlier."""


def dial(contact: PortContact, carrier: Carrier, sender: str, qualifiers: str = "") -> socket.socket:
    """Connect to a port and return the socket for messages (udp: datagrams); raises `OSError` if no port answers."""
    end = time.monotonic() + PATIENCE
    sock = open_connection(contact.host, contact.port, lambda: end)
    with closed_on_failure(sock):
        tune(sock)
        sock.sendall(carriers.opening(carrier, sender, qualifiers))
        if carrier is carriers.TEXT_ACK:
            _receive_line(sock, end)
        elif not carrier.text:
            number = _number(_receive_exactly(sock, 8, end))
            if carrier is carriers.UDP:
                return _datagrams(sock, contact.host, number)
    return sock


def dial_group(contact: PortContact, sender: str, qualifiers: str, group: Callable[[str], Group]) -> None:
    """Ask a port to join the multicast group of the messages, and wait until it listens; raises `OSError`.

    The port sends no answer: it closes the connection when it has joined the group, or is about to. ``group`` returns
    the group for the address of this machine from which the port is reached.
    """
    end = time.monotonic() + PATIENCE
    with open_connection(contact.host, contact.port, lambda: end) as sock:
        tune(sock)
        address = group(str(sock.getsockname()[0]))
        sock.sendall(carriers.opening(carriers.MCAST, sender, qualifiers, address))
        sock.shutdown(socket.SHUT_WR)
        sock.settimeout(_JOINING)
        with contextlib.suppress(TimeoutError, ConnectionResetError):
            if sock.recv(1):
                raise ConnectionRefusedError("the port refuses mcast")


def _number(answer: bytes) -> int:
    number = framed(answer)
    if number is None:
        raise ConnectionRefusedError("the peer does not answer like a YARP port")
    return number


def send_farewell(contact: PortContact, sender: str) -> None:
    """Notify a port of the end of a datagram connection, which it cannot detect; raises OSError."""
    end = time.monotonic() + _FAREWELL
    with open_connection(contact.host, contact.port, lambda: end) as sock:
        sock.sendall(carriers.opening(carriers.TEXT, "admin") + f"~{sender}\r\nq\r\n".encode())
        with contextlib.suppress(ConnectionRefusedError):
            while True:
                _receive(sock, 4096, end)


def _datagrams(sock: socket.socket, host: str, number: int) -> socket.socket:
    family, address = sock.family, sock.getpeername()[:1]
    sock.close()
    datagrams = socket.socket(family, socket.SOCK_DGRAM)
    try:
        datagrams.connect((*address, number))
    except (OSError, OverflowError) as error:
        datagrams.close()
        raise ConnectionRefusedError(f"{host} returned an unusable UDP port ({number})") from error
    return datagrams


def _receive_exactly(sock: socket.socket, size: int, end: float) -> bytes:
    received = b""
    while len(received) < size:
        received += _receive(sock, size - len(received), end)
    return received


def _receive_line(sock: socket.socket, end: float) -> bytes:
    received = b""
    while not received.endswith(b"\n"):
        received += _receive(sock, 1, end)
        if len(received) > carriers.LONGEST_NAME + 16:
            raise ConnectionRefusedError("the port's answer is too long for a line")
    return received


def _receive(sock: socket.socket, size: int, end: float) -> bytes:
    sock.settimeout(max(0.001, end - time.monotonic()))
    part = sock.recv(size)
    if not part:
        raise ConnectionRefusedError("the port closed the connection at once")
    return part
