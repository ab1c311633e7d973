"""Latched topics: publishers that cache their last samples, and subscriptions that request these samples.

The publishers are zenoh's advanced publishers, declared like those of rmw_zenoh: each has a token at
``<key>/@adv/pub/<zid>/<entity>/...``, and answers queries on that key with its cached samples. A reliable publisher
also publishes the number of its last sample on that key (a heartbeat), half a second after a sample.

zenoh's own advanced subscriber queries each publisher twice at the start, and if the two answers interleave, it drops
the older part of a history of more than one sample. Here a publisher that answers is queried once, and the live samples
of its session are held back until the answer is complete.
"""

from __future__ import annotations

import contextlib
from functools import partial
from threading import Lock
from typing import Protocol

import zenoh
from zenoh import ext

from bridge.concurrency import DelayedCalls, SerialExecutor
from bridge.hub.opening import prepare_to_send
from bridge.hub.zenoh_compat import BEHIND, SOURCE_NUMBERS, follow_tokens, subscribe, undeclare

HEARTBEAT = 0.5
"""Seconds from a sample to the heartbeat with the last sample's number, as in rmw_zenoh."""


class LatchedPublisher:
    """zenoh's advanced publisher.

    Sample miss detection makes zenoh number the samples per publisher and attach the session's id; without it, only the
    time would distinguish the caches of several publishers in one session. Midspan itself publishes the heartbeats,
    with the key and bytes that zenoh uses (observed on the wire, 1.10). A heartbeat blocks on a congested link, because
    it must not be lost. zenoh would send it on the single thread that runs all tasks of a session: while a heartbeat
    waits there, for up to five seconds, no latched publisher can be closed.

    Args:
        heartbeats: runs the delayed heartbeats; None if lost samples are not recovered.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        depth: int,
        heartbeats: DelayedCalls | None,
        *,
        reach: zenoh.Locality = zenoh.Locality.REMOTE,
        congestion: zenoh.CongestionControl,
        priority: zenoh.Priority,
        express: bool = False,
        encoding: zenoh.Encoding | None = None,
    ) -> None:
        self._session, self._heartbeats = session, heartbeats
        self._publisher = ext.declare_advanced_publisher(
            session,
            key,
            encoding=encoding,
            congestion_control=congestion,
            priority=priority,
            express=express,
            allowed_destination=reach,
            cache=ext.CacheConfig(depth),
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=None),
            publisher_detection=True,
        )
        identity = self._publisher.id
        self._heartbeat_key = f"{key}/@adv/pub/{identity.zid}/{identity.eid}/_"
        self._tell_last = self._heartbeat
        self._put = 0
        self._closed = False

    def put(self, payload: bytes | zenoh.ZBytes, attachment: bytes | None = None) -> None:
        """Publish; not thread-safe. Raises `zenoh.ZError` if the session is closed."""
        prepare_to_send(len(payload))
        self._publisher.put(payload, attachment=attachment)
        self._put += 1
        if self._heartbeats is not None:
            self._heartbeats.after(HEARTBEAT, self._tell_last, once=True)

    def _heartbeat(self) -> None:
        if self._closed:
            return
        number = (self._put - 1) % SOURCE_NUMBERS
        with contextlib.suppress(zenoh.ZError, RuntimeError):  # the session is being closed
            self._session.put(
                self._heartbeat_key,
                number.to_bytes(4, "little"),
                congestion_control=zenoh.CongestionControl.BLOCK,
                priority=zenoh.Priority.DATA,
                allowed_destination=zenoh.Locality.REMOTE,
            )

    def close(self) -> None:
        self._closed = True
        # Not `undeclare`, which holds the GIL while it waits; dropping the last reference releases the GIL.
        del self._publisher


ANSWER_SECONDS = 10.0
"""Time limit in seconds for a publisher's answer, and for holding back the live samples of its session."""

AGAIN_SECONDS = (1.0, 3.0, 9.0)
"""Delays in seconds of further queries to a publisher from which nothing has arrived. While its session joins, or a
link is restored, the publisher's token may already be visible although no query can reach it yet."""

_PUBLISHERS = "/@adv/pub/"
_MAX_PUBLISHERS = 4096


class HistoryListener(Protocol):
    """Receives the cached samples; called on threads of zenoh and of Midspan's executors."""

    def on_query(self, zid: str) -> None:
        """A session's publishers are being queried, so its live samples have to be held back."""

    def on_stored(self, sample: zenoh.Sample) -> None:
        """A cached sample arrived."""

    def done(self, zid: str) -> None:
        """The answer is complete, or the query has failed."""


