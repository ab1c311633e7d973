"""Restores missing links between zenoh sessions on this machine, and closes dead links to other machines.

Peers discover each other when one of them joins the router (zenoh calls this gossip), and link directly. zenoh does
not restore a link that has ended, and its routers do not forward between two peers (zenoh 1.10: ``closed_session`` in
``orchestrator.rs`` reconnects only to configured endpoints; ``peers_failover_brokering`` no longer has an effect). A
process that is suspended for about the lease of 3 s loses some of its links and keeps others. If it keeps the link to
the router, it and a lost peer receive nothing from each other until one of them is restarted. A worker that was
repeatedly stopped for 3 s showed this the fourth time. When a session joins, the router and all peers are announced
again. So if a session has lost a peer that is still at the router, it briefly opens another session (`Mesh`).

A first attempt to link may also fail: when 13 rmw_zenoh nodes joined at once on a busy machine, one of them had no link
to some workers, which did not see its topics. So a session also compares its links with the router's peers.

zenoh (1.10) ends a link that was silent for its lease. Over TLS it first waits until a packet has been written. If a
link with outgoing data is cut, this wait ends only when TCP gives up, up to a quarter of an hour later; until then all
sessions at the other end of the link count as present. A time limit makes TCP give up in time (RFC 5482; only Linux has
it, as ``TCP_USER_TIMEOUT``); see `LinkLimits`.
"""

from __future__ import annotations

import contextlib
import functools
import ipaddress
import json
import logging
import os
import secrets
import socket
import threading
import time
from collections.abc import Callable, Collection
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

import zenoh

from bridge.hub.errors import HubError, zenoh_reason
from bridge.hub.zenoh_config import LEASE_MS, LISTENERS

if TYPE_CHECKING:
    import psutil

_log = logging.getLogger(__name__)

MEMBERS = "members"
"""The verb to which Midspan's router responds with its sessions."""

_MARK = "d0c0ffee"
"""Prefix of the zenoh ids of sessions that introduce others; when such a session ends, no peer is lost."""

_FIRST_SECONDS = 1.5
"""Seconds before a lost session is introduced, longer than the other sessions and the router take to detect a loss.
Otherwise a process might be announced while it is suspended, and attempts to reach it still fail when it continues."""

_SOON_SECONDS = 0.2
_TOGETHER_SECONDS = 1.0
"""A session that lost its router within this many seconds of its peers was itself suspended, and need not wait."""

_LONGEST_SECONDS = 4.0
_INTRODUCTION_SECONDS = 2.0
_HOPELESS_SECONDS = 10.0
"""Seconds after which introductions alone will not restore a link, even on a busy machine."""

_REMEMBERED_SECONDS = 60.0
"""Seconds for which a lost session is searched for, because it may return to the router."""

_SEARCH_AGAIN_SECONDS = 300.0
"""Seconds until the next search for a session that stays at the router, because what kept it from linking, such as a
firewall or a lack of file descriptors, may be over."""

_COMPARE_SECONDS = 5.0
"""Seconds between comparisons with the router's peers; a peer without a link in two successive comparisons is lost."""

_SETTLE_SECONDS = 0.4
"""Seconds after a change of the graph until the link events are read, so that they have arrived by then."""

_MOST_EVENTS = 1000
"""Maximum number of unread link events."""

Members = Callable[[], set[str] | None]


