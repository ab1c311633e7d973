"""Asks any port by the text carrier, as YARP's own tools do: commands as text, answers as lines.

``CONNACK admin`` is answered by ``Welcome admin``; then each answer ends with ``<ACK>`` (the carrier is text_ack).
An administrative command is announced by a line ``a``, one for the port's owner by ``d``.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Sequence
from typing import Any, Self

from yarp_compat.ports.naming import PortError
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text, to_text

_STEP = 0.1  # seconds after which a thread that waits looks whether it still should


class LineSocket:
    """A short exchange of lines by TCP; raises `OSError`, also beyond ``timeout`` seconds or ``limit`` bytes."""

    def __init__(self, host: str, port: int, timeout: float, limit: int = 1 << 20) -> None:
        self._end = time.monotonic() + timeout
        self._limit = limit
        self._buffer = bytearray()
        self._taken = 0
        self._explain: Callable[[OSError], Exception] | None = None
        self._socket = socket.create_connection((host, port), timeout)
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError:  # it was closed at once
            self.close()
            raise

    def on_error(self, explain: Callable[[OSError], Exception]) -> None:
        """Have later errors raised as something else."""
        self._explain = explain

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, err: BaseException | None, trace: object) -> None:
        self.close()
        if isinstance(err, OSError) and self._explain:
            raise self._explain(err) from None

    def send(self, data: bytes) -> None:
        """Send all of it."""
        self._socket.settimeout(self._left())
        self._socket.sendall(data)

    def line(self) -> str:
        """The next line, without its end."""
        at = self._buffer.find(b"\n")
        while at < 0:
            seen = len(self._buffer)
            self._more()
            at = self._buffer.find(b"\n", seen)
        line = bytes(self._buffer[:at])
        del self._buffer[: at + 1]
        return line.rstrip(b"\r").decode("utf-8", "surrogateescape")

    def _more(self) -> None:
        data = self._some()
        if not data:
            raise ConnectionError("the connection was closed before the answer was complete")
        self._taken += len(data)
        if self._taken > self._limit:
            raise OSError(f"the answer is longer than {self._limit} bytes")
        self._buffer += data

    def _some(self) -> bytes:
        while True:
            self._socket.settimeout(min(self._left(), _STEP))
            try:
                return self._socket.recv(65536)
            except TimeoutError:
                continue

    def hurry(self, seconds: float) -> None:
        """Have the exchange end within so many seconds from now; any thread may ask for that."""
        self._end = min(self._end, time.monotonic() + seconds)

    def _left(self) -> float:
        left = self._end - time.monotonic()
        if left <= 0:
            raise TimeoutError
        return left


TIMEOUT = 5.0
_ACK = "<ACK>"


def ask(contact: PortContact, command: Sequence[Any], *, admin: bool = False, timeout: float = TIMEOUT) -> list[str]:
    """The lines of a port's answer to a Bottle (``admin``: the port's own); raises `PortError` if none in time."""
    return raw(contact, "admin", f"{'a' if admin else 'd'}\r\n{to_text(command)}\r\n", timeout)


def admin(contact: PortContact, command: Sequence[Any], timeout: float = TIMEOUT) -> list[Any]:
    """Send an administrative command and return the values of its answer; errors as `ask`."""
    lines = ask(contact, command, admin=True, timeout=timeout)
    try:
        return from_text(lines[0]) if lines else []
    except WireError as err:
        raise PortError(f"what {contact.name or 'the port'} answers at {contact.uri} is no Bottle: {err}") from None


def raw(contact: PortContact, sender: str, text: str, timeout: float = TIMEOUT) -> list[str]:
    """Introduce oneself as ``sender``, send lines, and return what comes back before the acknowledgement."""
    try:
        with LineSocket(contact.host, contact.port, timeout) as peer:
            peer.send(f"CONNACK {sender}\r\n{text}".encode("utf-8", "surrogateescape"))
            return _answer(peer, contact)
    except PortError:
        raise
    except OSError as err:
        why = f"no answer within {timeout:g} s" if isinstance(err, TimeoutError) else (err.strerror or str(err))
        raise PortError(f"{contact.name or 'the port'} does not answer at {contact.uri}: {why}") from None


def _answer(peer: LineSocket, contact: PortContact) -> list[str]:
    welcome = peer.line()
    if not welcome.startswith("Welcome"):
        raise PortError(f"what answers at {contact.uri} is no YARP port: it says {welcome[:60]!r}")
    lines: list[str] = []
    while (line := peer.line()) != _ACK:
        lines.append(line)
    return lines


QUESTION = "getPid"
PATIENCE = 1.0  # seconds that a port has to tell what it is


def ask_profile(contact: PortContact, timeout: float = PATIENCE) -> Profile | None:
    """The dialect of a port, None if unknown; C++ ports that wait for a reply answer nobody, so do not ask those."""
    try:
        answer = admin(contact, [QUESTION], timeout)
    except (PortError, WireError):
        return None
    if answer[:2] == [1, ""]:
        return Profile.YARP3
    return Profile.YARP4 if answer[:1] == ["fail"] else None
