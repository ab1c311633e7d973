"""The control socket of a worker that outlives its daemon: the next daemon finds it there and goes on with it."""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import threading
from collections.abc import Callable
from pathlib import Path

from bridge.daemon.protocol import (
    Command,
    Hello,
    Lines,
    Log,
    Owner,
    ProtocolError,
    Report,
    decode_command,
    encode_report,
)

logger = logging.getLogger("midspan.worker")

_SEND_SECONDS = 0.5
_READ_SIZE = 1 << 16


class ControlServer:
    """Listens on a Unix socket; one daemon at a time, a newer one takes the older one's place.

    Args:
        path: the socket's; nobody else may use it, so the worker's lock must be held.
        owner: who started this worker.
        obey: takes each command, on a thread of this server.

    Raises:
        RuntimeError: the socket cannot be made.
    """

    def __init__(self, path: Path, owner: Owner, obey: Callable[[Command], None]) -> None:
        self._path = path
        self._hello = Hello(os.getpid(), owner)
        self._obey = obey
        self._lock = threading.Lock()
        self._client: socket.socket | None = None
        self._closed = False
        self._server = socket.socket(socket.AF_UNIX)
        try:
            path.unlink(missing_ok=True)  # a dead predecessor's
            self._server.bind(str(path))
            path.chmod(0o600)
        except OSError as err:
            self._server.close()
            msg = f"cannot make {path}: {err.strerror}; make the state folder writable, or set 'state' to one that is"
            raise RuntimeError(msg) from None
        self._server.listen(4)
        self._thread = threading.Thread(target=self._accept, name="control", daemon=True)
        self._thread.start()

    def report(self, report: Report) -> None:
        """Send to the daemon that is connected, if one is."""
        self._send(encode_report(report))

    def relay(self, level: int, text: str) -> bool:
        """Send a log line; False where no daemon is connected."""
        return self._send(encode_report(Log(level, text)))

    def _send(self, data: bytes) -> bool:
        with self._lock:
            return self._send_now(data)

    def _send_now(self, data: bytes) -> bool:
        if self._client is None:
            return False
        try:
            self._client.sendall(data)
        except OSError:
            self._drop()
            return False
        return True

    def _drop(self) -> None:
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.shutdown(socket.SHUT_RDWR)
            self._client.close()
            self._client = None

    def _accept(self) -> None:
        while not self._closed:
            try:
                client, _ = self._server.accept()
            except OSError:
                return
            client.settimeout(_SEND_SECONDS)
            with self._lock:
                self._drop()
                self._client = client
                self._send_now(encode_report(self._hello))  # before any other report
            self._flush_log()
            threading.Thread(target=self._read, args=(client,), name="control-client", daemon=True).start()

    def _flush_log(self) -> None:
        for handler in logging.getLogger().handlers:
            handler.flush()

    def _read(self, client: socket.socket) -> None:
        lines = Lines()
        while True:
            try:
                data = client.recv(_READ_SIZE)
            except TimeoutError:
                continue
            except OSError:
                return
            if not data:
                break
            for line in lines.feed(data):
                try:
                    self._obey(decode_command(line))
                except ProtocolError as err:
                    logger.error("the daemon sent %s", err)  # noqa: TRY400
        with self._lock:
            if self._client is client:
                self._drop()

    def close(self) -> None:
        """Stop listening and remove the socket."""
        self._closed = True
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)  # wakes accept
        self._server.close()
        self._thread.join(1)
        with self._lock:
            self._drop()
        self._path.unlink(missing_ok=True)
