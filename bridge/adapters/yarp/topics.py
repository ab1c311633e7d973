"""The bridge's ports for a topic: inputs from YARP programs, outputs to them, and message envelopes."""

from __future__ import annotations

import itertools
import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from decimal import Decimal

from bridge.adapters.latched_cache import LatchedCache
from bridge.adapters.yarp.contents import Contents
from bridge.clock import steady
from bridge.hub.wire.qos import Qos
from bridge.messages.errors import MessageError
from bridge.messages.transcode.conversion import SideType
from bridge.messages.velocities import stop_after
from bridge.messages.yarp.codec import Codec, stamp_of
from bridge.messages.yarp.contents import Content
from bridge.resources import LARGE_MESSAGES
from bridge.routing.edge import Deliver, MadeBy
from bridge.routing.rules import COMMAND_SECONDS
from yarp_compat.ports.commands import CommandWriter
from yarp_compat.ports.connections import AnyOutput
from yarp_compat.ports.message import Payload, PortMessage
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.profile import Profile

_STAMP = re.compile(r"\s*-?\d{1,12}\s+(\d{1,12}(?:\.\d{1,30})?(?:[eE][+-]?\d{1,2})?)\s*")
_DAY_NS = 86_400_000_000_000


def envelope(count: int, stamp_ns: int | None) -> str:
    """Return the envelope of a message with this stamp, "" if it has no stamp."""
    if stamp_ns is None or stamp_ns <= 0:
        return ""
    return f"{count} {stamp_ns // 1_000_000_000}.{stamp_ns % 1_000_000_000:09d}"


def stamp(text: str) -> int | None:
    """Return the stamp of an envelope in nanoseconds; None if it has no valid stamp."""
    match = _STAMP.fullmatch(text)
    if match is None:
        return None
    time_ns = int(Decimal(match[1]).scaleb(9).to_integral_value())
    return time_ns if 0 < time_ns < 1 << 62 else None


def on_system_clock(stamp_ns: int | None) -> int | None:
    """Return a stamp that is within a day of the system's clock; None for simulated times and uptimes."""
    return stamp_ns if stamp_ns is not None and abs(time.time_ns() - stamp_ns) < _DAY_NS else None


HOLD_SECONDS = 2.0
"""Seconds for which the newest message of a new peer is held for its route, from when the graph lists the peer.

Before that, the message waits for as long as the name server takes.
"""

MAX_HELD = 64


@dataclass(slots=True)
class _Held:
    """A held message.

    ``since`` is when it arrived, ``listed`` when an update of the graph had found its peer (seconds of
    `bridge.clock.steady`); ``delivering``: whether it is being delivered.
    """

    since: float
    message: PortMessage
    listed: float | None = None
    delivering: bool = False


