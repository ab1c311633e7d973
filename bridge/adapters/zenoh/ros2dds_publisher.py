"""A publisher in the ros2dds dialect."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from typing import Protocol

import zenoh
from zenoh import ext

from bridge.adapters.zenoh.sink import PlainSink, priority
from bridge.hub.qos import Qos


class _Sink(Protocol):
    def put(self, payload: bytes) -> None: ...
    def close(self) -> None: ...


class _LatchedSink:
    """zenoh's advanced publisher: keeps the last samples and gives them to late joiners, as the plugin's own do.

    Sample miss detection has zenoh put our session's id on each sample, and tells several publishers of one key apart.
    """

    def __init__(self, session: zenoh.Session, key: str, qos: Qos) -> None:
        self._publisher = ext.declare_advanced_publisher(
            session,
            key,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=priority(qos),
            allowed_destination=zenoh.Locality.REMOTE,
            cache=ext.CacheConfig(max(qos.depth, 1)),
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5),
            publisher_detection=True,
        )

    def put(self, payload: bytes) -> None:
        with contextlib.suppress(zenoh.ZError):  # the session is being closed
            self._publisher.put(payload)

    def close(self) -> None:
        del self._publisher  # not `undeclare`: see `bridge.hub.publisher`


class Ros2ddsPublisher:
    """Publishes what comes from the hub; latched: an advanced publisher for each source, which goes with it."""

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        qos: Qos,
        withdraw: Callable[[], None],
        closed: Callable[[Ros2ddsPublisher], None],
    ) -> None:
        self._session, self._key, self._qos = session, key, qos
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
        make = _LatchedSink if self._qos.latched else PlainSink
        return make(self._session, self._key, self._qos)

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
