"""A subscription that receives over the lanes of this daemon's other workers if it can, and else over zenoh.

It chooses the transport per topic: while all of the topic's publishers are workers of this daemon, it has no subscriber
on zenoh, so that their puts cost little. During a switch, messages arrive over both transports. The subscription then
uses rmw_zenoh's sequence numbers to drop duplicates, and briefly holds messages that arrive too early.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from threading import Lock

import zenoh
from typing_extensions import override

from bridge.hub.endpoints.context import EndpointContext
from bridge.hub.endpoints.lane_state import Lanes, LeavingStep, ZenohSubscriber
from bridge.hub.endpoints.subscription import (
    HubSample,
    HubSubscription,
    Losses,
    PublisherState,
    PublisherStates,
    Refused,
)
from bridge.hub.endpoints.variants import ConvertedSample
from bridge.hub.graph import HubEndpoint
from bridge.hub.lane.inlet import Inlet
from bridge.hub.lane.lane import Lane
from bridge.hub.lane.lent import LentPayload
from bridge.hub.lane.numbering import Receiver
from bridge.hub.wire.keys import ANY_HASH, key_type
from bridge.hub.wire.qos import History, Qos

EARLY_SECONDS = 0.1
"""Seconds for which a message is held until earlier messages arrive on the other transport."""

LEAVING_SECONDS = 5.0
"""The same limit while a lane is being left, because the lane still delivers all earlier messages, then the fence."""

_UNANSWERED_SECONDS = 1.0


class Sequencer:
    """Merges the messages of a topic that arrive over two transports, according to their sequence numbers.

    Duplicates are dropped, and a message that arrives early is held for a moment. Not thread-safe: the lock of the
    subscription guards it and its arguments.

    Args:
        both: returns whether the messages of a publisher (by GID) may arrive over either transport.
        leaves: returns whether the lane of a publisher is being left.

    Attributes:
        early: by publisher, the time since which messages are held (monotonic seconds).
    """

    def __init__(
        self, sources: PublisherStates, losses: Losses, both: Callable[[bytes], bool], leaves: Callable[[bytes], bool]
    ) -> None:
        self._sources, self._losses = sources, losses
        self._both, self._leaves = both, leaves
        self.early: dict[bytes, float] = {}

    def accept(self, source: PublisherState, message: HubSample, first: int) -> list[HubSample]:
        """Return the messages to deliver now; messages up to number ``first`` may arrive over the other transport."""
        number, last = message.sequence, source.sequence
        if last is not None and number == last + 1 and not source.held:
            source.sequence, source.time_ns = number, message.source_time_ns
            return [message]
        if not source.paired:
            gap = source.accept(message)
            if gap:
                self._losses.add(gap, message)
            return [] if gap is None else [message]
        if number in source.held:  # both transports have reached this number, so no earlier message can still arrive
            return self._up_to(source, message.gid, number)
        if last is not None and number <= last:
            return []
        early = number > last + 1 if last is not None else first > 0
        if early and self._both(message.gid) and self._sources.hold(source, message):
            self.early.setdefault(message.gid, time.monotonic())
            return []
        if not source.held:
            return self._deliverable(source, message)
        self._sources.hold_anyway(source, message)
        return self._up_to(source, message.gid, number)

    def _up_to(self, source: PublisherState, gid: bytes, number: int) -> list[HubSample]:
        """Return the held messages up to a number, and those that follow it without a gap."""
        ready: list[HubSample] = []
        for held in sorted(source.held):
            if held > number and held != (source.sequence or 0) + 1:
                break
            ready += self._deliverable(source, self._sources.pop_held(source, held))
        if source.held:
            self.early[gid] = time.monotonic()
        else:
            self.early.pop(gid, None)
        return ready

    def _deliverable(self, source: PublisherState, message: HubSample) -> list[HubSample]:
        last = source.sequence
        if last is not None:
            if message.sequence <= last:
                return []
            if message.sequence > last + 1:
                self._losses.add(message.sequence - last - 1, message)
        source.sequence, source.time_ns = message.sequence, message.source_time_ns
        return [message]

    def _due(self, gid: bytes) -> float:
        return self.early[gid] + (LEAVING_SECONDS if self._leaves(gid) else EARLY_SECONDS)

    def due(self) -> float | None:
        """Return when to call `release` next (monotonic seconds), None while nothing is held."""
        return min(map(self._due, self.early), default=None)

    def release(self, now: float) -> list[HubSample]:
        """Return the messages that were held for the maximum time."""
        ready: list[HubSample] = []
        for gid in [gid for gid in self.early if self._due(gid) <= now]:
            source = self._sources.get(gid)
            if source is None or not source.held:  # dropped because there were too many publishers
                del self.early[gid]
            else:
                ready += self._up_to(source, gid, max(source.held))
        return ready


class LaneSubscription(HubSubscription):
    """Receives one volatile topic.

    Locks, in the order in which a thread may acquire them: ``_delivery`` is held while messages are ordered and
    delivered, so that messages of two transports are delivered in order; ``_lock`` also guards the lanes and the
    sequencer. Only the lane's thread chooses the transport.
    """

    def __init__(
        self,
        context: EndpointContext,
        lane: Lane,
        token: str,
        key: str,
        topic: str,
        qos: Qos,
        callback: Callable[[HubSample], None],
        on_refused: Refused | None = None,
        *,
        exact: bool = False,
    ) -> None:
        self.key = key
        self._lane, self._type_names = lane, key_type(key)
        # with a depth of 1, as for velocity commands, a message waits only `EARLY_SECONDS` for a lane being left
        self._patient = qos.history is not History.KEEP_LAST or qos.depth > 1
        self._delivery = Lock()
        self._lanes = Lanes()
        self._by_lane = 0
        self.receiver: Receiver | None = None
        super().__init__(context, token, key, topic, callback, on_refused, exact=exact)
        if Receiver is not None:
            locked = (self._delivery.locked, self._lock.locked)
            self.receiver = Receiver(self.sources, locked, self._reader.limit)
        self.why = "the graph is not evaluated yet"
        lane.add(self)

    @override
    def _declare(self, context: EndpointContext, key: str) -> Callable[[], None]:
        self._sequencer = Sequencer(self.sources, self._losses, self._both, self._leaves)
        self._zenoh = ZenohSubscriber(context, key, self._on_sample, self._lock)
        return self._zenoh.close

    @property
    @override
    def by_lane(self) -> int:
        return self._by_lane if self.receiver is None else self._by_lane + self.receiver.by_lane

    @override
    def hand_to(self, acceptor: object) -> None:
        if self.receiver is not None:
            self.receiver.hand_to(acceptor)

    @override
    def close(self) -> None:
        if self.receiver is not None:
            self.receiver.open = False
        self._lane.remove(self)
        super().close()
        self._leave_all()

    def _leave_all(self) -> None:
        for inlet in tuple(self._lanes.inlets):
            inlet.leave(self)

    def _both(self, gid: bytes) -> bool:
        return self._zenoh.everywhere and gid in self._lanes.joined

    def _leaves(self, gid: bytes) -> bool:
        return self._patient and self._lanes.is_leaving(gid)

    # -- messages ------------------------------------------------------------------------------------------------------

    @override
    def _on_sample(self, sample: zenoh.Sample | ConvertedSample) -> None:
        message = self._reader.read(sample)
        if message is None:
            return
        with self._delivery:
            with self._lock:
                source = self.sources.get(message.gid)
                if source is None or not source.zid:
                    source = self.sources.of(message, sample)
                message.zid = source.zid
                if self._lanes.leaving:
                    self._lanes.received.add(source.zid)
                ready = self._sequencer.accept(source, message, first=0)
                if not ready:
                    self._schedule()
            for deliverable in ready:
                self._callback(deliverable)

    def on_message(self, inlet: Inlet, attachment: tuple[int, int, bytes], payload: bytes | LentPayload) -> None:
        """Handle a message from a lane."""
        reader = self._reader
        if reader.closed:
            return
        sequence, time_ns, gid = attachment
        if len(payload) > reader.limit:
            reader.refuse("large", f"message of {len(payload)} bytes, the limit is {reader.limit}")
            return
        message = HubSample(payload, sequence, time_ns, gid, inlet.zid)
        with self._delivery:
            with self._lock:
                source = self.sources.get(gid)
                if source is None:
                    source = self.sources.add(gid, inlet.zid)
                joined = self._lanes.joined.get(gid)
                ready = self._sequencer.accept(source, message, first=0 if joined is None else joined.mark)
                if ready:
                    self._by_lane += 1
                elif source.held.get(sequence) is message:
                    self._by_lane += 1
                    message.data()  # a message that has to wait must not occupy the sender's memory
                    self._schedule()
            for ready_message in ready:
                self._callback(ready_message)

    def _schedule(self) -> None:
        if self._sequencer.early:
            self._lane.calls.within(EARLY_SECONDS, self._release_due)

    def _release_due(self) -> None:
        """Deliver the messages that were held for the maximum time."""
        self._release(time.monotonic())
        with self._lock:
            due = self._sequencer.due()
        if due is not None:
            self._lane.calls.within(due - time.monotonic(), self._release_due)

    def _release(self, now: float) -> None:
        with self._delivery:
            if self._reader.closed:
                return
            with self._lock:
                ready = self._sequencer.release(now)
            for message in ready:
                self._callback(message)

    # -- lanes ---------------------------------------------------------------------------------------------------------

    def on_mark(self, inlet: Inlet, gid: bytes, sequence: int) -> None:
        """Handle a mark: the publisher sends all messages after this number on the lane."""
        with self._lock:
            self._lanes.mark(inlet, gid, sequence)
            source = self.sources.get(gid)
            if source is None:
                source = self.sources.add(gid, inlet.zid)
            source.paired = True
        self._lane.wake(self)

    def on_fence(self, inlet: Inlet) -> None:
        """Handle a returned fence: the lane that is being left has delivered everything."""
        with self._lock:
            self._lanes.on_fence(inlet)
        self._lane.wake(self)

    def on_disconnected(self, inlet: Inlet) -> None:
        """Handle the end of a connection."""
        if inlet in self._lanes.inlets:
            self._drop(inlet)
            self._lane.wake(self)

    def _drop(self, inlet: Inlet) -> None:
        with self._lock:
            self._lanes.drop(inlet)
        self._release(math.inf)

    # -- the choice ----------------------------------------------------------------------------------------------------

    def settle(self) -> bool:
        """Continue the switch to the wanted transport; return whether to check again soon."""
        if self._reader.closed:
            return False
        for inlet in [inlet for inlet in tuple(self._lanes.inlets) if not inlet.alive]:
            self._drop(inlet)
        publishers = self._publishers()
        reason = self._why_zenoh(publishers)
        inlets: set[Inlet] = set()
        if not reason:
            for zid in {publisher.zid for publisher in publishers}:
                connection = self._lane.connections.inlet(zid)
                if isinstance(connection, str):
                    node = next(publisher.node for publisher in publishers if publisher.zid == zid)
                    reason = f"{node}: {connection}"
                    break
                inlets.add(connection)
        again = self._to_zenoh(reason) if reason else self._to_lane(publishers, inlets)
        if self._reader.closed:  # meanwhile; `close` has left only the lanes that were joined before
            self._leave_all()
            return False
        return again

    @property
    def settled(self) -> bool:
        """Whether messages arrive over only one transport."""
        return not self._zenoh.everywhere if self.way == "lane" else not self._lanes.inlets

    def _publishers(self) -> list[HubEndpoint]:
        """Return the topic's publishers of the same type in other sessions."""
        type_name, type_hash = self._type_names
        return [
            endpoint
            for endpoint in self._graph.publishers(self.topic)
            if endpoint.type_name == type_name and type_hash in (ANY_HASH, endpoint.type_hash) and not endpoint.own
        ]

    def _why_zenoh(self, publishers: list[HubEndpoint]) -> str:
        if not publishers:
            return "no other worker publishes it"
        for publisher in publishers:
            if publisher.qos.latched:
                return f"{publisher.node} stores messages for late joiners"
            if publisher.qos.history is History.KEEP_ALL:
                return f"{publisher.node} has the history keep_all"
        return ""

    def _to_lane(self, publishers: list[HubEndpoint], inlets: set[Inlet]) -> bool:
        now, lanes = time.monotonic(), self._lanes
        with self._lock:
            lanes.leaving.clear()
            lanes.prune({publisher.gid for publisher in publishers})
        for inlet in inlets - lanes.inlets.keys():
            lanes.inlets[inlet] = now
            inlet.join(self)
        with self._lock:
            missing = [publisher for publisher in publishers if not self._has_caught_up(publisher.gid, now)]
        if not missing:
            self._zenoh.listen(everywhere=False)
            self.way, self.why = "lane", ""
            return False
        self._zenoh.listen(everywhere=True)
        self.way, self.why = "zenoh", "switching to the lane"
        for publisher in missing:
            late = next(inlet for inlet in inlets if inlet.zid == publisher.zid)
            if not late.answered and now - late.since > _UNANSWERED_SECONDS:
                self._lane.connections.refuse(late, "it does not respond on its lane")
            elif publisher.gid not in lanes.joined and now - lanes.inlets.get(late, now) > _UNANSWERED_SECONDS:
                lanes.inlets[late] = now
                late.join(self)  # again, to receive another mark
        return True

    def _has_caught_up(self, gid: bytes, now: float) -> bool:
        source = self.sources.get(gid)
        last = None if source is None else source.sequence
        return self._lanes.has_caught_up(gid, last, now, self._lane.barriers.has_passed)

    def _to_zenoh(self, why: str) -> bool:
        self._zenoh.listen(everywhere=True)
        self.way, self.why = "zenoh", why
        now, lanes = time.monotonic(), self._lanes
        for inlet in tuple(lanes.inlets):
            with self._lock:
                step = lanes.leave(inlet)
            if step is LeavingStep.ENDED:
                inlet.leave(self)
                self._drop(inlet)
            elif step is LeavingStep.DECLARED:
                if self._lane.barriers.has_passed(inlet.zid, self._zenoh.declared):
                    with self._lock:
                        lanes.on_subscriber_known(inlet, now)
            else:
                with self._lock:
                    fence = lanes.start_fence(inlet, now)
                if fence:
                    inlet.fence(self)
        return bool(lanes.inlets)
