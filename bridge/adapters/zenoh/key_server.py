"""Serving a service in a foreign dialect."""

from __future__ import annotations

from collections.abc import Callable

import zenoh

from bridge.hub.answers import Answers
from bridge.hub.call import Call, CallError


class KeyServer(Answers):
    """Serves one key. zenoh tells no server that its caller is gone: the call goes on, and its reply gets lost.

    Args:
        session: the dialect's session.
        key: key expression of the service.
        name: the service's, for people.
        limit: bytes of a request or a reply at most.
        call: gets each request.
        withdraw: takes back what tells others of the service.
        closed: called once when it is closed.
        nothing: the request that a query without payload stands for, None where the service's has fields.
        encoding: of the replies.
        asked: expression of the keys whose queries are calls, ``key`` itself where it is "".
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        name: str,
        limit: int,
        call: Call,
        withdraw: Callable[[], None],
        closed: Callable[[KeyServer], None],
        nothing: bytes | None,
        encoding: zenoh.Encoding | None = None,
        asked: str = "",
    ) -> None:
        self._withdraw, self._on_closed, self._nothing = withdraw, closed, nothing
        self._expression = zenoh.KeyExpr(asked or key)
        self.encoding = encoding
        super().__init__(session, key, name, limit, call)

    def takes(self, query: zenoh.Query) -> bool:
        """A query of many keys at once, as of those who look what is there, is no call."""
        return self._expression.includes(query.key_expr)

    def request(self, payload: bytes) -> bytes:
        """See `Answers.request`."""
        if payload:
            return payload
        if self._nothing is None:
            msg = f"the request of {self.name} has no payload"
            raise CallError(msg)
        return self._nothing

    def closing(self) -> None:
        """See `Answers.closing`."""
        self._withdraw()

    def close(self) -> None:
        """See `EdgeServer.close`."""
        if self.end():
            self._on_closed(self)
