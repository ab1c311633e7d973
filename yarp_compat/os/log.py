"""``Log`` as in the Python bindings: ``yarp.Log().info("...")``, in YARP's log format.

The format (``[INFO] |component| text``), the streams and the environment variables are those of
src/libYARP_os/src/yarp/os/Log.cpp: trace, debug and info go to standard output, the others to standard error. The
library's messages (ports that open, connections that open and close) use Python's ``logging`` under ``yarp``.
"""

from __future__ import annotations

import atexit
import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Self

from yarp_compat.overriding import override

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


_SEVERITIES = {kind: kind.name.removesuffix("Type").upper() for kind in LogType if kind.name.endswith("Type")}
_COLORS = dict(zip(_SEVERITIES, ("01;37", "01;32", "01;34", "01;33", "01;31", "01;37m\033[41"), strict=True))


def enabled(environment: Mapping[str, str], name: str, *, default: bool) -> bool:
    """Return whether one of YARP's switches is on: ``1``, ``true``, ``on``, ``yes``; any other value is off.

    An empty or unset switch has the ``default``.
    """
    value = environment.get(name, "")
    return value.lower() in ("1", "true", "on", "yes") if value else default


@dataclass(frozen=True)
class CodePlace:
    """The source location of a message, from the program; ``name`` distinguishes instances (YARP's id)."""

    file: str = ""
    line: int = 0
    function: str = ""
    name: str = ""
    time: float = 0.0  # seconds; 0: the current time


_NOWHERE = CodePlace()


def line(kind: LogType, text: str, component: str = "", *, color: bool = False, place: CodePlace = _NOWHERE) -> str:
    """Return a line in YARP's format; traces include the function."""
    severity, name = _SEVERITIES[kind], place.name
    shown = f"\033[{_COLORS[kind]}m{severity}\033[00m" if color else severity
    if kind == LogType.TraceType and place.function:
        shown += f"] {place.function}: " if text or component else f"] {place.function}"
    else:
        shown += "] "
    return f"[{shown}{_source(component, name)}{text}"


def _source(component: str, name: str) -> str:
    """Return the prefix of the text: the component, and the name of its instance."""
    if not component and not name:
        return ""
    return f"|{component}| " if not name else f"|{component}|{name}| " if component else f"|{name}| "


PrintCallback = Callable[[LogType, str, str], None]


def _print(kind: LogType, text: str, component: str, place: CodePlace = _NOWHERE) -> None:
    stream = sys.stdout if kind <= LogType.InfoType else sys.stderr
    color = enabled(os.environ, "YARP_COLORED_OUTPUT", default=False)
    if enabled(os.environ, "YARP_VERBOSE_OUTPUT", default=False):
        code = f"{place.file}:{place.line} {place.function} " if place.file else ""
        name = CodePlace(name=place.name)
        out = f"[{place.time or time.time():.6f}] " + line(kind, code + text, component, color=color, place=name)
    else:
        out = line(kind, text, component, color=color, place=place)
    with _lock:
        stream.write(f"{out}\n")  # in one piece, so that other threads cannot write into the line
        stream.flush()


def _first_level() -> LogType:
    if not enabled(os.environ, "YARP_DEBUG_ENABLE", default=True):
        return LogType.InfoType
    return LogType.TraceType if enabled(os.environ, "YARP_TRACE_ENABLE", default=False) else LogType.DebugType


class _LogMethod:
    """A method of `Log`, for objects and the class; without a text it returns a stream."""

    def __init__(self, kind: LogType, doc: str) -> None:
        self._kind = kind
        self.__doc__ = doc

    def __get__(self, log: Log | None, owner: type[Log]) -> Callable[..., Any]:
        place = _NOWHERE if log is None else log.place

        def write(text: str | None = None, *values: object) -> LogStream | None:
            if text is None:
                return LogStream(self._kind, place)
            owner.write(self._kind, text, values, place=place)
            if self._kind == LogType.FatalType:
                raise SystemExit(1)
            return None

        write.__doc__ = self.__doc__
        return write


class LogStream:
    """A line composed as in C++, ``yarp.Log().info() << "speed" << 0.3``; it is printed when the stream is deleted.

    Pieces are separated by spaces. Floats have six digits, as in C++ streams.
    """

    def __init__(self, kind: LogType, place: CodePlace = _NOWHERE) -> None:
        self._kind = kind
        self._place = place
        self._pieces: list[str] | None = []

    def __lshift__(self, piece: object) -> Self:
        if self._pieces is not None:
            self._pieces.append(_piece(piece))
        return self

    def __del__(self) -> None:
        pieces, self._pieces = self._pieces, None
        if pieces is None:
            return
        Log.write(self._kind, " ".join(pieces).removesuffix("\n"), (), place=self._place)
        if self._kind == LogType.FatalType:
            # Python swallows SystemExit here
            atexit._run_exitfuncs()
            os._exit(1)


def _piece(piece: object) -> str:
    if isinstance(piece, bool):
        return "true" if piece else "false"
    if isinstance(piece, float):
        return f"{piece:g}"
    if isinstance(piece, (list, tuple)):
        return "{" + ", ".join(map(_piece, piece)) + "}"
    return str(piece)


