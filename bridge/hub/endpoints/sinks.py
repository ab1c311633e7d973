"""The keys of a publisher on zenoh: a sink sends a publisher's samples on one key, and may cache them."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable
from enum import Enum
from functools import partial
from typing import Any, ClassVar, Protocol

import zenoh
from typing_extensions import override

from bridge.hub.endpoints.context import EndpointContext
from bridge.hub.endpoints.latched import LatchedPublisher
from bridge.hub.endpoints.variants import CONVERTED, Convert
from bridge.hub.graph import HubGraph
from bridge.hub.lane.joining import flush_joined
from bridge.hub.opening import prepare_to_send
from bridge.hub.wire.qos import History, Qos, Reliability
from bridge.hub.zenoh_compat import BEHIND, keep_thread_state, source_infos, undeclare
from bridge.hub.zenoh_config import POOL
from bridge.messages.errors import ConversionError

KEEP_ALL_CACHE = 1000
"""Samples that a latched publisher caches if its history is unlimited."""
MAX_CACHE = 10_000

LARGE = POOL
"""Size in bytes above which a message does not fit into the shared memory, and needs hundreds of packets on a link."""

QUEUE = 1000
"""Default limit of the messages on one key that wait for a lane's reader whose buffer is full; for commands it is 1."""


_log = logging.getLogger(__name__)


class SamplePriority(Enum):
    """The zenoh priority of commands, states and streams."""

    COMMAND = zenoh.Priority.INTERACTIVE_HIGH
    STATE = zenoh.Priority.DATA_HIGH
    STREAM = zenoh.Priority.DATA


class Sink(Protocol):
    """Sends the samples of a publisher on one key."""

    keeps: ClassVar[bool]
    """Whether it caches samples for late joiners."""

    def send(self, payload: bytes, attachment: bytes) -> bool:
        """Send a sample; raises `zenoh.ZError` if the session is closed.

        False: no other session subscribes to the key, until the graph has a new epoch or the sink reports a match.
        """

    def matched(self) -> bool:
        """Return whether another session subscribes to the key."""

    def close(self) -> None: ...


def _matching(publisher: zenoh.Publisher) -> bool:
    # an object that is always truthy, although the wheel's stubs declare a bool
    status: Any = publisher.matching_status
    return bool(status.matching)


class Matching:
    """Whether another session subscribes to a publisher's key.

    A put without a subscriber costs a worker 14 us, and a query of the matching status 7 us, mostly because the memory
    that they use is no longer in the processor's caches. So a listener follows the changes. The listener may be late:
    in 1 case of 100, zenoh called it only after queries that the new subscriber sent after its declaration had been
    answered. The status is as recent as zenoh's routes. So if the listener reports no subscriber, the status is queried
    too: in `now` always, and in `reaches` once after each change of the graph, because the token that announces a
    subscriber follows its declaration.
    """

    def __init__(self, publisher: zenoh.Publisher, graph: HubGraph, matched: Callable[[], None]) -> None:
        self._publisher, self._graph, self._matched = publisher, graph, matched
        self._listener: Any = None
        self._reported: dict[str, bool] = {}
        self._absent: int | None = None
        """The graph's epoch in which a query found no subscriber."""

    def reaches(self) -> bool:
        """Return whether a put might reach a subscriber; not safe for two threads at once."""
        epoch = self._graph.epoch.value
        if self._absent == epoch and not self._reported[""]:
            return False
        if self.now():
            return True
        self._absent = epoch
        return False

    def now(self) -> bool:
        """Return whether a put would reach a subscriber now or a moment ago; not safe for two threads at once."""
        if self._listener is None:
            self._listener = self._publisher.declare_matching_listener(
                zenoh.handlers.Callback(self._on_changed, indirect=False)
            )
            # atomic in CPython, so that this older state does not replace a change reported meanwhile
            self._reported.setdefault("", _matching(self._publisher))
        if self._reported[""]:
            return True
        if _matching(self._publisher):
            self._absent = None
            self._matched()
            return True
        return False

    def _on_changed(self, status: Any) -> None:
        """Store a reported change; runs on a zenoh thread."""
        keep_thread_state()
        self._reported[""] = bool(status.matching)
        self._matched()

    def close(self) -> None:
        if self._listener is not None:
            undeclare(self._listener)


class _Version:
    """Converts messages to the version of the type that one key stands for."""

    def __init__(self, key: str, convert: Convert) -> None:
        self._key, self._convert = key, convert
        self._level = logging.WARNING

    def __call__(self, payload: bytes) -> bytes | None:
        """Return the converted message; None if the version cannot represent a value, which is logged once."""
        try:
            return self._convert(payload)
        except ConversionError as err:
            text = "%s: a message is not published in another version of its type: %s; further messages are not logged"
            _log.log(self._level, text, self._key, err)
            self._level = logging.DEBUG
            return None


