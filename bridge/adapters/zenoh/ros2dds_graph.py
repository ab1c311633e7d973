"""The topics, services and actions that bridges of the ros2dds dialect announce on a network."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

import zenoh

from bridge.adapters.base import Endpoint, Kind, MadeBy
from bridge.adapters.zenoh import ros2dds_tokens as tokens
from bridge.adapters.zenoh.mark import is_marked, sender
from bridge.adapters.zenoh.ros2dds_tokens import Token
from bridge.hub.errors import WireError

_log = logging.getLogger(__name__)

_MAX_TOKENS = 50_000


class Graph:
    """Follows the tokens of all bridges. Safe to use from any thread.

    Args:
        session: the dialect's session.
        prefix: the namespace that keys begin with, ``""`` or as ``robot1/``; other keys are not ours.
        changed: called after each change.
    """

    def __init__(self, session: zenoh.Session, prefix: str, changed: Callable[[], None]) -> None:
        self._own = str(session.zid())
        self._prefix, self._changed = prefix, changed
        self._lock = threading.Lock()
        self._tokens: dict[str, tuple[Token, ...]] = {}
        self._bridges: set[str] = set()
        self._publishers: dict[str, dict[str, Token]] = {}
        self._refused = 0
        self._subscriber = session.liveliness().declare_subscriber(
            tokens.ALL, zenoh.handlers.Callback(self._on_token, indirect=False), history=True
        )

    def endpoints(self) -> list[Endpoint]:
        """Every topic and service of every other bridge; of one told twice the newest counts."""
        with self._lock:
            known = [token for tokens_ in self._tokens.values() for token in tokens_]
        found: dict[tuple[str, Kind], Endpoint] = {}
        for token in known:
            made_by = MadeBy.MIDSPAN if is_marked(token.zid) else MadeBy.NATIVE
            found[endpoint_id(token.zid, token.key), token.kind] = Endpoint(
                endpoint_id(token.zid, token.key),
                token.kind,
                "/" + token.key.removeprefix(self._prefix),
                token.type,
                token.qos,
                made_by,
                f"zenoh-bridge-ros2dds {token.zid}" if made_by is MadeBy.NATIVE else f"midspan {token.zid}",
                token.type_hash,
            )
        return list(found.values())

    def publishers(self, key: str) -> list[Token]:
        """The native publishers that are announced for a key."""
        with self._lock:
            return list(self._publishers.get(key, {}).values())

    def who(self, key: str, sample: zenoh.Sample) -> tuple[str, Token | None]:
        """The bridge that a sample on a key is from ("" where it is not a bridge's), and what it announced for it."""
        zid = sender(sample)
        with self._lock:
            token = self._publishers.get(key, {}).get(zid)
            return (zid if zid in self._bridges else ""), token

    def warnings(self) -> list[str]:
        """How many tokens could not be read."""
        return [f"{self._refused} tokens of ros2dds bridges are left out: see the log"] if self._refused else []

    def close(self) -> None:
        """Hear no more."""
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]

    def _on_token(self, sample: zenoh.Sample) -> None:
        text = str(sample.key_expr)
        zid = tokens.zid_of(text)
        if zid == self._own:
            return
        put = sample.kind == zenoh.SampleKind.PUT
        try:
            told = tokens.parse(text)
        except WireError as err:
            if put:
                level = logging.DEBUG if self._refused else logging.WARNING
                self._refused += 1
                _log.log(level, "token left out, %s: %.200s", err, text)
            return
        with self._lock:
            self._count(zid, text, put=put)
            if not told or not all(token.key.startswith(self._prefix) for token in told):
                return
            changed = self._put(text, told) if put else self._delete(text)
        if changed:
            self._changed()

    def _count(self, zid: str, text: str, *, put: bool) -> None:
        """A bridge is one as long as its own token lives."""
        if text == tokens.alive_key(zid):
            if put and len(self._bridges) < _MAX_TOKENS:
                self._bridges.add(zid)
            else:
                self._bridges.discard(zid)

    def _put(self, text: str, told: tuple[Token, ...]) -> bool:
        if len(self._tokens) >= _MAX_TOKENS:
            return False
        self._tokens[text] = told
        for token in told:
            if token.kind is Kind.PUBLISHER and not is_marked(token.zid):
                self._publishers.setdefault(token.key, {})[token.zid] = token
        return True

    def _delete(self, text: str) -> bool:
        told = self._tokens.pop(text, ())
        for token in told:
            at_key = self._publishers.get(token.key, {})
            if at_key.get(token.zid) == token:
                del at_key[token.zid]
                if not at_key:
                    del self._publishers[token.key]
        return bool(told)


def endpoint_id(zid: str, key: str) -> str:
    """The id of a bridge's endpoint for a key."""
    return f"{zid} {key}"
