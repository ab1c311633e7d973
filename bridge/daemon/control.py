"""A worker's end of its channel to the daemon: pipes, or the control socket of a worker that outlives the daemon."""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import queue
import socket
import threading
from collections.abc import Callable
from pathlib import Path

from bridge.config.received import ReceivedConfig
from bridge.daemon import protocol
from bridge.daemon.heartbeat import start_heartbeat
from bridge.daemon.local_socket import LocalListener, receive, wait_readable
from bridge.progress import working

logger = logging.getLogger("midspan.worker")

_READ_SIZE = 1 << 16
_SEND_SECONDS = 0.5
_RETRY_SECONDS = 1.0
_MAX_GREETINGS = 32

LAST_SECONDS = 4.0
"""Limit in seconds for the stop of a worker whose daemon has exited."""


class Hangup:
    """Command from SIGHUP: reload the configuration."""


Commands = queue.SimpleQueue[protocol.Command | Hangup]
"""A `queue.SimpleQueue`: its ``put`` may be called from a signal handler."""


class DaemonPipe:
    """Reads commands from standard input and writes reports to standard output.

    It replaces both descriptors (`start_heartbeat` replaces the output), so that programs started by the worker do not
    inherit the daemon's pipes.
    """

    def __init__(self) -> None:
        self.heartbeat = start_heartbeat()
        self._input = os.dup(0)
        null = os.open(os.devnull, os.O_RDONLY)
        os.dup2(null, 0)
        os.close(null)
        self._lines = protocol.Lines()
        self._waiting: list[bytes] = []

    def first_config(self) -> protocol.NewConfig | None:
        """Wait for the first configuration; return None if the daemon exits or sends another command first."""
        working.at("reading the configuration")
        while True:
            if self._waiting:
                command = protocol.decode_command(self._waiting.pop(0), ReceivedConfig.of)
                return command if isinstance(command, protocol.NewConfig) else None
            data = os.read(self._input, _READ_SIZE)
            if not data:
                return None
            self._waiting = self._lines.feed(data)

    def read_to(self, commands: Commands, *, stop_at_end: bool) -> None:
        """Queue the daemon's commands, on a thread; with ``stop_at_end`` the end of the stream is a stop command."""
        threading.Thread(target=self._read, args=(commands, stop_at_end), name="daemon-pipe", daemon=True).start()

    def _read(self, commands: Commands, stop_at_end: bool) -> None:
        while True:
            for line in self._waiting:
                try:
                    commands.put(protocol.decode_command(line))
                except protocol.ProtocolError as err:
                    logger.error("the daemon sent %s", err)  # noqa: TRY400
            try:
                data = os.read(self._input, _READ_SIZE)
            except OSError as err:
                logger.error("cannot read the daemon's commands: %s", err)  # noqa: TRY400
                data = b""
            if not data:
                break
            self._waiting = self._lines.feed(data)
        if stop_at_end:
            commands.put(protocol.Stop("the daemon has exited"))
            end_process_after(LAST_SECONDS)

    def report(self, report: protocol.Report) -> None:
        """Write one report. Errors are ignored, because the reading thread detects that the daemon has exited."""
        self.heartbeat.write(protocol.encode_report(report))


def end_process_after(seconds: float) -> None:
    """Exit this process unconditionally after a delay, because the daemon, which would kill it, has exited."""
    timer = threading.Timer(seconds, os._exit, args=(1,))
    timer.daemon = True
    timer.start()


def with_pipe(server: ControlServer, pipe: Callable[[protocol.Report], None]) -> Callable[[protocol.Report], None]:
    """Return a function that sends reports; why a worker fails goes over the pipe if the daemon is not connected."""

    def report(report: protocol.Report) -> None:
        if not server.report(report) and isinstance(report, protocol.Failed):
            pipe(report)

    return report


class ControlServer:
    """Listens at a path for one daemon at a time; a new connection replaces the previous one.

    The caller holds the worker's lock. ``on_command`` is called with each command, on a thread of this server.
    Raises `RuntimeError` if the socket cannot be created.
    """

    def __init__(self, path: Path, owner: protocol.Owner, on_command: Callable[[protocol.Command], None]) -> None:
        self._hello = protocol.Hello(os.getpid(), owner)
        self._on_command = on_command
        self._lock = threading.Lock()
        self._client: socket.socket | None = None
        self._client_number = -1
        self._closing = threading.Event()
        self._greetings = threading.Semaphore(_MAX_GREETINGS)
        try:
            self._listener = LocalListener(path)
        except OSError as err:
            cure = "make the state folder writable, or set 'state' to one that is"
            raise RuntimeError(f"cannot create {path}: {err.strerror}; {cure}") from None
        self._thread = threading.Thread(target=self._accept, name="control", daemon=True)
        self._thread.start()

    def report(self, report: protocol.Report) -> bool:
        """Send a report; return False if no daemon is connected."""
        return self._send(protocol.encode_report(report))

    def relay(self, level: int, text: str) -> bool:
        """Send a log line; return False if no daemon is connected."""
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
        """Disconnect; the thread that reads the socket then closes it, so that no other file gets its number before."""
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.shutdown(socket.SHUT_RDWR)
            self._client = None

    def _accept(self) -> None:
        numbers = itertools.count()
        while not self._closing.is_set():
            try:
                client, _ = self._listener.sock.accept()
            except OSError as err:  # closed, out of descriptors, or the daemon has disconnected already
                if not self._closing.is_set():
                    logger.warning("the daemon cannot connect: %s; trying again", err.strerror)
                self._closing.wait(_RETRY_SECONDS)
                continue
            client.settimeout(_SEND_SECONDS)
            self._greetings.acquire()  # each is released within _SEND_SECONDS
            serving = threading.Thread(
                target=self._run, args=(client, next(numbers)), name="control-client", daemon=True
            )
            try:
                serving.start()
            except RuntimeError as err:  # the system is out of threads
                logger.warning("the daemon cannot connect: %s; trying again", err)
                self._greetings.release()
                client.close()

    def _run(self, client: socket.socket, number: int) -> None:
        with client:
            self._serve(client, number)

    def _serve(self, client: socket.socket, number: int) -> None:
        try:
            admitted = self._listener.admit(client, receive(client, self._listener.greeting))
        except OSError:
            admitted = False
        finally:
            self._greetings.release()
        with self._lock:
            if not admitted or self._closing.is_set() or number < self._client_number:  # a later client was first
                return
            self._drop()
            self._client, self._client_number = client, number
            self._send_now(protocol.encode_report(self._hello))  # before any other report
        self._flush_log()
        self._read(client)

    def _flush_log(self) -> None:
        for handler in logging.getLogger().handlers:
            handler.flush()

    def _read(self, client: socket.socket) -> None:
        lines = protocol.Lines()
        while True:
            try:
                wait_readable(client)
                data = client.recv(_READ_SIZE)
            except TimeoutError:
                continue
            except OSError:
                data = b""
            if not data:
                break
            for line in lines.feed(data):
                if self._client is not client:  # a later connection's commands come after this line
                    return
                try:
                    self._on_command(protocol.decode_command(line))
                except protocol.ProtocolError as err:
                    logger.error("the daemon sent %s", err)  # noqa: TRY400
        with self._lock:
            if self._client is client:
                self._drop()

    def close(self) -> None:
        """Stop listening and remove the socket."""
        with self._lock:
            self._closing.set()
        self._listener.close()
        self._thread.join(1)
        with self._lock:
            self._drop()
