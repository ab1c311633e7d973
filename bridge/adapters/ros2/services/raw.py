"""Clients and servers on Cyclone DDS: raw endpoints for requests and replies, which carry Cyclone DDS's header.

rmw_cyclonedds_cpp has no serializer that could be replaced (see `bridge.adapters.ros2.rcl`), but its requests and
replies are ordinary messages (`bridge.adapters.ros2.services.cyclone`). On another DDS the identity of a request is
outside the message, and Cyclone DDS does not report it. So servers on another DDS are not called, and clients on
another DDS get no replies.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Collection, Iterator
from typing import ClassVar, Protocol

from typing_extensions import override

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.context import Ros2Context
from bridge.adapters.ros2.graph import vendors
from bridge.adapters.ros2.graph.heartbeats import MATCH_SECONDS
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.adapters.ros2.services.cyclone import HEADER, PATIENCE_SECONDS, unwrap, unwrap_request, wrap
from bridge.adapters.ros2.services.port import ClientPort, Framed, RequestSender, ServerPort
from bridge.adapters.ros2.services.sender import MATCH_POLL, known_obstacle, refusal, refused_by
from bridge.hub.endpoints.calls import CallError
from bridge.messages.errors import MessageTypeError
from bridge.routing.edge import MadeBy


class Pair(Protocol):
    """A reader, and a writer in the other direction: `bridge.adapters.ros2.dds.cyclone.CyclonePair`."""

    def wake(self, waker: rcl.Waker | None) -> None:
        """Report new messages to a waker; with None, stop that before returning."""

    def take(self, taker: rcl.Taker) -> bytes | None:
        """Return the next message as CDR, or None."""

    def take_with_gid(self, taker: rcl.Taker) -> rcl.Taken | None:
        """Return the next message with the GUID of its writer, or None."""

    def publish(self, payload: bytes) -> None:
        """Publish CDR bytes; raises `RclError`."""

    def matched(self) -> int:
        """Return the number of writers that the reader has matched."""

    def matched_readers(self) -> frozenset[bytes]:
        """Return the GUIDs of the readers that the writer has matched; b"" for an unknown reader."""


class RawClient(ClientPort):
    """The writer of a client's requests, and the reader of its replies."""

    def __init__(self, name: str, pair: Pair, context: Ros2Context, type_id: str | None) -> None:
        self.handle = self._pair = pair
        self._id = os.urandom(8)
        self.sender = RawSender(name, pair, self._id, context, type_id)

    @override
    def wake(self, waker: rcl.Waker | None) -> None:
        self._pair.wake(waker)

    @override
    def replies(self, taker: rcl.Taker, limit: int) -> Iterator[tuple[int, bytes]]:
        for _ in range(limit):
            payload = self._pair.take(taker)
            if payload is None:
                return
            framed = unwrap(payload)
            if framed is not None:
                client, number = HEADER.unpack(framed.header)
                if client == self._id:  # DDS delivers each reply to all clients of the service
                    yield number, framed.payload

    @override
    def close(self) -> None:
        """Do nothing: the handle holds everything."""


