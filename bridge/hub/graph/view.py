"""The hub's graph as this session sees it: nodes, endpoints and origins, from the liveliness tokens of all sessions."""

from __future__ import annotations

import logging
from collections.abc import Callable
from threading import Lock

import zenoh

from bridge.hub.errors import HubWireError
from bridge.hub.graph.announcements import SessionAnnouncements
from bridge.hub.graph.endpoints import EndpointTable, HubEndpoint, HubNode
from bridge.hub.graph.hashes import KindOfEndpoint
from bridge.hub.graph.tokens import (
    ADMIN_SPACE,
    MIDSPAN_SPACE,
    EndpointKind,
    Origin,
    driver_key,
    member_key,
    near_key,
    parse_token,
    relay_key,
    velocity_key,
)
from bridge.hub.lane.numbering import Epoch
from bridge.hub.zenoh_compat import follow_tokens, undeclare

_log = logging.getLogger(__name__)


class HubGraph:
    """Nodes, endpoints and origins. Safe to use from any thread.

    Attributes:
        epoch: changes after each token that appears or disappears, and by `renew`.
        refused: number of tokens that were ignored because they are malformed or exceed the limit.
        trouble: the reason why the last of these tokens was ignored, "" if there are none.
    """

    def __init__(self, session: zenoh.Session, domain: int, max_tokens: int) -> None:
        self._zid = str(session.zid())
        self._domain = domain
        self._lock = Lock()
        self._announced = announced = SessionAnnouncements(domain, max_tokens, lambda zid: self._table.settle(zid))
        self._table = EndpointTable(self._zid, domain, max_tokens, announced.origins)
        self._origins, self._zids = announced.origins, self._table.zids  # read for each sample, without the lock
        self._own: dict[str, zenoh.LivelinessToken] = {}
        self._watches: dict[object, Callable[[], None]] = {}
        self.epoch = Epoch()
        self.refused = 0
        self.trouble = ""
        self._liveliness = session.liveliness()
        spaces = (*announced.spaces, f"{ADMIN_SPACE}/{domain}/**")
        self._subscribers = [follow_tokens(session, space, self._on_sample) for space in spaces]

    def endpoints(self) -> list[HubEndpoint]:
        """Return all endpoints, including those of this session."""
        with self._lock:
            return self._table.endpoints()

    def endpoint(self, gid: bytes) -> HubEndpoint | None:
        """Return the endpoint with this GID, None if it is unknown; too slow to call for each sample."""
        return next((endpoint for endpoint in self.endpoints() if endpoint.gid == gid), None)

    def publishers(self, topic: str | None = None) -> list[HubEndpoint]:
        """Return all publishers, or those of one topic."""
        return self._of_kind(EndpointKind.PUBLISHER, topic)

    def subscriptions(self, topic: str | None = None) -> list[HubEndpoint]:
        """Return all subscriptions, or those of one topic."""
        return self._of_kind(EndpointKind.SUBSCRIPTION, topic)

    def servers(self, name: str | None = None) -> list[HubEndpoint]:
        """Return all servers, or those of one service."""
        return self._of_kind(EndpointKind.SERVER, name)

    def clients(self, name: str | None = None) -> list[HubEndpoint]:
        """Return all clients, or those of one service."""
        return self._of_kind(EndpointKind.CLIENT, name)

    def nodes(self) -> list[HubNode]:
        """Return all nodes, including those of this session."""
        with self._lock:
            return self._table.nodes()

    def origins(self) -> dict[str, Origin]:
        """Return by zid the origin of each session that announces one."""
        with self._lock:
            return dict(self._origins)

    def members(self) -> dict[str, frozenset[str]]:
        """Return, by the session (zid) of each active worker, the members that it announces of its foreign network."""
        with self._lock:
            return self._announced.members()

    def announce_member(self, member: str) -> Callable[[], None]:
        """Announce that another session's worker is on our foreign network, until the returned function is called."""
        return self.announce(member_key(self._domain, self._zid, member))

    def velocities(self) -> list[tuple[str, str, str]]:
        """Return session (zid), hub topic and type of each velocity topic to which a side's own nodes subscribe."""
        with self._lock:
            return sorted(self._announced.velocities)

    def announce_velocity(self, topic: str, type_name: str) -> Callable[[], None]:
        """Announce that our side's own nodes subscribe to a velocity topic, until the returned function is called."""
        return self.announce(velocity_key(self._domain, self._zid, topic, type_name))

    def drivers(self, topic: str) -> dict[str, str]:
        """Return, by session (zid), who drives manually on a velocity topic in other sessions."""
        with self._lock:
            drivers = sorted(self._announced.drivers)
        return {zid: who for zid, name, who in drivers if name == topic and zid != self._zid}

    def announce_driver(self, topic: str, who: str) -> Callable[[], None]:
        """Announce that ``who`` drives manually on a velocity topic, until the returned function is called."""
        return self.announce(driver_key(self._domain, self._zid, topic, who))

    def relays(self) -> dict[str, tuple[int, str]]:
        """Return the sessions (zid) that may relay between nodes, each with its start (wall clock, ns) and router."""
        with self._lock:
            return dict(self._announced.relays)

    def near(self) -> frozenset[tuple[str, str]]:
        """Return the direct links that sessions that may relay announce: session (zid), and the other session."""
        with self._lock:
            return frozenset(self._announced.near)

    def announce_relay(self, since: int, router: str) -> Callable[[], None]:
        """Announce that this session may relay, until the returned function is called."""
        return self.announce(relay_key(self._domain, self._zid, since, router))

    def announce_near(self, session: str) -> Callable[[], None]:
        """Announce a direct link of this session to another one, until the returned function is called."""
        return self.announce(near_key(self._domain, self._zid, session))

    def midspan(self) -> frozenset[str]:
        """Return the sessions (zid) of all Midspan programs."""
        with self._lock:
            return frozenset(self._announced.sessions)

    def is_midspan(self, zid: str) -> bool:
        """Return whether a session (zid) belongs to a Midspan program. Fast enough to call for each sample."""
        return zid in self._announced.sessions

    @property
    def variants_version(self) -> int:
        """A number that changes when `other_hashes` changes, or a new publisher with buffers appears."""
        return self._table.variants_version

    def has_buffers(self, topic: str, type_name: str) -> bool:
        """Return whether another session's publisher of this topic and type announces buffer backends."""
        publishers = self.publishers(topic) if self._table.has_buffers else ()
        return any(end.buffers and end.type_name == type_name and not end.own for end in publishers)

    def other_hashes(self, wanted: KindOfEndpoint) -> dict[str, bool]:
        """Return the type hashes, or `NO_HASH`, that other sessions announce for a kind of endpoint.

        The value is whether an endpoint with this hash is latched.
        """
        with self._lock:
            return self._table.other_hashes(wanted)

    def origin_of(self, zid: str) -> Origin | None:
        """Return a session's origin. Fast enough to call for each sample."""
        return self._origins.get(zid)

    def zid_of(self, gid: bytes) -> str:
        """Return the session of the endpoint with this GID, "" if it is unknown."""
        return self._zids.get(gid, "")

    def watch(self, callback: Callable[[], None]) -> Callable[[], None]:
        """Call ``callback`` after each change, until the returned function is called.

        The callback runs on zenoh's thread, or on a thread that announces or withdraws a token of this session, so it
        must only set a flag and wake another thread.
        """
        watch = object()
        self._watches[watch] = callback

        def close() -> None:
            self._watches.pop(watch, None)

        return close

    def catch_up(self, seconds: float) -> None:
        """Wait, in a zenoh client, until the router has sent all tokens that it had at the time of the call.

        This works because the router answers in order. The requested key does not exist, and this session does not
        watch it, because zenoh itself would answer for a watched key.
        """
        for _ in self._liveliness.get(f"{MIDSPAN_SPACE}/{self._domain}/told/{self._zid}", timeout=seconds):
            pass

    def close(self) -> None:
        """Stop watching tokens. Safe to call twice."""
        self._watches.clear()
        undeclare(*self._subscribers)
        self._subscribers.clear()

    def _of_kind(self, kind: EndpointKind, topic: str | None) -> list[HubEndpoint]:
        with self._lock:
            return [endpoint for endpoint in self._table.endpoints(topic) if endpoint.kind is kind]

    def announce(self, key: str) -> Callable[[], None]:
        """Declare a token of this session, which exists until the returned function is called; it is safe to repeat."""
        token = self._own[key] = self._liveliness.declare_token(key)
        # not read back from zenoh, which drops a client's tokens when it loses its router
        with self._lock:
            changed = self._put_token(key)
        self._notify(changed)

        def withdraw() -> None:
            with self._lock:
                if self._own.get(key) is not token:  # withdrawn before; it may have been announced again
                    return
                changed = self._delete_token(key)
                del self._own[key]
            undeclare(token)
            self._notify(changed)

        return withdraw

    def _on_sample(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if f"/{self._zid}/" in key:
            return
        with self._lock:
            changed = self._delete_token(key) if sample.kind == zenoh.SampleKind.DELETE else self._put_token(key)
        self._notify(changed)

    def _put_token(self, key: str) -> bool:
        try:
            return self._announced.put(key) if _is_announcement(key) else self._table.add(key, parse_token(key))
        except HubWireError as err:
            self._refuse(key, str(err))
            return False

    def _delete_token(self, key: str) -> bool:
        try:
            return self._announced.delete(key) if _is_announcement(key) else self._table.remove(key)
        except HubWireError:
            return False

    def _refuse(self, key: str, why: str) -> None:
        level = logging.DEBUG if self.refused else logging.WARNING
        self.refused += 1
        self.trouble = f"{why}: {key:.100}"
        _log.log(level, "liveliness token ignored, %s: %.200s", why, key)

    def renew(self) -> None:
        """Begin a new epoch, because another session may have declared subscribers."""
        self.epoch.renew()

    def _notify(self, changed: bool) -> None:
        self.renew()
        if changed:
            for callback in tuple(self._watches.values()):
                callback()


def _is_announcement(key: str) -> bool:
    return key.startswith(MIDSPAN_SPACE)
