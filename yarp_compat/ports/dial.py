"""Connects to another port and introduces itself."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable

from yarp_compat.ports.sockets import closed_on_failure, tune
from yarp_compat.wire import carriers
from yarp_compat.wire.carriers import Carrier, Group, framed
from yarp_compat.wire.contact import PortContact

PATIENCE = 5.0  # seconds that a port has to answer a call
_FAREWELL = 1.0  # seconds that a port has to take a farewell
_JOINING = 1.0
"""Seconds that a port has to join a multicast group before messages are sent; those sent earlier it misses."""


def dial(contact: PortContact, carrier: Carrier, sender: str, qualifiers: str = "") -> socket.socket:
    """Connect to a port, for messages (by udp: datagrams) on the socket; raises `OSError` where no port answers."""
    end = time.monotonic() + PATIENCE
    sock = socket.create_connection((contact.host, contact.port), PATIENCE)
    with closed_on_failure(sock):
        tune(sock)
        sock.sendall(carriers.opening(carrier, sender, qualifiers))
        if carrier is carriers.TEXT_ACK:
            _line(sock, end)
        elif not carrier.text:
            number = _number(_exactly(sock, 8, end))
            if carrier is carriers.UDP:
                return _datagrams(sock, contact.host, number)
    return sock


def dial_group(contact: PortContact, sender: str, qualifiers: str, group: Callable[[str], Group]) -> None:
    """Tell a port which multicast group messages will be sent to, and wait until it listens; raises `OSError`.

    It answers nothing; that it closes the connection says that it has joined the group, or is about to. ``group`` makes
    the group for the address of this machine from which the port is reached.
    """
    with socket.create_connection((contact.host, contact.port), PATIENCE) as sock:
        tune(sock)
        address = group(str(sock.getsockname()[0]))
        sock.sendall(carriers.opening(carriers.MCAST, sender, qualifiers, address))
        sock.shutdown(socket.SHUT_WR)
        sock.settimeout(_JOINING)
        with contextlib.suppress(TimeoutError, ConnectionResetError):
            if sock.recv(1):
                raise ConnectionRefusedError("the port refuses mcast")


def _number(answer: bytes) -> int:
    found = framed(answer)
    if found is None:
        raise ConnectionRefusedError("what listens there does not answer as a YARP port")
    return found


def say_farewell(contact: PortContact, sender: str) -> None:
    """Tell a port that no datagrams will come any more, which it does not notice; raises OSError."""
    end = time.monotonic() + _FAREWELL
    with socket.create_connection((contact.host, contact.port), _FAREWELL) as sock:
        sock.sendall(carriers.opening(carriers.TEXT, "admin") + f"~{sender}\r\nq\r\n".encode())
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
        raise ConnectionRefusedError(f"{host} offers no usable UDP port ({number})") from error
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
        if len(came) > carriers.LONGEST_NAME + 16:
            raise ConnectionRefusedError("the port answers with a line without end")
    return came


def _some(sock: socket.socket, size: int, end: float) -> bytes:
    sock.settimeout(max(0.001, end - time.monotonic()))
    part = sock.recv(size)
    if not part:
        raise ConnectionRefusedError("the port closed the connection at once")
    return part