class PlainSink(Sink):
    """A volatile publisher, which caches nothing."""

    keeps: ClassVar[bool] = False

    def __init__(
        self,
        context: EndpointContext,
        key: str,
        options: PublisherOptions,
        convert: Convert | None = None,
        encoding: zenoh.Encoding | None = None,
        matched: Callable[[], None] = lambda: None,
    ) -> None:
        self._convert = None if convert is None else _Version(key, convert)
        self._declare = partial(
            context.session.declare_publisher,
            key,
            allowed_destination=context.reach,
            encoding=encoding or _encoding(convert),
        )
        self._publisher = self._declare(
            congestion_control=options.congestion, priority=options.priority, express=options.express
        )
        self._large: zenoh.Publisher | None = None
        self._matching = Matching(self._publisher, context.graph, matched)
        self._blocks = options.congestion is zenoh.CongestionControl.BLOCK
        self._put = self._publisher.put
        # the large publisher continues the count under the same id, so that subscribers see one source without gaps
        self._infos = source_infos(self._publisher)

    @override
    def send(self, payload: bytes, attachment: bytes) -> bool:
        if self._blocks:
            flush_joined()
        if not self._matching.reaches():
            return False
        if self._convert is not None:
            converted = self._convert(payload)
            if converted is None:
                return True
            payload = converted
        if len(payload) > LARGE and self._large is None and not self._blocks:
            # later messages use this publisher too, so that none overtakes the large message
            self._large = self._declare(congestion_control=zenoh.CongestionControl.DROP, priority=BEHIND)
            self._put = self._large.put
        prepare_to_send(len(payload))
        self._put(payload, attachment=attachment, source_info=next(self._infos))
        return True

    @override
    def matched(self) -> bool:
        return self._matching.now()

    @override
    def close(self) -> None:
        self._matching.close()
        for publisher in (self._publisher, self._large):
            if publisher is not None:
                undeclare(publisher)


class LatchedSink(Sink):
    """A transient-local publisher, which caches its last samples for late joiners."""

    keeps: ClassVar[bool] = True

    def __init__(
        self,
        context: EndpointContext,
        key: str,
        options: PublisherOptions,
        qos: Qos,
        convert: Convert | None = None,
        encoding: zenoh.Encoding | None = None,
    ) -> None:
        self._convert = None if convert is None else _Version(key, convert)
        reliable = qos.reliability is Reliability.RELIABLE
        depth = cache_depth(qos)
        # zenoh's buffers, which its cache shares; they are published on keys that are added later
        self.stored: deque[tuple[zenoh.ZBytes, bytes]] = deque(maxlen=depth)
        self._publisher = LatchedPublisher(
            context.session,
            key,
            depth,
            context.delays if reliable else None,
            reach=context.reach,
            congestion=options.congestion,
            priority=options.priority,
            express=options.express,
            encoding=encoding or _encoding(convert),
        )
        # the wheel's AdvancedPublisher does not show whether it is matched
        self._shadow = context.session.declare_publisher(key, allowed_destination=context.reach)

    @override
    def send(self, payload: bytes, attachment: bytes) -> bool:
        self._send(zenoh.ZBytes(payload), attachment)
        return True

    def _send(self, payload: zenoh.ZBytes, attachment: bytes) -> None:
        self.stored.append((payload, attachment))
        if self._convert is not None:
            converted = self._convert(payload.to_bytes())
            if converted is None:
                return
            payload = zenoh.ZBytes(converted)
        self._publisher.put(payload, attachment)

    def restore(self, samples: Iterable[tuple[zenoh.ZBytes, bytes]]) -> None:
        """Publish and cache the samples of another sink."""
        for payload, attachment in samples:
            self._send(payload, attachment)

    @override
    def matched(self) -> bool:
        return _matching(self._shadow)

    @override
    def close(self) -> None:
        undeclare(self._shadow)
        self._publisher.close()


def _encoding(convert: Convert | None) -> zenoh.Encoding | None:
    return None if convert is None else CONVERTED


class PublisherOptions:
    """How zenoh transports a publisher's samples.

    As in rmw_zenoh, samples are dropped on a congested link, and only RELIABLE with KEEP_ALL blocks, because one slow
    peer must not delay the others. A reliable latched subscription recovers dropped samples from the publisher's cache.
    """

    def __init__(self, qos: Qos, priority: str, express: bool | None, queue: int | None = None) -> None:
        self.blocks = qos.reliability is Reliability.RELIABLE and qos.history is History.KEEP_ALL
        self.congestion = zenoh.CongestionControl.BLOCK if self.blocks else zenoh.CongestionControl.DROP
        self.priority: zenoh.Priority = SamplePriority[priority.upper()].value
        self.express = self.priority == SamplePriority.COMMAND.value if express is None else express
        self.queue = queue or (1 if self.priority == SamplePriority.COMMAND.value else QUEUE)


def cache_depth(qos: Qos) -> int:
    """Return how many samples a latched publisher with this QoS caches, and a latched subscription requests."""
    return KEEP_ALL_CACHE if qos.history is History.KEEP_ALL else min(max(qos.depth, 1), MAX_CACHE)