class RawSender(RequestSender):
    """Sends the requests of a client, only while all servers that it has matched are on Cyclone DDS.

    DDS delivers a request to all of these servers, and a server on another DDS would execute it with wrong values.
    """

    def __init__(self, name: str, pair: Pair, client: bytes, context: Ros2Context, type_id: str | None) -> None:
        self._name, self._pair, self._id, self._context, self._type_id = name, pair, client, context, type_id
        self._number = 0
        self._verified: tuple[frozenset[bytes], frozenset[bytes]] | None = None
        self._first_matched: dict[bytes, float] = {}

    def _servers(self) -> frozenset[bytes]:
        """Return the GUIDs of the servers that have matched, except those of Midspan."""
        made_by = self._context.participant.marks.made_by
        return frozenset(gid for gid in self._pair.matched_readers() if made_by(gid) is not MadeBy.MIDSPAN)

    @override
    def has_server(self) -> bool:
        return bool(self._servers()) and self._pair.matched() > 0

    @override
    def obstacle(self) -> CallError | None:
        known = known_obstacle(self._context, self._name)
        if known is not None:
            return known
        matched = self._servers()
        if not all(map(vendors.is_cyclone, matched)):  # the graph may list the other server only later
            return refusal(vendors.not_on_cyclone(self._name))
        present = self._context.graph.snapshot.servers.get(self._name, frozenset())
        if (matched, present) != self._verified:
            refused = refused_by(self._context.graph.servers(self._name), self._context, self._name, self._type_id)
            if refused is not None:
                return refused
            self._verified = matched, present
        return None

    @property
    @override
    def outdated(self) -> bool:
        return self._verified is None or self._servers() != self._verified[0]

    @property
    @override
    def recipients(self) -> frozenset[bytes]:
        return frozenset() if self._verified is None else self._verified[0]

    @override
    def prepare(self, servers: Collection[bytes]) -> float:
        """Return the seconds until the servers have matched the reader of the replies, which DDS does not report."""
        now, matched = time.monotonic(), self._servers()
        if not matched:
            return MATCH_POLL
        self._first_matched = {gid: self._first_matched.get(gid, now) for gid in matched}
        return max(0.0, max(self._first_matched.values()) + MATCH_SECONDS - now)

    @override
    def wait(self, servers: Collection[bytes]) -> float:
        return self.prepare(servers)

    @override
    def send(self, request: bytes) -> int:
        self._number += 1
        self._pair.publish(wrap(HEADER.pack(self._id, self._number), request))
        return self._number

    @override
    def close(self) -> None:
        """Do nothing: the client's own reader receives the replies."""


ReplyReaders = Callable[[], list[bytes]]
"""Returns the GIDs of all readers of a service's replies; reads the graph."""


class RawServer(ServerPort):
    """The reader of a server's requests, and the writer of its replies."""

    listed_after: ClassVar[float] = 1.0  # Cyclone DDS discovers a client before its request, the graph soon after

    def __init__(self, pair: Pair, reply_readers: ReplyReaders) -> None:
        self.handle = self._pair = pair
        self._reply_readers = reply_readers
        self._lock = threading.Lock()
        self._reached: set[bytes] = set()
        self._tried: dict[bytes, float] = {}

    @override
    def wake(self, waker: rcl.Waker | None) -> None:
        self._pair.wake(waker)

    @override
    def requests(self, taker: rcl.Taker, limit: int) -> Iterator[tuple[rcl.RequestId, bytes]]:
        """Take and yield up to ``limit`` requests; a request's number is in its header, and 0 without a header."""
        for _ in range(limit):
            taken = self._pair.take_with_gid(taker)
            if taken is None:
                return
            framed = unwrap(taken.payload)
            number = 0 if framed is None else HEADER.unpack(framed.header)[1]
            yield rcl.RequestId(taken.gid, number), taken.payload

    @override
    def unwrap(self, request: rcl.RequestId, payload: bytes) -> Framed:
        if not vendors.is_cyclone(request.gid):
            raise MessageTypeError(vendors.CLIENT_NOT_ON_CYCLONE)
        return unwrap_request(payload)

    @override
    def send(self, request: rcl.RequestId, payload: bytes) -> bool:
        if not self._reaches(request.gid):
            return False
        self._pair.publish(payload)
        return True

    def _reaches(self, client: bytes) -> bool:
        """Return whether the writer of the replies has matched all readers of replies in the client's participant.

        DDS does not report which of several readers is the client's. After `PATIENCE_SECONDS` one matched reader
        suffices.
        """
        with self._lock:
            if client in self._reached:
                return True
            own = {gid for gid in self._reply_readers() if gid[:PREFIX_BYTES] == client[:PREFIX_BYTES]}
            matched, now = own & self._pair.matched_readers(), time.monotonic()
            late = now >= self._tried.setdefault(client, now) + PATIENCE_SECONDS
            if not matched or (matched != own and not late):
                return False
            del self._tried[client]
            self._reached.add(client)
            return True

    @override
    def retain(self, clients: set[bytes]) -> None:
        with self._lock:
            self._reached &= clients
            self._tried = {gid: since for gid, since in self._tried.items() if gid in clients}

    @override
    def discard(self, client: bytes) -> None:
        with self._lock:
            self._reached.discard(client)
            self._tried.pop(client, None)

    @override
    def close(self) -> None:
        """Do nothing: the handle holds everything."""