@dataclass(eq=False)
class InputPort:
    """An input port, which converts messages and delivers them to its topic's route.

    Attributes:
        only: returns whether messages of a peer are accepted; None accepts the messages of all peers.
        source: the id of the endpoint to which messages are attributed; None attributes them to the sending port.
        made_by: returns who created a port.
        refused: called for each refused message: topic, reason, explanation.
    """

    port: str
    topic: str
    type: str
    codec: Codec
    only: Callable[[str], bool] | None
    source: str | None
    made_by: Callable[[str], MadeBy]
    refused: Callable[[str, str, str], None]
    _deliver: Deliver | None = None
    _is_command: bool = False
    _held: dict[str, _Held] = field(default_factory=dict)
    _changed: threading.Condition = field(default_factory=threading.Condition)

    def on_message(self, message: PortMessage) -> None:
        """Handle a message, on its connection's thread."""
        LARGE_MESSAGES.passed(len(message.payload))
        peer = message.peer.route.source
        if self.only is not None and not self.only(peer):
            return
        made_by = self.made_by(peer)
        if made_by is MadeBy.MIDSPAN:
            return
        deliver = self._deliver
        if deliver is None or made_by is MadeBy.UNKNOWN or peer in self._held:
            self.release()  # an earlier message must be delivered first
            self._hold(peer, message)
            self.release()  # a route may have been connected meanwhile
            return
        self._pass_on(message, deliver)

    def _hold(self, peer: str, message: PortMessage) -> None:
        """Hold a message in place of the peer's earlier one; if that is being delivered, wait until it has been."""
        with self._changed:
            self._changed.wait_for(lambda: not ((held := self._held.get(peer)) and held.delivering))
            if peer in self._held or len(self._held) < MAX_HELD:
                self._held[peer] = _Held(steady(), message)

    def deliver_to(self, deliver: Deliver | None, *, command: bool = False) -> None:
        """Deliver messages to this route from now on; the next `release` delivers the held messages to it.

        ``command``: the messages are commands, which are not held for long, because a late command must not move the
        robot.
        """
        self._is_command = command  # first, because another thread may release a message
        self._deliver = deliver

    def _is_overdue(self, held: _Held, now: float) -> bool:
        if self._is_command:
            return now - held.since > COMMAND_SECONDS
        return held.listed is not None and now - held.listed > HOLD_SECONDS

    def mark_listed(self) -> None:
        """Note after an update of the graph which held messages have a known peer; the others wait for the next one."""
        now = steady()
        with self._changed:
            for peer, held in self._held.items():
                if held.listed is None and self.made_by(peer) is not MadeBy.UNKNOWN:
                    held.listed = now

    def waiting(self) -> set[str]:
        """Return the peers with held messages, even if they have left."""
        now = steady()
        with self._changed:
            for peer, held in list(self._held.items()):
                if self._is_overdue(held, now) and not held.delivering:
                    del self._held[peer]
            return set(self._held)

    def release(self) -> None:
        """Deliver the held messages whose senders are now known."""
        while self._held and (held := self._next()) is not None:
            peer, message, deliver = held
            try:
                self._pass_on(message, deliver)
            finally:
                with self._changed:
                    del self._held[peer]
                    self._changed.notify_all()

    def _next(self) -> tuple[str, PortMessage, Deliver] | None:
        """Return a held message that can be delivered; the peer's next message waits until this one is delivered."""
        now, deliver = steady(), self._deliver
        if deliver is None:
            return None
        with self._changed:
            for peer, held in [(peer, held) for peer, held in self._held.items() if not held.delivering]:
                made_by, overdue = self.made_by(peer), self._is_overdue(held, now)
                if made_by is MadeBy.NATIVE and not overdue:
                    held.delivering = True
                    return peer, held.message, deliver
                if made_by is not MadeBy.UNKNOWN or overdue:
                    del self._held[peer]
        return None

    def _pass_on(self, message: PortMessage, deliver: Deliver) -> None:
        peer = message.peer
        stamp_ns = stamp(message.envelope) if message.envelope else None
        try:
            cdr = self.codec.to_hub(message.payload, peer.profile, stamp_ns)
        except MessageError as err:
            self.refused(self.topic, "bad", f"from {peer.route.source}: {err}")
            return
        deliver(cdr, self.source or peer.route.source, on_system_clock(stamp_ns))


_QUEUE = 10
"""Queue depth from which messages are queued for slow readers; with a smaller depth only the newest is sent."""


@dataclass(frozen=True, slots=True)
class OutputPort:
    """An output port and its content."""

    core: PortCore
    content: Content


