"""The interface through which the engine, which routes between a side and the hub, uses the side's edge.

An edge only lists its side's graph, opens and closes endpoints there, and passes bytes on.
Rules, conversion, queues, latching, origins and counters are implemented only once, in the engine (``bridge.routing``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

from bridge.clock import SYSTEM, RunClock
from bridge.hub.endpoints.calls import Abandon, Call, Done
from bridge.hub.graph.tokens import Origin
from bridge.hub.wire.qos import Qos
from bridge.messages.errors import MessageTypeError
from bridge.messages.transcode.conversion import Conversion, ServiceConversion, SideType
from bridge.status import ConnectionStatus

if TYPE_CHECKING:
    from bridge.config.sections.routing import ParameterRule
    from bridge.hub.node import Hub

_NO_SERVICES = "{name}: services are not bridged to {side}"

Deliver = Callable[[bytes, str, int | None], None]
"""``deliver(payload, source, time_ns)`` handles one message, serialized as on the side; ``source`` is the id of the
endpoint that published it, ``time_ns`` its source timestamp on the system clock, or None if the middleware has none."""


class Kind(Enum):
    """The kind of an endpoint."""

    PUBLISHER = "publisher"
    SUBSCRIPTION = "subscription"
    SERVER = "server"
    CLIENT = "client"


class MadeBy(Enum):
    """Who created an endpoint on the side's network. Only NATIVE endpoints are bridged to the hub."""

    NATIVE = "native"
    MIDSPAN = "midspan"
    UNKNOWN = "unknown"


class Obstacle(NamedTuple):
    """Why calls to a server or from a client are not bridged, and how to fix that."""

    reason: str
    cure: str


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One publisher, subscription, server or client in a side's graph.

    Every edge represents an action as ROS 2 does: as the servers ``<action>/_action/send_goal``, ``cancel_goal`` and
    ``get_result``, and the publishers ``<action>/_action/feedback`` and ``status``.

    Attributes:
        id: unique on the side while the endpoint exists (ROS 2: GID in hex; ROS 1: node name and topic). A publisher
            that returns, or changes its QoS, needs a new id, because the engine may still follow the former endpoint.
        topic: absolute name of the topic or service as the side spells it.
        type: the type's name as the side spells it (ROS 1 ``std_msgs/String``, ROS 2 ``std_msgs/msg/String``; services
            ``std_srvs/SetBool``, ``std_srvs/srv/SetBool``; an action's ``nav2_msgs/action/NavigateToPose_SendGoal``).
        type_id: the type hash that the endpoint announced (md5 or RIHS01), "" if unknown.
        definition: full definition text if the middleware carries one (ROS 1 connection header), else "".
        node: fully qualified node name, for people.
        obstacle: why calls to this server, or from this client, are not bridged; None if they are bridged.
        uncalled: why this server gets no calls although others of the same name do; None if it gets calls.
    """

    id: str
    kind: Kind
    topic: str
    type: str
    qos: Qos
    made_by: MadeBy
    node: str = ""
    type_id: str = ""
    definition: str = ""
    obstacle: Obstacle | None = None
    uncalled: Obstacle | None = None


@dataclass(frozen=True, slots=True)
class Sighting:
    """Another Midspan worker that is now on this side's network.

    ``id`` identifies the worker, in a form that the edge chooses. ``record`` is its last announcement
    (`Edge.announce`), None before the first. ``received`` is ``time.monotonic()`` when the announcement arrived, or
    when the worker was first seen.
    """

    id: str
    record: bytes | None
    received: float


def is_command(qos: Qos) -> bool:
    """Return whether only the newest message counts, as for the engine's commands: volatile, with depth 1."""
    return qos.depth == 1 and not qos.latched


class EdgeListener(Protocol):
    """An edge's notifications to the engine; each call returns at once."""

    def graph_changed(self) -> None:
        """The endpoints, their properties or the network's identity may have changed."""

    def presence_changed(self) -> None:
        """Another Midspan worker joined this side's network, left it, or announced something."""

    def message_refused(self, topic: str, reason: str, why: str) -> None:
        """A message on this topic of the side was not delivered; ``reason`` is ``bad`` or ``large``."""

    def edge_failed(self, reason: str) -> None:
        """The edge cannot continue; the worker's process exits and is restarted."""


