"""Republishes the messages of other sessions under another hash of their type."""

from __future__ import annotations

import contextlib

import zenoh

from bridge.hub.endpoints.context import EndpointContext
from bridge.hub.endpoints.sinks import LatchedSink, PlainSink, PublisherOptions
from bridge.hub.endpoints.subscription import HubSample, PublisherState
from bridge.hub.endpoints.variants import RELAYED, Convert
from bridge.hub.wire.keys import pack_attachment
from bridge.hub.wire.qos import Qos


class RelayPublisher:
    """Publishes relayed messages on one key; created by `bridge.hub.node.Hub.relay_publisher`.

    The messages keep the numbers, times and GIDs of their publishers, so that it needs no token. If it is latched, it
    publishes the messages of one publisher only, each once, and caches them like that publisher. Not thread-safe.
    """

    def __init__(
        self, context: EndpointContext, key: str, qos: Qos, options: PublisherOptions, convert: Convert | None
    ) -> None:
        self._sink = (
            LatchedSink(context, key, options, qos, convert, RELAYED)
            if qos.latched
            else PlainSink(context, key, options, convert, RELAYED)
        )
        self._latched = qos.latched
        self._published: tuple[bytes, PublisherState] | None = None

    def put(self, sample: HubSample, payload: bytes) -> None:
        """Publish a received message; ``payload`` is its content, which is converted if necessary."""
        if self._latched and self._was_published(sample):
            return
        with contextlib.suppress(zenoh.ZError, AttributeError):  # it is being closed
            self._sink.send(payload, pack_attachment(sample.sequence, sample.source_time_ns, sample.gid))

    def _was_published(self, sample: HubSample) -> bool:
        """Return whether a latched message was published here before: another of its publishers here requested it."""
        if self._published is None or self._published[0] != sample.gid:
            self._published = sample.gid, PublisherState(sample.zid)
        return self._published[1].accept(sample) is None

    def close(self) -> None:
        """Stop publishing, and drop the cached messages."""
        self._sink.close()
