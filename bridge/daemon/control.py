"""A worker's end of the line to the daemon: pipes, or the control socket of a worker that outlives the daemon."""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import socket
import threading
from collections.abc import Callable
from pathlib import Path

from bridge.daemon import protocol
from bridge.daemon.begin import begin
from bridge.progress import working

logger = logging.getLogger("midspan.worker")

_READ_SIZE = 1 << 16
_SEND_SECONDS = 0.5

LAST_SECONDS = 4.0
"""A worker whose daemon is gone and whose stop hangs is ended after this."""


class Hangup:
    """Command from SIGHUP: load the configuration again."""


Commands = queue.SimpleQueue[protocol.Command | Hangup]
"""A `queue.SimpleQueue`: its ``put`` may be called from a signal handler."""


class DaemonPipe:
    """Reads commands from the standard input and writes reports to the standard output.

    Takes both descriptors for itself, the output by `begin`: programs that the worker starts do not inherit the
    daemon's pipes.
    """

    def __init__(self) -> None:
        self.heart = begin()
        self._input = os.dup(0)
        null = os.open(os.devnull, os.O_RDONLY)
        os.dup2(null, 0)
        os.close(null)
        self._lines = protocol.Lines()
        self._waiting: list[bytes] = []

    def first_config(self) -> protocol.NewConfig | None:
        """The configuration to start with; None where the daemon went, or told to stop, before it sent one."""
        working.at("reading the configuration")
        while True:
            if self._waiting:
                command = protocol.decode_command(self._waiting.pop(0))
                return command if isinstance(command, protocol.NewConfig) else None
            data = os.read(self._input, _READ_SIZE)
            if not data:
                return None
            self._waiting = self._lines.feed(data)

    def read_to(self, commands: Commands, *, stop_at_end: bool) -> None:
        """Put what comes into the queue, from a thread; the end of the stream stops unless told otherwise."""
        threading.Thread(target=self._read, args=(commands, stop_at_end), name="daemon-pipe", daemon=True).start()

    def _read(self, commands: Commands, stop_at_end: bool) -> None:
        while True:
            for line in self._waiting:
                try:
                    commands.put(protocol.decode_command(line))
                except protocol.ProtocolError as err:
                    logger.error("the daemon sent %s", err)  # noqa: TRY400
            data = os.read(self._input, _READ_SIZE)
            if not data:
                break
            self._waiting = self._lines.feed(data)
        if stop_at_end:
            commands.put(protocol.Stop("the daemon is gone"))
            end_process_after(LAST_SECONDS)

    def report(self, report: protocol.Report) -> None:
        """Write one report; a daemon that is gone is noticed by the reading thread."""
        self.heart.write(protocol.encode_report(report))


def end_process_after(seconds: float) -> None:
    """End this process hard if it is still there by then: its daemon is gone, nobody else would."""
    timer = threading.Timer(seconds, os._exit, args=(1,))
    timer.daemon = True
    timer.start()


class ControlServer:
    """Listens on a Unix socket for one daemon at a time; a newer one replaces the older.

    The caller holds the worker's lock. ``obey`` takes each command, on a thread of this server. Raises `RuntimeError`
    where the socket cannot be made.
    """

    def __init__(self, path: Path, owner: protocol.Owner, obey: Callable[[protocol.Command], None]) -> None:
        self._path = path
        self._hello = protocol.Hello(os.getpid(), owner)
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
            cure = "make the state folder writable, or set 'state' to one that is"
            raise RuntimeError(f"cannot make {path}: {err.strerror}; {cure}") from None
        self._server.listen(4)
        self._thread = threading.Thread(target=self._accept, name="control", daemon=True)
        self._thread.start()

    def report(self, report: protocol.Report) -> None:
        """Send to the daemon that is connected, if one is."""
        self._send(protocol.encode_report(report))

    def relay(self, level: int, text: str) -> bool:
        """Send a log line; False where no daemon is connected."""
        return self._send(protocol.encode_report(protocol.LogLine(level, text)))

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
                self._send_now(protocol.encode_report(self._hello))  # before any other report
            self._flush_log()
            threading.Thread(target=self._read, args=(client,), name="control-client", daemon=True).start()

    def _flush_log(self) -> None:
        for handler in logging.getLogger().handlers:
            handler.flush()

    def _read(self, client: socket.socket) -> None:
        lines = protocol.Lines()
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
                    self._obey(protocol.decode_command(line))
                except protocol.ProtocolError as err:
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