class EdgeSubscription(Protocol):
    """A subscription that the bridge holds on the side."""

    @property
    def lost(self) -> int:
        """Number of messages that the side has lost so far; 0 if it does not report them."""

    def close(self) -> None:
        """Stop delivering and close the endpoint. Safe to call twice."""


class EdgePublisher(Protocol):
    """A publisher that the bridge holds on the side.

    It may have an attribute ``native``: None, or an object with the attribute ``output``, by which C code sends small
    messages instead of `send` (``output.h``).
    """

    @property
    def dropped(self) -> int:
        """Number of messages that slow subscribers of this topic missed so far; 0 if the side does not report them."""

    @property
    def has_subscribers(self) -> bool:
        """Whether the topic has subscribers on the side; True if the side does not report them.

        The edge calls `EdgeListener.graph_changed` when the value changes.
        """

    def send(self, payload: bytes, source: str) -> None:
        """Publish bytes from the hub publisher ``source``; with a latched QoS, retain them for each source."""

    def drop_source(self, source: str) -> None:
        """Drop the messages retained for the hub publisher ``source``, which has left."""

    def close(self) -> None:
        """Close the endpoint. Safe to call twice."""


class EdgeCaller(Protocol):
    """A service client that the bridge holds on the side."""

    def call(self, request: bytes, done: Done) -> Abandon:
        """Begin a call with a request in the side's encoding; see `bridge.hub.endpoints.calls.Call`. Never blocks."""

    def close(self) -> None:
        """End every pending call with an error, and close the endpoint. Safe to call twice."""


class EdgeServer(Protocol):
    """A server that the bridge holds on the side."""

    def close(self) -> None:
        """Abandon every pending call, inform its client, and close the endpoint. Safe to call twice."""


