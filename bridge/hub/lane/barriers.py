"""Barriers, which show whether another session has all declarations that this session had sent by a given time.

zenoh delivers in order. So once another session's reply to a query arrives, that session has received everything that
this session declared before the query, and this session everything that the other one published before the reply.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import partial
from threading import Lock

import zenoh

from bridge.concurrency import SerialExecutor
from bridge.hub.zenoh_compat import answer, keep_thread_state, undeclare

_log = logging.getLogger(__name__)

_AGAIN_SECONDS = 1.0
"""Seconds after which a session that has not replied is queried again, because the query may be lost with a link."""

_REPLY_SECONDS = 10.0
"""Time limit for a reply in seconds: on a busy machine a session may need seconds for each."""


class LaneBarriers:
    """The barriers of one session. Safe to use from any thread.

    Args:
        renew: called before the reply to another session's barrier. The other session may have declared subscribers,
            so this session's publishers must check again whether they have subscribers.
    """

    def __init__(self, zid: str, session: zenoh.Session, domain: int, renew: Callable[[], None]) -> None:
        self._session = session
        self._lock = Lock()
        self._times: dict[str, tuple[float, float]] = {}
        """By session: when it was last queried, and when the last query to which it replied was sent."""

        self._closed = False
        self._asking = SerialExecutor("hub-lane-asks")
        self._key = f"@midspan/{domain}/lane/"
        self._answering = answer(session, self._key + zid, partial(_reply, renew))

    def has_passed(self, zid: str, since: float) -> bool:
        """Return whether a session has all declarations from this session before ``since``; query it if unknown."""
        with self._lock:
            requested, confirmed = self._times.get(zid, (0.0, 0.0))
            if confirmed >= since:
                return True
            now = time.monotonic()
            if requested < since or now - requested > _AGAIN_SECONDS:
                self._times[zid] = now, confirmed
                self._asking.submit(lambda: self._ask(zid, now))
        return False

    def forget(self, zid: str) -> None:
        """Drop what is known about a session whose lane has ended."""
        with self._lock:
            self._times.pop(zid, None)

    def close(self) -> None:
        self._closed = True
        undeclare(self._answering)
        self._asking.close()

    def _ask(self, zid: str, began: float) -> None:
        if self._closed:
            return

        def replied(reply: zenoh.Reply) -> None:
            keep_thread_state()
            if reply.ok is not None:
                with self._lock:
                    if (known := self._times.get(zid)) is not None:
                        self._times[zid] = known[0], max(known[1], began)

        try:
            self._session.get(
                self._key + zid,
                zenoh.handlers.Callback(replied, lambda: None, indirect=False),
                timeout=_REPLY_SECONDS,
            )
        except zenoh.ZError as err:
            _log.debug("no barrier: %s", err)


def _reply(renew: Callable[[], None], query: zenoh.Query) -> None:
    keep_thread_state()
    renew()
    with query:
        query.reply(str(query.key_expr), b"")
