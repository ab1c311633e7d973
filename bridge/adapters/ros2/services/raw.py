"""Clients and servers on Cyclone DDS: raw endpoints for requests and replies, which carry its header.

rmw_cyclonedds_cpp has no serializer that could be replaced (see `bridge.adapters.ros2.rcl`), but its requests and
replies are ordinary messages (`bridge.adapters.ros2.services.cyclone`). Those of clients and servers on another DDS are
not: the identity of a request is outside the message, and Cyclone DDS does not report it. So such servers are not
called, and such clients get no replies.
"""

from __future__ import annotations

import os
import time
from collections.abc import Collection, Iterator
from typing import Any

from typing_extensions import override

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.graph import vendors
from bridge.adapters.ros2.graph.heartbeats import MATCH_SECONDS
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.adapters.ros2.participant import SERVICE, Participant, reply_topic, request_topic
from bridge.adapters.ros2.rmw import RmwPair
from bridge.adapters.ros2.services.cyclone import HEADER, unwrap, wrap
from bridge.adapters.ros2.services.endpoint import Ros2Context
from bridge.adapters.ros2.services.sender import MATCH_POLL, RequestSender
from bridge.hub.endpoints.calls import CallError, UnsentCallError
from bridge.routing.edge import MadeBy


class RawClient(RmwPair):
    """The writer of a client's requests, and the reader of its replies."""

    def __init__(self, name: str, service_class: Any, participant: Participant) -> None:
        replies = service_class.response_support, reply_topic(name)
        requests = service_class.request_support, request_topic(name)
        with participant.creating():
            super().__init__(participant.pointer, replies, requests, SERVICE.depth)
        self._id = os.urandom(8)
        self._number = 0

    def send(self, request: bytes) -> int:
        """Send a request; return its number. Raises `RclError`."""
        self._number += 1
        self.writer.publish(wrap(HEADER.pack(self._id, self._number), request))
        return self._number

    def replies(self, taker: rcl.Taker, limit: int) -> Iterator[tuple[int, bytes]]:
        """Yield replies with the numbers of their requests; DDS delivers each reply to all clients of a name."""
        for _ in range(limit):
            payload = self.take(taker)
            if payload is None:
                return
            framed = unwrap(payload)
            if framed is not None:
                client, number = HEADER.unpack(framed.header)
                if client == self._id:
                    yield number, framed.payload


class RawServer(RmwPair):
    """The reader of a server's requests, and the writer of its replies."""

    def __init__(self, name: str, service_class: Any, participant: Participant) -> None:
        requests = service_class.request_support, request_topic(name)
        replies = service_class.response_support, reply_topic(name)
        with participant.creating():
            super().__init__(participant.pointer, requests, replies, SERVICE.depth)
        self._participant = participant

    def request(self, taker: rcl.Taker) -> tuple[rcl.RequestId, bytes] | None:
        """Return the next request with its header; the number in its id is that of the header, if it has one."""
        taken = self.take_with_gid(taker)
        if taken is None:
            return None
        framed = unwrap(taken.payload)
        number = HEADER.unpack(framed.header)[1] if framed is not None else 0
        return rcl.RequestId(taken.gid, number), taken.payload

    def reply(self, payload: bytes) -> None:
        """Send a reply with its header; raises `RclError`."""
        self.writer.publish(payload)

    def reaches(self, client: bytes) -> bool:
        """Return whether the replies' writer has matched a reader of a client's participant."""
        matched = self._participant.matched_readers(self.writer)
        return any(reader[:PREFIX_BYTES] == client[:PREFIX_BYTES] for reader in matched)


class RawReach:
    """A `bridge.adapters.ros2.services.cyclone.Reach`: Cyclone DDS reports which readers a writer has matched."""

    def __init__(self, server: RawServer) -> None:
        self._server = server

    def reaches(self, gid: bytes) -> bool:
        """Return whether a client's reader has matched."""
        return self._server.reaches(gid)

    def written(self) -> None:
        """Do nothing: replies are not counted."""

    def retain(self, gids: set[bytes]) -> None:
        """Do nothing: each reply asks again."""

    def discard(self, gid: bytes) -> None:
        """Do nothing: each reply asks again."""


class RawSender(RequestSender):
    """Sends the requests of a client on Cyclone DDS, only while all native servers that it has matched are on it, too.

    DDS delivers a request to all of them, and one on another DDS would execute it with wrong values.
    """

    def __init__(self, name: str, client: RawClient, context: Ros2Context, type_id: str | None) -> None:
        self._name, self._client, self._context, self._type_id = name, client, context, type_id
        self._participant = context.participant
        self._verified_servers: tuple[frozenset[bytes], frozenset[bytes]] | None = None
        self._first_matched: dict[bytes, float] = {}

    def _matched(self) -> frozenset[bytes]:
        return self._participant.matched_readers(self._client.writer)

    def _native(self) -> frozenset[bytes]:
        made_by = self._participant.marks.made_by
        return frozenset(gid for gid in self._matched() if made_by(gid) is not MadeBy.MIDSPAN)

    @override
    def has_server(self) -> bool:
        return bool(self._native()) and self._client.matched() > 0

    @override
    def obstacle(self) -> CallError | None:
        known = self._known_obstacle()
        if known is not None:
            return known
        native = self._native()
        if not all(map(vendors.is_cyclone, native)):  # the graph may list it later
            return UnsentCallError(f"{self._name}: {vendors.SERVERS_ON_CYCLONE_ONLY}")
        present = self._context.graph.snapshot.servers.get(self._name, frozenset())
        if (native, present) != self._verified_servers:
            refused = self._refused(self._context.graph.servers(self._name))
            if refused is not None:
                return refused
            self._verified_servers = native, present
        return None

    @property
    @override
    def outdated(self) -> bool:
        return self._verified_servers is None or self._native() != self._verified_servers[0]

    @override
    def prepare(self, servers: Collection[bytes]) -> float:
        """Return the seconds until the servers have matched the reader of the replies, which DDS does not report."""
        now, native = time.monotonic(), self._native()
        if not native:
            return MATCH_POLL
        self._first_matched = {gid: self._first_matched.get(gid, now) for gid in native}
        return max(0.0, max(self._first_matched.values()) + MATCH_SECONDS - now)

    @override
    def wait(self, servers: Collection[bytes]) -> float:
        return self.prepare(servers)

    @override
    def send(self, request: bytes) -> int:
        return self._client.send(request)

    @override
    def close(self) -> None:
        """Do nothing: the client's own reader receives the replies."""
