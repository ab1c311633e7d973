"""What all endpoints of the edge share, and the interface of its two DDS implementations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from bridge.adapters.ros2.graph.graph import Ros2Graph
from bridge.adapters.ros2.graph.heartbeats import Heartbeats
from bridge.adapters.ros2.graph.neighbors import ProcessWatch
from bridge.adapters.ros2.loop import ReadLoop
from bridge.adapters.ros2.participant import Participant
from bridge.adapters.ros2.services.held import HeldRequests
from bridge.adapters.ros2.services.port import ClientPort, ServerPort
from bridge.adapters.ros2.types import TypeSupports
from bridge.concurrency import DelayedCalls
from bridge.routing.edge import Endpoint, Obstacle

Closed = Callable[[Any], None]
"""Called with an endpoint that has closed."""

Replied = Callable[[int, bytes], None]
"""Called with the number of a request, and its reply as CDR."""


class Joined(NamedTuple):
    """The participant, its GUID prefix, and the size of its shared memory in bytes; 0 if it has none."""

    participant: Participant
    prefix: bytes
    segment: int


class Dds(ABC):
    """The DDS implementation of the worker's own participant, and all that depends on it.

    Attributes:
        types: creates the types of its endpoints.
    """

    types: TypeSupports

    @abstractmethod
    def join(self, state: Path, node: str) -> Joined:
        """Create the participant with one node; a process can have only one."""

    @abstractmethod
    def separates_versions(self) -> bool:
        """Return whether a writer can be restricted to the subscriptions of one version of its type."""

    @abstractmethod
    def obstacle(self, service: str, servers: Sequence[Endpoint]) -> Obstacle | None:
        """Return why a client here cannot call a service with these servers; None if it can."""

    @abstractmethod
    def open_client(
        self, name: str, service_class: Any, context: Ros2Context, replied: Replied, type_id: str | None
    ) -> ClientPort:
        """Create a client's endpoints; raises `MessageTypeError`.

        Args:
            name: the service's name.
            service_class: the service's type, from ``types``.
            context: the edge's shared state.
            replied: called with each reply that does not arrive at the client's own reader.
            type_id: the version of the type that the requests have; None if the type has only one version.
        """

    @abstractmethod
    def open_server(self, name: str, service_class: Any, context: Ros2Context) -> ServerPort:
        """Create a server's endpoints; raises `MessageTypeError`."""

    @abstractmethod
    def follow(self, heartbeats: Heartbeats, endpoints: Iterable[Endpoint]) -> None:
        """Record the endpoints on the graph, so that writers can be prepared for new readers."""

    @abstractmethod
    def refresh(self, prefix: bytes, dead: Sequence[bytes], also: int) -> None:
        """Dispose dead participants; prompt all others to announce themselves, also to the port ``also`` if not 0."""

    @abstractmethod
    def clean(self, prefix: bytes, past: Iterable[bytes]) -> None:
        """Remove what this daemon's dead participants have left on this machine."""

    @abstractmethod
    def details(self, endpoints: Collection[Endpoint]) -> dict[str, Any]:
        """Return the part of the worker's status that names nodes on another DDS."""

    @abstractmethod
    def notes(self, endpoints: Collection[Endpoint]) -> Mapping[str, list[str]]:
        """Return what ``explain`` adds about services, by name."""

    @abstractmethod
    def warnings(self, endpoints: Collection[Endpoint], served: Collection[str]) -> list[str]:
        """Return warnings about nodes on another DDS; ``served`` are the services that the bridge serves."""


@dataclass(frozen=True, slots=True)
class Ros2Context:
    """The shared state of the edge's endpoints."""

    participant: Participant
    loop: ReadLoop
    graph: Ros2Graph
    processes: ProcessWatch
    later: DelayedCalls
    heartbeats: Heartbeats
    dds: Dds
    held: HeldRequests
