"""Calling a service of a foreign dialect."""

from __future__ import annotations

from collections.abc import Callable

import zenoh

from bridge.hub.errands import Errands
from bridge.hub.queries import Queries


class KeyCaller(Queries):
    """Calls the servers of one key as the plugins do: of several all are asked, and the first reply counts.

    Args:
        session: the dialect's session.
        key: key expression of the service.
        name: the service's, for people.
        limit: bytes of a request or a reply at most.
        errands: where what may wait for zenoh is done.
        withdraw: takes back what tells others that we call the service.
        closed: called once when it is closed.
        attached: gives the attachment of the request with this number.
        encoding: of the requests.
    """

    where = "this zenoh network"

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        name: str,
        limit: int,
        errands: Errands,
        withdraw: Callable[[], None],
        closed: Callable[[KeyCaller], None],
        attached: Callable[[int], bytes | None] = lambda _number: None,
        encoding: zenoh.Encoding | None = None,
    ) -> None:
        self._withdraw, self._on_closed, self._attach = withdraw, closed, attached
        self.encoding = encoding
        super().__init__(session, key, name, limit, errands, None, zenoh.QueryTarget.BEST_MATCHING)

    def attached(self, number: int) -> bytes | None:
        """See `Queries.attached`."""
        return self._attach(number)

    def closing(self) -> None:
        """See `Queries.closing`."""
        self._withdraw()

    def close(self) -> None:
        """See `EdgeCaller.close`."""
        if self.end():
            self._on_closed(self)
