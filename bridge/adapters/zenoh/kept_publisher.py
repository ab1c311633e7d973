"""A publisher on a plain key that keeps what is latched, for those who ask for it."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable

import zenoh

from bridge.adapters.kept import Kept
from bridge.adapters.zenoh.sink import PlainSink
from bridge.hub.qos import Qos


class KeptPublisher:
    """Puts what comes from the hub on a plain key, and answers a ``get`` there with what is kept.

    Args:
        session: the dialect's session.
        key: key expression.
        qos: latched or not, and how many messages of each source are kept.
        encoding: told with each sample.
        newest: whether a ``get`` is answered with the newest message alone, not with every source's.
        closed: called once when it is closed.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        qos: Qos,
        encoding: zenoh.Encoding | None,
        closed: Callable[[KeptPublisher], None],
        *,
        newest: bool = False,
    ) -> None:
        self._session, self._key, self._qos, self._encoding = session, key, qos, encoding
        self._newest, self._closed = newest, closed
        self._lock = threading.Lock()
        self._kept = Kept(qos.depth)
        self._listener: zenoh.MatchingListener[None] | None = None
        self._sink: PlainSink | None = PlainSink(session, key, qos, encoding)
        self._queryable = (
            session.declare_queryable(
                key, zenoh.handlers.Callback(self._on_query, indirect=False), allowed_origin=zenoh.Locality.REMOTE
            )
            if qos.latched
            else None
        )

    @property
    def dropped(self) -> int:
        """Nothing: zenoh does not tell what a congested link dropped."""
        return 0

    def send(self, payload: bytes, source: str) -> None:
        """See `EdgePublisher.send`."""
        with self._lock:
            if self._sink is None:
                return
            if self._qos.latched:
                self._kept.add(payload, source)
            self._sink.put(payload)

    def forget(self, source: str) -> None:
        """See `EdgePublisher.forget`."""
        with self._lock:
            self._kept.forget(source)

    def put_again(self) -> None:
        """Put what is kept once more."""
        with self._lock:
            for payload in self._kept.all():
                if self._sink is not None:
                    self._sink.put(payload)

    def close(self) -> None:
        """Give the key back. Safe to call twice."""
        with self._lock:
            sink, self._sink = self._sink, None
        if sink is not None:
            sink.close()
            if self._queryable is not None:
                with contextlib.suppress(zenoh.ZError):
                    self._queryable.undeclare()  # type: ignore[no-untyped-call]
            self._closed(self)

    def _on_query(self, query: zenoh.Query) -> None:
        with self._lock:
            kept = self._kept.all()
        with query, contextlib.suppress(zenoh.ZError):
            for payload in kept[-1:] if self._newest else kept:
                query.reply(self._key, payload, encoding=self._encoding, timestamp=self._session.new_timestamp())

    def watch(self, matched: Callable[[], None]) -> None:
        """Call ``matched`` when the key has got its first subscriber."""

        def changed(status: zenoh.MatchingStatus) -> None:
            if status.matching:
                matched()

        if self._sink is not None:
            handler = zenoh.handlers.Callback(changed, indirect=False)
            self._listener = self._sink.publisher.declare_matching_listener(handler)