class TopicOutput:
    """The output of one topic and type; thread-safe. ``stamped``: the topic's messages begin with a header."""

    def __init__(self, topic: str, side_type: SideType, stamped: bool, contents: Contents) -> None:
        self.topic, self.side_type = topic, side_type
        self._stamped, self._contents = stamped, contents
        self._ports: tuple[OutputPort, ...] = ()
        self._commands: dict[PortCore, CommandWriter] = {}
        self._publishers: list[YarpPublisher] = []
        self._numbers = itertools.count()
        self._lock = threading.RLock()

    def publisher(self, qos: Qos, closed: Callable[[YarpPublisher], None]) -> YarpPublisher:
        """Create a publisher."""
        publisher = YarpPublisher(self, qos, closed)
        with self._lock:
            self._publishers.append(publisher)
        return publisher

    def remove(self, publisher: YarpPublisher) -> bool:
        """Remove a closed publisher; return whether it was the last publisher."""
        with self._lock:
            if publisher in self._publishers:
                self._publishers.remove(publisher)
            return not self._publishers

    def add(self, port: OutputPort) -> None:
        """Add an output port."""
        with self._lock:
            self._ports = (*self._ports, port)

    def drop(self, core: PortCore) -> None:
        """Remove a closed port."""
        with self._lock:
            self._ports = tuple(port for port in self._ports if port.core is not core)
            self._commands.pop(core, None)

    @property
    def has_readers(self) -> bool:
        """Whether a reader is connected to one of the ports."""
        return any(port.core.connections.outputs for port in self._ports)

    @property
    def dropped(self) -> int:
        """The number of messages dropped for slow readers, or unsent when one disconnected."""
        return sum(port.core.lost.total() for port in self._ports)

    def write(self, cdr: bytes, *, lifespan: float | None = None, strict: bool = True) -> None:
        """Publish on all ports; raises the last `ConversionError` if a content cannot express the message.

        Args:
            cdr: the message.
            lifespan: for commands: the time in seconds for which a reader may leave one unacknowledged.
            strict: queue the message for busy readers; otherwise they get only the newest message.
        """
        LARGE_MESSAGES.passed(len(cdr))
        failure: MessageError | None = None
        number = next(self._numbers)
        for port in self._ports:
            try:
                if lifespan is None:
                    self._write(port, cdr, number, None, strict=strict)
                else:
                    self._command(port, cdr, number, lifespan)
            except MessageError as err:
                failure = err
        if failure is not None:
            raise failure

    def send_latched(self, core: PortCore, target: str) -> None:
        """Send the cached messages to a new reader."""
        with self._lock:
            port = next((port for port in self._ports if port.core is core), None)
            if port is None:
                return
            for payload in [payload for publisher in self._publishers for payload in publisher.latched()]:
                self._write(port, payload, next(self._numbers), lambda output: output.route.target == target)

    def _write(
        self, port: OutputPort, cdr: bytes, number: int, chosen: Callable[[AnyOutput], bool] | None, *,
        strict: bool = True,
    ) -> None:  # fmt: skip
        port.core.write(self._payload(port, cdr), self._envelope(cdr, number), strict=strict, chosen=chosen)

    def _command(self, port: OutputPort, cdr: bytes, number: int, lifespan: float) -> None:
        writer = self._commands.get(port.core)
        if writer is None:
            writer = self._commands.setdefault(port.core, CommandWriter(port.core, lifespan))
        stopped = stop_after(self.side_type.name, cdr)
        command = self._payload(port, cdr)
        stop = command if stopped == cdr else self._payload(port, stopped) if stopped else None
        writer.write(command, stop, self._envelope(cdr, number))

    def _payload(self, port: OutputPort, cdr: bytes) -> Callable[[Profile], Payload]:
        side, contents = self.side_type, self._contents
        return lambda profile: contents.codec(port.content, side.name, side.type_id, profile).to_yarp(cdr).payload

    def _envelope(self, cdr: bytes, number: int) -> str:
        return envelope(number, stamp_of(cdr)) if self._stamped else ""

    @property
    def lock(self) -> threading.RLock:
        """A lock to hold while publishing and caching a message, so that late joiners receive all messages in order."""
        return self._lock


class YarpPublisher:
    """One publisher of a topic (`bridge.routing.edge.EdgePublisher`)."""

    def __init__(self, output: TopicOutput, qos: Qos, closed: Callable[[YarpPublisher], None]) -> None:
        self.output = output
        self._latched = qos.latched
        self._lifespan = None if qos.lifespan_ns is None else qos.lifespan_ns / 1e9
        self._strict = qos.depth >= _QUEUE
        self._cache = LatchedCache(qos.depth)
        self._closed: Callable[[YarpPublisher], None] | None = closed

    @property
    def has_subscribers(self) -> bool:
        """Whether a reader is connected to one of the topic's ports."""
        return self.output.has_readers

    @property
    def dropped(self) -> int:
        """The number of messages dropped for slow readers of the topic."""
        return self.output.dropped

    def latched(self) -> list[bytes]:
        """Return the cached messages for late joiners."""
        return self._cache.all()

    def send(self, payload: bytes, source: str) -> None:
        """Publish a message, and cache it if the publisher is latched."""
        if not self._latched:
            self.output.write(payload, lifespan=self._lifespan, strict=self._strict)
            return
        with self.output.lock:
            self._cache.add(payload, source)
            self.output.write(payload)

    def drop_source(self, source: str) -> None:
        """Remove the cached messages of a source."""
        with self.output.lock:
            self._cache.drop_source(source)

    def close(self) -> None:
        """Remove the publisher from its output. Safe to call twice."""
        closed, self._closed = self._closed, None
        if closed is not None:
            closed(self)
