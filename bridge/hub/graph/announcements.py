"""What Midspan sessions announce: origin, members of their network, velocities, manual drivers and versions."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from bridge.hub.errors import HubWireError
from bridge.hub.graph.tokens import (
    MIDSPAN_SPACE,
    Origin,
    parse_driver,
    parse_member,
    parse_near,
    parse_origin,
    parse_relay,
    parse_velocity,
    parse_wire,
)
from bridge.hub.wire.version import refusal

_log = logging.getLogger(__name__)


class SessionAnnouncements:
    """What Midspan sessions announce in one graph. Not thread-safe: the lock of the graph guards them.

    Args:
        max_tokens: the maximum number of tokens of each kind.
        settle: called with the session (zid) whose origin may have changed.

    Attributes:
        spaces: key expressions of the tokens.
        origins: the origin of each session that announces one, by zid.
        velocities: session (zid), hub topic and type of each velocity topic to which a side's own nodes subscribe.
        drivers: session (zid), velocity topic and name of each person who drives manually.
        relays: the sessions (zid) that may relay, with the time of the start (wall clock, ns) and the router of each.
        near: the direct links that these announce: session, and the other session.
        sessions: the sessions (zid) of all Midspan programs.
    """

    def __init__(self, domain: int, max_tokens: int, settle: Callable[[str], None]) -> None:
        space = f"{MIDSPAN_SPACE}/{domain}"
        self._max_tokens, self._settle_endpoints = max_tokens, settle
        self._member_space, self._wire_space = f"{space}/member/", f"{space}/wire/"
        self._relay_space = f"{space}/relay/"
        kinds = ("wire", "origin", "member", "velocity", "driver", "relay", "near")
        self.spaces = tuple(f"{space}/{kind}/**" for kind in kinds)
        self.origins: dict[str, Origin] = {}
        self.velocities: set[tuple[str, str, str]] = set()
        self.drivers: set[tuple[str, str, str]] = set()
        self.relays: dict[str, tuple[int, str]] = {}
        self.near: set[tuple[str, str]] = set()
        self.sessions: set[str] = set()
        # drivers are polled: they come and go with each press of a control, for which no route needs to be checked
        self._sets: dict[str, tuple[Callable[[str], Any], set[Any], str, bool]] = {
            f"{space}/velocity/": (parse_velocity, self.velocities, "topics of velocities", True),
            f"{space}/driver/": (parse_driver, self.drivers, "manual drivers", False),
            f"{space}/near/": (parse_near, self.near, "direct links", True),
        }
        self._tokens: dict[str, dict[str, Origin]] = {}
        self._members: dict[str, dict[str, None]] = {}
        self._strangers: set[str] = set()

    def members(self) -> dict[str, frozenset[str]]:
        """Return, by the session (zid) of each active worker, the members that it announces of its foreign network."""
        return {zid: frozenset(members) for zid, members in self._members.items()}

    def put(self, key: str) -> bool:
        """Add a token; return whether to call the watches. Raises `HubWireError` if malformed or above the limit."""
        if key.startswith(self._member_space):
            return self._put_member(*parse_member(key))
        for space, (parse, values, kind, watched) in self._sets.items():
            if key.startswith(space):
                value = parse(key)
                self._check_room(len(values), kind)
                values.add(value)
                return watched
        if key.startswith(self._wire_space):
            return self._put_wire(*parse_wire(key))
        if key.startswith(self._relay_space):
            relay, since, router = parse_relay(key)
            self._check_room(len(self.relays), "relays")
            self.relays[relay] = since, router
            return True
        token = parse_origin(key)
        if token.zid not in self._tokens:
            self._check_room(len(self._tokens), "origins")
        tokens = self._tokens.setdefault(token.zid, {})
        # the newest of a session's origins is valid; the token that it replaces is removed immediately afterwards
        tokens.pop(key, None)
        tokens[key] = token.origin
        self._settle(token.zid)
        return True

    def delete(self, key: str) -> bool:
        """Remove a token; return whether to call the watches. Raises `HubWireError` if it is malformed."""
        if key.startswith(self._member_space):
            return self._delete_member(*parse_member(key))
        for space, (parse, values, _, watched) in self._sets.items():
            if key.startswith(space):
                value = parse(key)
                known = value in values
                values.discard(value)
                return watched and known
        if key.startswith(self._wire_space):
            return self._delete_wire(parse_wire(key)[0])
        if key.startswith(self._relay_space):
            relay, since, router = parse_relay(key)
            if self.relays.get(relay) != (since, router):  # a newer token has replaced it
                return False
            del self.relays[relay]
            return True
        zid = parse_origin(key).zid
        tokens = self._tokens.get(zid, {})
        if tokens.pop(key, None) is None:
            return False
        if not tokens:
            del self._tokens[zid]
        self._settle(zid)
        return True

    def _put_member(self, zid: str, member: str) -> bool:
        self._check_room(sum(map(len, self._members.values())), "members of networks")
        self._members.setdefault(zid, {})[member] = None
        return True

    def _delete_member(self, zid: str, member: str) -> bool:
        members = self._members.get(zid, {})
        if member not in members:
            return False
        del members[member]
        if not members:
            del self._members[zid]
        return True

    def _put_wire(self, zid: str, version: str, release: str) -> bool:
        """Handle a session's version: if it is incompatible, the origin of the session's endpoints stays unknown."""
        reason = refusal(version)
        known = zid in self.sessions
        if not known:
            self._check_room(len(self.sessions), "versions")
            self.sessions.add(zid)
        if not reason or zid in self._strangers:
            return not known
        self._strangers.add(zid)
        _log.warning("Midspan %.40s on the hub is refused, session %s: %s", release, zid, reason)
        self._settle(zid)
        return True

    def _delete_wire(self, zid: str) -> bool:
        known = zid in self.sessions
        self.sessions.discard(zid)
        if zid not in self._strangers:
            return known
        self._strangers.remove(zid)
        self._settle(zid)
        return True

    def _settle(self, zid: str) -> None:
        tokens = self._tokens.get(zid)
        if tokens and zid not in self._strangers:
            self.origins[zid] = next(reversed(tokens.values()))
        else:
            self.origins.pop(zid, None)
        self._settle_endpoints(zid)

    def _check_room(self, count: int, kind: str) -> None:
        if count >= self._max_tokens:
            raise HubWireError(f"more than {self._max_tokens} {kind}")
