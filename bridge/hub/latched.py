"""A zenoh publisher that keeps its last samples and gives them to late joiners, and what it tells of itself."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from threading import Condition, Thread

import zenoh
from zenoh import ext

HEARTBEAT = 0.5
"""Seconds after which a latched publisher tells its last sample's number, as rmw_zenoh's do."""

_NUMBERS = 1 << 32


class Heartbeats:
    """A thread, made when it is first needed, that tells the numbers of a session's last samples.

    A heartbeat waits where a link is congested, as it must not be lost. zenoh (1.10) would send it on the one thread
    that runs all of a session's tasks: no latched publisher can be closed while one waits there, up to five seconds.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._due: dict[Callable[[], None], float] = {}
        self._changed = Condition()
        self._thread: Thread | None = None
        self._closed = False

    def soon(self, tell: Callable[[], None]) -> None:
        """Have ``tell`` called in half a second, once however often this is said until then."""
        with self._changed:
            if tell in self._due or self._closed:
                return
            self._due[tell] = time.monotonic() + HEARTBEAT
            if self._thread is None:
                self._thread = Thread(target=self._run, name=self._name, daemon=True)
                self._thread.start()
            elif len(self._due) == 1:
                self._changed.notify()

    def close(self) -> None:
        """Tell no more. Safe to call twice."""
        with self._changed:
            self._closed = True
            self._due.clear()
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(1.0)

    def _run(self) -> None:
        while (tell := self._next()) is not None:
            with contextlib.suppress(zenoh.ZError, RuntimeError):  # the session is being closed
                tell()

    def _next(self) -> Callable[[], None] | None:
        with self._changed:
            while not self._closed:
                tell, due = next(iter(self._due.items()), (None, 0.0))
                left = due - time.monotonic()
                if tell is not None and left <= 0:
                    del self._due[tell]
                    return tell
                self._changed.wait(None if tell is None else left)
        return None


class LatchedPublisher:
    """zenoh's advanced publisher.

    Sample miss detection makes zenoh number the samples per publisher and put the session's id on them; without it the
    caches of several publishers in one session would be told apart by time alone. Its heartbeats are ours: see
    `Heartbeats`; their key and bytes are those of zenoh's own, seen on the wire (1.10).

    Args:
        session: whose it is.
        key: what it publishes.
        depth: how many samples it keeps.
        heartbeats: what tells the last sample's number, None where nobody is to recover a lost one.
        congestion: what becomes of a sample where a link is congested.
        priority: of its samples.
        express: whether each sample goes in a packet of its own.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        depth: int,
        heartbeats: Heartbeats | None,
        *,
        congestion: zenoh.CongestionControl,
        priority: zenoh.Priority,
        express: bool = False,
    ) -> None:
        self._session, self._heartbeats = session, heartbeats
        self._publisher = ext.declare_advanced_publisher(
            session,
            key,
            congestion_control=congestion,
            priority=priority,
            express=express,
            allowed_destination=zenoh.Locality.REMOTE,
            cache=ext.CacheConfig(depth),
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=None),
            publisher_detection=True,
        )
        identity = self._publisher.id
        self._heartbeat_key = f"{key}/@adv/pub/{identity.zid}/{identity.eid}/_"
        self._tell_last = self._heartbeat
        self._put = 0
        self._closed = False

    def put(self, payload: bytes, attachment: bytes | None = None) -> None:
        """Publish; one at a time. Raises `zenoh.ZError` where the session is closed."""
        self._publisher.put(payload, attachment=attachment)
        self._put += 1
        if self._heartbeats is not None:
            self._heartbeats.soon(self._tell_last)

    def _heartbeat(self) -> None:
        if not self._closed:
            number = (self._put - 1) % _NUMBERS
            self._session.put(
                self._heartbeat_key,
                number.to_bytes(4, "little"),
                congestion_control=zenoh.CongestionControl.BLOCK,
                priority=zenoh.Priority.DATA,
                allowed_destination=zenoh.Locality.REMOTE,
            )

    def close(self) -> None:
        """Keep nothing any more."""
        self._closed = True
        # Not `undeclare`, which holds Python's lock; when the last reference goes, the lock is given away.
        del self._publisher
