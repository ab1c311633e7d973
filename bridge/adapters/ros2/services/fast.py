"""Clients and servers on Fast DDS: rcl's clients and services, used with bytes (`bridge.adapters.ros2.rcl`)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, ClassVar

from typing_extensions import override

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.context import Replied, Ros2Context
from bridge.adapters.ros2.graph import vendors
from bridge.adapters.ros2.participant import SERVICE
from bridge.adapters.ros2.services import cyclone
from bridge.adapters.ros2.services.matching import MatchCounter
from bridge.adapters.ros2.services.port import ClientPort, Framed, ServerPort
from bridge.adapters.ros2.services.sender import FastSender


class FastClient(ClientPort):
    """An rcl client. Raises `MessageTypeError` if the middleware refuses it."""

    def __init__(
        self, name: str, service_class: Any, context: Ros2Context, replied: Replied, type_id: str | None
    ) -> None:
        self.handle = context.participant.make_client(service_class, name, SERVICE)
        self._pointer, self._taker = int(self.handle.pointer), rcl.CallTaker()
        self.sender = FastSender(name, self._pointer, service_class.response_support, context, replied, type_id)

    @override
    def wake(self, waker: rcl.Waker | None) -> None:
        rcl.wake("client", self._pointer, waker)

    @override
    def replies(self, taker: rcl.Taker, limit: int) -> Iterator[tuple[int, bytes]]:
        for _ in range(limit):
            taken = self._taker.response(self._pointer)
            if taken is not None:  # else a reply to another client, as DDS delivers each reply to all clients
                request, payload = taken
                yield request.number, payload

    @override
    def close(self) -> None:
        self._taker.close()


class FastServer(ServerPort):
    """An rcl service. Raises `MessageTypeError` if the middleware refuses it."""

    listed_after: ClassVar[float] = math.inf  # a request may arrive before its client is discovered

    def __init__(self, name: str, service_class: Any, context: Ros2Context) -> None:
        self.handle = context.participant.make_server(service_class, name, SERVICE)
        self._pointer, self._taker = int(self.handle.pointer), rcl.CallTaker()
        self._reach = cyclone.ReplyReach(name, MatchCounter(self._pointer, "service"), context)

    @override
    def wake(self, waker: rcl.Waker | None) -> None:
        rcl.wake("service", self._pointer, waker)

    @override
    def requests(self, taker: rcl.Taker, limit: int) -> Iterator[tuple[rcl.RequestId, bytes]]:
        for _ in range(limit):
            taken = self._taker.request(self._pointer)
            if taken is not None:
                yield taken

    @override
    def unwrap(self, request: rcl.RequestId, payload: bytes) -> Framed:
        return cyclone.unwrap_request(payload) if vendors.is_cyclone(request.gid) else Framed(b"", payload)

    @override
    def send(self, request: rcl.RequestId, payload: bytes) -> bool:
        of_cyclone = vendors.is_cyclone(request.gid)
        if of_cyclone and not self._reach.reaches(request.gid):
            return False
        reached = rcl.send_response(self._pointer, request, payload)
        if of_cyclone:
            self._reach.count_reply()
        return reached

    @override
    def retain(self, clients: set[bytes]) -> None:
        self._reach.retain(clients)

    @override
    def discard(self, client: bytes) -> None:
        self._reach.discard(client)

    @override
    def close(self) -> None:
        self._taker.close()
