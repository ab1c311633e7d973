"""Clients and servers on the keys of a foreign dialect."""

from __future__ import annotations

from collections.abc import Callable

import zenoh
from typing_extensions import override

from bridge.adapters.zenoh.topics import Announcement, KeyContext
from bridge.hub.endpoints.call_server import CallServer
from bridge.hub.endpoints.calls import Call, CallClient, CallError


class KeyCaller(CallClient):
    """Calls the servers of a key that zenoh selects (`BEST_MATCHING`), and uses the first reply, like the plugins.

    ``attached`` returns the attachment of a request, by its number. A server is offered on the hub as soon as its token
    is seen, which may be before zenoh has learned its queryable.
    """

    where = "this zenoh network"
    first_server = 1.0

    def __init__(
        self, context: KeyContext, key: str, name: str, announcement: Announcement,
        attached: Callable[[int], bytes | None] = lambda _number: None, encoding: zenoh.Encoding | None = None,
    ) -> None:  # fmt: skip
        self.announcement, self.encoding = announcement, encoding
        self._withdraw, self._attach = announcement.withdraw, attached
        super().__init__(
            context.session, key, name, context.limit, context.executor, context.ends, context.delays,
            zenoh.QueryTarget.BEST_MATCHING, context.closed,
        )  # fmt: skip

    @override
    def _attached(self, number: int) -> bytes | None:
        return self._attach(number)


class KeyServer(CallServer):
    """Serves one key. zenoh does not report a client's exit, so the client's call continues, and the reply is lost.

    Args:
        nothing: the request that a query without payload means; None if the service's request has fields.
        asked: expression of the keys whose queries are calls; "" means ``key``.
    """

    def __init__(
        self, context: KeyContext, key: str, name: str, call: Call, announcement: Announcement,
        nothing: bytes | None, encoding: zenoh.Encoding | None = None, asked: str = "",
    ) -> None:  # fmt: skip
        self.announcement, self.encoding = announcement, encoding
        self._withdraw, self._empty_request = announcement.withdraw, nothing
        self._expression = zenoh.KeyExpr(asked or key)
        super().__init__(context.session, key, name, context.limit, call, context.closed)

    @override
    def _is_call(self, query: zenoh.Query) -> bool:
        """Return whether a query is a call; a query with a wildcard is not, because it only explores."""
        return self._expression.includes(query.key_expr)

    @override
    def _request(self, payload: bytes) -> bytes:
        if payload:
            return payload
        if self._empty_request is None:
            raise CallError(f"the request of {self.name} has no payload")
        return self._empty_request
