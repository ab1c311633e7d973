"""A topic on its way to YARP programs: one message, several output ports, each with a content of its own."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from dataclasses import dataclass

from bridge.adapters.kept import Kept
from bridge.adapters.yarp.contents import Contents
from bridge.adapters.yarp.stamps import envelope
from bridge.hub.qos import Qos
from bridge.messages.conversion import SideType
from bridge.messages.errors import MessageError
from bridge.messages.yarp.codec import stamp_of
from bridge.messages.yarp.contents import Content
from yarp_compat.ports.connections import AnyOutput
from yarp_compat.ports.message import Payload
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.profile import Profile

_QUEUE = 10
"""Depth from which a stream waits for a slow reader; a rule that gives less wants it fresh rather than complete."""


@dataclass(frozen=True, slots=True)
class Outlet:
    """An output port and what it carries."""

    core: PortCore
    content: Content


class TopicOutput:
    """What is published of one topic and type. Methods may be called from any thread.

    Args:
        topic: its name.
        side_type: its type.
        stamped: whether its messages begin with a header.
        contents: the converters.
    """

    def __init__(self, topic: str, side_type: SideType, stamped: bool, contents: Contents) -> None:
        self.topic, self.side_type = topic, side_type
        self._stamped, self._contents = stamped, contents
        self._outlets: tuple[Outlet, ...] = ()
        self._publishers: list[TopicPublisher] = []
        self._numbers = itertools.count()
        self._lock = threading.RLock()

    def publisher(self, qos: Qos, closed: Callable[[TopicPublisher], None]) -> TopicPublisher:
        """A new publisher."""
        made = TopicPublisher(self, qos, closed)
        with self._lock:
            self._publishers.append(made)
        return made

    def remove(self, publisher: TopicPublisher) -> bool:
        """A publisher is closed; whether it was the last one."""
        with self._lock:
            if publisher in self._publishers:
                self._publishers.remove(publisher)
            return not self._publishers

    def add(self, outlet: Outlet) -> None:
        """Another port for the topic."""
        with self._lock:
            self._outlets = (*self._outlets, outlet)

    def drop(self, core: PortCore) -> None:
        """A port is closed."""
        with self._lock:
            self._outlets = tuple(outlet for outlet in self._outlets if outlet.core is not core)

    @property
    def dropped(self) -> int:
        """Messages that slow readers missed."""
        return sum(
            sum(output.counters.dropped.values())
            for outlet in self._outlets
            for output in outlet.core.connections.outputs
        )

    def write(self, cdr: bytes, *, command: bool = False, strict: bool = True) -> None:
        """Publish on all ports; raises the last `ConversionError` where a content cannot say it.

        Args:
            cdr: the message.
            command: a reader that is busy with the last one misses this one, so that none waits behind another.
            strict: a reader that is busy gets it later; else the newest alone.
        """
        failure: MessageError | None = None
        number = next(self._numbers)
        for outlet in self._outlets:
            try:
                self._write(outlet, cdr, number, _idle if command else None, strict=strict and not command)
            except MessageError as err:
                failure = err
        if failure is not None:
            raise failure

    def welcome(self, core: PortCore, target: str) -> None:
        """A reader came: give it what is kept."""
        with self._lock:
            outlet = next((outlet for outlet in self._outlets if outlet.core is core), None)
            if outlet is None:
                return
            for payload in [payload for publisher in self._publishers for payload in publisher.kept()]:
                self._write(outlet, payload, next(self._numbers), lambda output: output.route.target == target)

    def _write(
        self,
        outlet: Outlet,
        cdr: bytes,
        number: int,
        chosen: Callable[[AnyOutput], bool] | None,
        *,
        strict: bool = True,
    ) -> None:
        side, contents = self.side_type, self._contents

        def payload(profile: Profile) -> Payload:
            return contents.codec(outlet.content, side.name, side.type_id, profile).to_yarp(cdr).payload

        stamp = envelope(number, stamp_of(cdr)) if self._stamped else ""
        outlet.core.write(payload, stamp, strict=strict, chosen=chosen)

    @property
    def lock(self) -> threading.RLock:
        """Held while a message is published and kept, so that late joiners get each in order."""
        return self._lock


class TopicPublisher:
    """One publisher of a topic; see `EdgePublisher`."""

    def __init__(self, output: TopicOutput, qos: Qos, closed: Callable[[TopicPublisher], None]) -> None:
        self.output = output
        self._latched, self._command = qos.latched, not qos.latched and qos.depth == 1
        self._strict = qos.depth >= _QUEUE
        self._kept = Kept(qos.depth)
        self._closed = closed

    @property
    def dropped(self) -> int:
        """Messages that slow readers of the topic missed."""
        return self.output.dropped

    def kept(self) -> list[bytes]:
        """What late joiners get."""
        return self._kept.all()

    def send(self, payload: bytes, source: str) -> None:
        """See `EdgePublisher.send`."""
        if not self._latched:
            self.output.write(payload, command=self._command, strict=self._strict)
            return
        with self.output.lock:
            self._kept.add(payload, source)
            self.output.write(payload)

    def forget(self, source: str) -> None:
        """See `EdgePublisher.forget`."""
        with self.output.lock:
            self._kept.forget(source)

    def close(self) -> None:
        """Give it back. Safe to call twice."""
        closed, self._closed = self._closed, _nothing
        closed(self)


def _idle(output: AnyOutput) -> bool:
    return not output.busy


def _nothing(_: TopicPublisher) -> None:
    """It was closed before."""
