"""A publisher in the ros2dds dialect."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from typing import Protocol

import zenoh

from bridge.adapters.zenoh.sink import PlainSink, priority
from bridge.hub.latched import Heartbeats, LatchedPublisher
from bridge.hub.qos import Qos


class _Sink(Protocol):
    def put(self, payload: bytes) -> None: ...
    def close(self) -> None: ...


class _LatchedSink:
    """Keeps the last samples and gives them to late joiners, as the plugin's own publishers do."""

    def __init__(self, session: zenoh.Session, key: str, qos: Qos, heartbeats: Heartbeats) -> None:
        depth, congestion = max(qos.depth, 1), zenoh.CongestionControl.DROP
        self._publisher = LatchedPublisher(
            session, key, depth, heartbeats, congestion=congestion, priority=priority(qos)
        )

    def put(self, payload: bytes) -> None:
        with contextlib.suppress(zenoh.ZError):  # the session is being closed
            self._publisher.put(payload)

    def close(self) -> None:
        self._publisher.close()


class Ros2ddsPublisher:
    """Publishes what comes from the hub; latched: an advanced publisher for each source, which goes with it."""

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        qos: Qos,
        heartbeats: Heartbeats,
        withdraw: Callable[[], None],
        closed: Callable[[Ros2ddsPublisher], None],
    ) -> None:
        self._session, self._key, self._qos, self._heartbeats = session, key, qos, heartbeats
        self._withdraw, self._closed = withdraw, closed
        self._lock = threading.Lock()
        self._open = True
        self._sinks: dict[str, _Sink] = {}

    @property
    def dropped(self) -> int:
        """Nothing: zenoh does not tell what a congested link dropped."""
        return 0

    def send(self, payload: bytes, source: str) -> None:
        """See `EdgePublisher.send`."""
        name = source if self._qos.latched else ""
        with self._lock:
            if not self._open:
                return
            sink = self._sinks.get(name)
            if sink is None:
                sink = self._sinks[name] = self._make()
            sink.put(payload)

    def _make(self) -> _Sink:
        if self._qos.latched:
            return _LatchedSink(self._session, self._key, self._qos, self._heartbeats)
        return PlainSink(self._session, self._key, self._qos)

    def forget(self, source: str) -> None:
        """See `EdgePublisher.forget`."""
        with self._lock:
            sink = self._sinks.pop(source, None) if self._qos.latched else None
        if sink is not None:
            sink.close()

    def close(self) -> None:
        """Give the publishers back. Safe to call twice."""
        with self._lock:
            opened, self._open = self._open, False
            sinks, self._sinks = list(self._sinks.values()), {}
        if opened:
            self._withdraw()
            for sink in sinks:
                sink.close()
            self._closed(self)
