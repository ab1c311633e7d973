"""The supervised worker's end of the daemon's pipes."""

from __future__ import annotations

import logging
import os
import sys
import threading

from bridge.daemon.child import LAST_SECONDS, Commands, end_process_after
from bridge.daemon.protocol import Lines, NewConfig, ProtocolError, Report, Stop, decode_command, encode_report

logger = logging.getLogger("midspan.worker")

_READ_SIZE = 1 << 16


class DaemonPipe:
    """Reads commands from the standard input and writes reports to the standard output.

    Takes both descriptors for itself: whatever else in this process writes to the standard output reaches stderr, and
    programs that the worker starts do not inherit the daemon's pipes.
    """

    def __init__(self) -> None:
        self._input = os.dup(0)
        self._output = os.dup(1)
        null = os.open(os.devnull, os.O_RDONLY)
        os.dup2(null, 0)
        os.close(null)
        os.dup2(2, 1)
        sys.stdout = sys.stderr
        self._lines = Lines()
        self._waiting: list[bytes] = []
        self._lock = threading.Lock()

    def first_config(self) -> NewConfig | None:
        """The configuration to start with; None where the daemon went, or told to stop, before it sent one."""
        while True:
            if self._waiting:
                command = decode_command(self._waiting.pop(0))
                return command if isinstance(command, NewConfig) else None
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
                    commands.put(decode_command(line))
                except ProtocolError as err:
                    logger.error("the daemon sent %s", err)  # noqa: TRY400
            data = os.read(self._input, _READ_SIZE)
            if not data:
                break
            self._waiting = self._lines.feed(data)
        if stop_at_end:
            commands.put(Stop("the daemon is gone"))
            end_process_after(LAST_SECONDS)

    def report(self, report: Report) -> None:
        """Write one report; a daemon that is gone is noticed by the reading thread."""
        data = encode_report(report)
        with self._lock:
            try:
                while data:
                    data = data[os.write(self._output, data) :]
            except OSError:
                return