class Edge(ABC):
    """The edge of one side. After `start`, any thread may call its methods, none of which blocks on a peer."""

    side: ClassVar[str]
    services: ClassVar[bool] = False
    """Whether services and actions are bridged; otherwise they are not reported."""

    own_threads: ClassVar[bool] = False
    """Whether the threads that deliver messages of more than `bridge.routing.limits.BULK` serve one publisher each."""

    sends_views: ClassVar[bool] = False
    """Whether `EdgePublisher.send` also accepts a memoryview, which is invalid after the call."""

    outlives_network: ClassVar[bool] = False
    """Whether endpoints keep their ids if the network's identity changes, as in ROS 1 when only the master restarts."""

    one_queue: ClassVar[bool] = False
    """Whether all publishers of a topic share one queue to each subscriber, as in a ROS 1 node: commands, which are not
    queued, then exclude other messages from the topic."""

    awaited: ClassVar[str] = "its network"
    """What the edge waits for while the network is unavailable; shown to people."""

    away: str = ""
    """Why the network is unavailable, if the edge knows a reason; shown to people."""

    clock: RunClock = SYSTEM
    """The clock for stamps; the worker sets it before `start`."""

    @abstractmethod
    def start(self, listener: EdgeListener) -> None:
        """Start joining the network, and return at once; if the network is unavailable, it is joined later."""

    @abstractmethod
    def stop(self) -> None:
        """Close and unregister everything that the edge created, within two seconds. Safe to call twice."""

    @abstractmethod
    def network(self) -> str | None:
        """Return the identity of the joined network, None while it is unavailable."""

    @abstractmethod
    def is_own_network(self, origin: Origin) -> bool:
        """Return whether an origin on the hub is the network of this edge."""

    @abstractmethod
    def endpoints(self) -> Sequence[Endpoint]:
        """Return the side's graph as last seen, without this edge's own endpoints."""

    @abstractmethod
    def to_hub(self, endpoint: Endpoint) -> Conversion:
        """Return the conversion of an endpoint's type to the hub; raises `bridge.messages.errors.MessageTypeError`."""

    @abstractmethod
    def from_hub(self, type_name: str, type_hash: str) -> Conversion:
        """Return the conversion from a hub type to the side; raises `bridge.messages.errors.MessageTypeError`."""

    @abstractmethod
    def learn(self, type_name: str, definition: str) -> None:
        """Store the definition of a ROS 2 type, received from another worker on the hub, for a later `from_hub`."""

    @abstractmethod
    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> EdgeSubscription:
        """Subscribe on the side; the edge calls ``deliver`` on its threads, one call at a time per source."""

    @abstractmethod
    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> EdgePublisher:
        """Advertise on the side; raises `bridge.messages.errors.MessageTypeError` if the type cannot be used.

        A command's QoS has a lifespan: the side must not deliver it later, for example after its network was down.
        """

    def service_to_hub(self, endpoint: Endpoint) -> ServiceConversion:
        """Return the conversion of a server's type; raises `bridge.messages.errors.MessageTypeError`."""
        raise MessageTypeError(_NO_SERVICES.format(side=self.side, name=endpoint.topic))

    def service_from_hub(self, type_name: str, type_hash: str) -> ServiceConversion:
        """Return the conversion of a hub service's type; raises `bridge.messages.errors.MessageTypeError`."""
        del type_hash
        raise MessageTypeError(_NO_SERVICES.format(side=self.side, name=type_name))

    def caller(self, name: str, side_type: SideType) -> EdgeCaller:
        """Open a client of the side's server ``name``; raises `bridge.messages.errors.MessageTypeError`."""
        del side_type
        raise MessageTypeError(_NO_SERVICES.format(side=self.side, name=name))

    def serve(self, name: str, side_type: SideType, call: Call) -> EdgeServer:
        """Serve ``name`` on the side; ``call`` receives requests and replies with responses, serialized as on the side.

        The edge runs ``call``, which returns at once, on one of its threads. The client receives a
        `bridge.hub.endpoints.calls.CallError` as an error in the side's form. Raises
        `bridge.messages.errors.MessageTypeError` if the type cannot be used.
        """
        del side_type, call
        raise MessageTypeError(_NO_SERVICES.format(side=self.side, name=name))

    def carry_parameters(
        self, rules: Sequence[ParameterRule], hub: Hub, active: Callable[[], bool]
    ) -> Callable[[], None]:
        """Share the parameters of the nodes in the rules, until the returned function is called.

        Called after `start`; most sides have no parameters, and do nothing. ``active`` returns whether this worker is
        the one that bridges the network to the hub.
        """
        del rules, hub, active
        return lambda: None

    def announce(self, record: bytes) -> None:  # noqa: B027 - a side without other Midspan workers has nothing to do
        """Send a record to all present and future Midspan workers on this side's network; it replaces the last record.

        One thread calls this up to about five times a second, with up to a few kilobytes. Each record is also a
        heartbeat, and is sent even if it equals the last; records are not queued.
        """

    def sightings(self) -> Sequence[Sighting]:
        """Return the other Midspan workers on this network, of any daemon, node or hub.

        A worker that left cleanly, or whose death the side reports, disappears at once. A worker that may be suspended
        stays, with an old ``received``. Dead predecessors of this worker are omitted.
        """
        return ()

    def settled(self, since: float) -> bool:  # noqa: ARG002 - there are no other workers
        """Return whether all workers present at ``since`` (monotonic) are known; until then nothing is bridged."""
        return True

    def why_not(self, topic: str, type_name: str) -> str:  # noqa: ARG002 - most sides accept every topic
        """Return why the side cannot have a topic of this name, else ""; such a topic does not count as refused."""
        return ""

    def side_name(self, hub_name: str) -> str:
        """Return the side's name for a hub topic."""
        return hub_name

    def hub_name(self, side_name: str) -> str:
        """Return the hub's name for a topic of the side; the name is valid on the hub."""
        return side_name

    def has_subscribers(self, topic: str) -> bool:
        """Return whether another node on the side subscribes to a topic."""
        return any(e.topic == topic and e.kind is Kind.SUBSCRIPTION for e in self.endpoints())

    def resumed(self, seconds: float) -> None:  # noqa: B027  most have nothing to do
        """Recover after this process was suspended for ``seconds``, because the network may consider it dead."""

    def details(self) -> dict[str, Any]:
        """Return additional entries for the side's status document."""
        return {}

    def version_notes(self) -> Mapping[tuple[str, str, str], Sequence[str]]:
        """Return which fields are lost in the messages of nodes that have other versions of the types, as texts.

        The keys are ``topic`` or ``service``, the direction as in decisions, and the name on the side.
        """
        return {}

    def programs(self) -> Mapping[str, str]:
        """Return, by the id of each native endpoint, the middleware and the release of its program, as text.

        The result is empty if all programs on the side use the same middleware and release.
        """
        return {}

    def connections(self) -> list[ConnectionStatus]:
        """Return the side's connections to other nodes, if the edge opens them itself."""
        return []

    def warnings(self) -> list[str]:
        """Return problems of the side that do not belong to one route, for people; for example incompatible QoS."""
        return []
