"""Outputs and acceptors of C code, written in Python, and calls of those that are written in C.

See ``bridge/routing/output.h`` and ``bridge/hub/lane/receiving.h``.
"""

from __future__ import annotations

import ctypes
import math
import time
from collections import deque
from collections.abc import Callable
from ctypes import PYFUNCTYPE, c_bool, c_char_p, c_int64, c_size_t, c_void_p, py_object
from typing import Any

from bridge.routing.doorway import Deadline
from bridge.routing.exit import Exit

GID = b"g" * 16

_ACCEPTOR, _OUTPUT = b"bridge.hub.lane.receiving.acceptor", b"bridge.routing.output"
_Accept = PYFUNCTYPE(c_bool, py_object, py_object, c_void_p, c_size_t, c_int64)
_IsReady = PYFUNCTYPE(c_bool, py_object)
_Send = PYFUNCTYPE(c_bool, py_object, c_void_p, c_size_t)

_new = PYFUNCTYPE(py_object, c_void_p, c_char_p, c_void_p)(("PyCapsule_New", ctypes.pythonapi))
_pointer = PYFUNCTYPE(c_void_p, py_object, c_char_p)(("PyCapsule_GetPointer", ctypes.pythonapi))


class _Acceptor(ctypes.Structure):
    _fields_ = [("accept", _Accept)]


class _Output(ctypes.Structure):
    _fields_ = [("is_ready", _IsReady), ("send", _Send)]


def foreign_capsule() -> object:
    """Return a capsule that is neither an output nor an acceptor."""
    return _new(ctypes.addressof(_FOREIGN), b"foreign", None)


_FOREIGN = ctypes.c_int(0)


class RecordingAcceptor:
    """Accepts the messages of a receiver, or refuses them; ``accepted`` has GID, payload and time of each.

    ``on_call`` is called before the answer.
    """

    def __init__(self) -> None:
        self.accepts = True
        self.accepted: list[tuple[bytes, bytes, int]] = []
        self.on_call: Callable[[], object] = lambda: None
        self._functions = _Acceptor(_Accept(self._accept))
        self.acceptor = _new(ctypes.addressof(self._functions), _ACCEPTOR, None)

    def _accept(self, owner: object, gid: bytes, payload: int, size: int, time_ns: int) -> bool:
        assert owner is self
        self.on_call()
        if self.accepts:
            self.accepted.append((gid, ctypes.string_at(payload, size), time_ns))
        return self.accepts


class RecordingOutput:
    """Sends the messages of an exit to the list ``sent``, while it is ``ready`` and does not fail (``accepts``)."""

    def __init__(self) -> None:
        self.ready = self.accepts = True
        self.sent: list[bytes] | deque[bytes] = []
        self._functions = _Output(_IsReady(self._is_ready), _Send(self._send))
        self.output = _new(ctypes.addressof(self._functions), _OUTPUT, None)

    def _is_ready(self, owner: object) -> bool:
        assert owner is self
        return self.ready

    def _send(self, _owner: object, message: int, size: int) -> bool:
        ctypes.memset(message - 4, 0xFF, 4)  # an output may overwrite these bytes
        if self.accepts:
            self.sent.append(ctypes.string_at(message, size))
        return self.accepts


def exit_to(output: object, limit: int = 64 * 1024) -> Exit:
    """Return an exit that passes on all messages of `GID` as they are."""
    lease = Deadline()
    lease.until = math.inf
    way = Exit(lease, None, (deque[Any](),), (), None, limit, ())
    way.allow({GID})
    way.send_by(output)
    return way


def pass_on(way: Exit, payload: bytes, gid: object = GID, time_ns: int | None = None) -> bool:
    """Call an exit as a receiver does; return whether it has sent the message. Raises what the receiver would clear."""
    functions = ctypes.cast(_pointer(way.acceptor, _ACCEPTOR), ctypes.POINTER(_Acceptor))
    address = ctypes.cast(payload, c_void_p)
    return functions.contents.accept(way, gid, address, len(payload), time.time_ns() if time_ns is None else time_ns)
