"""What a client or a server of a service needs from the worker's DDS: endpoints, and requests and replies as bytes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from typing import Any, ClassVar, NamedTuple

from bridge.adapters.ros2 import rcl
from bridge.hub.endpoints.calls import CallError


class Framed(NamedTuple):
    """A payload without its header: ``header`` has Cyclone DDS's 16 bytes, or none; ``payload`` is CDR."""

    header: bytes
    payload: bytes


class RequestSender(ABC):
    """Sends the requests of one client. Not thread-safe: the client's lock is held."""

    @abstractmethod
    def has_server(self) -> bool:
        """Return whether the client and a server have discovered each other."""

    @abstractmethod
    def obstacle(self) -> CallError | None:
        """Return why the matched servers cannot be called; the graph is read only after a change."""

    @property
    @abstractmethod
    def outdated(self) -> bool:
        """Whether another server has matched since `obstacle`."""

    @property
    @abstractmethod
    def recipients(self) -> frozenset[bytes]:
        """The GIDs of the servers that get requests, as of `obstacle`, which may be newer than the last snapshot."""

    @abstractmethod
    def wait(self, servers: Collection[bytes]) -> float:
        """Return the seconds until a request may be sent to these servers; raises `UnsentCallError`."""

    @abstractmethod
    def prepare(self, servers: Collection[bytes]) -> float:
        """Prepare servers on Cyclone DDS for requests; return the seconds until they are ready, 0 if they are.

        Raises `UnsentCallError` if they cannot be called.
        """

    @abstractmethod
    def send(self, request: bytes) -> int:
        """Send a request; return its number. Raises `RclError`."""

    @abstractmethod
    def close(self) -> None:
        """Stop receiving replies that do not arrive at the client's own reader."""


class ServicePort(ABC):
    """The DDS endpoints of a client or a server.

    Attributes:
        handle: rclpy's inner object, or one with its methods, for `bridge.adapters.ros2.loop.EndpointReader`.
    """

    handle: Any

    @abstractmethod
    def wake(self, waker: rcl.Waker | None) -> None:
        """Report new requests or replies to a waker; with None, stop that before returning."""

    @abstractmethod
    def close(self) -> None:
        """Release what the handle does not hold; nothing is sent or taken afterwards."""


class ClientPort(ServicePort):
    """The endpoints of a client, and the ``sender`` of its requests."""

    sender: RequestSender

    @abstractmethod
    def replies(self, taker: rcl.Taker, limit: int) -> Iterator[tuple[int, bytes]]:
        """Take up to ``limit`` replies; yield those to this client with the numbers of their requests."""


class ServerPort(ServicePort):
    """The endpoints of a server.

    Attributes:
        listed_after: seconds after a request by which the graph lists its client, unless the client has left.
    """

    listed_after: ClassVar[float]

    @abstractmethod
    def requests(self, taker: rcl.Taker, limit: int) -> Iterator[tuple[rcl.RequestId, bytes]]:
        """Take and yield up to ``limit`` requests, as they were received."""

    @abstractmethod
    def unwrap(self, request: rcl.RequestId, payload: bytes) -> Framed:
        """Separate the header from a request; raises `MessageTypeError` if the request cannot be served."""

    @abstractmethod
    def send(self, request: rcl.RequestId, payload: bytes) -> bool:
        """Send a reply with its header; return False if its client is unreachable. Raises `RclError`."""

    @abstractmethod
    def retain(self, clients: set[bytes]) -> None:
        """Forget all clients except these, by their GIDs."""

    @abstractmethod
    def discard(self, client: bytes) -> None:
        """Forget one client."""
