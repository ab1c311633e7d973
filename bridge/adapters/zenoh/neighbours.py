"""Midspan's own sessions on a network of keys: their mark, who they are, and what they announce.

Each of our sessions declares the liveliness token ``@midspan/keys/<zid>/<side>/<scope>`` and publishes its records on
the same key. The scope tells networks of one dialect apart that share a zenoh network: another namespace, other keys.

The mark is the end of a session's id, which stands in the liveliness tokens of its endpoints, in the source info of
each sample that Midspan sends, and in the time stamps that the session gives. Native sessions have random ids.
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
    """A random session id that carries the mark; zenoh takes up to 32 hex digits, the first not 0."""
    return secrets.choice("123456789abcdef") + secrets.token_hex(_DIGITS // 2)[: _DIGITS - 1 - len(MARK)] + MARK


def is_marked(zid: str) -> bool:
    """Whether a session is Midspan's."""
    return len(zid) == _DIGITS and zid.endswith(MARK)


def sender(sample: zenoh.Sample) -> str:
    """The session that sent a sample, or only gave its time stamp (a router may); "" where the sample names none."""
    info = sample.source_info
    if info is not None:
        return str(info.source_id.zid)
    stamp = sample.timestamp
    return "" if stamp is None else str(stamp.get_id())


def time_ns(sample: zenoh.Sample) -> int | None:
    """A sample's time stamp in nanoseconds of system time; set by its source, or by the first router on its way."""
    stamp = sample.timestamp
    return None if stamp is None else int(stamp.get_time_as_ntp64().as_nanos())


SPACE = "@midspan/keys"
DISCOVERY_SECONDS = 1.5
"""How long a session that was never seen here counts as being on our network: its token may be on its way."""

_KEPT = 64
_MAX_RECORD = 1 << 20
_MAX_UNSURE = 4096
_LOOK_SECONDS = 5.0


class KeyNeighbours:
    """Follows Midspan's other sessions of our side and scope.

    Args:
        scope: what tells this network from others of the side on the same zenoh network.
        past: ids of this daemon's own past sessions.
        graph_changed: called when what `is_own` says may have changed.
        presence_changed: called when a neighbour came, left or announced something.
    """

    def __init__(
        self, session: zenoh.Session, side: str, scope: str, past: frozenset[str],
        graph_changed: Callable[[], None], presence_changed: Callable[[], None],
    ) -> None:  # fmt: skip
        self._session, self._past = session, past
        self._graph_changed, self._presence_changed = graph_changed, presence_changed
        self._own = str(session.zid())
        self._place = f"{side}/{quote(scope, safe='') or '%'}"
        self._lock = threading.Lock()
        self._seen: dict[str, Sighting] = {}
        self._unsure: dict[str, float] = {}
        self._settled: set[str] = set()
        self._looking_since: float | None = None
        self._looked_since = 0.0
        space = f"{SPACE}/*/{self._place}"
        self._publisher = session.declare_publisher(
            f"{SPACE}/{self._own}/{self._place}", express=True, priority=zenoh.Priority.INTERACTIVE_HIGH,
            congestion_control=zenoh.CongestionControl.DROP, allowed_destination=zenoh.Locality.REMOTE,
        )  # fmt: skip
        self._subscribers = follow_tokens(session, space, self._on_token), subscribe(session, space, self._on_record)
        self._token = session.liveliness().declare_token(f"{SPACE}/{self._own}/{self._place}")

    def is_own(self, zid: str) -> bool:
        """Whether the session of a hub origin is on this very network."""
        if zid == self._own or zid in self._past or zid in self._seen:
            return True
        now = time.monotonic()
        with self._lock:
            if len(self._unsure) > _MAX_UNSURE:
                self._unsure.clear()
                self._settled.clear()
            return now - self._unsure.setdefault(zid, now) < DISCOVERY_SECONDS

    def tick(self, now: float) -> None:
        """Report that an unknown session has had its time to appear."""
        with self._lock:
            over = {z for z, since in self._unsure.items() if now - since >= DISCOVERY_SECONDS} - self._settled
            self._settled |= over
        if over:
            self._graph_changed()

    def announce(self, record: bytes) -> None:
        """Send a record to all neighbours."""
        with contextlib.suppress(zenoh.ZError):  # the session is being closed
            self._publisher.put(record)

    def sightings(self) -> list[Sighting]:
        """The neighbours on the network."""
        with self._lock:
            return [sighting for zid, sighting in self._seen.items() if zid not in self._past]

    def settled(self, since: float) -> bool:
        """Whether all that were there at ``since`` are seen; asks the network where that is not known yet."""
        with self._lock:
            if self._looked_since >= since:
                return True
            now = time.monotonic()
            if self._looking_since is not None and now - self._looking_since < _LOOK_SECONDS:
                return False
            self._looking_since = now
        self._session.liveliness().get(
            f"{SPACE}/*/{self._place}",
            zenoh.handlers.Callback(self._on_found, lambda: self._looked(now), indirect=False),
            timeout=_LOOK_SECONDS,
        )
        return False

    def _on_found(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._see(_zid(reply.ok), None)

    def _looked(self, since: float) -> None:
        with self._lock:
            self._looked_since, self._looking_since = max(since, self._looked_since), None
        self._presence_changed()

    def _on_token(self, token: zenoh.Sample) -> None:
        zid = _zid(token)
        if token.kind == zenoh.SampleKind.PUT:
            self._see(zid, None)
            return
        with self._lock:
            gone = self._seen.pop(zid, None)
        if gone is not None:
            self._graph_changed()
            self._presence_changed()

    def _on_record(self, sample: zenoh.Sample) -> None:
        if len(sample.payload) <= _MAX_RECORD:
            self._see(_zid(sample), sample.payload.to_bytes())

    def _see(self, zid: str, record: bytes | None) -> None:
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
        """Leave."""
        undeclare(self._token, self._publisher, *self._subscribers)


def remember(own: str, file: Path) -> frozenset[str]:
    """Add our session's id to those kept in a file; returns those that were there."""
    try:
        past = file.read_text().split()[-_KEPT:]
    except OSError:
        past = []
    keep(file, "\n".join([*past, own]) + "\n", "for some seconds after a crash, topics of its own may come back")
    return frozenset(past)


def _zid(sample: zenoh.Sample) -> str:
    return str(sample.key_expr).removeprefix(SPACE + "/").partition("/")[0]
