"""Queries to any port over the text carrier, as YARP's tools send them: commands as text, answers as lines.

The port answers ``CONNACK admin`` with ``Welcome admin``; each further answer ends with ``<ACK>`` (carrier text_ack).
A line ``a`` precedes an administrative command, a line ``d`` a message for the port's owner.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable, Sequence
from typing import Any, Self

from yarp_compat.ports.naming import PortError
from yarp_compat.ports.sockets import open_connection
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text, to_text

_STEP = 0.1  # seconds between checks of the deadline, which `hurry` may bring forward


class LineSocket:
    """A short exchange of lines over TCP.

    All methods raise `OSError`, including when the exchange exceeds ``timeout`` seconds or ``limit`` bytes.
    """

    def __init__(self, host: str, port: int, timeout: float, limit: int = 1 << 20) -> None:
        self._host, self._port = host, port
        self._end = time.monotonic() + timeout
        self._limit = limit
        self._buffer = bytearray()
        self._received_bytes = 0
        self._explain: Callable[[OSError], Exception] | None = None
        self._socket: socket.socket | None = None

    def open(self) -> Self:
        self._socket = open_connection(self._host, self._port, lambda: self._end)
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError:  # the peer has already closed the connection
            self.close()
            raise
        return self

    def on_error(self, explain: Callable[[OSError], Exception]) -> None:
        """If an `OSError` leaves the ``with`` block, raise ``explain(error)`` instead."""
        self._explain = explain

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, err: BaseException | None, trace: object) -> None:
        self.close()
        if isinstance(err, OSError) and self._explain:
            raise self._explain(err) from None

    def send(self, data: bytes) -> None:
        """Send all of ``data``."""
        unsent = memoryview(data)
        while unsent:
            sock = self._ready()
            with contextlib.suppress(TimeoutError):
                unsent = unsent[sock.send(unsent) :]

    def line(self) -> str:
        """Return the next line, without its terminator."""
        at = self._buffer.find(b"\n")
        while at < 0:
            seen = len(self._buffer)
            self._receive()
            at = self._buffer.find(b"\n", seen)
        line = bytes(self._buffer[:at])
        del self._buffer[: at + 1]
        return line.rstrip(b"\r").decode("utf-8", "surrogateescape")

    def _receive(self) -> None:
        data = self._receive_some()
        if not data:
            raise ConnectionError("the connection was closed before the answer was complete")
        self._received_bytes += len(data)
        if self._received_bytes > self._limit:
            raise OSError(f"the answer is longer than {self._limit} bytes")
        self._buffer += data

    def _receive_some(self) -> bytes:
        """Receive bytes; after the deadline, only those that have arrived: this process may have been starved."""
        while True:
            left = self._end - time.monotonic()
            try:
                return self._connected(left).recv(65536)
            except (TimeoutError, BlockingIOError):
                if left <= 0:
                    raise TimeoutError from None

    def hurry(self, seconds: float) -> None:
        """End the exchange within ``seconds`` of now, unless the host name is still being resolved. Thread-safe."""
        self._end = min(self._end, time.monotonic() + seconds)

    def _ready(self) -> socket.socket:
        """Return the socket for sending, which nothing does after the deadline."""
        left = self._end - time.monotonic()
        if left <= 0:
            raise TimeoutError
        return self._connected(left)

    def _connected(self, left: float) -> socket.socket:
        """Return the socket, with a timeout until the next check of the deadline, which is ``left`` seconds away."""
        if self._socket is None:
            raise OSError("not connected")
        self._socket.settimeout(min(max(left, 0.0), _STEP))
        return self._socket


TIMEOUT = 5.0  # seconds for a whole query by default
_ACK = "<ACK>"


def ask(contact: PortContact, command: Sequence[Any], *, admin: bool = False, timeout: float = TIMEOUT) -> list[str]:
    """Send a Bottle and return the lines of the reply; ``admin``: the Bottle is an administrative command.

    Raises `PortError` if the port does not reply completely within ``timeout`` seconds.
    """
    return raw(contact, "admin", f"{'a' if admin else 'd'}\r\n{to_text(command)}\r\n", timeout)


def admin(contact: PortContact, command: Sequence[Any], timeout: float = TIMEOUT) -> list[Any]:
    """Send an administrative command and return the values of the reply; raises like `ask`."""
    lines = ask(contact, command, admin=True, timeout=timeout)
    try:
        return from_text(lines[0]) if lines else []
    except WireError as err:
        raise PortError(f"the answer of {contact.name or 'the port'} at {contact.uri} is not a Bottle: {err}") from None


def raw(contact: PortContact, sender: str, text: str, timeout: float = TIMEOUT) -> list[str]:
    """Introduce this client as ``sender``, send lines, and return the lines before the acknowledgment."""
    try:
        with LineSocket(contact.host, contact.port, timeout).open() as peer:
            peer.send(f"CONNACK {sender}\r\n{text}".encode("utf-8", "surrogateescape"))
            return _answer(peer, contact)
    except PortError:
        raise
    except OSError as err:
        reason = f"no answer within {timeout:g} s" if isinstance(err, TimeoutError) else (err.strerror or str(err))
        raise PortError(f"cannot query {contact.name or 'the port'} at {contact.uri}: {reason}") from None


def _answer(peer: LineSocket, contact: PortContact) -> list[str]:
    welcome = peer.line()
    if not welcome.startswith("Welcome"):
        raise PortError(f"{contact.uri} is not a YARP port: it answers {welcome[:60]!r}")
    lines: list[str] = []
    while (line := peer.line()) != _ACK:
        lines.append(line)
    return lines


_DIALECT_COMMAND = "getPid"  # a request from ROS: ports of YARP 3 reply 1 "", ports of YARP 4 reply "fail"
PATIENCE = 1.0  # seconds for a port to answer the query for its dialect


def ask_profile(contact: PortContact, timeout: float = PATIENCE) -> Profile | None:
    """Return the dialect of a port; None if unknown.

    A C++ port does not answer while it is itself waiting for a reply, so do not send this query to a port in that
    state.
    """
    try:
        answer = admin(contact, [_DIALECT_COMMAND], timeout)
    except (PortError, WireError):
        return None
    if answer[:2] == [1, ""]:
        return Profile.YARP3
    return Profile.YARP4 if answer[:1] == ["fail"] else None
