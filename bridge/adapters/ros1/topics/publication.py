"""One topic that this node publishes, shared by the bridge's publishers of that topic.

A ROS 1 node has one publication per topic, while the hub may have any number of publishers. Latched messages are
retained for each of these publishers, and every late joiner receives all of them.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from threading import Lock
from typing import Any

from bridge.adapters.ros1.compiled import Outputs
from bridge.adapters.ros1.connection_loop import ConnectionLoop
from bridge.adapters.ros1.handshake import ORIGIN_FIELD, Header, encode
from bridge.adapters.ros1.topics.commands import CommandConnection
from bridge.adapters.ros1.topics.outlet import SubscriberConnection
from bridge.adapters.ros1_peers import DeadlineSocket
from bridge.concurrency import DelayedCalls
from bridge.messages.transcode.conversion import SideType

_log = logging.getLogger(__name__)

ANY = "*"
"""The md5 sum and the type of a subscriber that accepts any message."""


class Publication:
    """The connections to a topic's subscribers; ``changed`` is called when a subscriber has joined or left.

    Attributes:
        users: number of publishers that share the publication.
        latches: number of these publishers that latch.
        published: bytes of all messages that Python has published.
        lifespan: time in seconds after which a message is too old, for commands; None for other topics.
        outputs: sends small messages in C; None for commands, or without a compiler.
    """

    def __init__(
        self, topic: str, side_type: SideType, node: Callable[[], str], origin: str, loop: ConnectionLoop,
        changed: Callable[[], None], later: DelayedCalls, lifespan: float | None = None,
    ) -> None:  # fmt: skip
        self.topic, self.side_type, self.lifespan, self._later = topic, side_type, lifespan, later
        self.users = self.latches = self.published = 0
        self._node, self._origin, self._loop, self._changed = node, origin, loop, changed
        self._lock = Lock()
        self._closed = False
        self._dropped_before = 0
        self._connections: tuple[SubscriberConnection, ...] = ()
        self.outputs = None if Outputs is None or lifespan is not None else Outputs((self._lock.locked,))
        self._retained: dict[str, deque[bytes]] = {}

    @property
    def connections(self) -> tuple[SubscriberConnection, ...]:
        """The connected subscribers."""
        return self._connections

    @property
    def dropped(self) -> int:
        """Number of messages that slow subscribers missed."""
        return self._dropped_before + sum(c.dropped for c in self._connections)

    def header(self) -> Header:
        """Return the connection header for subscribers."""
        header = {
            "callerid": self._node(),
            "topic": self.topic,
            "type": self.side_type.name,
            "md5sum": self.side_type.type_id,
            "message_definition": self.side_type.definition,
            "latching": "1" if self.latches else "0",
        }
        return header | {ORIGIN_FIELD: self._origin} if self._origin else header

    def mismatch(self, header: Header) -> str:
        """Return why a subscriber's type does not match; "" if it does."""
        name, md5 = self.side_type.name, self.side_type.type_id
        if header["md5sum"] in (ANY, md5):
            return ""
        theirs = header.get("type", name)
        if theirs != name:
            return f"topic types do not match: [{theirs}] vs. [{name}]"
        return (
            f"{header['callerid']} wants topic {self.topic} to have {theirs} with md5 {header['md5sum']}, but this"
            f" node has md5 {md5}; use the same version of {name.split('/')[0]} on both sides"
        )

    def admit(self, sock: DeadlineSocket, subscriber: str) -> None:
        """Send the header and the retained messages to a new subscriber; raises `OSError`.

        The new connection replaces an earlier connection of the same node, which the peer may have lost. A subscriber
        that is admitted while the publication ends is disconnected after the header.
        """
        sock.sendall(encode(self.header()))
        connection = self._connection(sock, subscriber)
        for old in [c for c in self._connections if c.peer == subscriber]:
            self.remove(old)
        with self._lock:
            closed = self._closed
            if not closed:
                self._connections = (*self._connections, connection)
                self._set_outputs()
                for source, payloads in self._retained.items():
                    for payload in payloads:
                        connection.send(payload, source, len(payloads))
        try:
            admitted = not closed and self._loop.add(connection)
        except OSError as err:  # the system is out of descriptors or memory
            _log.warning("%s: the subscriber %s cannot be watched: %s", self.topic, subscriber, err)
            admitted = False
        if not admitted:
            self.remove(connection)
        self._changed()

    def _connection(self, sock: DeadlineSocket, subscriber: str) -> SubscriberConnection:
        name = f"midspan-ros1-out{self.topic}"
        if self.lifespan is None:
            return SubscriberConnection(sock, name, subscriber, self.remove)
        return CommandConnection(sock, name, subscriber, self.remove, self.side_type.name, self.lifespan)

    def remove(self, connection: SubscriberConnection) -> None:
        """Disconnect a subscriber. Safe to call twice."""
        with self._lock:
            listed = connection in self._connections
            if listed:
                self._connections = tuple(c for c in self._connections if c is not connection)
                self._set_outputs()
                self._dropped_before += connection.dropped
        self._loop.remove(connection)
        connection.close()
        if listed:
            _log.debug("%s: the subscriber %s has disconnected", self.topic, connection.peer)
            self._changed()

    def _set_outputs(self) -> None:
        if self.outputs is not None:
            self.outputs.set(tuple(c.socket for c in self._connections if c.socket is not None))

    def close(self) -> None:
        with self._lock:
            self._closed = True
            if self.outputs is not None:
                self.outputs.open = False
        for connection in self._connections:
            self.remove(connection)

    def send(self, payload: bytes, source: str, depth: int, *, retain: bool) -> None:
        """Publish to all subscribers without blocking."""
        with self._lock:
            if self._closed:
                return
            if retain:
                kept = self._retained.get(source)
                if kept is None or kept.maxlen != depth:
                    kept = self._retained[source] = deque(kept or (), depth)
                kept.append(payload)
            self.published += len(payload)
            broken = [c for c in self._connections if not c.send(payload, source, depth)]
        for connection in broken:
            self.remove(connection)
        if self.lifespan is not None and self._connections:
            self._later.after(self.lifespan, self._check_commands, once=True)

    def _check_commands(self) -> None:
        """Look for commands that have become late; once more while some may."""
        with self._lock:
            checked = {c: c.check() for c in self._connections if isinstance(c, CommandConnection)}
        if any(checked.values()) and self.lifespan is not None:
            self._later.after(self.lifespan, self._check_commands, once=True)

    def drop_source(self, source: str) -> None:
        """Drop a source's retained messages."""
        with self._lock:
            self._retained.pop(source, None)

    def bus_stats(self) -> list[Any]:
        """Return an entry of ``getBusStats``."""
        return [
            self.topic,
            figure(self.published if self.outputs is None else self.published + self.outputs.bytes),
            [[c.id, *map(figure, c.counts()), not c.done] for c in self._connections],
        ]


def figure(number: int) -> int | float:
    """Return a number in a form that XML-RPC, whose integers have 32 bits, can represent."""
    return number if number < 2**31 else float(number)
