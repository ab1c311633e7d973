"""The network: every program sends JSON in datagrams to one multicast group, and receives those of all others.

A program announces itself with ``{"hello": ID, "node": NAME, "by": "", "ends": {ID: [KIND, TOPIC, TYPE, LATCHED,
NUMBERS]}, "record": ""}``, twice a second, and at once when it opens or closes an endpoint or changes its record. It
leaves with ``{"bye": ID}``. A message is ``{"from": ENDPOINT, "topic": TOPIC, "message": {...}}``. Latched messages
also have ``"source"`` and ``"number"``, and the publisher's hello lists the numbers of its retained messages. A
subscriber that is late, or lost a datagram, sends ``{"again": [ENDPOINT]}``; the publisher then sends the retained
messages to this subscriber only. A subscriber may receive latched messages twice and in any order, which it detects by
their numbers.
"""

from __future__ import annotations

import itertools
import json
import os
import select
import socket
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

BEAT = 0.5
SILENT = 3.0
"""Seconds of silence after which a program counts as dead."""
LARGEST = 60_000
"""Maximum size of a datagram, bytes."""


@dataclass
class End:
    """A publisher (``kind`` is "pub") or a subscription ("sub").

    The ``id`` of another program's endpoint ends with ``@`` and a number. The number changes when the program returns
    after a silence, so that its latched messages are received again, for the new endpoint.
    """

    id: str
    kind: str
    topic: str
    type: str
    latched: bool
    take: Callable[[bytes, str], None] | None = None
    retained: dict[str, tuple[int, bytes]] = field(default_factory=dict)
    """Latched publishers: number and datagram of the last message of each source."""
    received: dict[tuple[str, str], int] = field(default_factory=dict)
    """Subscriptions: the last number received from each latched publisher and source."""
    numbers: list[int] = field(default_factory=list)
    """Latched publishers: numbers of the retained messages, as announced."""


@dataclass
class Program:
    """Another program on the network, as last announced."""

    id: str
    address: tuple[str, int]
    last_seen: float
    appearance: int
    node: str = ""
    by: str = ""
    record: str = ""
    ends: dict[str, End] = field(default_factory=dict)

    def graph(self) -> list[tuple[str, ...]]:
        """Return the properties of the program's endpoints that the graph shows."""
        return [(e.id, e.kind, e.topic, e.type, str(e.latched)) for e in self.ends.values()]


