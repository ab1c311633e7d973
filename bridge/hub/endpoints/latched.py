"""Latched topics: publishers that keep their last samples, and how subscriptions get what these keep.

The publishers are zenoh's advanced publishers, as rmw_zenoh makes them: each has a token at
``<key>/@adv/pub/<zid>/<entity>/...``, answers queries there with the last samples that it keeps, and publishes there,
half a second after a change, the number of its last sample.

zenoh's own advanced subscriber asks each publisher twice at the start, and where the answers cross, it leaves out the
older part of a history of more than one sample. Here each publisher is asked once, and what its session publishes
meanwhile is held back until the answer is complete.
"""

from __future__ import annotations

import contextlib
import logging
from functools import partial
from threading import Lock
from typing import Protocol

import zenoh
from zenoh import ext

from bridge.concurrency import DelayedCalls, SerialExecutor
from bridge.hub.zenoh_compat import BEHIND, SOURCE_NUMBERS, follow_tokens, subscribe, undeclare

HEARTBEAT = 0.5
"""Seconds after which a latched publisher publishes its last sample's number, as rmw_zenoh's do."""


class LatchedPublisher:
    """zenoh's advanced publisher.

    Sample miss detection makes zenoh number the samples per publisher and put the session's id on them; without it the
    caches of several publishers in one session would be told apart by time alone. Its heartbeats are ours; their key
    and bytes are those of zenoh's own, seen on the wire (1.10). A heartbeat waits where a link is congested, as it must
    not be lost. zenoh would send it on the one thread that runs all of a session's tasks: no latched publisher can be
    closed while one waits there, up to five seconds.

    Args:
        heartbeats: what publishes the last sample's number, None where nobody is to recover a lost one.
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
    ) -> None:
        self._session, self._heartbeats = session, heartbeats
        self._publisher = ext.declare_advanced_publisher(
            session,
            key,
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

    def put(self, payload: bytes, attachment: bytes | None = None) -> None:
        """Publish; one at a time. Raises `zenoh.ZError` where the session is closed."""
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
        """Drop the kept samples."""
        self._closed = True
        # Not `undeclare`, which holds Python's lock; when the last reference goes, the lock is given away.
        del self._publisher


_log = logging.getLogger(__name__)

ANSWER_SECONDS = 10.0
"""How long a publisher may take to answer; what its session publishes is held back for so long."""

_PUBLISHERS = "/@adv/pub/"
_MAX_PUBLISHERS = 4096


class HistoryListener(Protocol):
    """Receives the history; called on zenoh's threads."""

    def asked(self, zid: str) -> None:
        """A session's publishers were asked: hold back what it publishes."""

    def came(self, sample: zenoh.Sample) -> None:
        """One of the samples that were asked for."""

    def done(self, zid: str) -> None:
        """All that was asked for has come, or never will."""


class LatchedHistory:
    """Asks the publishers of one key, those that are there and those that come, once `open` was called.

    With ``recovers`` it asks again where a publisher's last sample did not come. ``depth`` is how many samples each
    publisher is asked for; it may be changed later.

    It asks by ``executor``: a query waits where the link is congested, and zenoh's receiving thread, which tells of the
    publishers, must go on reading. Two peers that both waited so for the other to read would do it for five seconds,
    and then lose their link.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        depth: int,
        listener: HistoryListener,
        executor: SerialExecutor,
        *,
        reach: zenoh.Locality = zenoh.Locality.REMOTE,
        recovers: bool,
    ) -> None:
        self._session, self._key, self.depth = session, key, depth
        self._listener, self._executor, self._reach, self._recovers = listener, executor, reach, recovers
        self._samples = zenoh.KeyExpr(key)
        self._closed = False
        self._lock = Lock()
        self._numbers: dict[tuple[str, str], int] = {}
        self._subscribers: list[zenoh.Subscriber[None]] = []

    def open(self) -> None:
        """Begin; the live samples must be subscribed to before."""
        space = f"{self._key}{_PUBLISHERS}**"
        self._subscribers = [follow_tokens(self._session, space, self._on_token)]
        if self._recovers:
            self._subscribers.append(subscribe(self._session, space, self._on_heartbeat))

    def saw(self, info: zenoh.SourceInfo | None) -> None:
        """Remember the number of the newest sample of a publisher."""
        if info is None:
            return
        identity = info.source_id
        publisher = str(identity.zid), str(identity.eid)
        with self._lock:
            if is_newer(info.source_sn, self._numbers.get(publisher)):
                if len(self._numbers) >= _MAX_PUBLISHERS:
                    del self._numbers[next(iter(self._numbers))]
                self._numbers[publisher] = info.source_sn

    def ask(self, publishers: str, zid: str) -> None:
        """Ask the publishers at a key for what they keep. Not to be called with a lock held that the listener needs."""
        self._listener.asked(zid)
        self._executor.submit(partial(self._ask, publishers, zid))

    def _ask(self, publishers: str, zid: str) -> None:
        if self._closed:
            return
        try:
            self._session.get(
                f"{publishers}?_max={self.depth}",
                zenoh.handlers.Callback(self._on_reply, lambda: self._listener.done(zid), indirect=False),
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
        """Ask all publishers of a session, after a gap in what one of them published."""
        self.ask(f"{self._key}{_PUBLISHERS}{zid}/**", zid)

    def close(self) -> None:
        """Stop asking. Safe to call twice."""
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
        else:
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

    def _on_reply(self, reply: zenoh.Reply) -> None:
        # what is asked is not on the samples' key: whoever answers could say anything on any key that it may write
        if reply.ok is not None and self._samples.includes(reply.ok.key_expr):
            self._listener.came(reply.ok)


def is_newer(number: int, seen: int | None) -> bool:
    """Whether a source number follows another one; the numbers wrap."""
    return seen is None or 0 < (number - seen) % SOURCE_NUMBERS < SOURCE_NUMBERS // 2


def _publisher(sample: zenoh.Sample) -> tuple[str, str] | None:
    """Session and entity that a token or a heartbeat is about."""
    parts = str(sample.key_expr).rpartition(_PUBLISHERS)[2].split("/")
    return (parts[0], parts[1]) if len(parts) > 1 else None
