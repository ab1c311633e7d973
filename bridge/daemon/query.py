"""State of the daemon and its workers, on a Unix socket in the state folder.

A running worker responds on the hub; for one that cannot start, only the daemon can respond.
"""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge import state_file
from bridge.config.model import Config
from bridge.daemon.worker_states import Phase as Phase
from bridge.state_file import state_folder
from bridge.status import DaemonStatus, read_daemon_status

if TYPE_CHECKING:
    from yarp_compat.selector_loop import SelectorLoop


logger = logging.getLogger("midspan.daemon")

_MAX_RESPONSE = 1 << 20


class QueryServer:
    """Sends one JSON document on each connection, then closes it."""

    def __init__(self, loop: SelectorLoop, path: Path, document: Callable[[], dict[str, Any]]) -> None:
        self._loop = loop
        self._path = path
        self._document = document
        self._spare = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)
        self._server = socket.socket(socket.AF_UNIX)
        try:
            path.unlink(missing_ok=True)  # left by a dead daemon: this one holds the lock
            self._server.bind(str(path))
            path.chmod(0o600)
        except OSError as err:
            logger.warning("cannot create socket %s: %s; commands cannot query the workers", path, err.strerror)
            return
        self._server.listen(8)
        self._server.setblocking(False)
        loop.on_readable(self._server.fileno(), self._accept)

    def _accept(self) -> None:
        try:
            client, _ = self._server.accept()
        except OSError as err:
            if err.errno == errno.EMFILE:
                self._turn_away()
            return
        self._accepted(client)

    def _accepted(self, client: socket.socket) -> None:
        with contextlib.suppress(OSError), client:
            client.setblocking(False)  # the document is far smaller than the socket buffer
            client.sendall(json.dumps(self._document()).encode())

    def _turn_away(self) -> None:
        """Accept and close a connection with the spare descriptor: if it stayed pending, the loop would spin."""
        os.close(self._spare)
        with contextlib.suppress(OSError):
            self._server.accept()[0].close()
        self._spare = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)

    def close(self) -> None:
        """Stop listening and remove the socket."""
        self._loop.unwatch(self._server.fileno())
        self._server.close()
        os.close(self._spare)
        with contextlib.suppress(OSError):
            self._path.unlink(missing_ok=True)


def ask_daemon(config: Config, seconds: float = 1.0) -> DaemonStatus | None:
    """Return the state of this configuration's daemon, None if it is not running (or its folder is another user's)."""
    document = ask_socket(config, state_file.daemon_socket, b"", seconds)
    return None if document is None else read_daemon_status(document)


def ask_socket(config: Config, path: Callable[[Config], Path], request: bytes, seconds: float) -> dict[str, Any] | None:
    """Return the response on one of the daemon's sockets, None without a valid one."""
    config = config.model_copy(update={"state": state_folder(config).absolute()})
    response = b""
    if not hasattr(socket, "AF_UNIX"):  # on Windows, which has no daemon
        return None
    with socket.socket(socket.AF_UNIX) as sock:
        sock.settimeout(seconds)
        try:
            sock.connect(str(path(config)))
            if request:  # even an empty send fails if the server has already responded and closed
                sock.sendall(request)
            while data := sock.recv(1 << 16):
                response += data
                if len(response) > _MAX_RESPONSE:
                    return None
            document = json.loads(response)
        except (OSError, ValueError, RuntimeError):
            return None
    return document if isinstance(document, dict) else None
