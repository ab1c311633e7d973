"""Sockets of ports and connections: their options, listening addresses, and sending several buffers at once."""

from __future__ import annotations

import contextlib
import errno
import os
import random
import selectors
import socket
import time
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Protocol, Self

from yarp_compat.ports.naming import Naming
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.framing import JOINED, Buffer

_KEEP_ALIVE = (("TCP_KEEPIDLE", 30), ("TCP_KEEPINTVL", 10), ("TCP_KEEPCNT", 3))
"""TCP keepalive: seconds of silence before the first probe, seconds between probes, number of probes."""


class Closable(Protocol):
    """An object that can be closed, such as a socket or a port."""

    def close(self) -> object: ...


class Openable(ABC):
    """A base class for objects that are open inside a ``with`` block."""

    @abstractmethod
    def open(self) -> Self:
        """Open the object and return it."""

    @abstractmethod
    def close(self) -> None: ...

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(self, *_: object) -> None:
        self.close()


@contextlib.contextmanager
def closed_on_failure(made: Closable) -> Iterator[None]:
    """Close an object if the ``with`` block raises."""
    try:
        yield
    except BaseException:
        made.close()
        raise


_STEP = 0.1  # seconds between checks of a deadline that may change in the meantime
_CONNECTING = (errno.EINPROGRESS, errno.EWOULDBLOCK, getattr(errno, "WSAEWOULDBLOCK", errno.EWOULDBLOCK))


@contextlib.contextmanager
def host_checked(host: str) -> Iterator[None]:
    """Raise only `OSError` if ``host`` cannot be a host name, or if a port number is out of range.

    Without this, the resolver raises `UnicodeError`, and the methods of sockets raise `TypeError` or `OverflowError`.
    """
    try:
        yield
    except (TypeError, ValueError, OverflowError) as error:
        raise OSError(f"{host[:80]!r} is not a host name: {error}") from None


def open_connection(host: str, port: int, end: Callable[[], float]) -> socket.socket:
    """Connect over TCP; raises only `OSError`, even if ``host`` cannot be a host name (ports register any text).

    ``end`` returns the deadline on the monotonic clock, which may become earlier. It does not limit the lookup of the
    host's addresses; the attempts to connect to them share the time that is left.
    """
    with host_checked(host):
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    problem = OSError(f"{host} has no address")
    for index, (family, kind, protocol, _, address) in enumerate(addresses):
        latest = time.monotonic() + _left(end) / (len(addresses) - index)
        try:
            sock = socket.socket(family, kind, protocol)
            with closed_on_failure(sock):
                _connect(sock, address, partial(_earlier, end, latest))
                sock.settimeout(max(end() - time.monotonic(), _STEP))
        except OSError as error:
            problem = error
        else:
            return sock
    raise problem


def _connect(sock: socket.socket, address: tuple[object, ...], end: Callable[[], float]) -> None:
    sock.setblocking(False)
    number = sock.connect_ex(address)
    if number in _CONNECTING:
        with selectors.DefaultSelector() as selector:
            selector.register(sock, selectors.EVENT_WRITE)
            # the deadline is checked last, because the connection may have been made while this process was suspended
            while not selector.select(max(0.0, min(end() - time.monotonic(), _STEP))):
                _left(end)
        number = sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    if number:
        raise OSError(number, os.strerror(number))


def _earlier(end: Callable[[], float], latest: float) -> float:
    return min(end(), latest)


def _left(end: Callable[[], float]) -> float:
    left = end() - time.monotonic()
    if left <= 0:
        raise TimeoutError
    return left


def tune(sock: socket.socket) -> None:
    """Set options to send small messages at once, and to detect unreachable peers."""
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEP_ALIVE:
            if hasattr(socket, name):
                sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def set_service(sock: socket.socket, tos: int) -> bool:
    """Set the type of service of a socket's packets (0 to 255); return False if this machine does not allow that."""
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
    """Return the type of service of a socket's packets; 0 if unknown."""
    try:
        if sock.family == socket.AF_INET6:
            return sock.getsockopt(socket.IPPROTO_IPV6, socket.IPV6_TCLASS)
        return sock.getsockopt(socket.IPPROTO_IP, socket.IP_TOS)
    except (OSError, AttributeError):
        return 0


