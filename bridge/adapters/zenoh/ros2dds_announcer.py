"""The tokens by which bridges of the ros2dds dialect learn of our topics, services and actions."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable

import zenoh

from bridge.adapters.base import Kind
from bridge.adapters.zenoh.ros2dds_tokens import Token, action_key, action_of, alive_key, token_key
from bridge.hub.qos import Qos
from bridge.messages.conversion import SideType


class Announcer:
    """Our own tokens: one for each key and kind, with the QoS of the most that we offer or ask for there.

    An action has one token for the whole, as long as its goals or its results are served or called by us.

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
        if action and not side_type.name.endswith(("_SendGoal", "_GetResult")):
            return lambda: None
        place = kind, action or key
        with self._lock:
            self._wanted.setdefault(place, []).append(token)
            self._settle(place)

        def withdraw() -> None:
            with self._lock:
                self._wanted[place].remove(token)
                self._settle(place)

        return withdraw

    def _settle(self, place: tuple[Kind, str]) -> None:
        wanted = self._wanted[place]
        token = max(wanted, key=lambda t: (t.qos.latched, t.qos.depth)) if wanted else None
        text = "" if token is None else action_key(token) if action_of(token.key) else token_key(token)
        told = self._told.get(place)
        if told is not None and told[0] == text:
            return
        if told is not None:
            del self._told[place]
            told[1].undeclare()  # type: ignore[no-untyped-call]
        if text:
            self._told[place] = text, self._session.liveliness().declare_token(text)
        else:
            del self._wanted[place]

    def close(self) -> None:
        """Leave."""
        with self._lock, contextlib.suppress(zenoh.ZError):
            self._alive.undeclare()  # type: ignore[no-untyped-call]
