"""The sending half of a client on Fast DDS: requests in the form that the servers need."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial

from typing_extensions import override

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.context import Replied, Ros2Context
from bridge.adapters.ros2.filters import ListFilter, is_available
from bridge.adapters.ros2.graph import vendors
from bridge.adapters.ros2.participant import request_topic
from bridge.adapters.ros2.services.cyclone import CycloneCalls
from bridge.adapters.ros2.services.matching import MatchCounter
from bridge.adapters.ros2.services.port import RequestSender
from bridge.hub.endpoints.calls import CallError, UnsentCallError
from bridge.messages.errors import MessageTypeError
from bridge.routing.edge import Endpoint, MadeBy, Obstacle

MATCH_POLL = 0.01
"""Seconds between two checks whether a server has matched."""


class FastSender(RequestSender):
    """Sends the requests of one client on Fast DDS.

    Servers on Cyclone DDS get requests in another form, and their replies arrive at a separate reader. If a server has
    matched or left since the last request, the form is chosen from the graph again. A filter keeps requests from
    servers that need the other form.

    Raises `MessageTypeError` if the requests cannot be filtered.

    Args:
        pointer: the client's ``rcl_client_t *``.
        response_support: the address of the type support of the responses.
        replied: called with each reply of a server on Cyclone DDS.
        type_id: the version of the type that the requests have; None if the type has only one version.
    """

    def __init__(
        self, name: str, pointer: int, response_support: int, context: Ros2Context, replied: Replied,
        type_id: str | None = None,
    ) -> None:  # fmt: skip
        self._name, self._pointer, self._context, self._type_id = name, pointer, context, type_id
        self._open = partial(CycloneCalls, name, response_support, context, replied)
        self._matches = MatchCounter(pointer, "client")
        self._filter: ListFilter | None = None
        if is_available():  # rmw_get_gid_for_client returns the reader's GID in Kilted
            writer = context.graph.own_writer(request_topic(name)) or b""
            self._filter = ListFilter(name, writer)
        self._verified: tuple[int | None, frozenset[bytes]] = None, frozenset()
        self._recipients = frozenset[bytes]()
        self._on_cyclone = False
        self._cyclone: CycloneCalls | None = None
        self._written = 0

    @override
    def has_server(self) -> bool:
        return rcl.has_server(self._context.participant.pointer, self._pointer)

    @override
    def obstacle(self) -> CallError | None:
        known = known_obstacle(self._context, self._name)
        if known is not None:
            return known
        present = self._context.graph.snapshot.servers.get(self._name, frozenset())
        matched = self._matches.total()
        if matched is None or (matched, present) != self._verified:
            servers = self._context.graph.servers(self._name)
            refused = refused_by(servers, self._context, self._name, self._type_id)
            if refused is not None:
                return refused
            called = self._context.graph.called(servers)
            self._verified, self._on_cyclone = (matched, present), vendors.are_cyclone(called)
            self._recipients = frozenset(bytes.fromhex(server.id) for server in called)
            if self._filter is not None:
                self._filter.restrict(self._recipients)
        return None

    @property
    @override
    def outdated(self) -> bool:
        """Whether another server, which may need the other form, has matched since `obstacle`."""
        return self._matches.total() not in (None, self._verified[0])

    @property
    @override
    def recipients(self) -> frozenset[bytes]:
        return self._recipients

    @override
    def wait(self, servers: Collection[bytes]) -> float:
        return self.prepare(servers) if self._on_cyclone else 0.0

    @override
    def prepare(self, servers: Collection[bytes]) -> float:
        return self._calls().wait(MATCH_POLL, servers, self._written)

    @override
    def send(self, request: bytes) -> int:
        if not self._on_cyclone:
            self._written = rcl.send_request(self._pointer, request)
            return self._written
        number, wrapped = self._calls().wrap(request)
        self._written = rcl.send_request(self._pointer, wrapped)
        return number

    def _calls(self) -> CycloneCalls:
        if self._cyclone is None:
            try:
                self._cyclone = self._open()
            except MessageTypeError as err:
                raise UnsentCallError(str(err)) from None
            self._context.loop.add(self._cyclone)
        return self._cyclone

    @override
    def close(self) -> None:
        """Stop receiving replies of servers on Cyclone DDS."""
        if self._cyclone is not None:
            self._context.loop.remove(self._cyclone)


def known_obstacle(context: Ros2Context, service: str) -> CallError | None:
    """Return why the servers of the last snapshot cannot be called; None if they can."""
    known = context.graph.snapshot.obstacles.get(service)
    return None if known is None else refusal(known)


def refused_by(
    servers: Sequence[Endpoint], context: Ros2Context, service: str, type_id: str | None
) -> CallError | None:
    """Return why a client of the version ``type_id`` cannot call these servers; None if it can."""
    obstacle = context.graph.obstacle(service, servers, type_id)
    if obstacle is not None:
        return refusal(obstacle)
    if not any(server.made_by is MadeBy.NATIVE for server in servers):  # it has just left
        return CallError(f"{service} has no server on ROS 2")
    return None


def refusal(obstacle: Obstacle) -> UnsentCallError:
    """Return the error of a call that an obstacle prevents."""
    return UnsentCallError(f"{obstacle.reason}; {obstacle.cure}")
