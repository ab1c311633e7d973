"""Restarts links to other machines on which zenoh did not send its state.

A router of zenoh (1.10) sends a neighbor its subscriptions, services and tokens when it computes its trees, at most
every 0.1 s, and only if the last computation was without this neighbor (``compute_trees`` in ``network.rs``). So if a
link is cut and restored between two computations, they are not sent again. The link is connected, but in one direction
or both no message crosses it until it is cut once more. Measured: if a link is cut within 50 ms after messages cross it
again, this happens nearly always; if it is cut 250 ms after, never.

So each external router has a token, which it sends and loses together with the rest of its state. If a neighbor's token
has disappeared although the neighbor is linked, `LinkRestarts` closes the link, and zenoh connects it again. If that
does not bring the token back, the pauses between restarts double, because each restart also cuts what does cross.

A new router may lack the state, too: it gets the index of a router that has left, and zenoh compares only indices. If
two routers leave and another joins before the next computation, no message of the new one reaches its neighbor, for
good. Measured: if all this takes 60 ms, it happens nearly always; if it takes 110 ms, never. So each router sends its
zenoh id to each other router whose token appears, which then closes the link if the token of the first does not arrive.
Routers of other programs send no id, and may stay without the state.
"""

from __future__ import annotations

import contextlib
import logging
import socket
import time
from dataclasses import dataclass, field
from threading import Lock

import psutil
import zenoh

from bridge.concurrency import Backoff
from bridge.hub.graph.tokens import MIDSPAN_SPACE
from bridge.hub.links import duplicate
from bridge.hub.security.handshake import HostPort
from bridge.hub.zenoh_compat import follow_tokens, keep_thread_state, subscribe, undeclare

_log = logging.getLogger(__name__)

_KEY = f"{MIDSPAN_SPACE}/external"
_SECONDS = 1.5
"""Seconds for which a link must lack the token before it is closed: zenoh computes its trees every 0.1 s."""

_LONGEST_SECONDS = 60.0
"""Maximum of the same after restarts that did not bring the token back."""

_STOPPED_SECONDS = 3.0
"""A longer time between two checks means that this process was stopped, and may not have read a token yet."""

_LOG_SECONDS = 600.0
"""Minimum seconds between two log lines about the same neighbor."""

_MOST_LOST = 1000
"""Maximum number of routers whose tokens are expected; more ids are ignored."""

_REMEMBERED_SECONDS = 60.0
"""Seconds for which a lost router may return with the same zenoh id."""


@dataclass(slots=True)
class _Lost:
    """A router whose token has disappeared, or has not arrived.

    Attributes:
        linked: when it was last linked.
        pause: seconds after which a link without the token is closed.
        restarts: number of times that its links were closed.
        logged: when that was last logged.
    """

    linked: float
    pauses: Backoff = field(default_factory=lambda: Backoff(_SECONDS, _LONGEST_SECONDS))
    pause: float = field(init=False)
    restarts: int = 0
    logged: float = float("-inf")

    def __post_init__(self) -> None:
        self.pause = self.pauses.pause(0.0)