class Mesh:
    """Watches the direct links of a session, and restores missing ones.

    Args:
        config: returns a configuration for another session on the same hub.
        members: returns the zenoh ids of all sessions at this session's routers, None if no router answers.
        peers: returns the same, but only for sessions that are peers.
        rejoin: has sessions join their router again; see `bridge.hub.rejoin`.

    Attributes:
        mended: number of missing links that were restored.
        ended: number of links that have ended, to peers and routers.
    """

    def __init__(
        self, session: zenoh.Session, config: Callable[[], zenoh.Config], members: Members, peers: Members,
        rejoin: Callable[[Collection[str]], None],
    ) -> None:  # fmt: skip
        self._session, self._config, self._members, self._peers = session, config, members, peers
        self._rejoin = rejoin
        self._lost: dict[str, float] = {}
        self._unlinked: set[str] = set()  # according to the last comparison
        self._unreachable: dict[str, float] = {}  # the sessions given up, and when to search for each again
        self._compare_at = time.monotonic() + _COMPARE_SECONDS
        self._router_lost_at = float("-inf")
        self._wake, self._closed = Event(), Event()
        self.mended = self.ended = 0
        # Not a callback: on zenoh's thread, it would block the opening and closing of links on the GIL; on a separate
        # thread, it would keep a program that does not close its session from exiting.
        channel: Any = zenoh.handlers.RingChannel(_MOST_EVENTS)
        self._listener: Any = session.info.declare_transport_events_listener(channel)
        self._events: Any = self._listener.handler
        self._thread = Thread(target=self._run, name="hub-mesh", daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """Read the link events soon. Call this after each change of the graph, on any thread.

        The end of a link takes the tokens of the session at its other end with it. Zenoh's own wait for link events
        polls ten times a second.
        """
        self._wake.set()

    def close(self) -> None:
        """Stop watching. Safe to call twice."""
        self._closed.set()
        self._wake.set()
        with contextlib.suppress(zenoh.ZError):  # the session is closed already
            self._listener.undeclare()
        self._thread.join(2 * _INTRODUCTION_SECONDS)

    @property
    def lost(self) -> frozenset[str]:
        """Zenoh ids of the sessions whose links are missing."""
        return frozenset(self._lost)

    def _run(self) -> None:
        while not self._closed.is_set():
            if self._wake.wait(max(0.0, self._compare_at - time.monotonic())):
                self._wake.clear()
                self._closed.wait(_SETTLE_SECONDS)
            self._attempt(self._handle_events)
            self._attempt(self._compare)  # also after a failure, as it sets the end of the next wait
            self._search()

    @staticmethod
    def _attempt(*steps: Callable[[], None]) -> None:
        """Run steps; a failure must not end the thread, since the next attempt may succeed."""
        try:
            for step in steps:
                step()
        except (zenoh.ZError, HubError) as err:
            # the session is being closed, another cannot be opened, or the file of `hub.zenoh` is invalid at the moment
            _log.debug("cannot follow links: %s", zenoh_reason(err))
        except Exception:
            _log.exception("following the links failed")

    def _handle_events(self) -> None:
        while (event := self._events.try_recv()) is not None:
            self._on_event(event)

    def _search(self) -> None:
        """Introduce the lost sessions until each of them is linked or given up."""
        pause = _SOON_SECONDS
        while self._lost and not self._closed.wait(pause):
            self._attempt(self._handle_events, self._compare, self._restore_links)
            self._give_up(time.monotonic() - _REMEMBERED_SECONDS)
            pause = min(2 * pause, _LONGEST_SECONDS)

    def _give_up(self, oldest: float) -> None:
        """Stop searching for sessions that were lost before the time ``oldest``."""
        expired = {zid for zid, at in self._lost.items() if at <= oldest}
        self._lost = {zid: at for zid, at in self._lost.items() if zid not in expired}
        self._unreachable |= dict.fromkeys(expired, time.monotonic() + _SEARCH_AGAIN_SECONDS)

    @functools.cached_property
    def _is_client(self) -> bool:
        return bool(json.loads(self._config().get_json("mode")) == "client")

    def _compare(self) -> None:
        """Record the router's peers without a link in two comparisons as lost; a client needs no links to peers."""
        now = time.monotonic()
        if now < self._compare_at:
            return
        self._compare_at = now + _COMPARE_SECONDS
        peers = None if self._is_client else self._peers()
        if peers is None:
            self._unlinked = set()
            return
        # a session that has left may return
        linked = self._linked_peers()
        self._unreachable = {zid: due for zid, due in self._unreachable.items() if zid in peers - linked}
        linked |= {zid for zid, due in self._unreachable.items() if now < due} | {str(self._session.zid())}
        unlinked = {zid for zid in peers - linked if not zid.startswith(_MARK)}
        for zid in unlinked & self._unlinked:
            self._lost.setdefault(zid, now - _FIRST_SECONDS)
        self._unlinked = unlinked

    def _on_event(self, event: zenoh.TransportEvent) -> None:
        """Record a lost peer or router."""
        if event.kind != zenoh.SampleKind.DELETE:
            return
        zid, now = str(event.transport.zid), time.monotonic()
        if zid.startswith(_MARK):
            return
        self.ended += 1
        if event.transport.whatami == zenoh.WhatAmI.ROUTER:
            self._router_lost_at = now
        elif event.transport.whatami == zenoh.WhatAmI.PEER:
            self._lost[zid] = now

    def _restore_links(self) -> None:
        """Introduce the missing sessions; do nothing while no router reports its sessions."""
        if not self._session.info.routers_zid():  # when the router returns, all peers are announced
            return
        members = self._members()
        if members is None:
            return
        for zid in self._linked_peers() & self._lost.keys():
            del self._lost[zid]
        before = time.monotonic() - _FIRST_SECONDS
        router = self._router_lost_at
        due = {zid for zid, at in self._lost.items() if at < before or abs(at - router) < _TOGETHER_SECONDS}
        missing = due & members
        if missing and not self._introduce(missing):
            long_ago = time.monotonic() - _HOPELESS_SECONDS
            # a further search must not end the router's link to a node again and again
            missing -= self._linked_peers() | self._unreachable.keys()
            hopeless = {zid for zid in missing if self._lost.get(zid, long_ago) < long_ago}
            if hopeless:
                self._rejoin(hopeless)

    def _linked_peers(self) -> set[str]:
        return {str(zid) for zid in self._session.info.peers_zid()}

    def _introduce(self, missing: Collection[str]) -> bool:
        """Open another session, which makes the router announce all peers, until the missing sessions are linked.

        Return whether they are.
        """
        config = self._config()
        config.insert_json5("id", json.dumps(_MARK + secrets.token_hex(12)))
        config.insert_json5("listen/endpoints", json.dumps(LISTENERS))  # the user's may have fixed ports, in use here
        session = zenoh.open(config)
        try:
            deadline = time.monotonic() + _INTRODUCTION_SECONDS
            while time.monotonic() < deadline and not self._closed.wait(0.02):
                if self._linked_peers().issuperset(missing):
                    self.mended += len(missing)
                    _log.warning("restored the direct link to %s", ", ".join(missing))
                    return True
            return False
        finally:
            session.close()  # type: ignore[no-untyped-call]


_EVERY = 1.0
_OPTION: int | None = getattr(socket, "TCP_USER_TIMEOUT", None)


def _far(address: str) -> bool:
    return not ipaddress.ip_address(address.partition("%")[0]).is_loopback


def limit_links(process: psutil.Process, far: Callable[[str], bool] = _far) -> None:
    """Set the time limit on the connections of ``process``, which is this process, to addresses that are ``far``."""
    if _OPTION is None:
        return
    import psutil  # only needed with an external listener

    with contextlib.suppress(psutil.Error, OSError):
        for connection in process.net_connections("tcp"):
            if connection.raddr and connection.fd >= 0 and far(connection.raddr.ip):
                with contextlib.suppress(OSError), duplicate(connection.fd) as copy:
                    copy.setsockopt(socket.IPPROTO_TCP, _OPTION, LEASE_MS)


def duplicate(descriptor: int) -> socket.socket:
    """Return a socket for the same connection, because zenoh may close ``descriptor``, and its number may be reused.

    Raises `OSError` if ``descriptor`` is not a socket.
    """
    copy = os.dup(descriptor)
    try:
        return socket.socket(fileno=copy)
    except OSError:
        os.close(copy)
        raise


_LOG_SECONDS = 60.0


class LinkLimits:
    """Sets the time limit on new connections, on a separate thread, which then calls ``check`` each second.

    Attributes:
        trouble: why the last time failed, or "". The log has the traceback, at most once a minute.
    """

    def __init__(self, check: Callable[[], None]) -> None:
        import psutil  # on the caller's thread, which can report that it fails

        self._process = psutil.Process()
        self._check = check
        self.trouble = ""
        self._logged_at = float("-inf")
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="hub-link-limits", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._end.set()
        self._thread.join(2.0)

    def _run(self) -> None:
        while not self._end.wait(_EVERY):
            try:
                limit_links(self._process)
                self._check()
            except zenoh.ZError:  # the session is being closed
                self.trouble = ""
            except Exception as err:
                self.trouble = f"checking the links to other machines failed: {type(err).__name__}: {err}"
                if time.monotonic() > self._logged_at + _LOG_SECONDS:
                    self._logged_at = time.monotonic()
                    _log.exception("checking the links to other machines failed; it is repeated each second")
            else:
                self.trouble = ""