class Log:
    """YARP's logger: ``yarp.Log().info("speed %f", 0.3)``, ``yarp.Log.info("...")``; ``fatal`` also ends the program.

    Without a text the methods return a `LogStream`. ``Log(file, line, function)`` sets the source location, which
    ``YARP_VERBOSE_OUTPUT`` shows; a name and a time in seconds may follow.
    """

    LogTypeUnknown, TraceType, DebugType, InfoType, WarningType, ErrorType, FatalType, LogTypeReserved = LogType

    _minimum = _first_level()
    _forwarded = LogType.DebugType
    _callback: PrintCallback | None = None
    _forward: PrintCallback | None = None

    def __init__(self, file: str = "", line: int = 0, func: str = "", *rest: Any) -> None:
        names = [part for part in rest if isinstance(part, str)]
        times = [part for part in rest if isinstance(part, (int, float))]
        self.place = CodePlace(file, line, func, "".join(names[:1]), times[0] if times else 0.0)

    trace = _LogMethod(LogType.TraceType, "Print a trace message, shown only if ``YARP_TRACE_ENABLE`` is 1.")
    debug = _LogMethod(LogType.DebugType, "Print a debug message, hidden if ``YARP_DEBUG_ENABLE`` is 0.")
    info = _LogMethod(LogType.InfoType, "Print an info message.")
    warning = _LogMethod(LogType.WarningType, "Print a warning.")
    error = _LogMethod(LogType.ErrorType, "Print an error.")
    fatal = _LogMethod(LogType.FatalType, "Print an error and raise `SystemExit`.")

    @staticmethod
    def nolog(*text: object) -> None:
        """Print nothing."""

    @classmethod
    def setMinimumPrintLevel(cls, level: int) -> None:
        """Print only messages of this severity or above."""
        cls._minimum = LogType(level)

    @classmethod
    def minimumPrintLevel(cls) -> LogType:
        """Return the lowest severity that is printed."""
        return cls._minimum

    @staticmethod
    def defaultMinimumPrintLevel() -> LogType:
        """Return the lowest severity to print according to the environment variables."""
        return _first_level()

    @classmethod
    def setPrintCallback(cls, callback: PrintCallback) -> None:
        """Use ``callback(type, text, component)`` for printing."""
        cls._callback = None if callback is _print else staticmethod(callback)

    @classmethod
    def printCallback(cls) -> PrintCallback:
        """Return the callback for printing."""
        return cls._callback or _print

    @classmethod
    def defaultPrintCallback(cls) -> PrintCallback:
        """Return the callback that prints to the terminal."""
        return _print

    @classmethod
    def setMinimumForwardLevel(cls, level: int) -> None:
        """Forward only messages of this severity or above, see `setForwardCallback`."""
        cls._forwarded = LogType(level)

    @classmethod
    def minimumForwardLevel(cls) -> LogType:
        """Return the lowest severity that is forwarded."""
        return cls._forwarded

    @staticmethod
    def defaultMinimumForwardLevel() -> LogType:
        """Return the lowest severity that is forwarded by default."""
        return LogType.DebugType

    @classmethod
    def setForwardCallback(cls, callback: PrintCallback | None) -> None:
        """Also forward each message to ``callback(type, text, component)``."""
        cls._forward = None if callback is None else staticmethod(callback)

    @classmethod
    def forwardCallback(cls) -> PrintCallback | None:
        """Return the callback for forwarding, or None."""
        return cls._forward

    @staticmethod
    def defaultForwardCallback() -> PrintCallback | None:
        """Return None: messages are not sent to yarplogger."""
        return None

    @classmethod
    def write(
        cls, kind: LogType, text: str, values: tuple[object, ...], component: str = "", place: CodePlace = _NOWHERE
    ) -> None:
        """Print and forward a text, after ``%`` formatting with ``values``."""
        message = str(text) % values if values else str(text)
        if kind >= cls._minimum:
            if cls._callback is None:
                _print(kind, message, component, place)
            else:
                cls._callback(kind, message, component)
        if cls._forward is not None and kind >= cls._forwarded:
            cls._forward(kind, message, component)


class LogHandler(logging.Handler):
    """A ``logging`` handler that prints in YARP's format, for scripts that have not configured logging."""

    @override
    def emit(self, record: logging.LogRecord) -> None:
        kind = next((kind for least, kind in _LEVELS if record.levelno >= least), LogType.TraceType)
        text = record.getMessage()
        if record.exc_info:
            text += "\n" + _FORMATTER.formatException(record.exc_info)
        Log.write(kind, text, (), record.name)


_FORMATTER = logging.Formatter()
_LEVELS = (
    (logging.ERROR, LogType.ErrorType),
    (logging.WARNING, LogType.WarningType),
    (logging.INFO, LogType.InfoType),
    (logging.DEBUG, LogType.DebugType),
)


def print_as_yarp() -> None:
    """Print the library's messages in YARP's format, unless the program has configured logging."""
    logger = logging.getLogger("yarp")
    if logger.handlers or logging.getLogger().handlers:
        return
    logger.addHandler(LogHandler())
    logger.setLevel(logging.INFO)