class LinkRestarts:
    """Finds and closes the links that lack their neighbor's state.

    A neighbor that neither had a token nor sent its zenoh id is another program, or an earlier release, and keeps its
    link.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._lock = Lock()
        self._present: set[str] = set()
        """Zenoh ids of the routers with a token."""
        self._new: set[str] = set()
        """Those to which this router has not sent its own id yet."""
        self._lost: dict[str, _Lost] = {}
        """By zenoh id."""
        self._since: dict[tuple[str, str, str], float] = {}
        """By zenoh id and both addresses, when a link was first seen without the token."""
        self._checked = time.monotonic()
        self._zid = str(session.zid())
        # before the token, because other routers send their ids as soon as they receive it
        self._ids = subscribe(session, f"{_KEY}/{self._zid}/*", self._on_id)
        self._token = session.liveliness().declare_token(f"{_KEY}/{self._zid}")
        self._subscriber = follow_tokens(session, f"{_KEY}/*", self._on_token)

    def check(self) -> None:
        """Close the links that have lacked the token for a while; called once a second."""
        self._send_id()
        before, self._checked = self._checked, time.monotonic()
        with self._lock:
            if not self._lost or self._checked - before > _STOPPED_SECONDS:
                self._since = {}
                return
        links = [(str(link.zid), str(link.src), str(link.dst)) for link in self._session.info.links()]
        now, linked = time.monotonic(), {zid for zid, *_ in links}
        with self._lock:
            for zid in linked & self._lost.keys():
                self._lost[zid].linked = now
            self._lost = {zid: lost for zid, lost in self._lost.items() if now - lost.linked < _REMEMBERED_SECONDS}
            self._since = {link: self._since.get(link, now) for link in links if link[0] in self._lost}
            overdue = [link for link, since in self._since.items() if now - since >= self._lost[link[0]].pause]
            for link in overdue:  # if it stays open, it gets the next pause, too
                del self._since[link]
            routers = {zid: self._lost[zid] for zid, *_ in overdue}
        for zid, here, there in overdue:
            if close_connection(here, there):
                _log_restart(routers[zid], there, now)
        for lost in routers.values():
            lost.pause = lost.pauses.pause(0.0)

    def close(self) -> None:
        """Stop following tokens; this router's token ends with the session, and so not before the links."""
        undeclare(self._subscriber, self._ids)

    def _send_id(self) -> None:
        """Send this router's id to the new routers: messages also cross to a router that lacks this one's state."""
        with self._lock:
            new, self._new = self._new - {self._zid}, set()
        for zid in new:
            self._session.put(f"{_KEY}/{zid}/{self._zid}", b"")

    def _on_id(self, sample: zenoh.Sample) -> None:
        """Expect the token of a router that has received this one's; runs on a zenoh thread."""
        keep_thread_state()
        zid = str(sample.key_expr).rpartition("/")[2]
        with self._lock:
            if zid not in self._present and len(self._lost) < _MOST_LOST:
                self._lost.setdefault(zid, _Lost(time.monotonic()))

    def _on_token(self, sample: zenoh.Sample) -> None:
        """Note a router's token; runs on a zenoh thread."""
        keep_thread_state()
        zid = str(sample.key_expr).rpartition("/")[2]
        with self._lock:
            if sample.kind == zenoh.SampleKind.DELETE:
                self._present.discard(zid)
                self._lost.setdefault(zid, _Lost(time.monotonic()))
            else:
                self._present.add(zid)
                self._new.add(zid)
                self._lost.pop(zid, None)
                self._since = {link: since for link, since in self._since.items() if link[0] != zid}


def _log_restart(lost: _Lost, place: str, now: float) -> None:
    lost.restarts += 1
    if now - lost.logged < _LOG_SECONDS:
        return
    lost.logged = now
    again = "" if lost.restarts == 1 else f"; it did so {lost.restarts} times: restart Midspan there"
    _log.warning("restarting the link to %s: zenoh connected it without the other machine's topics%s", place, again)


def close_connection(here: str, there: str) -> bool:
    """Shut down the TCP connection between two locators of zenoh, and return whether it was open.

    Other protocols are not supported.
    """
    ends = [(place.host, place.port) for place in (HostPort.of(here), HostPort.of(there)) if place is not None]
    try:
        connections = psutil.Process().net_connections("tcp")
    except (psutil.Error, OSError):
        return False
    closed = False
    for connection in connections:
        if connection.fd >= 0 and [tuple(connection.laddr), tuple(connection.raddr)] == ends:
            with contextlib.suppress(OSError), duplicate(connection.fd) as copy:
                copy.shutdown(socket.SHUT_RDWR)
                closed = True
    return closed
