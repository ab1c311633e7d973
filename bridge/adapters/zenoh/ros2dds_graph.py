"""The endpoints that bridges of the ros2dds dialect announce, and Midspan's own tokens."""

from __future__ import annotations

import itertools
import logging
import threading
from collections.abc import Callable

import zenoh

from bridge.adapters.zenoh import ros2dds_tokens as tokens
from bridge.adapters.zenoh.neighbors import is_marked, sender
from bridge.adapters.zenoh.ros2dds_tokens import (
    ACTION_PARTS,
    Token,
    action_end,
    action_key,
    action_of,
    alive_key,
    token_key,
)
from bridge.hub.errors import HubWireError
from bridge.hub.wire.qos import Qos
from bridge.hub.zenoh_compat import follow_tokens, undeclare
from bridge.messages.transcode.conversion import SideType
from bridge.routing.edge import Endpoint, Kind, MadeBy

_log = logging.getLogger(__name__)

_MAX_TOKENS = 50_000


class Ros2ddsGraph:
    """Follows the tokens of all bridges; thread-safe. Keys without ``prefix`` ("" or like ``robot1/``) are ignored.

    A bridge may announce a publisher of a key again, with another QoS or after its link was lost. The publisher's
    endpoint then gets a new id, so that its messages are never attributed to the previous endpoint, whose cached
    messages are dropped.
    """

    def __init__(self, session: zenoh.Session, prefix: str, changed: Callable[[], None]) -> None:
        self._own = str(session.zid())
        self._prefix, self._changed = prefix, changed
        self._lock = threading.Lock()
        self._tokens: dict[str, tuple[Token, ...]] = {}
        self._bridges: set[str] = set()
        self._publishers: dict[str, dict[str, list[Token]]] = {}  # by key and by bridge, the newest last
        self._numbers: dict[tuple[str, str], int] = {}  # the number of the current publisher, by bridge and key
        self._next_number = itertools.count(1)
        self._refused = 0
        self._subscriber = follow_tokens(session, tokens.ALL, self._on_token)

    def endpoints(self) -> list[Endpoint]:
        """Return the topics and services of all other bridges; of duplicates, the newest."""
        with self._lock:
            known = [
                (token, self._publisher_id(token.zid, token.key) if _is_native_publisher(token) else "")
                for tokens_ in self._tokens.values()
                for token in tokens_
            ]
        endpoints: dict[tuple[str, Kind], Endpoint] = {}
        for token, publisher in known:
            made_by = MadeBy.MIDSPAN if is_marked(token.zid) else MadeBy.NATIVE
            node = f"{'zenoh-bridge-ros2dds' if made_by is MadeBy.NATIVE else 'midspan'} {token.zid}"
            id_, topic = publisher or endpoint_id(token.zid, token.key), "/" + token.key.removeprefix(self._prefix)
            endpoints[id_, token.kind] = Endpoint(
                id_, token.kind, topic, token.type, token.qos, made_by, node, token.type_hash
            )
        return list(endpoints.values())

    def publishers(self, key: str) -> dict[str, Token]:
        """Return the native publishers that are announced for a key, by id."""
        with self._lock:
            return {self._publisher_id(zid, key): known[-1] for zid, known in self._publishers.get(key, {}).items()}

    def publisher_of(self, key: str, sample: zenoh.Sample) -> tuple[str, Token | None]:
        """Return the id of a sample's publisher, "" if no bridge sent it, and its token, None if not received yet."""
        zid = sender(sample)
        with self._lock:
            known = self._publishers.get(key, {}).get(zid)
            if known is None and zid not in self._bridges:
                return "", None
            return self._publisher_id(zid, key), None if known is None else known[-1]

    def _publisher_id(self, zid: str, key: str) -> str:
        number = self._numbers.get((zid, key))
        if number is None:
            number = self._numbers[zid, key] = next(self._next_number)
        return f"{endpoint_id(zid, key)} {number}"

    def warnings(self) -> list[str]:
        """Return a warning with the number of invalid tokens, if there are any."""
        return [f"{self._refused} tokens of ros2dds bridges are ignored: see the log"] if self._refused else []

    def close(self) -> None:
        undeclare(self._subscriber)

    def _on_token(self, sample: zenoh.Sample) -> None:
        text = str(sample.key_expr)
        zid = tokens.zid_of(text)
        if zid == self._own:
            return
        put = sample.kind == zenoh.SampleKind.PUT
        try:
            announced = tokens.parse(text)
        except HubWireError as err:
            if put:
                level = logging.DEBUG if self._refused else logging.WARNING
                self._refused += 1
                _log.log(level, "token ignored, %s: %.200s", err, text)
            return
        with self._lock:
            self._track_bridge(zid, text, put=put)
            if not announced or not all(token.key.startswith(self._prefix) for token in announced):
                return
            changed = self._add(text, announced) if put else self._remove(text)
        if changed:
            self._changed()

    def _track_bridge(self, zid: str, text: str, *, put: bool) -> None:
        """Track which sessions are bridges: those that have declared a bridge's token."""
        if text == tokens.alive_key(zid):
            if put and len(self._bridges) < _MAX_TOKENS:
                self._bridges.add(zid)
            else:
                self._bridges.discard(zid)
                departed = [key for bridge, key in self._numbers if bridge == zid]
                for key in [key for key in departed if zid not in self._publishers.get(key, {})]:
                    del self._numbers[zid, key]

    def _add(self, text: str, announced: tuple[Token, ...]) -> bool:
        if text in self._tokens or len(self._tokens) >= _MAX_TOKENS:
            return False
        self._tokens[text] = announced
        for token in announced:
            if _is_native_publisher(token):
                known = self._publishers.setdefault(token.key, {}).setdefault(token.zid, [])
                if known:
                    self._numbers.pop((token.zid, token.key), None)
                known.append(token)
        return True

    def _remove(self, text: str) -> bool:
        announced = self._tokens.pop(text, ())
        for token in announced:
            at_key = self._publishers.get(token.key, {})
            known = at_key.get(token.zid, [])
            if token in known:
                if token == known[-1]:
                    self._numbers.pop((token.zid, token.key), None)
                known.remove(token)
                if not known:
                    del at_key[token.zid]
                if not at_key:
                    del self._publishers[token.key]
        return bool(announced)


