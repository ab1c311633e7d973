"""Requests and replies as Cyclone DDS exchanges them.

rmw_fastrtps sends the identity of a request as inline QoS. rmw_cyclonedds puts it into the payload of the request and
of its reply: the encapsulation header is followed by the client's id (8 bytes) and the request's number (int64 in the
payload's byte order; ``cdds_request_header_t`` in rmw_cyclonedds_cpp's serdata.hpp). 16 bytes do not change the
alignment of what follows. rcl's client drops replies without inline QoS, so a separate reader receives them.
"""

from __future__ import annotations

import os
import struct
import threading
import time
from collections.abc import Collection

from typing_extensions import override

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.context import Replied, Ros2Context
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.adapters.ros2.loop import EndpointReader
from bridge.adapters.ros2.participant import reply_topic, request_topic
from bridge.adapters.ros2.rcl import ENCAPSULATION
from bridge.adapters.ros2.services.matching import MatchCounter
from bridge.adapters.ros2.services.port import Framed
from bridge.messages.errors import MessageTypeError

HEADER = struct.Struct("<8sq")
_BODY = len(ENCAPSULATION) + HEADER.size
_PADDING = 3
"""Bits of the encapsulation's last byte that count the padding bytes at the end (DDS-XTypes 1.3, 7.6.3.1.2)."""

FIRST_NUMBER = 1 << 40
"""Beyond the numbers of requests to servers on Fast DDS, which count from 1."""

PATIENCE_SECONDS = 1.0
"""Seconds after which a reply is sent although not all readers of its topic have matched."""


def unwrap(payload: bytes) -> Framed | None:
    """Separate the header from a request or a reply; return None unless it is little-endian CDR with a header."""
    if payload[:2] != ENCAPSULATION[:2] or len(payload) < _BODY:
        return None
    end = len(payload) - (payload[3] & _PADDING)
    return Framed(payload[len(ENCAPSULATION) : _BODY], ENCAPSULATION + payload[_BODY : max(end, _BODY)])


def unwrap_request(payload: bytes) -> Framed:
    """Separate the header from a request; raises `MessageTypeError` unless it is little-endian CDR with a header."""
    framed = unwrap(payload)
    if framed is None:
        raise MessageTypeError("the request is not little-endian CDR with Cyclone DDS's header")
    return framed


def wrap(header: bytes, payload: bytes) -> bytes:
    """Return a request or a reply with its header."""
    return ENCAPSULATION + header + payload[len(ENCAPSULATION) :]


class CycloneCalls(EndpointReader):
    """The requests of one client to servers on Cyclone DDS, and the reader of their replies.

    Raises `MessageTypeError` if the middleware refuses the reader.
    """

    def __init__(self, name: str, response_support: int, context: Ros2Context, replied: Replied) -> None:
        self._reader = context.participant.make_raw_reader(response_support, reply_topic(name))
        super().__init__(context.participant, self._reader)
        self._topic, self._graph, self._heartbeats = request_topic(name), context.graph, context.heartbeats
        self._replied = replied
        self._id = os.urandom(8)
        self._number = FIRST_NUMBER
        self._matched, self._prepared_at = (0, frozenset[bytes]()), 0.0

    @override
    def wake(self, waker: rcl.Waker | None) -> None:
        self._reader.wake(waker)

    def wait(self, poll: float, servers: Collection[bytes], last: int) -> float:
        """Return the seconds until a request may be sent, 0 for now, and ``poll`` while no server has matched.

        The first call after a match begins to prepare the servers; ``last`` is the number of requests written before.
        """
        matched = self._reader.matched(), frozenset(servers)
        writer = self._graph.own_writer(self._topic) if matched != self._matched else None
        if writer is not None:
            self._matched, self._prepared_at = matched, self._heartbeats.prepare(writer, last, servers)
        return max(0.0, self._prepared_at - time.monotonic()) if self._matched[0] else poll

    def wrap(self, request: bytes) -> tuple[int, bytes]:
        """Return a request's number, and its payload with a header."""
        self._number += 1
        return self._number, wrap(HEADER.pack(self._id, self._number), request)

    @override
    def drain(self, taker: rcl.Taker, limit: int) -> None:
        for _ in range(limit):
            payload = self._reader.take(taker)
            if payload is None:
                return
            framed = unwrap(payload)
            if framed is None:
                continue
            client, number = HEADER.unpack(framed.header)
            if client == self._id:  # DDS delivers each reply to all clients of the service
                self._replied(number, framed.payload)


class ReplyReach:
    """Checks whether replies reach clients on Cyclone DDS; rmw_fastrtps checks this only for clients on Fast DDS."""

    def __init__(self, service: str, matches: MatchCounter, context: Ros2Context) -> None:
        self._service, self._matches = service, matches
        self._graph, self._heartbeats = context.graph, context.heartbeats
        self._lock = threading.Lock()
        self._reached: set[bytes] = set()
        self._tried: dict[bytes, float] = {}
        self._replies = 0

    def reaches(self, gid: bytes) -> bool:
        """Return whether the client with this request writer can receive, as far as can be known.

        The result is False at the first call, which begins to send heartbeats.
        """
        with self._lock:
            if gid in self._reached:
                return True
            readers = self._graph.reply_readers(self._service)
            if not any(reader[:PREFIX_BYTES] == gid[:PREFIX_BYTES] for reader in readers):
                return False
            now, matched = time.monotonic(), self._matches.current()
            first = self._tried.setdefault(gid, now)
            few = matched is not None and matched < len(readers)
            if first == now or (few and now - first < PATIENCE_SECONDS):
                writer = self._graph.own_writer(reply_topic(self._service))
                if writer is not None:
                    self._heartbeats.prepare(writer, self._replies, [gid])
                return False
            del self._tried[gid]
            self._reached.add(gid)
            return True

    def count_reply(self) -> None:
        """Count a reply to a client on Cyclone DDS.

        Replies to other clients do not count, because rmw_fastrtps does not report whether it has dropped such a reply,
        and a heartbeat that announces more than was written would make the client skip its reply.
        """
        self._replies += 1

    def retain(self, gids: set[bytes]) -> None:
        """Remove all clients except these."""
        with self._lock:
            self._reached &= gids
            self._tried = {gid: since for gid, since in self._tried.items() if gid in gids}

    def discard(self, gid: bytes) -> None:
        """Remove one client."""
        with self._lock:
            self._reached.discard(gid)
            self._tried.pop(gid, None)
