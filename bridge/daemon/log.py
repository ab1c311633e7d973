"""Logging of the daemon and its workers: to stderr, with journald's priorities if journald reads it.

A supervised worker writes ``<priority>text``; the daemon prepends the worker's name and logs the line.
"""

from __future__ import annotations

import logging
import os
import re
import sys
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from enum import Enum
from queue import SimpleQueue
from threading import Event, Thread

from typing_extensions import override

from bridge.config.model import Config

LEVELS = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}
RECENT_LINES = 200
WAITING_RECORDS = 1000
FLUSH_SECONDS = 0.5

# syslog's numbers (sd-daemon(3)): err, warning, info, debug
_PRIORITIES = {logging.ERROR: 3, logging.WARNING: 4, logging.INFO: 6, logging.DEBUG: 7}
_PRIORITY = re.compile(r"<([0-7])>")
_COLOR = re.compile(r"\x1b\[[0-9;]*m")
_OF_RCUTILS = re.compile(r"\[(DEBUG|INFO)\] \[")


class Style(Enum):
    """The format of a line."""

    TERMINAL = "terminal"
    JOURNAL = "journal"
    SUPERVISED = "supervised"


def style_for(environ: Mapping[str, str] = os.environ) -> Style:
    """Return the style for stderr: journald sets ``JOURNAL_STREAM`` for the processes whose output it reads."""
    return Style.JOURNAL if environ.get("JOURNAL_STREAM") else Style.TERMINAL


class LineFormatter(logging.Formatter):
    """Formats a record as lines that each start with the priority, or with the time and level."""

    def __init__(self, style: Style, name: str) -> None:
        super().__init__(datefmt="%H:%M:%S")
        self._line_style = style
        self._name = name

    @override
    def format(self, record: logging.LogRecord) -> str:
        text = record.getMessage()
        if record.exc_info:
            text += "\n" + self.formatException(record.exc_info)
        name = "" if self._line_style is Style.SUPERVISED else f"{getattr(record, 'worker', self._name)}: "
        prefix = self._prefix(record)
        return "\n".join(f"{prefix}{name}{line}" for line in text.split("\n"))

    def _prefix(self, record: logging.LogRecord) -> str:
        if self._line_style is not Style.TERMINAL:
            return f"<{priority(record.levelno)}>"
        return f"{self.formatTime(record, self.datefmt)}.{int(record.msecs):03d} {record.levelname.lower():7} "


def priority(level: int) -> int:
    """Return syslog's priority for a logging level."""
    return next((number for least, number in _PRIORITIES.items() if level >= least), 7)


def split_priority(line: str) -> tuple[int, str]:
    """Return level and text of a worker's line.

    A line without priority is from a library. It loses its colors and counts as a warning, unless it has ROS 2's usual
    format (rcutils, logging.c: ``[INFO] [time] [name]: text``).
    """
    match = _PRIORITY.match(line)
    if match is None:
        line = _COLOR.sub("", line)
        ros = _OF_RCUTILS.match(line)
        return LEVELS[ros[1].lower()] if ros else logging.WARNING, line
    number = int(match[1])
    level = next((level for level, least in _PRIORITIES.items() if number <= least), logging.DEBUG)
    return level, line[match.end() :]


class RelayHandler(logging.Handler):
    """Queues log lines until a daemon is connected: the log of a worker that outlives its daemon."""

    def __init__(self) -> None:
        super().__init__()
        self.setFormatter(LineFormatter(Style.SUPERVISED, ""))
        self._lines: deque[tuple[int, str]] = deque(maxlen=RECENT_LINES)
        self._sink: Callable[[int, str], bool] = lambda _level, _text: False

    def relay_to(self, sink: Callable[[int, str], bool]) -> None:
        """Send lines with ``sink``, which returns whether it delivered the line."""
        self._sink = sink

    @override
    def flush(self) -> None:
        self.acquire()
        try:
            while self._lines and self._sink(*self._lines[0]):
                self._lines.popleft()
        finally:
            self.release()

    @override
    def close(self) -> None:
        """Write undelivered lines to stderr, which the daemon reads after the exit of the process."""
        self.flush()
        self.acquire()
        try:
            for level, text in self._lines:
                sys.stderr.write(f"<{priority(level)}>{text}\n")
            self._lines.clear()
        finally:
            self.release()
        super().close()

    @override
    def emit(self, record: logging.LogRecord) -> None:
        for line in self.format(record).split("\n"):
            self._lines.append(split_priority(line))
        self.flush()


class StderrHandler(logging.Handler):
    """Writes to stderr on a thread, because a suspended reader of the log, such as a terminal, blocks writing.

    At most `WAITING_RECORDS` wait; further ones are dropped and counted.
    """

    def __init__(self) -> None:
        super().__init__()
        # not the stream, whose lock Python needs at its exit; None if stderr was closed before Python started
        self._file = None if sys.stderr is None else sys.stderr.fileno()
        self._waiting: SimpleQueue[str | Event | None] = SimpleQueue()
        self._dropped = 0
        Thread(target=self._run, name="midspan-log", daemon=True).start()

    @override
    def emit(self, record: logging.LogRecord) -> None:
        if self._waiting.qsize() >= WAITING_RECORDS:
            self._dropped += 1
            return
        dropped, self._dropped = self._dropped, 0
        if dropped:
            text = f"{dropped} log messages were dropped, because the reader of the log was suspended"
            self._waiting.put(self.format(logging.LogRecord(record.name, logging.WARNING, "", 0, text, None, None)))
        self._waiting.put(self.format(record))

    @override
    def flush(self) -> None:
        """Wait up to `FLUSH_SECONDS` until all records are written."""
        written = Event()
        self._waiting.put(written)
        written.wait(FLUSH_SECONDS)

    @override
    def close(self) -> None:
        self._waiting.put(None)
        super().close()

    def _run(self) -> None:
        while (item := self._waiting.get()) is not None:
            if isinstance(item, Event):
                item.set()
                continue
            data = f"{item}\n".encode(errors="backslashreplace")
            with suppress(OSError):  # a closed stderr or a full disk must not stop a bridge
                while data and self._file is not None:
                    data = data[os.write(self._file, data) :]


def setup(config: Config, name: str, style: Style, handler: logging.Handler | None = None) -> None:
    """Set up the root logger of this process."""
    logging.raiseExceptions = False  # a closed stderr must not stop a bridge
    handler = handler or logging.StreamHandler(sys.stderr)
    if handler.formatter is None:
        handler.setFormatter(LineFormatter(style, name))
    root = logging.getLogger()
    for old in list(root.handlers):
        root.removeHandler(old)
    root.addHandler(handler)
    set_level(config)


def set_level(config: Config) -> None:
    """Apply the configured level."""
    logging.getLogger().setLevel(LEVELS[config.log.level])