def _is_native_publisher(token: Token) -> bool:
    return token.kind is Kind.PUBLISHER and not is_marked(token.zid)


def endpoint_id(zid: str, key: str) -> str:
    """Return the id of a bridge's endpoint for a key."""
    return f"{zid} {key}"


_NAMING = "_SendGoal", "_GetResult"
"""Suffixes of the types of action parts that contain the action's type."""


class TokenAnnouncer:
    """Midspan's tokens: one for each key and kind, with the strongest QoS that is offered or requested there.

    An action has a single token while Midspan serves or calls its send_goal or get_result service. A server's token is
    declared once all five parts exist, as in the plugin (``src/node_info.rs``), so that a client that sends a goal
    receives the first feedback.

    The plugin creates a route on a session's first token for a key, and drops the route when any token for the key is
    withdrawn. Therefore the old token is withdrawn before a token with another QoS is declared
    (``src/routes_mgr.rs``).
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._zid = str(session.zid())
        self._lock = threading.Lock()
        self._wanted: dict[tuple[Kind, str], list[Token]] = {}
        self._announced: dict[tuple[Kind, str], tuple[str, zenoh.LivelinessToken]] = {}
        self._alive = session.liveliness().declare_token(alive_key(self._zid))

    def announce(self, kind: Kind, key: str, side_type: SideType, qos: Qos) -> Callable[[], None]:
        """Announce a topic or a service until the returned function is called."""
        token = Token(self._zid, kind, key, side_type.name, side_type.type_id, qos)
        action = action_of(key)
        entry = (action_end(kind), action) if action else (kind, key)
        with self._lock:
            self._wanted.setdefault(entry, []).append(token)
            self._update(entry)

        def withdraw() -> None:
            with self._lock:
                self._wanted[entry].remove(token)
                self._update(entry)

        return withdraw

    def _update(self, entry: tuple[Kind, str]) -> None:
        wanted, announced = self._wanted[entry], self._announced.get(entry)
        text = _token_text(wanted, declared=announced is not None)
        if announced is not None and announced[0] == text:
            return
        if announced is not None:
            del self._announced[entry]
            undeclare(announced[1])
        if text:
            self._announced[entry] = text, self._session.liveliness().declare_token(text)
        if not wanted:
            del self._wanted[entry]

    def close(self) -> None:
        """Withdraw the token that shows that this bridge is alive."""
        with self._lock:
            undeclare(self._alive)


def _token_text(wanted: list[Token], *, declared: bool) -> str:
    """Return the key of the token for these endpoints; "" while an action is incomplete and not ``declared``."""
    if not wanted:
        return ""
    if not action_of(wanted[0].key):
        return token_key(max(wanted, key=lambda t: (t.qos.latched, t.qos.depth)))
    named = [token for token in wanted if token.type.endswith(_NAMING)]
    served = any(token.kind is Kind.SERVER for token in named)
    whole = len({token.key for token in wanted}) == ACTION_PARTS
    return action_key(named[-1]) if named and (declared or whole or not served) else ""
