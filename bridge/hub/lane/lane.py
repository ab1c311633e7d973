"""The lanes of one session: its writing end, its connections to others, and the transport of each subscription."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any, Protocol

import zenoh

from bridge.concurrency import DelayedCalls, SerialExecutor
from bridge.hub.lane import folder
from bridge.hub.lane.inlet import Inlet
from bridge.hub.lane.writer import LaneWriter
from bridge.hub.zenoh_compat import answer, keep_thread_state, undeclare

_log = logging.getLogger(__name__)

_POLL_SECONDS, _LONGEST_POLL_SECONDS = 0.02, 0.5
"""Seconds between two checks of a subscription that is switching transports; longer while nothing changes."""

_SETTLE_SECONDS = 0.02
_SHARE = 4
"""The pause after a check is this multiple of its cost, as the graph changes often while hundreds of topics start."""

_AGAIN_SECONDS = 2.0
"""Seconds until a session without a lane is tried again."""

_MAX_REFUSED = 1000
_BARRIER_SECONDS = 1.0


class Choosing(Protocol):
    """A subscription that chooses between its lane and zenoh."""

    def settle(self) -> bool:
        """Continue the switch to the wanted transport; return whether to check again soon."""

    def parted(self, inlet: Inlet) -> None:
        """Handle the end of a connection."""


class Lane:
    """The writing end is None if this session cannot have one.

    Args:
        renew: called before the reply to a barrier: another session has declared subscribers.

    Attributes:
        writer: sends this session's publications to other sessions.
        why: why this session cannot publish on the lane, else "".
    """

    def __init__(self, path: Path, zid: str, session: zenoh.Session, domain: int, renew: Callable[[], None]) -> None:
        self._folder, self._zid, self._session = path, zid, session
        self._lock = Lock()
        self._inlets: dict[str, Inlet] = {}
        self._refused: dict[str, tuple[float, str]] = {}
        self._choosing: dict[Choosing, None] = {}
        self._looking: dict[Choosing, None] = {}
        self._wake, self._closing = Event(), Event()
        self._barriers: dict[str, tuple[float, float]] = {}
        self._asking = SerialExecutor("hub-lane-asks")
        self._barrier_key = f"@midspan/{domain}/lane/"
        self.writer: LaneWriter | None = None
        self.why = ""
        folder.clean(path)  # before this one listens, since the check of a socket counts as a reader there
        try:
            self.writer = LaneWriter(path, zid)
        except OSError as err:
            self.why = f"{path}: {err.strerror or err}"
            _log.warning("this worker has no lane, its messages use zenoh: %s", self.why)
        self.calls = DelayedCalls("hub-lane-calls")
        self._answering = answer(session, self._barrier_key + zid, partial(_reply, renew))
        self._thread = Thread(target=self._run, name="hub-lane", daemon=True)
        self._thread.start()

    # -- subscriptions -------------------------------------------------------------------------------------------------

    def add(self, chooser: Choosing) -> None:
        """Add a subscription, which chooses now and after each change of the graph."""
        with self._lock:
            self._choosing[chooser] = None
        self.wake(chooser)

    def remove(self, chooser: Choosing) -> None:
        """Remove a closed subscription."""
        with self._lock:
            self._choosing.pop(chooser, None)
            self._looking.pop(chooser, None)

    def wake(self, chooser: Choosing) -> None:
        """Let a subscription check soon."""
        with self._lock:
            self._looking[chooser] = None
        self._wake.set()

    def graph_changed(self) -> None:
        """Let all subscriptions check soon."""
        with self._lock:
            self._looking.update(self._choosing)
        self._wake.set()

    def _run(self) -> None:
        again: list[Choosing] = []
        pause = _POLL_SECONDS
        while not self._closing.is_set():
            woken = self._wake.wait(pause if again else None)
            pause = _POLL_SECONDS if woken else min(2 * pause, _LONGEST_POLL_SECONDS)
            self._wake.clear()
            with self._lock:
                looking, self._looking = {**dict.fromkeys(again), **self._looking}, {}
            began = time.thread_time()
            again = [chooser for chooser in looking if chooser in self._choosing and self._settle(chooser)]
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

    # -- connections ---------------------------------------------------------------------------------------------------

    def inlet(self, zid: str) -> Inlet | str:
        """Return the connection to a session, or why they are not connected."""
        with self._lock:
            inlet = self._inlets.get(zid)
            if inlet is not None and inlet.alive:
                return inlet
            at, reason = self._refused.get(zid, (0.0, ""))
            if reason and time.monotonic() - at < _AGAIN_SECONDS:
                return reason
        try:
            sock = folder.connect(self._folder, zid)
        except OSError as err:
            exists = not isinstance(err, FileNotFoundError)
            reason = err.strerror or str(err)
            if not exists:
                reason = folder.other_version(self._folder, zid) or "it has no lane here"
            self._refuse(zid, reason, again=exists)
            return reason
        inlet = Inlet(sock, zid, self._lost)
        with self._lock:
            self._refused.pop(zid, None)
            self._inlets[zid] = inlet
        return inlet

    def refuse(self, inlet: Inlet, why: str) -> None:
        """Close an unusable connection, and connect again later."""
        self._refuse(inlet.zid, why)
        inlet.close()

    def _lost(self, inlet: Inlet) -> None:
        with self._lock:
            if self._inlets.get(inlet.zid) is inlet:
                del self._inlets[inlet.zid]
                self._barriers.pop(inlet.zid, None)
                ended = inlet.zid not in self._refused
            else:
                ended = False
            choosing = tuple(self._choosing)
        if ended:
            self._refuse(inlet.zid, "the lane ended")
        for chooser in choosing:
            chooser.parted(inlet)

    def _refuse(self, zid: str, why: str, *, again: bool = True) -> None:
        with self._lock:
            if len(self._refused) >= _MAX_REFUSED:
                del self._refused[next(iter(self._refused))]
            self._refused[zid] = time.monotonic(), why
        if again and not self._closing.is_set():
            self.calls.after(_AGAIN_SECONDS, self.graph_changed, once=True)

    def state(self) -> dict[str, Any]:
        """Return the lane's state for the status document."""
        with self._lock:
            writers = sum(inlet.alive for inlet in self._inlets.values())
        readers, dropped = (0, 0) if self.writer is None else (self.writer.readers, self.writer.dropped)
        return {"why": self.why, "writers": writers, "readers": readers, "dropped": dropped}

    # -- barriers ------------------------------------------------------------------------------------------------------

    def passed(self, zid: str, since: float) -> bool:
        """Return whether a session knows all declarations of this session before ``since``; query it if unknown."""
        with self._lock:
            requested, confirmed = self._barriers.get(zid, (0.0, 0.0))
            if confirmed >= since:
                return True
            now = time.monotonic()
            if requested < since or now - requested > _BARRIER_SECONDS:
                self._barriers[zid] = now, confirmed
                self._asking.submit(lambda: self._ask(zid, now))
        return False

    def _ask(self, zid: str, began: float) -> None:
        if self._closing.is_set():
            return

        def replied(reply: zenoh.Reply) -> None:
            keep_thread_state()
            if reply.ok is not None:
                with self._lock:
                    if (known := self._barriers.get(zid)) is not None:
                        self._barriers[zid] = known[0], max(known[1], began)

        try:
            self._session.get(
                self._barrier_key + zid,
                zenoh.handlers.Callback(replied, lambda: None, indirect=False),
                timeout=_BARRIER_SECONDS,
            )
        except zenoh.ZError as err:
            _log.debug("no barrier: %s", err)

    def close(self) -> None:
        """End all connections. Safe to call twice."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._wake.set()
        undeclare(self._answering)
        if self.writer is not None:
            self.writer.close()
        with self._lock:
            inlets = list(self._inlets.values())
        for inlet in inlets:
            inlet.close()
        self._thread.join(2.0)
        self.calls.close(1.0)
        self._asking.close()


def _reply(renew: Callable[[], None], query: zenoh.Query) -> None:
    keep_thread_state()
    renew()
    with query:
        query.reply(str(query.key_expr), b"")
