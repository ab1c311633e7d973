"""The sockets of the lanes in the state folder: one for each session, named after the session's id."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

from bridge.hub.lane.wire import VERSION

_CREDENTIALS = struct.Struct("@3i")
_SEND_BUFFER = 1 << 20
"""Maximum number of bytes in the kernel's buffer for a reader; commands cannot overtake the messages in it."""

_BACKLOG = 64
_UNREADY = ".new"


def possible() -> bool:
    """Return whether this system supports lanes."""
    return (
        all(hasattr(socket, name) for name in ("AF_UNIX", "SOCK_SEQPACKET", "SO_PEERCRED"))
        and Path("/proc/self/fd").is_dir()
    )


def listen(folder: Path, zid: str) -> socket.socket:
    """Listen on the session's socket; raises `OSError`."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    sock = _socket()
    try:
        with _short(folder, _name(zid)) as path:
            unready = Path(f"{path}{_UNREADY}")  # renamed when it accepts readers: `clean` removes sockets that do not
            sock.bind(str(unready))
            unready.chmod(0o600)
            sock.listen(_BACKLOG)
            unready.rename(path)
    except BaseException:
        sock.close()
        raise
    return sock


def connect(folder: Path, zid: str) -> socket.socket:
    """Connect to a session; raises `OSError` if it has no lane, or belongs to another user."""
    if not zid.isalnum():  # the id is untrusted: any participant can announce it in the graph
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
    return _connect(folder, _name(zid))


def _connect(folder: Path, name: str) -> socket.socket:
    sock = _socket()
    try:
        with _short(folder, name) as path:
            sock.setblocking(False)  # never wait for a process that does not accept
            sock.connect(path)
        check_peer(sock)
        sock.setblocking(True)
    except BaseException:
        sock.close()
        raise
    return sock


def check_peer(sock: socket.socket) -> None:
    """Raise `PermissionError` unless the other end runs as the same user."""
    _, user, _ = _CREDENTIALS.unpack(sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size))
    if user != os.geteuid():
        raise PermissionError(f"the other end of the lane belongs to user {user}")


def other_version(folder: Path, zid: str) -> str:
    """Return a text if a session's lane has a different version, else ""."""
    path = next(folder.glob(f"{zid}.*"), None) if zid.isalnum() else None
    return f"its lane has version {path.suffix[1:]}, ours {VERSION}; zenoh is used instead" if path else ""


def remove(folder: Path, zid: str) -> None:
    """Remove a session's socket."""
    with contextlib.suppress(OSError):
        (folder / _name(zid)).unlink()


def clean(folder: Path) -> None:
    """Remove the sockets of sessions that have died, including those of other versions."""
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            if path.suffix == _UNREADY:
                continue
            try:
                _connect(folder, path.name).close()
            except ConnectionRefusedError:
                path.unlink(missing_ok=True)
            except OSError:
                pass


def _socket() -> socket.socket:
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
    return sock


def _name(zid: str) -> str:
    return f"{zid}.{VERSION}"


@contextlib.contextmanager
def _short(folder: Path, name: str) -> Iterator[str]:
    """Yield a path that fits into a socket's address, even if the folder's path is too long."""
    number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{number}/{name}"
    finally:
        os.close(number)