class LatchedHistory:
    """Queries every publisher of one key, existing or later, once `open` was called.

    With ``recovers``, it queries a publisher again if a heartbeat shows that the publisher's last sample did not
    arrive. ``depth`` is the number of samples to request from each publisher; it may be changed later. ``delays`` makes
    the queries of `AGAIN_SECONDS`.

    Queries run on ``executor``, because a query blocks on a congested link, and zenoh's receiving thread, which reports
    the publishers, must continue to read. Two peers that wait for each other to read would block for five seconds, and
    then lose their link.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        depth: int,
        listener: HistoryListener,
        executor: SerialExecutor,
        ends: SerialExecutor,
        delays: DelayedCalls,
        *,
        reach: zenoh.Locality = zenoh.Locality.REMOTE,
        recovers: bool,
    ) -> None:
        self._session, self._key, self.depth = session, key, depth
        self._listener, self._executor, self._ends, self._delays = listener, executor, ends, delays
        self._reach, self._recovers = reach, recovers
        self._samples = zenoh.KeyExpr(key)
        self._closed = False
        self._lock = Lock()
        self._numbers: dict[tuple[str, str], int] = {}
        self._silent: dict[tuple[str, str], int] = {}  # number of queries to silent publishers
        self._subscribers: list[zenoh.Subscriber[None]] = []

    def open(self) -> None:
        """Start following the publishers; the subscription to live samples must already exist."""
        space = f"{self._key}{_PUBLISHERS}**"
        self._subscribers = [follow_tokens(self._session, space, self._on_token)]
        if self._recovers:
            self._subscribers.append(subscribe(self._session, space, self._on_heartbeat))

    def on_sample(self, info: zenoh.SourceInfo | None) -> None:
        """Record the number of a publisher's newest sample."""
        if info is None:
            return
        identity = info.source_id
        publisher = str(identity.zid), str(identity.eid)
        with self._lock:
            self._silent.pop(publisher, None)
            if is_newer(info.source_sn, self._numbers.get(publisher)):
                if len(self._numbers) >= _MAX_PUBLISHERS:
                    del self._numbers[next(iter(self._numbers))]
                self._numbers[publisher] = info.source_sn

    def ask(self, publishers: str, zid: str) -> None:
        """Query the publishers at a key for their cached samples; the caller must not hold a lock of the listener."""
        self._listener.on_query(zid)
        self._executor.submit(partial(self._ask, publishers, zid))

    def _ask(self, publishers: str, zid: str) -> None:
        if self._closed:
            self._listener.done(zid)
            return
        done = partial(self._ends.submit, partial(self._on_done, publishers, zid))
        try:
            self._session.get(
                f"{publishers}?_max={self.depth}",
                zenoh.handlers.Callback(partial(self._on_reply, publishers), done, indirect=False),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                accept_replies=zenoh.ReplyKeyExpr.ANY,
                timeout=ANSWER_SECONDS,
                priority=BEHIND,
                allowed_destination=self._reach,
            )
        except zenoh.ZError:
            # the session is being closed
            self._listener.done(zid)

    def ask_session(self, zid: str) -> None:
        """Query all publishers of a session, after a gap in the samples of one of them."""
        self.ask(f"{self._key}{_PUBLISHERS}{zid}/**", zid)

    def close(self) -> None:
        """Stop querying. Safe to call twice."""
        self._closed = True
        undeclare(*self._subscribers)
        self._subscribers = []

    def _on_token(self, token: zenoh.Sample) -> None:
        publisher = _publisher(token)
        if publisher is None:
            return
        if token.kind == zenoh.SampleKind.DELETE:
            with self._lock:
                self._numbers.pop(publisher, None)
                self._silent.pop(publisher, None)
            return
        with self._lock:
            if len(self._silent) < _MAX_PUBLISHERS:
                self._silent[publisher] = 0
        self.ask(str(token.key_expr), publisher[0])

    def _on_heartbeat(self, sample: zenoh.Sample) -> None:
        publisher = _publisher(sample)
        number = int.from_bytes(sample.payload.to_bytes()[:4], "little")
        if publisher is None:
            return
        with self._lock:
            seen = self._numbers.get(publisher)
        if is_newer(number, seen):
            self.ask(str(sample.key_expr), publisher[0])

    def _on_reply(self, publishers: str, reply: zenoh.Reply) -> None:
        # the query is not on the samples' key, so a server could reply with samples of any key
        if reply.ok is not None and self._samples.includes(reply.ok.key_expr):
            with self._lock:
                self._silent.pop(_identity(publishers), None)
            self._listener.on_stored(reply.ok)

    def _on_done(self, publishers: str, zid: str) -> None:
        """End the query of a publisher, and prepare another query if no sample of the publisher has arrived."""
        self._listener.done(zid)
        publisher = _identity(publishers)
        with self._lock:
            queries = self._silent.get(publisher, len(AGAIN_SECONDS))
            if self._closed or queries >= len(AGAIN_SECONDS):
                return
            self._silent[publisher] = queries + 1
        self._delays.after(AGAIN_SECONDS[queries], partial(self._ask_silent, publishers))

    def _ask_silent(self, publishers: str) -> None:
        publisher = _identity(publishers)
        if not self._closed and publisher in self._silent:
            self.ask(publishers, publisher[0])


def is_newer(number: int, seen: int | None) -> bool:
    """Return whether a source number is later than the last one seen, or nothing was seen; the numbers wrap."""
    return seen is None or 0 < (number - seen) % SOURCE_NUMBERS < SOURCE_NUMBERS // 2


def _publisher(sample: zenoh.Sample) -> tuple[str, str] | None:
    """Return session and entity of a token's or a heartbeat's publisher, None for other keys."""
    identity = _identity(str(sample.key_expr))
    return identity if identity[1] else None


def _identity(key: str) -> tuple[str, str]:
    """Return session and entity of the publisher at a key; "" if the key has no entity."""
    zid, _, tail = key.rpartition(_PUBLISHERS)[2].partition("/")
    return zid, tail.partition("/")[0]
