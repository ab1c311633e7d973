"""The lanes of one session: its writing end, its connections to others, and the choice of subscriptions' transports."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Protocol

import zenoh

from bridge.concurrency import DelayedCalls
from bridge.hub.lane import folder
from bridge.hub.lane.barriers import LaneBarriers
from bridge.hub.lane.blocks import Blocks
from bridge.hub.lane.connections import AGAIN_SECONDS, LaneConnections
from bridge.hub.lane.inlet import Inlet
from bridge.hub.lane.writer import LaneWriter
from bridge.status import LaneStatus

_log = logging.getLogger(__name__)

_POLL_SECONDS, _LONGEST_POLL_SECONDS = 0.02, 0.5
"""Seconds between two checks of a subscription that is switching transports; the time grows while nothing changes."""

_SETTLE_SECONDS = 0.02
_SHARE = 4
"""The pause after a check is this multiple of its CPU time, because the graph changes often while many topics start."""


class Choosing(Protocol):
    """A subscription that chooses between lanes and zenoh."""

    def settle(self) -> bool:
        """Continue the switch to the wanted transport; return whether to check again soon."""

    def on_disconnected(self, inlet: Inlet) -> None:
        """Handle the end of a connection."""


class Lane:
    """The lanes of one session.

    Args:
        renew: called before the reply to a barrier, because another session has declared subscribers.

    Attributes:
        barriers: show whether another session has received this session's declarations.
        calls: makes delayed calls for the subscriptions.
        connections: the connections to the sessions from which this session receives.
        writer: sends this session's publications to other sessions; None if that is impossible.
        why: why this session cannot publish on the lane, else "".
    """

    def __init__(self, path: Path, zid: str, session: zenoh.Session, domain: int, renew: Callable[[], None]) -> None:
        self._lock = Lock()
        self._choosing: dict[Choosing, None] = {}
        self._to_check: dict[Choosing, None] = {}
        self._wake, self._closing = Event(), Event()
        self.calls = DelayedCalls("hub-lane-calls")
        self.calls.after(0.0, lambda: None)  # starts the thread now, since the system may be out of threads later
        self.writer: LaneWriter | None = None
        self.why = ""
        folder.clean(path)  # before the writer listens, because it would count the check of its socket as a reader
        try:
            self.writer = LaneWriter(path, zid, Blocks(self.calls.after), self.calls.after)
        except OSError as err:
            self.why = f"{path}: {err.strerror or err}"
            _log.warning("this worker has no lane, its messages use zenoh: %s", self.why)
        self.barriers = LaneBarriers(zid, session, domain, renew)
        self.connections = LaneConnections(
            path, self._check_later, self.barriers.forget, self._on_disconnected, self.calls.after
        )
        self._thread = Thread(target=self._run, name="hub-lane", daemon=True)
        self._thread.start()

    def add(self, chooser: Choosing) -> None:
        """Add a subscription, which chooses its transport now and after each change of the graph."""
        with self._lock:
            self._choosing[chooser] = None
        self.wake(chooser)

    def remove(self, chooser: Choosing) -> None:
        """Remove a closed subscription."""
        with self._lock:
            self._choosing.pop(chooser, None)
            self._to_check.pop(chooser, None)

    def wake(self, chooser: Choosing) -> None:
        """Let a subscription choose again soon."""
        with self._lock:
            self._to_check[chooser] = None
        self._wake.set()

    def graph_changed(self) -> None:
        """Let all subscriptions choose again soon."""
        with self._lock:
            self._to_check.update(self._choosing)
        self._wake.set()

    def _run(self) -> None:
        unsettled: list[Choosing] = []
        pause = _POLL_SECONDS
        while not self._closing.is_set():
            woken = self._wake.wait(pause if unsettled else None)
            pause = _POLL_SECONDS if woken else min(2 * pause, _LONGEST_POLL_SECONDS)
            self._wake.clear()
            with self._lock:
                to_check, self._to_check = {**dict.fromkeys(unsettled), **self._to_check}, {}
            began = time.thread_time()
            unsettled = [chooser for chooser in to_check if chooser in self._choosing and self._settle(chooser)]
            self._closing.wait(max(_SETTLE_SECONDS, _SHARE * (time.thread_time() - began)))

    @staticmethod
    def _settle(chooser: Choosing) -> bool:
        try:
            return chooser.settle()
        except zenoh.ZError as err:  # the session is being closed
            _log.debug("cannot choose a transport: %s", err)
        except Exception:
            _log.exception("the choice between lane and zenoh failed")
        return False

    def _on_disconnected(self, inlet: Inlet) -> None:
        with self._lock:
            choosing = tuple(self._choosing)
        for chooser in choosing:
            chooser.on_disconnected(inlet)

    def _check_later(self) -> None:
        if not self._closing.is_set():
            # a call for each session: an earlier call, for another session, comes before this one may be tried again
            self.calls.after(AGAIN_SECONDS, self.graph_changed)

    def status(self) -> LaneStatus:
        """Return the lane's state for the status document."""
        readers, dropped = (0, 0) if self.writer is None else (self.writer.readers, self.writer.dropped)
        return LaneStatus(why=self.why, writers=self.connections.alive(), readers=readers, dropped=dropped)

    def close(self) -> None:
        """End all connections. Safe to call twice."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._wake.set()
        self.barriers.close()
        if self.writer is not None:
            self.writer.close()
        self.connections.close()
        self._thread.join(2.0)
        self.calls.close(1.0)
