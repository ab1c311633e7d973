"""A publisher on the hub."""

from __future__ import annotations

import logging
import time
from functools import partial
from threading import Lock

import zenoh

from bridge.hub.endpoints.context import EndpointContext
from bridge.hub.endpoints.sinks import LatchedSink, PlainSink, PublisherOptions, SamplePriority, Sink
from bridge.hub.endpoints.variants import Variants
from bridge.hub.errors import HubClosedError, HubError, zenoh_reason
from bridge.hub.graph.tokens import gid_of
from bridge.hub.lane.blocks import Blocks, StoredMessage
from bridge.hub.lane.joining import MAX_LINKS
from bridge.hub.lane.numbering import Sender
from bridge.hub.lane.outlet import Outlet
from bridge.hub.lane.wire import BOUND
from bridge.hub.lane.writer import LaneWriter
from bridge.hub.wire.keys import ATTACHMENT, GID_SIZE, key_type, key_variant
from bridge.hub.wire.qos import Qos
from bridge.messages.unchanged import same
from bridge.resources import LARGE_MESSAGES

_log = logging.getLogger(__name__)
_pack = ATTACHMENT.pack

NO_LANE = "this worker has no lane"


class HubPublisher:
    """Publishes one topic on the hub; created by `bridge.hub.node.Hub.publisher`. Safe to use from any thread.

    Each sample is published with the same number on all of the publisher's keys (`bridge.hub.endpoints.variants`), so
    that a subscription that receives it on two of them delivers it only once.

    Attributes:
        gid: the 16 bytes that identify the publisher in its samples.
        sender: numbers the samples. While it is ``direct`` and not ``busy``, routes may send by it instead of `put`.
    """

    def __init__(
        self,
        context: EndpointContext,
        token: str,
        key: str,
        topic: str,
        qos: Qos,
        options: PublisherOptions,
    ) -> None:
        self.topic, self.key = topic, key
        self.gid = gid_of(token)
        self._command, self._queue = options.priority == SamplePriority.COMMAND.value, options.queue
        self._outlets: tuple[Outlet, ...] = ()
        self._writer: LaneWriter | None = None
        self._why = NO_LANE
        self._limit, self._on_close = context.limit, context.closed
        self._lock = Lock()
        self._graph = context.graph
        self.sender = Sender(self.gid, context.graph.epoch)
        self._plain = partial(PlainSink, context, options=options, matched=self.sender.match)
        self._stored: LatchedSink | None = None
        if qos.latched:
            self._latched = partial(LatchedSink, context, options=options, qos=qos)
            self._base: Sink = (stored := self._latched(key))
            self._stored = stored
            self._why = "messages are stored for late joiners"
        else:
            self._base = self._plain(key)
            if context.lane is not None and not options.blocks:
                self._writer = context.lane.writer
                self._why = context.lane.why
        self._more: dict[str, Sink] = {}  # by type hash
        self._sinks: tuple[Sink, ...] = (self._base,)
        """The sinks of all keys; empty once the publisher is closed."""
        # register with the variants and the lane before the token announces the publisher
        self._variants = context.variants
        self._variants.add(self, token)
        if self._writer is not None:
            self._writer.add(self)
        self._withdraw = context.graph.announce(token)
        with self._lock:
            self._set_direct()

    @property
    def by_lane(self) -> int:
        """Number of messages sent on at least one lane."""
        return self.sender.by_lane

    def blocks(self) -> Blocks | None:
        """Return where to write a large message before it is `put`, instead of in bytes; None if that is no use.

        It saves a copy if all subscriptions are on lanes.
        """
        lanes_only = self._outlets and not self._command and self.sender.is_quiet()
        return self._writer.blocks if lanes_only and self._writer is not None else None

    def put(self, payload: bytes | StoredMessage, source_time_ns: int | None = None) -> None:
        """Publish CDR bytes, which begin with the encapsulation header.

        ``payload`` may be a large message in one of `blocks`, which the caller still releases.
        ``source_time_ns`` is the message's source timestamp (system time), by default now. Raises `HubClosedError` if
        the publisher or its session is closed, and `HubError` if the message is larger than the hub's limit.
        """
        size = len(payload)
        if size > self._limit:
            raise HubError(f"message of {size} bytes on {self.topic}: the hub's limit is {self._limit}")
        LARGE_MESSAGES.passed(size)
        if source_time_ns is None:
            source_time_ns = time.time_ns()
        sender = self.sender
        # the lock is held while sending, so that the numbers arrive in order
        with self._lock:
            if not self._sinks:
                raise HubClosedError(f"publisher of {self.topic} is closed")
            sender.busy = True
            try:
                attachment = _pack(sender.next(), source_time_ns, GID_SIZE, self.gid)
                if self._outlets:
                    self._send_on_lanes(payload, attachment)
                if not sender.is_quiet():
                    self._send_on_keys(payload, attachment)
            finally:
                sender.busy = False

    def _send_on_lanes(self, payload: bytes | StoredMessage, attachment: bytes) -> None:
        self.sender.by_lane += 1
        if isinstance(payload, StoredMessage):
            self._lend(payload, attachment)
        elif len(payload) > BOUND and (stored := self._stored_message(payload)) is not None:
            with stored:
                self._lend(stored, attachment)
        else:
            for outlet in self._outlets:
                outlet.send(attachment, payload)

    def _stored_message(self, payload: bytes) -> StoredMessage | None:
        return None if self._writer is None else self._writer.blocks.store(payload)

    def _lend(self, stored: StoredMessage, attachment: bytes) -> None:
        for outlet in self._outlets:
            outlet.lend(attachment, stored)

    def _send_on_keys(self, payload: bytes | StoredMessage, attachment: bytes) -> None:
        matches, epoch, reached = self.sender.matches, self._graph.epoch.value, False
        if isinstance(payload, StoredMessage):  # a subscription has just appeared
            payload = payload.to_bytes()
        try:
            for sink in self._sinks:
                if sink.send(payload, attachment):
                    reached = True
        except zenoh.ZError as err:
            raise HubClosedError(f"cannot publish on {self.topic}: {zenoh_reason(err)}") from None
        if not reached:
            self.sender.rest(epoch, matches)

    def pass_over(self) -> bool:
        """Count a message without encoding it, if no subscription exists; return False if it has to be `put`.

        Nothing receives the messages of a volatile publisher without subscriptions. Later subscriptions see the same
        sequence numbers as if the message had been put. Raises `HubClosedError` if the publisher is closed.
        """
        with self._lock:
            if not self._sinks:
                raise HubClosedError(f"publisher of {self.topic} is closed")
            if self._outlets or self._stored is not None or self._any_matched():
                return False
            self.sender.next()
            return True

    def matched(self) -> bool:
        """Return whether any subscription exists, in another session or on another node of a shared session."""
        with self._lock:
            return bool(self._sinks) and (bool(self._outlets) or self._any_matched())

    def _any_matched(self) -> bool:
        # called for each message; a generator would cost several times as much for one sink
        for sink in self._sinks:  # noqa: SIM110
            if sink.matched():
                return True
        return False

    def way(self) -> tuple[str, str]:
        """Return the current transport, and the reason for zenoh if it is used or the publisher cannot use the lane.

        The transport is ``lane``, ``zenoh``, ``both``, or "" if no subscription exists.
        """
        with self._lock:
            lane = bool(self._outlets)
            other = self._any_matched()
        if lane or self._writer is not None:
            return {(True, False): "lane", (True, True): "both", (False, True): "zenoh"}.get((lane, other), ""), (
                "a subscription is not on the lane" if other else ""
            )
        return ("zenoh" if other else ""), self._why

    def attach(self, outlet: Outlet) -> None:
        """Send the number of the last message on a lane, and from now on all messages."""
        with self._lock:
            outlet.command = outlet.command or self._command
            outlet.depth = max(outlet.depth, self._queue)
            if outlet not in self._outlets:
                self._outlets += (outlet,)
            self.sender.direct = False
            outlet.mark(self.gid, self.sender.sequence)
            self._set_direct()

    def detach(self, outlet: Outlet) -> None:
        """Stop sending on a lane."""
        with self._lock:
            self._outlets = tuple(other for other in self._outlets if other is not outlet)
            self._set_direct()

    def _set_direct(self) -> None:
        """Let routes send by the lanes of all readers.

        Not if there are too many, or if the messages are commands, or stored for late joiners.
        """
        links = [(outlet.link.fast, outlet.number) for outlet in self._outlets if not outlet.command]
        known = tuple((link, number) for link, number in links if link is not None)
        plain = self._stored is None and not self._command and len(known) == len(self._outlets) <= MAX_LINKS
        self.sender.direct = False
        self.sender.send_to(known if plain else ())
        self.sender.direct = plain and bool(self._sinks)

    def follow_variants(self, variants: Variants) -> None:
        """Publish also under the other hashes that subscriptions announce, with the cached samples for latched ones."""
        for type_hash, latched in variants.items():
            latched = latched and self._stored is not None
            sink = self._more.get(type_hash)
            if sink is None or (latched and not sink.keeps):
                key, known = key_variant(self.key, type_hash), self._variants.converter(*key_type(self.key), type_hash)
                convert = None if known is same else known
                self._replace(
                    type_hash, self._latched(key, convert=convert) if latched else self._plain(key, convert=convert)
                )
        for type_hash in self._more.keys() - variants.keys():
            self._replace(type_hash, None)

    def _replace(self, type_hash: str, sink: Sink | None) -> None:
        stored = None if self._stored is None else self._stored.stored
        restored: set[bytes] = set()
        if stored is not None and isinstance(sink, LatchedSink):
            # restore most samples without the lock: a congested link must not delay the messages on the other keys
            with self._lock:
                samples = tuple(stored)
            restored.update(attachment for _, attachment in samples)
            sink.restore(samples)
        with self._lock:
            closed = not self._sinks
            before = self._more.pop(type_hash, None)
            if sink is not None and not closed:
                if stored is not None and isinstance(sink, LatchedSink):
                    sink.restore(sample for sample in stored if sample[1] not in restored)
                self._more[type_hash] = sink
            if not closed:
                self._sinks = (self._base, *self._more.values())
                self.sender.match()
        if before is not None:
            before.close()
        if sink is not None and closed:
            sink.close()

    def close(self) -> None:
        """Leave the graph and drop the cached samples. Safe to call twice."""
        with self._lock:
            sinks, self._sinks = self._sinks, ()
            self._more.clear()
            self._outlets = ()
            self._set_direct()
        if sinks:
            self._variants.remove(self)
            if self._writer is not None:
                self._writer.remove(self)
            for sink in sinks:
                sink.close()
            self._withdraw()  # last: a publisher that has left the graph sends late joiners nothing
            self._on_close(self)
