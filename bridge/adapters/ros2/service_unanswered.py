"""The results of goals that clients wait for, remembered beyond the death of this worker.

A DDS client whose server dies waits for ever. Its request is lost with the worker, but not the goal, which lives at its
real server; so the next worker asks there again and sends the reply to the dead one's request: a reply finds its client
by the request's identity alone (``rmw_request_id_t``), whoever sends it.

This is for ``get_result`` alone, which may be asked for as often as one likes. A goal, a request to cancel one, and the
call of a service are never repeated.
"""

from __future__ import annotations

import logging
import threading
from pathlib import Path
from typing import IO

from bridge.adapters.keep import keep
from bridge.adapters.ros2.service_rcl import RequestId

_log = logging.getLogger(__name__)

_RESULT = "/_action/get_result"
_GID_BYTES = 16
_MOST = 10_000
"""Requests that are remembered at most."""
_MOST_BYTES = 64
"""Of one: it is a goal's UUID."""
_SPARE_LINES = 20_000
_LOSS = "after a crash, ROS 2 clients that wait for results of goals wait on"

_Open = dict[RequestId, tuple[str, bytes]]


class Unanswered:
    """Requests without a reply yet, in a file: a line for each that came, and one for each that has its reply.

    What is written is in the system's hands at once, and outlives a kill. Safe to use from any thread.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._open = _read(path)
        self._left = dict(self._open)
        self._lines = 0
        self._file: IO[bytes] | None = None
        self._begin()

    def asked(self, name: str, request: RequestId, payload: bytes) -> None:
        """A request of the service ``name`` came."""
        if not name.endswith(_RESULT) or len(payload) > _MOST_BYTES:
            return
        with self._lock:
            if len(self._open) < _MOST:
                self._open[request] = name, payload
                self._write(_asked(name, request, payload))

    def answered(self, request: RequestId) -> None:
        """Its reply went out, or nobody waits for it any more."""
        with self._lock:
            if self._open.pop(request, None) is not None:
                self._write(f"- {request.gid.hex()} {request.number}\n")

    def left(self, name: str) -> list[tuple[RequestId, bytes]]:
        """The requests of a service that a dead predecessor left; each is given once."""
        with self._lock:
            found = [(request, payload) for request, (of, payload) in self._left.items() if of == name]
            for request, _ in found:
                del self._left[request]
        return found

    def close(self) -> None:
        """Write no more."""
        with self._lock:
            if self._file is not None:
                self._file.close()
                self._file = None

    def _write(self, line: str) -> None:
        if self._file is None:
            return
        self._lines += 1
        if self._lines > len(self._open) + _SPARE_LINES:
            self._begin()
            return
        try:
            self._file.write(line.encode())
        except OSError as err:
            self._give_up(err)

    def _begin(self) -> None:
        """Write the file anew, with what is open alone."""
        text = "".join(_asked(name, request, payload) for request, (name, payload) in self._open.items())
        if self._file is not None:
            self._file.close()
            self._file = None
        if not keep(self._path, text, _LOSS):
            return
        try:
            self._file = self._path.open("ab", buffering=0)
            self._lines = len(self._open)
        except OSError as err:
            self._give_up(err)

    def _give_up(self, err: OSError) -> None:
        _log.warning("cannot write %s: %s; %s", self._path, err.strerror, _LOSS)
        self._file = None


def _asked(name: str, request: RequestId, payload: bytes) -> str:
    return f"+ {request.gid.hex()} {request.number} {payload.hex()} {name}\n"


def _read(path: Path) -> _Open:
    """What was not answered; lines that are not whole are left out."""
    found: _Open = {}
    try:
        lines = path.read_text(errors="replace").splitlines()
    except OSError:
        return found
    for line in lines:
        try:
            match line.split():
                case ["+", gid, number, payload, name]:
                    found[RequestId(bytes.fromhex(gid), int(number))] = name, bytes.fromhex(payload)
                case ["-", gid, number]:
                    found.pop(RequestId(bytes.fromhex(gid), int(number)), None)
        except ValueError:
            continue
    sound = {r: what for r, what in found.items() if len(r.gid) == _GID_BYTES and len(what[1]) <= _MOST_BYTES}
    return dict(list(sound.items())[-_MOST:])
