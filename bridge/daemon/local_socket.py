"""Sockets at a path in the state folder, for processes of the same user.

If Python has Unix sockets, the path is a Unix socket, and its file mode controls access. Elsewhere (on Windows) the
path is a file with a port of the loopback interface and two secrets. Every user of the machine can connect to that
port, so a client sends the first secret before anything else. The listener then responds with the second secret, which
shows the client that no other program listens there: a dead process may have left the file.

Windows ignores the mode with which that file is created: its access list is inherited from the state folder, so every
user who can read the folder can use the socket. ``icacls`` restricts the folder (docs/operate/security.md).
"""

from __future__ import annotations

import contextlib
import hmac
import json
import os
import secrets
import select
import socket
import time
from pathlib import Path
from typing import NamedTuple

_UNIX = hasattr(socket, "AF_UNIX")
_SECRET_BYTES = 32
_BACKLOG = 8
_MAX_FILE = 1000
_LEAST_SECONDS = 1e-3


class _Address(NamedTuple):
    """The address of a listener, as stored in its file."""

    port: int
    of_client: bytes
    of_listener: bytes


class LocalListener:
    """Listens at a path; raises `OSError` if it cannot. A file that a dead listener left there is replaced.

    The caller accepts connections from ``sock``, and uses only those that `admit` accepts.

    Attributes:
        sock: the listening socket.
        greeting: number of bytes that a client sends first.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        path.unlink(missing_ok=True)
        if _UNIX:
            self._address = None
            self.greeting = 0
            self.sock = socket.socket(socket.AF_UNIX)
        else:
            self.greeting = 2 * _SECRET_BYTES
            self.sock = socket.socket(socket.AF_INET)
            if hasattr(socket, "SO_EXCLUSIVEADDRUSE"):  # Windows: no other socket may share the port
                self.sock.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
        try:
            if self.greeting:
                self.sock.bind(("127.0.0.1", 0))
                self.sock.listen(_BACKLOG)
                self._address = self._publish()
            else:
                self.sock.bind(str(path))
                path.chmod(0o600)
                self.sock.listen(_BACKLOG)
        except OSError:
            self.sock.close()
            raise

    def _publish(self) -> _Address:
        """Write the file atomically."""
        first, second = (secrets.token_hex(_SECRET_BYTES) for _ in range(2))
        port = self.sock.getsockname()[1]
        new = self._path.with_name(f"{self._path.name}.new")
        new.unlink(missing_ok=True)
        with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
            json.dump([port, first, second], file)
        new.replace(self._path)
        return _Address(port, first.encode(), second.encode())

    def admit(self, client: socket.socket, greeting: bytes) -> bool:
        """Return whether a client's first bytes prove that it can read the file; respond to the client if so."""
        if self._address is None:
            return True
        if not hmac.compare_digest(greeting, self._address.of_client):
            return False
        client.sendall(self._address.of_listener)  # fits into the buffer of a new connection
        return True

    def close(self) -> None:
        """Stop listening, and remove the file. A thread that waits in ``accept`` returns."""
        if self._path.exists():
            with contextlib.suppress(OSError):
                self.sock.shutdown(socket.SHUT_RDWR)  # Linux wakes the thread
            with contextlib.suppress(OSError), socket.socket(self.sock.family) as waker:  # for other systems
                waker.setblocking(False)
                waker.connect(self.sock.getsockname())
        self.sock.close()
        with contextlib.suppress(OSError):
            self._path.unlink(missing_ok=True)


def receive(client: socket.socket, size: int) -> bytes:
    """Return exactly ``size`` bytes, fewer at the end of the stream.

    Raises `TimeoutError` unless all of them arrive within the socket's timeout.
    """
    seconds = client.gettimeout()
    end = None if seconds is None else time.monotonic() + seconds
    data = b""
    try:
        while len(data) < size and (part := client.recv(size - len(data))):
            data += part
            if end is not None:
                client.settimeout(max(end - time.monotonic(), _LEAST_SECONDS))
    finally:
        client.settimeout(seconds)
    return data


def wait_readable(sock: socket.socket) -> None:
    """Wait, whatever the socket's timeout is, until a read would not block; a shutdown on any thread ends the wait.

    The socket must not be closed meanwhile.
    """
    if hasattr(select, "poll"):  # unlike select, it accepts any descriptor
        poll = select.poll()
        poll.register(sock, select.POLLIN)
        poll.poll()
    else:
        select.select([sock], [], [])


def connect(path: Path, seconds: float) -> socket.socket:
    """Connect to the listener at a path; raises `OSError` if no listener exists, or if it belongs to another user.

    A Unix socket connects at once or not at all. Elsewhere this waits up to ``seconds`` for each step. The socket has
    this timeout.
    """
    sock = socket.socket(socket.AF_UNIX if _UNIX else socket.AF_INET)
    try:
        if _UNIX:
            sock.setblocking(False)
            sock.connect(str(path))
            sock.settimeout(seconds)
        else:
            sock.settimeout(seconds)
            _join(sock, _read(path))
    except BaseException:
        sock.close()
        raise
    return sock


def _join(sock: socket.socket, address: _Address) -> None:
    """Connect to a port of the loopback interface, and check that it belongs to the listener that wrote the file."""
    sock.connect(("127.0.0.1", address.port))
    sock.sendall(address.of_client)
    if not hmac.compare_digest(receive(sock, len(address.of_listener)), address.of_listener):
        raise PermissionError(f"port {address.port} belongs to another program")


def _read(path: Path) -> _Address:
    """Read a listener's file; raises `OSError`."""
    with path.open("rb") as file:
        data = file.read(_MAX_FILE)
    try:
        port, first, second = json.loads(data)
        if port in range(1, 1 << 16):
            return _Address(port, first.encode("ascii"), second.encode("ascii"))
    except (ValueError, TypeError, AttributeError, RecursionError):
        pass
    raise OSError(f"{path} is not the file of a listener")
