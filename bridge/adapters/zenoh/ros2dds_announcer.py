"""The tokens by which bridges of the ros2dds dialect learn of our topics, services and actions."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable

import zenoh

from bridge.adapters.base import Kind
from bridge.adapters.zenoh.ros2dds_tokens import (
    ACTION_PARTS,
    Token,
    action_end,
    action_key,
    action_of,
    alive_key,
    token_key,
)
from bridge.hub.qos import Qos
from bridge.messages.conversion import SideType

_NAMING = "_SendGoal", "_GetResult"
"""The types of parts that tell the action's."""


class Announcer:
    """Our own tokens: one for each key and kind, with the QoS of the most that we offer or ask for there.

    An action has one token for the whole, as long as its goals or its results are served or called by us. A server's
    comes once all five of its parts are there, as the plugin's does (``src/node_info.rs``): who sends a goal
    then hears its first feedback.

    The plugin takes up a route when the first token of a session for a key comes, and drops it when any of them goes;
    so the old token goes before one with another QoS comes (its ``src/routes_mgr.rs``).
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._zid = str(session.zid())
        self._lock = threading.Lock()
        self._wanted: dict[tuple[Kind, str], list[Token]] = {}
        self._told: dict[tuple[Kind, str], tuple[str, zenoh.LivelinessToken]] = {}
        self._alive = session.liveliness().declare_token(alive_key(self._zid))

    def tell(self, kind: Kind, key: str, side_type: SideType, qos: Qos) -> Callable[[], None]:
        """Announce a topic or a service until the returned function is called."""
        token = Token(self._zid, kind, key, side_type.name, side_type.type_id, qos)
        action = action_of(key)
        place = (action_end(kind), action) if action else (kind, key)
        with self._lock:
            self._wanted.setdefault(place, []).append(token)
            self._settle(place)

        def withdraw() -> None:
            with self._lock:
                self._wanted[place].remove(token)
                self._settle(place)

        return withdraw

    def _settle(self, place: tuple[Kind, str]) -> None:
        wanted, told = self._wanted[place], self._told.get(place)
        text = _text(wanted, begun=told is not None)
        if told is not None and told[0] == text:
            return
        if told is not None:
            del self._told[place]
            told[1].undeclare()  # type: ignore[no-untyped-call]
        if text:
            self._told[place] = text, self._session.liveliness().declare_token(text)
        if not wanted:
            del self._wanted[place]

    def close(self) -> None:
        """Leave."""
        with self._lock, contextlib.suppress(zenoh.ZError):
            self._alive.undeclare()  # type: ignore[no-untyped-call]


def _text(wanted: list[Token], *, begun: bool) -> str:
    """The key of the token that says all of these, "" where there is nothing to say yet.

    Args:
        wanted: a topic's, a service's or one end of an action's parts.
        begun: it has been said already.
    """
    if not wanted:
        return ""
    if not action_of(wanted[0].key):
        return token_key(max(wanted, key=lambda t: (t.qos.latched, t.qos.depth)))
    named = [token for token in wanted if token.type.endswith(_NAMING)]
    served = any(token.kind is Kind.SERVER for token in named)
    whole = len({token.key for token in wanted}) == ACTION_PARTS
    return action_key(named[-1]) if named and (begun or whole or not served) else ""
