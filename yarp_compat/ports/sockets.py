"""The sockets of ports and connections: how they are set, where a port listens, several buffers sent at once."""

from __future__ import annotations

import contextlib
import errno
import os
import random
import socket
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Protocol, Self

from yarp_compat.ports.naming import Naming
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.framing import JOINED, Buffer

_KEEP_ALIVE = (("TCP_KEEPIDLE", 30), ("TCP_KEEPINTVL", 10), ("TCP_KEEPCNT", 3))
"""After how many seconds of silence the system asks a peer's machine, how far apart, and how often."""


class Closable(Protocol):
    """A socket, or a port."""

    def close(self) -> object:
        """Close it."""


class Openable(ABC):
    """Open between ``with`` and its end."""

    @abstractmethod
    def open(self) -> Self:
        """Open it."""

    @abstractmethod
    def close(self) -> None:
        """Close it."""

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(self, *_: object) -> None:
        self.close()


@contextlib.contextmanager
def closed_on_failure(made: Closable) -> Iterator[None]:
    """Close something where what is done to it fails."""
    try:
        yield
    except BaseException:
        made.close()
        raise


def tune(sock: socket.socket) -> None:
    """Have small messages sent at once, and the end of a peer's machine noticed."""
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEP_ALIVE:
            if hasattr(socket, name):
                sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def set_service(sock: socket.socket, tos: int) -> bool:
    """Set the type of service of a socket's packets (0 to 255); False where this machine does not allow that."""
    if not 0 <= tos <= 255:
        return False
    try:
        if sock.family == socket.AF_INET6:
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_TCLASS, tos)
        else:
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_TOS, tos)
    except (OSError, AttributeError):
        return False
    return True


def service(sock: socket.socket) -> int:
    """The type of service of a socket's packets; 0 where this machine does not tell."""
    try:
        if sock.family == socket.AF_INET6:
            return sock.getsockopt(socket.IPPROTO_IPV6, socket.IPV6_TCLASS)
        return sock.getsockopt(socket.IPPROTO_IP, socket.IP_TOS)
    except (OSError, AttributeError):
        return 0


def send_all(sock: socket.socket, buffers: Sequence[Buffer]) -> None:
    """Send all of the buffers, in few system calls; waits until the peer took them."""
    left = flat(buffers)
    while left:
        left = sent(left, send_some(sock, left))


def send_some(sock: socket.socket, buffers: Sequence[Buffer]) -> int:
    """Send what the socket takes of the buffers; the number of bytes."""
    if len(buffers) == 1:
        return sock.send(buffers[0])
    if hasattr(sock, "sendmsg"):
        return sock.sendmsg(buffers[:512])
    return sock.send(buffers[0])  # Windows


def flat(buffers: Sequence[Buffer]) -> list[Buffer]:
    """The buffers as bytes, small ones put together, empty ones left out."""
    made = [b if isinstance(b, (bytes, bytearray)) else memoryview(b).cast("B") for b in buffers]
    if sum(map(len, made)) <= JOINED:
        return [b"".join(made)]
    return [b for b in made if len(b)]


def sent(buffers: list[Buffer], count: int) -> list[Buffer]:
    """The rest of the buffers after ``count`` bytes of them."""
    for index, buffer in enumerate(buffers):
        if count < len(buffer):
            return [memoryview(buffer)[count:], *buffers[index + 1 :]]
        count -= len(buffer)
    return []


_BACKLOG = 1024  # connections that wait to be accepted


def registered(naming: Naming, name: str, host: str | None, number: int) -> tuple[PortContact, socket.socket]:
    """Register a port, and listen; raises `NamingError`, or `OSError` where it cannot listen.

    Where no ``host`` is given, the name server's will do, or any; where no ``number`` is (0), a free one of the
    naming's `numbers`, else the name server's or any.
    """
    wanted = number or _free(naming.numbers, name)
    contact = naming.register(name, host or "", wanted)
    sock: socket.socket | None = None
    try:
        sock = listening(host or contact.host, contact.port, host_fixed=bool(host), number_fixed=bool(number))
        if (found := sock.getsockname()[1]) != contact.port:
            contact = naming.register(contact.name, contact.host, found)
    except BaseException:
        if sock is not None:
            sock.close()
        naming.unregister(contact.name)
        raise
    return contact, sock


def _free(numbers: range, name: str) -> int:
    """A number that nobody listens at, the same each time for a name where it is free; 0 where all are taken."""
    if not numbers:
        return 0
    first = random.randrange(len(numbers)) if name in ("", "...") else zlib.crc32(name.encode(errors="replace"))  # noqa: S311 - no secret
    for step in range(len(numbers)):
        number = numbers[(first + step) % len(numbers)]
        try:
            _bound(socket.AF_INET, "", number).close()
        except OSError:
            continue
        return number
    return 0


def listening(host: str, number: int, *, host_fixed: bool, number_fixed: bool) -> socket.socket:
    """A socket that listens at an address and number (0: any); raises `OSError` where it cannot.

    Unless ``host_fixed``, it listens at all of this machine's addresses where ``host`` is none of them (another machine
    translates it); unless ``number_fixed``, at another number where that one is taken.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return _at(family, host, number)
    except OSError as error:
        if error.errno == errno.EADDRINUSE and not number_fixed:
            return _at(family, host, 0)
        if error.errno == errno.EADDRNOTAVAIL and not host_fixed:
            return _at(family, "", number)
        raise


def _at(family: int, host: str, number: int) -> socket.socket:
    sock = _bound(family, host, number)
    with closed_on_failure(sock):
        sock.listen(_BACKLOG)  # here two of those that share a number are told apart
    return sock


def _bound(family: int, host: str, number: int) -> socket.socket:
    sock = socket.socket(family, socket.SOCK_STREAM)
    with closed_on_failure(sock):
        if os.name == "posix":  # elsewhere this would let two programs listen on one number
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((host, number))
    return sock