class Node:
    """A program's connection to the network.

    Args:
        group: ``address:port`` of the multicast group.
        interface: address of the network interface; loopback joins programs of one machine only.
        name: node name, for display.
        by: the bridge's name; "" for a native program.
        changed: called when programs, their endpoints or their records change.
    """

    def __init__(
        self, group: str, interface: str, name: str, by: str = "", changed: Callable[[], None] = lambda: None
    ) -> None:
        self.id, self.name, self.by, self.record = os.urandom(6).hex(), name, by, ""
        self.programs: dict[str, Program] = {}
        address, _, port = group.partition(":")
        self._group, self._changed = (address, int(port)), changed
        self._ends: dict[str, End] = {}
        self._numbers, self._appearances = itertools.count(1), itertools.count(1)
        self._lock = threading.RLock()
        self._closed = False
        self._own = self._socket(("", 0))
        self._own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(interface))
        self._all = self._socket(self._group)
        member = struct.pack("4s4s", socket.inet_aton(address), socket.inet_aton(interface))
        self._all.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._listen, self._beat)]
        for thread in self._threads:
            thread.start()

    @staticmethod
    def _socket(place: tuple[str, int]) -> socket.socket:
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        sock.bind(place)
        return sock

    def open(
        self, kind: str, topic: str, type_: str, *, latched: bool, take: Callable[[bytes, str], None] | None = None
    ) -> End:
        """Open a publisher, or a subscription that calls ``take(message, publisher)``."""
        end = End(f"{self.id}.{next(self._numbers)}", kind, topic, type_, latched, take)
        with self._lock:
            self._ends[end.id] = end
        self.hello()
        for program in list(self.programs.values()):
            self._ask(program)
        return end

    def close_end(self, end: End) -> None:
        """Close a publisher or a subscription."""
        with self._lock:
            self._ends.pop(end.id, None)
        self.hello()

    def publish(self, end: End, message: bytes, source: str = "") -> None:
        """Send JSON to all, and retain it if the publisher is latched; raises `ValueError` if it is too large."""
        with self._lock:
            head, number = {"from": end.id, "topic": end.topic}, next(self._numbers)
            if end.latched:
                head |= {"source": source, "number": number}
            data = json.dumps(head)[:-1].encode() + b', "message": %b}' % message
            if len(data) > LARGEST:
                msg = f"a message of {len(message)} bytes on {end.topic}: a datagram holds at most {LARGEST}"
                raise ValueError(msg)
            if end.latched:
                end.retained[source] = number, data
                end.numbers = [number for number, _ in end.retained.values()]
            self._send(data)

    def drop(self, end: End, source: str) -> None:
        """Drop the retained message of a source."""
        with self._lock:
            end.retained.pop(source, None)
            end.numbers = [number for number, _ in end.retained.values()]

    def hello(self) -> None:
        """Announce this program with its publishers and subscriptions."""
        with self._lock:
            ends = {
                e.id: [e.kind, e.topic, e.type, e.latched, [n for n, _ in e.retained.values()]]
                for e in self._ends.values()
            }
            message = {"hello": self.id, "node": self.name, "by": self.by, "record": self.record, "ends": ends}
            self._send(json.dumps(message).encode())

    def close(self) -> None:
        """Announce the exit, and close the sockets."""
        with self._lock:
            self._send(json.dumps({"bye": self.id}).encode())
            self._closed = True
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(2 * BEAT)
        self._own.close()
        self._all.close()

    def _send(self, data: bytes, to: tuple[str, int] | None = None) -> None:
        if not self._closed:
            self._own.sendto(data, to or self._group)

    def _beat(self) -> None:
        while not self._closed:
            self.hello()
            time.sleep(BEAT)
            silent = [p.id for p in list(self.programs.values()) if time.monotonic() - p.last_seen > SILENT]
            for dead in silent:
                self._on_exit(dead)

    def _listen(self) -> None:
        while not self._closed:
            for sock in select.select([self._own, self._all], [], [], BEAT)[0]:
                data, address = sock.recvfrom(65536)
                try:
                    self._dispatch(json.loads(data), address)
                except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
                    continue  # an invalid datagram, which any program may send

    def _dispatch(self, datagram: dict[str, Any], address: tuple[str, int]) -> None:
        if "from" in datagram:
            self._message(datagram)
        elif "hello" in datagram and datagram["hello"] != self.id:
            self._hello(datagram, address)
        elif "again" in datagram:
            self._again(datagram["again"], address)
        elif "bye" in datagram:
            self._on_exit(datagram["bye"])

    def _again(self, ends: list[str], address: tuple[str, int]) -> None:
        with self._lock:
            for end in (self._ends[id_] for id_ in ends if id_ in self._ends):
                for _, data in end.retained.values():
                    self._send(data, address)

    def _on_exit(self, program: str) -> None:
        silent = self.programs.pop(program, None)
        if silent is None:
            return
        of_it = {end.id for end in silent.ends.values()}
        with self._lock:
            for end in self._ends.values():
                end.received = {of: number for of, number in end.received.items() if of[0] not in of_it}
        self._changed()

    def _message(self, datagram: dict[str, Any]) -> None:
        program = self.programs.get(str(datagram["from"]).partition(".")[0])
        publisher = None if program is None else program.ends.get(datagram["from"])
        if publisher is None and "number" in datagram:
            return  # `_ask` requests it after the publisher's next hello, which lists its number
        id_ = str(datagram["from"]) if publisher is None else publisher.id
        with self._lock:
            ends = [e for e in self._ends.values() if e.topic == datagram["topic"] and e.take]
            receivers = [e.take for e in ends if self._is_new(e, id_, datagram)]
        for take in receivers:
            take(json.dumps(datagram["message"]).encode(), id_)

    @staticmethod
    def _is_new(end: End, publisher: str, datagram: dict[str, Any]) -> bool:
        if "number" not in datagram:
            return True
        of, number = (publisher, str(datagram["source"])), int(datagram["number"])
        new = number > end.received.get(of, 0)
        end.received[of] = max(number, end.received.get(of, 0))
        return new

    def _hello(self, datagram: dict[str, Any], address: tuple[str, int]) -> None:
        before = self.programs.get(datagram["hello"])
        appearance = next(self._appearances) if before is None else before.appearance
        now = Program(
            datagram["hello"], address, time.monotonic(), appearance, datagram["node"], datagram["by"],
            datagram["record"],
        )  # fmt: skip
        now.ends = {
            id_: End(f"{id_}@{appearance}", str(k), str(t), str(ty), bool(la), numbers=[int(n) for n in numbers])
            for id_, (k, t, ty, la, numbers) in datagram["ends"].items()
        }
        self.programs[now.id] = now
        self._ask(now)
        if before is None or (before.graph(), before.record) != (now.graph(), now.record):
            self._changed()

    def _ask(self, program: Program) -> None:
        """Request the retained messages that a latched subscription has not received."""
        with self._lock:
            latched = [e for e in self._ends.values() if e.kind == "sub" and e.latched]
            incomplete = [
                id_
                for id_, pub in program.ends.items()
                for sub in latched
                if sub.topic == pub.topic and pub.numbers
                if set(pub.numbers) - {number for (of, _), number in sub.received.items() if of == pub.id}
            ]
            if incomplete:
                self._send(json.dumps({"again": incomplete}).encode(), program.address)