def send_all(sock: socket.socket, buffers: Sequence[Buffer]) -> None:
    """Send all buffers, in few system calls; blocks until the socket has accepted them."""
    left = flat(buffers)
    while left:
        left = sent(left, send_some(sock, left))


def send_some(sock: socket.socket, buffers: Sequence[Buffer]) -> int:
    """Send as much of the buffers as the socket accepts; return the number of bytes."""
    if len(buffers) == 1:
        return sock.send(buffers[0])
    if hasattr(sock, "sendmsg"):
        return sock.sendmsg(buffers[:512])
    return sock.send(buffers[0])  # Windows


def flat(buffers: Sequence[Buffer]) -> list[Buffer]:
    """Return the buffers as bytes: joined if their total size is small, otherwise without empty ones."""
    chunks = [b if isinstance(b, (bytes, bytearray)) else memoryview(b).cast("B") for b in buffers]
    if sum(map(len, chunks)) <= JOINED:
        return [b"".join(chunks)]
    return [b for b in chunks if len(b)]


def sent(buffers: list[Buffer], count: int) -> list[Buffer]:
    """Return the buffers without their first ``count`` bytes."""
    for index, buffer in enumerate(buffers):
        if count < len(buffer):
            return [memoryview(buffer)[count:], *buffers[index + 1 :]]
        count -= len(buffer)
    return []


_BACKLOG = 1024  # connections waiting to be accepted


def registered(naming: Naming, name: str, host: str | None, number: int) -> tuple[PortContact, socket.socket]:
    """Register a port and listen; raises `NamingError`, or `OSError` if it cannot listen.

    Without a ``host``, the port listens on the one that the name server returns, or on any; without a ``number`` (0),
    on a free one of the naming's `numbers`, else on the name server's or on any.
    """
    wanted = number or _free_number(naming.numbers, name)
    contact = naming.register(name, host or "", wanted)
    sock: socket.socket | None = None
    try:
        sock = listening(host or contact.host, contact.port, host_fixed=bool(host), number_fixed=bool(number))
        if (actual := sock.getsockname()[1]) != contact.port:
            contact = naming.register(contact.name, contact.host, actual)
    except BaseException:
        if sock is not None:
            sock.close()
        naming.unregister(contact.name)
        raise
    return contact, sock


def _free_number(numbers: range, name: str) -> int:
    """Return a free number, if possible always the same for a name; 0 if all are in use."""
    if not numbers:
        return 0
    first = random.randrange(len(numbers)) if name in ("", "...") else zlib.crc32(name.encode(errors="replace"))  # noqa: S311 - not a secret
    for step in range(len(numbers)):
        number = numbers[(first + step) % len(numbers)]
        try:
            _bound_socket(socket.AF_INET, "", number).close()
        except OSError:
            continue
        return number
    return 0


def listening(host: str, number: int, *, host_fixed: bool, number_fixed: bool) -> socket.socket:
    """Return a socket that listens on an address and number (0: any); raises `OSError` if it cannot.

    Unless ``host_fixed``, it listens on all of this machine's addresses if ``host`` is none of them (with address
    translation); unless ``number_fixed``, on another number if ``number`` is in use.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return _listening_socket(family, host, number)
    except OSError as error:
        if error.errno == errno.EADDRINUSE and not number_fixed:
            return _listening_socket(family, host, 0)
        if error.errno == errno.EADDRNOTAVAIL and not host_fixed:
            return _listening_socket(family, "", number)
        raise


def _listening_socket(family: int, host: str, number: int) -> socket.socket:
    sock = _bound_socket(family, host, number)
    with closed_on_failure(sock):
        sock.listen(_BACKLOG)  # fails if another socket listens on the same number
    return sock


def _bound_socket(family: int, host: str, number: int) -> socket.socket:
    sock = socket.socket(family, socket.SOCK_STREAM)
    with closed_on_failure(sock):
        if os.name == "posix":  # on Windows this would let two programs listen on one number
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with host_checked(host):
            sock.bind((host, number))
    return sock
