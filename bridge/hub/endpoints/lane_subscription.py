"""A subscription that receives small messages over the lanes of this daemon's other workers, otherwise over zenoh.

It chooses per topic: while all of the topic's publishers are workers of this daemon, it has no subscriber on zenoh, so
that their puts cost little. During a switch, messages arrive over both transports: by the sequence numbers of rmw_zenoh
it drops duplicates, and briefly holds messages that arrive too early.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

import zenoh
from typing_extensions import override

from bridge.hub.endpoints.publisher import EndpointContext
from bridge.hub.endpoints.subscription import HubSample, HubSubscription, PublisherState, Refused
from bridge.hub.graph import HubEndpoint
from bridge.hub.lane.inlet import Inlet
from bridge.hub.lane.lane import Lane
from bridge.hub.lane.wire import BOUND
from bridge.hub.wire.keys import ANY_HASH
from bridge.hub.wire.qos import History, Qos
from bridge.hub.zenoh_compat import subscribe, undeclare

_EARLY_SECONDS = 0.1
"""Seconds for which a message is held for earlier ones on the other transport."""

_LEAVING_SECONDS = 5.0
"""The same while a lane is being closed: it still delivers all earlier messages, and ends with its fence.

Not for a subscription of depth 1, such as those of velocity commands, which must never wait: its newest message counts.
"""

_CAUGHT_SECONDS = 1.0
"""Seconds after a mark, after which all earlier messages have arrived."""

_UNANSWERED_SECONDS = 1.0
_SPARED_MARKS = 64


@dataclass(slots=True)
class _Joined:
    """A publisher that sends all messages after ``mark`` on a lane."""

    inlet: Inlet
    mark: int
    since: float
    caught: bool = False


@dataclass(slots=True)
class _Leaving:
    """A lane that is being closed.

    ``passed`` is the time when its session knew of the subscriber on zenoh (0.0: not yet), ``fenced`` the time when the
    fence was sent, ``ended`` whether it came back.
    """

    passed: float = 0.0
    fenced: float = 0.0
    ended: bool = False


class LaneSubscription(HubSubscription):
    """Receives one topic that is not latched."""

    def __init__(
        self,
        context: EndpointContext,
        lane: Lane,
        token: str,
        key: str,
        topic: str,
        type_names: tuple[str, str],
        qos: Qos,
        callback: Callable[[HubSample], None],
        on_refused: Refused | None = None,
    ) -> None:
        self._lane = lane
        self._session, self._reach = context.session, context.reach
        self._type, self._hash = type_names
        self._newest_counts = qos.history is History.KEEP_LAST and qos.depth <= 1
        self.key = key
        self._delivery = Lock()
        self._switching = Lock()
        self._everywhere = True
        self._declared = time.monotonic()
        self._joined: dict[bytes, _Joined] = {}
        self._inlets: dict[Inlet, float] = {}
        self._leaving: dict[Inlet, _Leaving] = {}
        self._heard: set[str] = set()
        self._early: dict[bytes, float] = {}
        self._large = 0
        super().__init__(context, token, key, topic, callback, on_refused)
        self.why = "the graph is not evaluated yet"
        lane.add(self)

    @override
    def close(self) -> None:
        self._lane.remove(self)
        super().close()
        for inlet in tuple(self._inlets):
            inlet.leave(self)

    def _declare(self, context: EndpointContext, key: str) -> Callable[[], None]:
        self._subscriber = subscribe(context.session, key, self._on_sample, context.reach)
        return self._undeclare_current

    def _undeclare_current(self) -> None:
        with self._switching:
            undeclare(self._subscriber)

    # -- messages ------------------------------------------------------------------------------------------------------

    def _on_sample(self, sample: zenoh.Sample) -> None:
        message = self._reader.read(sample)
        if message is None:
            return
        with self._delivery:
            with self._lock:
                source = self.sources.get(message.gid)
                if source is None or not source.zid:
                    source = self.sources.of(message, sample)
                message.zid = source.zid
                if self._leaving:
                    self._heard.add(source.zid)
                ready = self._in_turn(source, message, first=0)
            for deliverable in ready:
                self._callback(deliverable)
        if len(message.payload) > BOUND:
            self.grown()

    def heard(self, inlet: Inlet, attached: tuple[int, int, bytes], payload: bytes) -> None:
        """Handle a message from a lane."""
        if self._reader.closed:
            return
        sequence, time_ns, gid = attached
        if len(payload) > self._reader.limit:
            self._reader.refuse("large", f"message of {len(payload)} bytes, the limit is {self._reader.limit}")
            return
        message = HubSample(zenoh.ZBytes(payload), sequence, time_ns, gid, inlet.zid)
        with self._delivery:
            with self._lock:
                source = self.sources.get(gid)
                if source is None:
                    source = self.sources.add(gid, inlet.zid)
                joined = self._joined.get(gid)
                before = self.sources.held_bytes, source.sequence
                ready = self._in_turn(source, message, first=0 if joined is None else joined.mark)
                self.by_lane += bool(ready) or (self.sources.held_bytes, source.sequence) != before
            for ready_message in ready:
                self._callback(ready_message)

    def _in_turn(self, source: PublisherState, message: HubSample, first: int) -> list[HubSample]:
        """Return the messages to deliver now; ``first`` earlier messages may arrive over the other transport."""
        number, last = message.sequence, source.sequence
        if not source.paired:
            gap = source.accept(message)
            if gap:
                self._losses.add(gap, message)
            return [] if gap is None else [message]
        if number in source.held:  # both transports have reached this number, so no earlier message is missing
            return self._up_to(source, message.gid, number)
        if last is not None and number <= last:
            return []
        early = number > last + 1 if last is not None else first > 0
        if early and self._both(message.gid) and self.sources.hold(source, message):
            self._early.setdefault(message.gid, time.monotonic())
            self._lane.calls.after(_EARLY_SECONDS, self._release_due, once=True)
            return []
        if not source.held:
            return self._deliverable(source, message)
        self.sources.hold_anyway(source, message)
        return self._up_to(source, message.gid, number)

    def _both(self, gid: bytes) -> bool:
        return self._everywhere and gid in self._joined

    def _up_to(self, source: PublisherState, gid: bytes, number: int) -> list[HubSample]:
        """Return the held messages up to a number, and those that follow it without a gap."""
        ready: list[HubSample] = []
        for held in sorted(source.held):
            if held > number and held != (source.sequence or 0) + 1:
                break
            ready += self._deliverable(source, self.sources.pop_held(source, held))
        if source.held:
            self._early[gid] = time.monotonic()
        else:
            self._early.pop(gid, None)
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

    def _release_due(self) -> None:
        """Deliver the messages that were held for the maximum time."""
        self._release_due_at(time.monotonic())
        with self._lock:
            due = min(map(self._due, self._early), default=None)
        if due is not None:
            self._lane.calls.after(due - time.monotonic(), self._release_due, once=True)

    def _due(self, gid: bytes) -> float:
        """Return when the messages of a publisher are held no longer."""
        joined = self._joined.get(gid)
        leaves = joined is not None and joined.inlet in self._leaving and not self._newest_counts
        return self._early[gid] + (_LEAVING_SECONDS if leaves else _EARLY_SECONDS)

    def _release_due_at(self, now: float) -> None:
        """Deliver the messages whose time is over."""
        with self._delivery:
            ready: list[HubSample] = []
            if self._reader.closed:
                return
            with self._lock:
                for gid in [gid for gid in self._early if self._due(gid) <= now]:
                    source = self.sources.get(gid)
                    if source is None or not source.held:  # dropped, as there were too many publishers
                        del self._early[gid]
                        continue
                    ready += self._up_to(source, gid, max(source.held))
            for message in ready:
                self._callback(message)

    # -- lanes ---------------------------------------------------------------------------------------------------------

    def marked(self, inlet: Inlet, gid: bytes, sequence: int) -> None:
        """Handle a mark: the publisher sends messages after this number on the lane."""
        with self._lock:
            joined = self._joined.get(gid)
            if joined is None or joined.inlet is not inlet:
                self._joined[gid] = _Joined(inlet, sequence, time.monotonic())
            source = self.sources.get(gid)
            if source is None:
                source = self.sources.add(gid, inlet.zid)
            source.paired = True
        self._lane.wake(self)

    def fenced(self, inlet: Inlet) -> None:
        """Handle a returned fence: the closing lane has delivered everything."""
        with self._lock:
            leaving = self._leaving.get(inlet)
            if leaving is not None:
                leaving.ended = True
        self._lane.wake(self)

    def grown(self) -> None:
        """Handle a message that is too large for the lane."""
        if not self._large:
            self._large = BOUND
            self._lane.wake(self)

    def parted(self, inlet: Inlet) -> None:
        """Handle the end of a connection."""
        if inlet in self._inlets:
            self._drop(inlet)
            self._lane.wake(self)

    def _drop(self, inlet: Inlet) -> None:
        with self._lock:
            self._inlets.pop(inlet, None)
            self._leaving.pop(inlet, None)
            for gid in [gid for gid, joined in self._joined.items() if joined.inlet is inlet]:
                del self._joined[gid]
        self._release_due_at(math.inf)

    # -- the choice ----------------------------------------------------------------------------------------------------

    def settle(self) -> bool:
        """Continue the switch to the wanted transport; return whether to check again soon."""
        if self._reader.closed:
            return False
        for inlet in [inlet for inlet in self._inlets if not inlet.alive]:
            self._drop(inlet)
        publishers = self._publishers()
        reason = self._why_zenoh(publishers)
        inlets: set[Inlet] = set()
        if not reason:
            for zid in {publisher.zid for publisher in publishers}:
                connection = self._lane.inlet(zid)
                if isinstance(connection, str):
                    node = next(publisher.node for publisher in publishers if publisher.zid == zid)
                    reason = f"{node}: {connection}"
                    break
                inlets.add(connection)
        return self._to_zenoh(reason) if reason else self._to_lane(publishers, inlets)

    @property
    def settled(self) -> bool:
        """Whether messages arrive over only one transport."""
        return not self._everywhere if self.way == "lane" else not self._inlets

    def _publishers(self) -> list[HubEndpoint]:
        """Return the publishers of the topic, without those of its own session."""
        return [
            endpoint
            for endpoint in self._graph.publishers(self.topic)
            if endpoint.type_name == self._type and self._hash in (ANY_HASH, endpoint.type_hash) and not endpoint.own
        ]

    def _why_zenoh(self, publishers: list[HubEndpoint]) -> str:
        if self._large:
            return f"a message was larger than {BOUND} bytes"
        if not publishers:
            return "no other worker publishes it"
        for publisher in publishers:
            if publisher.qos.latched:
                return f"{publisher.node} stores messages for late joiners"
            if publisher.qos.history is History.KEEP_ALL:
                return f"{publisher.node} has the history keep_all"
        return ""

    def _to_lane(self, publishers: list[HubEndpoint], inlets: set[Inlet]) -> bool:
        now = time.monotonic()
        with self._lock:
            self._leaving.clear()
            self._prune_marks(publishers)
        for inlet in inlets - self._inlets.keys():
            self._inlets[inlet] = now
            inlet.join(self)
        with self._lock:
            missing = [publisher for publisher in publishers if not self._caught(publisher.gid, now)]
        if not missing:
            self._listen(everywhere=False)
            self.way, self.why = "lane", ""
            return False
        self._listen(everywhere=True)
        self.way, self.why = "zenoh", "switching to the lane"
        for publisher in missing:
            late = next(inlet for inlet in inlets if inlet.zid == publisher.zid)
            if not late.answered and now - late.since > _UNANSWERED_SECONDS:
                self._lane.refuse(late, "it does not respond on its lane")
            elif publisher.gid not in self._joined and now - self._inlets.get(late, now) > _UNANSWERED_SECONDS:
                self._inlets[late] = now
                late.join(self)  # once more, for another mark
        return True

    def _prune_marks(self, publishers: list[HubEndpoint]) -> None:
        """Drop the marks of publishers that left, once there are many."""
        if len(self._joined) > 2 * len(publishers) + _SPARED_MARKS:
            present = {publisher.gid for publisher in publishers}
            self._joined = {gid: joined for gid, joined in self._joined.items() if gid in present}

    def _caught(self, gid: bytes, now: float) -> bool:
        """Return whether all messages that a publisher sent only on zenoh have arrived."""
        joined = self._joined.get(gid)
        if joined is None:
            return False
        last = self.sources[gid].sequence if gid in self.sources else None
        joined.caught = joined.caught or (last or 0) >= joined.mark or now - joined.since > _CAUGHT_SECONDS
        return joined.caught

    def _to_zenoh(self, why: str) -> bool:
        self._listen(everywhere=True)
        self.way, self.why = "zenoh", why
        now = time.monotonic()
        for inlet in tuple(self._inlets):
            with self._lock:
                leaving = self._leaving.setdefault(inlet, _Leaving())
            if leaving.ended:
                inlet.leave(self)
                self._drop(inlet)
            elif not leaving.passed:
                if self._lane.passed(inlet.zid, self._declared):
                    leaving.passed = now
                    with self._lock:
                        self._heard.discard(inlet.zid)
            elif not leaving.fenced and (inlet.zid in self._heard or now - leaving.passed > _CAUGHT_SECONDS):
                leaving.fenced = now
                inlet.fence(self)
        return bool(self._inlets)

    def _listen(self, *, everywhere: bool) -> None:
        """Subscribe on zenoh to all sessions, or only to this one if it has several nodes."""
        with self._switching:
            if self._reader.closed or everywhere == self._everywhere:
                return
            before = self._subscriber
            if everywhere:
                with self._lock:
                    self._everywhere = True
                self._subscriber = subscribe(self._session, self.key, self._on_sample, self._reach)
                self._declared = time.monotonic()
            elif self._reach == zenoh.Locality.ANY:
                self._subscriber = subscribe(self._session, self.key, self._on_sample, zenoh.Locality.SESSION_LOCAL)
            if not (everywhere and self._reach != zenoh.Locality.ANY):
                undeclare(before)
            if not everywhere:
                with self._lock:
                    self._everywhere = False
