"""What the daemon says of itself and its workers, on a Unix socket in its state folder: also of those that do not run.

A running worker answers on the hub; one that cannot start has nobody to answer for it but the daemon.
"""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
import socket
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Any

from bridge import state_file
from bridge.config.model import Config
from bridge.daemon.loop import SelectorLoop
from bridge.state_file import state_folder


class Phase(Enum):
    """What a slot is doing."""

    OFF = "off"
    UNAVAILABLE = "not available"
    QUEUED = "queued"
    STARTING = "starting"
    UP = "running"
    PAUSED = "restarting"
    FAILED = "cannot work"
    STOPPING = "stopping"


logger = logging.getLogger("midspan.daemon")

_MAX_ANSWER = 1 << 20


class QueryServer:
    """Answers each connection with one JSON document, and closes it."""

    def __init__(self, loop: SelectorLoop, path: Path, document: Callable[[], dict[str, Any]]) -> None:
        self._loop = loop
        self._path = path
        self._document = document
        self._spare = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)
        self._server = socket.socket(socket.AF_UNIX)
        try:
            path.unlink(missing_ok=True)  # a dead predecessor's: the daemon's lock is ours
            self._server.bind(str(path))
            path.chmod(0o600)
        except OSError as err:
            logger.warning("cannot make %s: %s; nobody can ask this daemon about its workers", path, err.strerror)
            return
        self._server.listen(8)
        self._server.setblocking(False)
        loop.on_readable(self._server.fileno(), self._answer)

    def _answer(self) -> None:
        try:
            client, _ = self._server.accept()
        except OSError as err:
            if err.errno == errno.EMFILE:
                self._turn_away()
            return
        self._accepted(client)

    def _accepted(self, client: socket.socket) -> None:
        with contextlib.suppress(OSError), client:
            client.setblocking(False)  # an answer is far smaller than a socket's buffer
            client.sendall(json.dumps(self._document()).encode())

    def _turn_away(self) -> None:
        """Without a descriptor for it, a waiting connection would wake the loop without end: the spare one takes it."""
        os.close(self._spare)
        with contextlib.suppress(OSError):
            self._server.accept()[0].close()
        self._spare = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)

    def close(self) -> None:
        """Stop listening and remove the socket."""
        self._loop.forget(self._server.fileno())
        self._server.close()
        os.close(self._spare)
        with contextlib.suppress(OSError):
            self._path.unlink(missing_ok=True)


def ask_daemon(config: Config, seconds: float = 1.0) -> dict[str, Any] | None:
    """What the daemon of this configuration says of itself, None where none runs (or its state folder is not ours).

    Returns:
        ``daemon``, ``pid``, ``uptime`` (seconds), ``config`` (file or null), ``refused`` (why the last reload was, or
        ""), ``status`` (one line), ``workers``: a list of ``worker``, ``phase`` (`bridge.daemon.query.Phase`),
        ``text`` (what it is at, also while it starts), ``since`` (seconds in this phase), ``still`` (seconds for which
        a starting or running one has neither come further nor computed), ``beat`` (seconds since its process's last
        heartbeat, null before the first), ``pid``, ``restarts``, ``ended`` (how its last process ended by itself).
    """
    return ask_socket(config, state_file.daemon_socket, b"", seconds)


def ask_socket(
    config: Config, path: Callable[[Config], Path], question: bytes, seconds: float
) -> dict[str, Any] | None:
    """The answer on one of the daemon's sockets, None where there is none."""
    config = config.model_copy(update={"state": state_folder(config).absolute()})
    answer = b""
    if not hasattr(socket, "AF_UNIX"):  # Windows, where no daemon runs
        return None
    with socket.socket(socket.AF_UNIX) as sock:
        sock.settimeout(seconds)
        try:
            sock.connect(str(path(config)))
            if question:  # even no bytes at all cannot be sent to a server that has answered and left
                sock.sendall(question)
            while data := sock.recv(1 << 16):
                answer += data
                if len(answer) > _MAX_ANSWER:
                    return None
            said = json.loads(answer)
        except (OSError, ValueError, RuntimeError):
            return None
    return said if isinstance(said, dict) else None
