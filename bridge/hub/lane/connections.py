"""The reading ends of one session's lanes: a connection to each session from which it receives."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from threading import Lock

from bridge.hub.lane import folder
from bridge.hub.lane.inlet import Inlet

AGAIN_SECONDS = 2.0
"""Seconds after a failed connection to a session before the next attempt."""

_MAX_REFUSED = 1000


class LaneConnections:
    """The connections of one session. Safe to use from any thread.

    Args:
        path: the folder of the sockets.
        retry: called after a failure that may not last.
        gone: called with the session (zid) whose connection has ended.
        disconnected: called with each connection that has ended.
        later: calls a function after some seconds.
    """

    def __init__(
        self, path: Path, retry: Callable[[], None], gone: Callable[[str], None], disconnected: Callable[[Inlet], None],
        later: Callable[[float, Callable[[], None]], None],
    ) -> None:  # fmt: skip
        self._folder, self._retry, self._gone, self._disconnected = path, retry, gone, disconnected
        self._later = later
        self._lock = Lock()
        self._inlets: dict[str, Inlet] = {}
        self._refused: dict[str, tuple[float, str]] = {}

    def inlet(self, zid: str) -> Inlet | str:
        """Return the connection to a session, opened if necessary, or the reason why it cannot be opened."""
        with self._lock:
            inlet = self._inlets.get(zid)
            if inlet is not None and inlet.alive:
                return inlet
            at, reason = self._refused.get(zid, (0.0, ""))
            if reason and time.monotonic() - at < AGAIN_SECONDS:
                return reason
        try:
            sock = folder.connect(self._folder, zid)
        except OSError as err:
            exists = not isinstance(err, FileNotFoundError)
            reason = err.strerror or str(err)
            if not exists:
                reason = folder.other_version(self._folder, zid) or "it has no lane here"
            self._refuse(zid, reason, may_recover=exists)
            return reason
        inlet = Inlet(sock, zid, self._lost, self._later)
        with self._lock:
            self._refused.pop(zid, None)
            self._inlets[zid] = inlet
        return inlet

    def refuse(self, inlet: Inlet, why: str) -> None:
        """Close an unusable connection; it is opened again later."""
        self._refuse(inlet.zid, why)
        inlet.close()

    def alive(self) -> int:
        """Return the number of open connections."""
        with self._lock:
            return sum(inlet.alive for inlet in self._inlets.values())

    def close(self) -> None:
        with self._lock:
            inlets = list(self._inlets.values())
        for inlet in inlets:
            inlet.close()

    def _lost(self, inlet: Inlet) -> None:
        with self._lock:
            current = self._inlets.get(inlet.zid) is inlet
            if current:
                del self._inlets[inlet.zid]
            ended = current and inlet.zid not in self._refused
        if current:
            self._gone(inlet.zid)
        try:
            if ended:
                self._refuse(inlet.zid, "the lane ended")
        finally:  # the subscriptions have to change to zenoh, even if no thread can be started for the next attempt
            self._disconnected(inlet)

    def _refuse(self, zid: str, why: str, *, may_recover: bool = True) -> None:
        with self._lock:
            if len(self._refused) >= _MAX_REFUSED:
                del self._refused[next(iter(self._refused))]
            self._refused[zid] = time.monotonic(), why
        if may_recover:
            self._retry()
