"""Clients and servers on the keys of a foreign dialect."""

from __future__ import annotations

from collections.abc import Callable

import zenoh

from bridge.adapters.zenoh.topics import Announcement, KeyContext
from bridge.hub.endpoints.calls import Call, CallClient, CallError, CallServer


class KeyCaller(CallClient):
    """Calls a key's servers as the plugins do: all, and the first reply counts; ``attached(number)`` is attached."""

    where = "this zenoh network"

    def __init__(
        self, context: KeyContext, key: str, name: str, announcement: Announcement,
        attached: Callable[[int], bytes | None] = lambda _number: None, encoding: zenoh.Encoding | None = None,
    ) -> None:  # fmt: skip
        self.announcement, self.encoding = announcement, encoding
        self._withdraw, self._attach = announcement.withdraw, attached
        target = zenoh.QueryTarget.BEST_MATCHING
        super().__init__(context.session, key, name, context.limit, context.executor, target, context.closed)

    def _attached(self, number: int) -> bytes | None:
        return self._attach(number)


class KeyServer(CallServer):
    """Serves one key. zenoh does not report that a caller left: the call goes on, and its reply is lost.

    Args:
        nothing: the request that a query without payload stands for, None where the service's has fields.
        asked: expression of the keys whose queries are calls, ``key`` itself where it is "".
    """

    def __init__(
        self, context: KeyContext, key: str, name: str, call: Call, announcement: Announcement,
        nothing: bytes | None, encoding: zenoh.Encoding | None = None, asked: str = "",
    ) -> None:  # fmt: skip
        self.announcement, self.encoding = announcement, encoding
        self._withdraw, self._nothing = announcement.withdraw, nothing
        self._expression = zenoh.KeyExpr(asked or key)
        super().__init__(context.session, key, name, context.limit, call, context.closed)

    def _takes(self, query: zenoh.Query) -> bool:
        """Whether a query is a call; one of many keys at once only looks around."""
        return self._expression.includes(query.key_expr)

    def _request(self, payload: bytes) -> bytes:
        if payload:
            return payload
        if self._nothing is None:
            raise CallError(f"the request of {self.name} has no payload")
        return self._nothing
