"""Hearing one key of a foreign dialect."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import zenoh

from bridge.adapters.zenoh.inbox import Inbox
from bridge.adapters.zenoh.mark import is_marked, sender, time_ns


class KeySubscription:
    """Delivers what native programs put on a key; what any Midspan put there is passed over.

    Args:
        session: the dialect's session.
        key: key expression.
        inbox: where messages go.
        source_of: the id of the endpoint that a native sample is from, "" where it is nobody's that counts here.
        closed: called once when it is closed.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        inbox: Inbox,
        source_of: Callable[[zenoh.Sample], str],
        closed: Callable[[KeySubscription], None],
    ) -> None:
        self.key = key
        self._session, self._inbox, self._source_of, self._on_closed = session, inbox, source_of, closed
        self._open = True
        self._subscriber: zenoh.Subscriber[None] = session.declare_subscriber(
            key,
            zenoh.handlers.Callback(self._on_sample, indirect=False),
            allowed_origin=zenoh.Locality.REMOTE,
        )

    @property
    def lost(self) -> int:
        """Messages that found the queue full."""
        return self._inbox.lost

    def close(self) -> None:
        """Stop delivering. Safe to call twice."""
        opened, self._open = self._open, False
        if opened:
            with contextlib.suppress(zenoh.ZError):
                self._subscriber.undeclare()  # type: ignore[no-untyped-call]
            self._inbox.close()
            self._on_closed(self)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        source = self.native(sample)
        if source:
            self.take(sample, source)

    def native(self, sample: zenoh.Sample) -> str:
        """The endpoint that a sample is from; "" where it is to be passed over."""
        if not self._open or sample.kind != zenoh.SampleKind.PUT or is_marked(sender(sample)):
            return ""
        return self._source_of(sample)

    def take(self, sample: zenoh.Sample, source: str) -> None:
        """A native message came."""
        self._inbox.add(sample.payload, source, time_ns(sample))
