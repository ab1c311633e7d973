"""Midspan's sessions on a dialect's zenoh network: their mark, their ids, and their announcements.

Each Midspan session declares the liveliness token ``@midspan/keys/<zid>/<side>/<scope>`` and publishes its records on
the same key. The scope distinguishes networks of one dialect on the same zenoh network, which differ in namespace or
keys.

The mark is the suffix of a session's id. The id is part of the liveliness tokens of its endpoints, of the source info
of each sample that Midspan sends, and of the time stamps that the session sets. Native sessions have random ids.
"""

from __future__ import annotations

import contextlib
import secrets
import threading
import time
from collections.abc import Callable
from pathlib import Path
from urllib.parse import quote

import zenoh

from bridge.hub.zenoh_compat import follow_tokens, subscribe, undeclare
from bridge.routing.edge import Sighting
from bridge.state_file import keep

MARK = "6d7370616e7a"
"""Last twelve hex digits of a marked id."""

_DIGITS = 32


def new_zid() -> str:
    """Return a random session id with the mark; zenoh accepts up to 32 hex digits, the first not 0."""
    return secrets.choice("123456789abcdef") + secrets.token_hex(_DIGITS // 2)[: _DIGITS - 1 - len(MARK)] + MARK


def is_marked(zid: str) -> bool:
    """Return whether a session is Midspan's, by its id."""
    return len(zid) == _DIGITS and zid.endswith(MARK)


def sender(sample: zenoh.Sample) -> str:
    """Return the id of the session that sent a sample, or else time-stamped it (maybe a router); "" if unknown."""
    info = sample.source_info
    if info is not None:
        return str(info.source_id.zid)
    stamp = sample.timestamp
    return "" if stamp is None else str(stamp.get_id())


def time_ns(sample: zenoh.Sample) -> int | None:
    """Return a sample's time stamp in nanoseconds of system time, set by its source or by a router.

    It comes from a hybrid logical clock, which never goes back: if the system clock was set back, the hybrid clock only
    counts its stamps (`bridge.routing.stall.AgeGate`).
    """
    stamp = sample.timestamp
    return None if stamp is None else int(stamp.get_time_as_ntp64().as_nanos())


def ticks(sample: zenoh.Sample) -> int:
    """Return a sample's time stamp in units of 2^-32 s, 0 if it has none; a counting clock adds one unit per stamp."""
    stamp = sample.timestamp
    return 0 if stamp is None else int(str(stamp.get_time_as_ntp64()))


SPACE = "@midspan/keys"
DISCOVERY_SECONDS = 1.5
"""How long an unknown session counts as being on this network, because its token may be delayed."""

_MAX_STORED = 64
_MAX_RECORD = 1 << 20
_MAX_UNDISCOVERED = 4096
_POLL_SECONDS = 5.0


class KeyNeighbors:
    """Follows the other Midspan sessions of the same side and scope.

    Args:
        scope: distinguishes this network from others of the side on the same zenoh network.
        past: ids of this daemon's past sessions.
        graph_changed: called when the result of `is_own` may have changed.
        presence_changed: called when a neighbor joined, left or sent a record.
    """

    def __init__(
        self, session: zenoh.Session, side: str, scope: str, past: frozenset[str],
        graph_changed: Callable[[], None], presence_changed: Callable[[], None],
    ) -> None:  # fmt: skip
        self._session, self._past = session, past
        self._graph_changed, self._presence_changed = graph_changed, presence_changed
        self._own = str(session.zid())
        self._suffix = f"{side}/{quote(scope, safe='') or '%'}"
        self._lock = threading.Lock()
        self._seen: dict[str, Sighting] = {}
        self._undiscovered: dict[str, float] = {}
        self._settled: set[str] = set()
        self._query_since: float | None = None
        self._complete_since = 0.0
        space = f"{SPACE}/*/{self._suffix}"
        self._publisher = session.declare_publisher(
            f"{SPACE}/{self._own}/{self._suffix}", express=True, priority=zenoh.Priority.INTERACTIVE_HIGH,
            congestion_control=zenoh.CongestionControl.DROP, allowed_destination=zenoh.Locality.REMOTE,
        )  # fmt: skip
        self._subscribers = follow_tokens(session, space, self._on_token), subscribe(session, space, self._on_record)
        self._token = session.liveliness().declare_token(f"{SPACE}/{self._own}/{self._suffix}")

    def is_own(self, zid: str) -> bool:
        """Return whether the session of a hub origin is on this network."""
        if zid == self._own or zid in self._past or zid in self._seen:
            return True
        now = time.monotonic()
        with self._lock:
            if len(self._undiscovered) > _MAX_UNDISCOVERED:
                self._undiscovered.clear()
                self._settled.clear()
            return now - self._undiscovered.setdefault(zid, now) < DISCOVERY_SECONDS

    def tick(self, now: float) -> None:
        """Report unknown sessions that have not appeared in time."""
        with self._lock:
            expired = {z for z, since in self._undiscovered.items() if now - since >= DISCOVERY_SECONDS} - self._settled
            self._settled |= expired
        if expired:
            self._graph_changed()

    def announce(self, record: bytes) -> None:
        """Send a record to all neighbors."""
        with contextlib.suppress(zenoh.ZError):  # the session is being closed
            self._publisher.put(record)

    def sightings(self) -> list[Sighting]:
        """Return the neighbors on the network, without this daemon's past sessions."""
        with self._lock:
            return [sighting for zid, sighting in self._seen.items() if zid not in self._past]

    def settled(self, since: float) -> bool:
        """Return whether all sessions that existed at ``since`` are known; queries the network if unsure."""
        with self._lock:
            if self._complete_since >= since:
                return True
            now = time.monotonic()
            if self._query_since is not None and now - self._query_since < _POLL_SECONDS:
                return False
            self._query_since = now
        # on a thread of its own, because zenoh 1.10 calls the handler of this query while it holds the session's lock
        handler = zenoh.handlers.Callback(self._on_reply, lambda: self._on_query_done(now), indirect=True)
        self._session.liveliness().get(f"{SPACE}/*/{self._suffix}", handler, timeout=_POLL_SECONDS)
        return False

    def _on_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._add_sighting(_zid(reply.ok), None)

    def _on_query_done(self, since: float) -> None:
        with self._lock:
            self._complete_since, self._query_since = max(since, self._complete_since), None
        self._presence_changed()

    def _on_token(self, token: zenoh.Sample) -> None:
        zid = _zid(token)
        if token.kind == zenoh.SampleKind.PUT:
            self._add_sighting(zid, None)
            return
        with self._lock:
            lost = self._seen.pop(zid, None)
        if lost is not None:
            self._graph_changed()
            self._presence_changed()

    def _on_record(self, sample: zenoh.Sample) -> None:
        if len(sample.payload) <= _MAX_RECORD:
            self._add_sighting(_zid(sample), sample.payload.to_bytes())

    def _add_sighting(self, zid: str, record: bytes | None) -> None:
        if zid == self._own or not is_marked(zid):
            return
        with self._lock:
            known = self._seen.get(zid)
            if known is not None and record is None:
                return
            self._seen[zid] = Sighting(zid, record, time.monotonic())
        if known is None:
            self._graph_changed()
        self._presence_changed()

    def close(self) -> None:
        """Withdraw the token, and stop receiving."""
        undeclare(self._token, self._publisher, *self._subscribers)


def remember(own: str, file: Path) -> frozenset[str]:
    """Add this session's id to the ids in a file; return the previous ones."""
    try:
        past = file.read_text(encoding="utf-8").split()[-_MAX_STORED:]
    except OSError:
        past = []
    keep(file, "\n".join([*past, own]) + "\n", "for a few seconds after a crash, its own topics may loop back")
    return frozenset(past)


def _zid(sample: zenoh.Sample) -> str:
    return str(sample.key_expr).removeprefix(SPACE + "/").partition("/")[0]
