"""``Log`` as in the Python bindings: ``yarp.Log().info("...")``, in the format of YARP's own lines.

The format (``[INFO] |component| text``), the streams and the environment variables are those of
src/libYARP_os/src/yarp/os/Log.cpp: trace, debug and info go to standard output, the rest to standard error. YARP's own
messages (ports that open, connections that come and go) go through Python's ``logging`` under ``yarp``.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Any

_lock = threading.Lock()


class LogType(IntEnum):
    """The severity of a message."""

    LogTypeUnknown = 0
    TraceType = 1
    DebugType = 2
    InfoType = 3
    WarningType = 4
    ErrorType = 5
    FatalType = 6
    LogTypeReserved = 255


_WORDS = {kind: kind.name.removesuffix("Type").upper() for kind in LogType if kind.name.endswith("Type")}
_COLOURS = dict(zip(_WORDS, ("01;37", "01;32", "01;34", "01;33", "01;31", "01;37m\033[41"), strict=True))


def enabled(environment: Mapping[str, str], name: str, *, default: bool) -> bool:
    """Whether a switch of YARP's is on: ``1``, ``true``, ``on``, ``yes``; anything else is off."""
    value = environment.get(name, "")
    return value.lower() in ("1", "true", "on", "yes") if value else default


def line(kind: LogType, text: str, component: str = "", *, colour: bool = False) -> str:
    """One line as YARP prints it."""
    word = _WORDS[kind]
    shown = f"\033[{_COLOURS[kind]}m{word}\033[00m" if colour else word
    return f"[{shown}] |{component}| {text}" if component else f"[{shown}] {text}"


PrintCallback = Callable[[LogType, str, str], None]


def _print(kind: LogType, text: str, component: str) -> None:
    stream = sys.stdout if kind <= LogType.InfoType else sys.stderr
    out = line(kind, text, component, colour=enabled(os.environ, "YARP_COLORED_OUTPUT", default=False))
    if enabled(os.environ, "YARP_VERBOSE_OUTPUT", default=False):
        out = f"[{time.time():.6f}] {out}"
    with _lock:
        stream.write(f"{out}\n")  # in one piece: between two, other threads' text would stand in the line
        stream.flush()


def _first_level() -> LogType:
    if not enabled(os.environ, "YARP_DEBUG_ENABLE", default=True):
        return LogType.InfoType
    return LogType.TraceType if enabled(os.environ, "YARP_TRACE_ENABLE", default=False) else LogType.DebugType


def _prints(kind: LogType, doc: str) -> classmethod[Any, ..., None]:
    def say(cls: type[Log], text: str, *values: object) -> None:
        cls._say(kind, text, values)

    say.__doc__ = doc
    return classmethod(say)


class Log:
    """Prints: ``yarp.Log().info("speed %f", 0.3)``, ``yarp.Log.info("...")``; ``fatal`` ends the program, too."""

    LogTypeUnknown, TraceType, DebugType, InfoType, WarningType, ErrorType, FatalType, LogTypeReserved = LogType

    _minimum = _first_level()
    _callback: PrintCallback = staticmethod(_print)

    trace = _prints(LogType.TraceType, "Print for whoever follows each step; only where ``YARP_TRACE_ENABLE`` is 1.")
    debug = _prints(LogType.DebugType, "Print for developers; not shown when ``YARP_DEBUG_ENABLE`` is 0.")
    info = _prints(LogType.InfoType, "Print what users want to know.")
    warning = _prints(LogType.WarningType, "Print what may be wrong.")
    error = _prints(LogType.ErrorType, "Print what is wrong.")

    @classmethod
    def fatal(cls, text: str, *values: object) -> None:
        """Print, and end the program by `SystemExit`."""
        cls._say(LogType.FatalType, text, values)
        raise SystemExit(1)

    @classmethod
    def setMinimumPrintLevel(cls, level: int) -> None:
        """Print nothing less grave than this."""
        cls._minimum = LogType(level)

    @classmethod
    def minimumPrintLevel(cls) -> LogType:
        """The least grave messages that are printed."""
        return cls._minimum

    @classmethod
    def setPrintCallback(cls, callback: PrintCallback) -> None:
        """Have ``callback(type, text, component)`` print instead."""
        cls._callback = staticmethod(callback)

    @classmethod
    def defaultPrintCallback(cls) -> PrintCallback:
        """The callback that prints to the terminal."""
        return _print

    @classmethod
    def _say(cls, kind: LogType, text: str, values: tuple[object, ...], component: str = "") -> None:
        if kind >= cls._minimum:
            cls._callback(kind, str(text) % values if values else str(text), component)


class LogHandler(logging.Handler):
    """Prints the records of ``logging`` as YARP prints its own, for a script that set up no logging."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print one record."""
        kind = next((kind for least, kind in _LEVELS if record.levelno >= least), LogType.TraceType)
        text = record.getMessage()
        if record.exc_info:
            text += "\n" + _FORMATTER.formatException(record.exc_info)
        Log._say(kind, text, (), record.name)


_FORMATTER = logging.Formatter()
_LEVELS = (
    (logging.ERROR, LogType.ErrorType),
    (logging.WARNING, LogType.WarningType),
    (logging.INFO, LogType.InfoType),
    (logging.DEBUG, LogType.DebugType),
)


def print_as_yarp() -> None:
    """Print the library's own messages in YARP's format, if the program has set up no logging of its own."""
    logger = logging.getLogger("yarp")
    if logger.handlers or logging.getLogger().handlers:
        return
    logger.addHandler(LogHandler())
    logger.setLevel(logging.INFO)
