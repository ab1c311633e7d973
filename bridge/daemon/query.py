"""Requests to the daemon, on a socket in its state folder: its state, its log, a reload.

A running worker responds on the hub; only the daemon can report on a worker that cannot start. A request is one line of
JSON, ``{"verb": "status"}``; the response is one JSON document, after which the daemon closes the connection.
"""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
import socket
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge import state_file
from bridge.config.model import Config
from bridge.daemon import local_socket
from bridge.daemon.worker_states import Phase as Phase
from bridge.state_file import state_folder
from bridge.status import DaemonStatus, read_daemon_status

if TYPE_CHECKING:
    from yarp_compat.selector_loop import SelectorLoop


logger = logging.getLogger("midspan.daemon")

Verb = Callable[[dict[str, Any]], dict[str, Any]]
"""Returns the response to a request; raises `ValueError`, `KeyError` or `TypeError` for an invalid one."""

STATUS, RELOAD = "status", "reload"
_MAX_RESPONSE = 1 << 20
_MAX_REQUEST = 1 << 10
_MAX_CLIENTS = 8


class _Client:
    """A connection whose request has not arrived completely yet, or whose response has not been sent completely."""

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self.received = b""
        self.admitted = False
        self.response = b""


class QueryServer:
    """Responds to requests with its ``verbs``, by name, on the loop's thread."""

    def __init__(self, loop: SelectorLoop, path: Path, verbs: Mapping[str, Verb]) -> None:
        self._loop = loop
        self._verbs = verbs
        self._clients: deque[_Client] = deque()
        self._spare = os.open(os.devnull, os.O_RDONLY)
        self._listener: local_socket.LocalListener | None = None
        try:
            self._listener = local_socket.LocalListener(path)
        except OSError as err:
            logger.warning("cannot create socket %s: %s; commands cannot query the daemon", path, err.strerror)
            return
        self._listener.sock.setblocking(False)
        loop.on_readable(self._listener.sock, partial(self._accept, self._listener))

    def _accept(self, listener: local_socket.LocalListener) -> None:
        try:
            sock, _ = listener.sock.accept()
        except OSError as err:
            if err.errno == errno.EMFILE:
                self._turn_away(listener)
            return
        sock.setblocking(False)
        while len(self._clients) >= _MAX_CLIENTS:
            self._close(self._clients[0])  # the oldest unfinished connection
        client = _Client(sock)
        self._clients.append(client)
        try:
            self._loop.on_readable(sock, partial(self._read, listener, client))
        except OSError as err:  # the system cannot watch more
            logger.warning("a command cannot query the daemon: %s", err.strerror)
            self._close(client)

    def _turn_away(self, listener: local_socket.LocalListener) -> None:
        """Accept and close a connection with the spare descriptor, because a pending one would make the loop spin."""
        os.close(self._spare)
        with contextlib.suppress(OSError):
            listener.sock.accept()[0].close()
        self._spare = os.open(os.devnull, os.O_RDONLY)

    def _read(self, listener: local_socket.LocalListener, client: _Client) -> None:
        try:
            data = client.sock.recv(_MAX_REQUEST)
            client.received += data
            if not client.admitted and len(client.received) >= listener.greeting:
                greeting, client.received = client.received[: listener.greeting], client.received[listener.greeting :]
                client.admitted = listener.admit(client.sock, greeting)
                data = data if client.admitted else b""
            request, end, _ = client.received.partition(b"\n")
            if client.admitted and end:
                client.response = self._respond(request)
                self._loop.on_readable(client.sock, None)
                self._send(client)
                return
            if data and len(client.received) < _MAX_REQUEST:
                return
        except BlockingIOError:
            return
        except OSError:
            pass
        self._close(client)

    def _send(self, client: _Client) -> None:
        """Send the response as fast as the client reads it: a document may be larger than a socket's buffer."""
        try:
            while client.response:
                client.response = client.response[client.sock.send(client.response) :]
        except BlockingIOError:
            self._loop.on_writable(client.sock, partial(self._send, client))
            return
        except OSError:
            pass
        self._close(client)

    def _respond(self, line: bytes) -> bytes:
        try:
            request = json.loads(line)
            document = self._verbs[request["verb"]](request)
        except (ValueError, KeyError, TypeError, RecursionError) as err:
            document = {"error": f"not a request: {err!r}"}
        return json.dumps(document).encode()

    def _close(self, client: _Client) -> None:
        self._clients.remove(client)
        self._loop.unwatch(client.sock)
        client.sock.close()

    def close(self) -> None:
        """Stop listening and remove the socket."""
        while self._clients:
            self._close(self._clients[0])
        if self._listener is not None:
            self._loop.unwatch(self._listener.sock)
            self._listener.close()
        os.close(self._spare)


def ask_daemon(config: Config, seconds: float = 1.0) -> DaemonStatus | None:
    """Return the state of this configuration's daemon, None if it does not run, respond or belong to this user."""
    document = request(config, STATUS, seconds)
    return None if document is None else read_daemon_status(document)


def reload_daemon(config: Config, seconds: float = 20.0) -> str | None:
    """Make a daemon load its file again; return why it rejects the file, "" if not, None if the daemon does not run."""
    document = request(config, RELOAD, seconds)
    if document is None:
        return None
    if "rejected" in document:
        return str(document["rejected"])
    return str(
        document.get("error") or "the daemon is of an earlier release, which cannot reload on request; restart it"
    )


def request(config: Config, verb: str, seconds: float, **fields: Any) -> dict[str, Any] | None:
    """Return the daemon's response to a request, None if no valid response arrives within ``seconds``."""
    config = config.model_copy(update={"state": state_folder(config).absolute()})
    response = b""
    try:
        with local_socket.connect(state_file.daemon_socket(config), seconds) as sock:
            with contextlib.suppress(OSError):  # a daemon of an earlier release does not read the request
                sock.sendall(json.dumps({"verb": verb, **fields}).encode() + b"\n")
            with contextlib.suppress(ConnectionError):  # and resets the connection after its response
                while data := sock.recv(1 << 16):
                    response += data
                    if len(response) > _MAX_RESPONSE:
                        return None
        document = json.loads(response)
    except (OSError, ValueError, RuntimeError):
        return None
    return document if isinstance(document, dict) else None
