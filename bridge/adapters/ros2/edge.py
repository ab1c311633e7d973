"""The ROS 2 edge: rclpy over Fast DDS, raw bytes both ways, no executor."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from bridge.adapters.base import (
    Deliver,
    Edge,
    EdgeCaller,
    EdgeListener,
    EdgePublisher,
    EdgeServer,
    EdgeSubscription,
    Endpoint,
    Kind,
    MadeBy,
    Sighting,
)
from bridge.adapters.ros2 import neighbours, rcl, shm, spdp
from bridge.adapters.ros2.environment import domain
from bridge.adapters.ros2.graph import Graph, Snapshot
from bridge.adapters.ros2.lives import Lives
from bridge.adapters.ros2.loop import Loop, TakeLoop
from bridge.adapters.ros2.mark import new_prefix, participant_number
from bridge.adapters.ros2.origins import Origins
from bridge.adapters.ros2.participant import Participant
from bridge.adapters.ros2.presence import TYPE, Presence
from bridge.adapters.ros2.process import use_profile
from bridge.adapters.ros2.publisher import Ros2Publisher
from bridge.adapters.ros2.qos import mismatch
from bridge.adapters.ros2.service_caller import Ros2Caller
from bridge.adapters.ros2.service_later import Later
from bridge.adapters.ros2.service_parts import Parts
from bridge.adapters.ros2.service_server import Ros2Server
from bridge.adapters.ros2.service_types import ServiceTypes
from bridge.adapters.ros2.subscription import Ros2Subscription
from bridge.adapters.ros2.types import TypeSupports
from bridge.adapters.ros2.waitset import WaitSetLoop
from bridge.config.model import Config
from bridge.hub.call import Call
from bridge.hub.origin import Origin
from bridge.hub.qos import Qos
from bridge.messages.conversion import Conversion, ServiceConversion, SideType
from bridge.messages.errors import MessageTypeError
from bridge.messages.hashes import rihs01
from bridge.messages.refusals import refusal
from bridge.messages.registry import Registry

if TYPE_CHECKING:
    from bridge.config.sections.parameters import ParameterRule
    from bridge.hub.session import Hub

_log = logging.getLogger(__name__)

_Service = TypeVar("_Service", Ros2Caller, Ros2Server)
_AnyService = Ros2Caller | Ros2Server

_FORGOTTEN = 15.0
"""Seconds after which others may have given us up: Fast DDS's default lease is 20."""


class Ros2Edge(Edge):
    """One participant on a ROS 2 (DDS) network. A process has one at a time: the mark is the process's."""

    side: ClassVar[str] = "ros2"
    services: ClassVar[bool] = True

    def __init__(self, config: Config, registry: Registry, state: Path) -> None:
        self._config, self._registry, self._state = config, registry, state
        self._types, self._service_types = TypeSupports(), ServiceTypes()
        self._lock = threading.Lock()
        self._subscriptions: set[Ros2Subscription] = set()
        self._publishers: set[Ros2Publisher] = set()
        self._services: set[_AnyService] = set()
        self._listener: EdgeListener | None = None
        self._prefix = b""
        self._neighbours: neighbours.Neighbours | None = None
        self._participant: Participant | None = None
        self._loop: Loop | None = None
        self._parts: Parts | None = None
        self._graph: Graph | None = None
        self._origins: Origins | None = None
        self._presence: Presence | None = None

    def start(self, listener: EdgeListener) -> None:
        """Join the DDS network, which is always there; takes about half a second."""
        self._listener = listener
        removed = shm.clean()
        if removed:
            _log.info("removed %d shared-memory segments of dead ROS 2 processes", removed)
        profile = use_profile(self._config, self._state)
        self._prefix = profile.prefix
        if profile.segment and self._config.ros2.transport == "auto" and self._config.ros2.profile is None:
            number = domain(self._config, os.environ)
            self._neighbours = neighbours.Neighbours(self._prefix, number, self._leave_shared_memory)
        self._participant = Participant(self._config.ros2.node, domain(self._config, os.environ))
        self._loop = TakeLoop() if rcl.has_eventfd() else WaitSetLoop(self._participant)
        self._loop.start()
        graph = self._graph = Graph(self._participant, self._prefix, self._changed)
        self._parts = Parts(self._participant, self._loop, graph, Lives(self._prefix), Later())
        self._origins = Origins(
            self._prefix, self._state / "ros2", lambda: graph.snapshot.participants, listener.graph_changed
        )
        self._greet(self._origins.predecessors)
        self._clean_ports(self._origins.past)
        graph.start()
        string = self._types.message_class(TYPE, self._registry.ros2(TYPE).type_id)
        self._presence = Presence(
            self._participant,
            self._loop,
            string,
            lambda: graph.snapshot.participants,
            self._origins.past,
            listener.presence_changed,
        )

    def _greet(self, dead: Sequence[bytes]) -> None:
        """Say farewell for our dead predecessors, and have everybody announce himself to us."""
        number, caller = domain(self._config, os.environ), new_prefix(rcl.host_prefix())
        call = [spdp.hello(caller, number, participant_number(self._prefix)), spdp.farewell(caller)]
        localhost_only = self._config.ros2.localhost_only and self._config.ros2.profile is None
        spdp.say([*map(spdp.farewell, dead), *call], number, localhost_only=localhost_only)

    def _clean_ports(self, past: Iterable[bytes]) -> None:
        """Remove what our dead predecessors left in shared memory; not what has our own number, or another's."""
        numbers = {participant_number(prefix) for prefix in past} - {participant_number(self._prefix)}
        of_domain = domain(self._config, os.environ)
        shm.clean_ports(port for number in numbers for port in spdp.unicast_ports(of_domain, number))

    def _changed(self, snapshot: Snapshot) -> None:
        if self._neighbours is not None:
            self._neighbours.follow(snapshot.participants)
        with self._lock:
            following: list[Ros2Subscription | _AnyService] = [*self._subscriptions, *self._services]
        for endpoint in following:
            endpoint.refit()
        if self._listener is not None:
            self._listener.graph_changed()

    def carry_parameters(
        self, rules: Sequence[ParameterRule], hub: Hub, active: Callable[[], bool]
    ) -> Callable[[], None]:
        """Be the nodes whose parameters ROS 1 owns: `ros2 param` asks for services only of nodes that are there."""
        del hub, active
        participant = self._participant
        assert participant is not None
        names = dict.fromkeys(rule.node for rule in rules if rule.owner == "ros1")
        nodes = [participant.make_node(name) for name in names]

        def leave() -> None:
            while nodes:
                participant.destroy(nodes.pop())

        return leave

    def announce(self, record: bytes) -> None:
        """See `Edge.announce`."""
        presence = self._presence
        if presence is not None:
            presence.announce(record)

    def sightings(self) -> Sequence[Sighting]:
        """See `Edge.sightings`."""
        presence = self._presence
        return presence.sightings() if presence is not None else ()

    def settled(self, since: float) -> bool:
        """See `Edge.settled`."""
        presence = self._presence
        return presence is not None and presence.settled(since)

    def _leave_shared_memory(self) -> None:
        neighbours.note(self._state / "ros2")
        if self._listener is not None:
            self._listener.edge_failed(
                "there are ROS 2 nodes of another user or container, to which shared memory delivers nothing:"
                " starting again with UDP alone"
            )

    def stop(self) -> None:
        """Leave the network."""
        graph, self._graph = self._graph, None
        loop, self._loop = self._loop, None
        participant, self._participant = self._participant, None
        if graph is None or loop is None or participant is None:
            return
        graph.stop()
        presence, self._presence = self._presence, None
        if presence is not None:
            presence.close()
        origins, self._origins = self._origins, None
        watch, self._neighbours = self._neighbours, None
        for part in (origins, watch):
            if part is not None:
                part.close()
        with self._lock:
            endpoints: list[Ros2Subscription | Ros2Publisher | _AnyService]
            endpoints = [*self._subscriptions, *self._publishers, *self._services]
        for endpoint in endpoints:
            endpoint.close()
        parts, self._parts = self._parts, None
        if parts is not None:
            parts.later.stop()
        loop.stop()
        participant.close()

    def network(self) -> str | None:
        """The participant's GUID prefix in hex."""
        return self._prefix.hex() if self._participant is not None else None

    def is_own_network(self, origin: Origin) -> bool:
        """Whether a ROS 2 origin is ours, or its participant is seen on our DDS network."""
        return origin.side == self.side and self._origins is not None and self._origins.is_own(origin.network)

    def endpoints(self) -> Sequence[Endpoint]:
        """Publishers, subscriptions, servers and clients of all other participants."""
        return self._graph.snapshot.endpoints if self._graph is not None else ()

    def to_hub(self, endpoint: Endpoint) -> Conversion:
        """The bytes are the same once they are checked: DDS carries whatever a program says."""
        known = self._known(endpoint.type, endpoint.type_id)
        return Conversion(known, known, self._registry.hub_check(endpoint.type))

    def from_hub(self, type_name: str, type_hash: str) -> Conversion:
        """The bytes are the same once they are checked: DDS delivers junk nowhere, and says nothing."""
        known = self._known(type_name, type_hash)
        return Conversion(known, known, self._registry.hub_check(type_name))

    def _known(self, type_name: str, type_hash: str) -> SideType:
        known = self._registry.ros2(type_name)
        if type_hash and type_hash != known.type_id:
            raise MessageTypeError(
                f"{type_name}: its publisher has {type_hash}, this machine's definition has {known.type_id}",
                "install the same version of the message package on both, or give its .msg folder in types.folders",
            )
        return known

    def learn(self, type_name: str, definition: str) -> None:
        """Keep a definition that another worker told."""
        self._registry.learn_ros2(type_name, definition)

    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> EdgeSubscription:
        """Subscribe; ``qos`` is the most that is asked for, each publisher is heard as far as it offers that."""
        if self._participant is None or self._loop is None or self._graph is None:
            msg = "the ROS 2 edge is not started"
            raise RuntimeError(msg)
        self._check_one_type(topic, side_type.name)
        subscription = Ros2Subscription(
            topic,
            self._types.message_class(side_type.name, side_type.type_id),
            qos,
            deliver,
            participant=self._participant,
            loop=self._loop,
            graph=self._graph,
            closed=self._subscription_closed,
        )
        with self._lock:
            self._subscriptions.add(subscription)
        subscription.refit()  # a change of the graph since it was made has passed it by
        return subscription

    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> EdgePublisher:
        """Advertise; the topic is on the graph at once."""
        if self._participant is None:
            msg = "the ROS 2 edge is not started"
            raise RuntimeError(msg)
        self._check_one_type(topic, side_type.name)
        message_class = self._types.message_class(side_type.name, side_type.type_id)
        publisher = Ros2Publisher(topic, message_class, qos, self._participant, self._publisher_closed)
        with self._lock:
            self._publishers.add(publisher)
        return publisher

    def _check_one_type(self, topic: str, type_name: str) -> None:
        """A DDS participant has one type per topic; Fast DDS says so in words that nobody understands."""
        with self._lock:
            here: list[Ros2Subscription | Ros2Publisher] = [*self._subscriptions, *self._publishers]
        other = next((e.type_name for e in here if e.topic == topic and e.type_name != type_name), None)
        if other is not None:
            raise MessageTypeError(
                f"{topic} crosses on ROS 2 as {other} already, it cannot also be {type_name}",
                f"rename one of the two by a rule with 'type: {type_name}': a ROS 2 program has one type per topic",
            )

    def service_to_hub(self, endpoint: Endpoint) -> ServiceConversion:
        """The bytes are the same once they are checked, as those of topics are."""
        conversion = self._service(endpoint.type, "")
        request, _ = self._part_hashes(conversion.side)
        if endpoint.type_id not in ("", request):
            raise MessageTypeError(
                f"{endpoint.type}: its server's requests have {endpoint.type_id}, this machine's have {request}",
                "install the same version of the package on both, or give its .srv folder in types.folders",
            )
        return conversion

    def service_from_hub(self, type_name: str, type_hash: str) -> ServiceConversion:
        """The bytes are the same once they are checked, as those of topics are."""
        return self._service(type_name, type_hash)

    def _service(self, type_name: str, type_hash: str) -> ServiceConversion:
        known = self._registry.service_ros2(type_name, type_hash)
        request, response = self._registry.hub_service_check(type_name, type_hash)
        return ServiceConversion(known, known, request, request, response, response)

    def _part_hashes(self, service: SideType) -> tuple[str, str]:
        request, response = self._registry.service_schemas(service.name, service.type_id)
        return rihs01(request), rihs01(response)

    def _service_class(self, service: SideType) -> Any:
        return self._service_types.service_class(service.name, service.type_id, self._part_hashes(service))

    def caller(self, name: str, side_type: SideType) -> EdgeCaller:
        """A client of the native servers of a name."""
        service_class = self._service_class(side_type)
        return self._kept(Ros2Caller(name, service_class, self._started(), self._service_closed))

    def serve(self, name: str, side_type: SideType, call: Call) -> EdgeServer:
        """A server; a DDS client that cannot be told of an error waits on, as after any reply that is lost."""
        service_class = self._service_class(side_type)
        refuse = refusal(self._registry, side_type.name, side_type.type_id)
        return self._kept(Ros2Server(name, service_class, call, refuse, self._started(), self._service_closed))

    def _started(self) -> Parts:
        if self._parts is None:
            msg = "the ROS 2 edge is not started"
            raise RuntimeError(msg)
        return self._parts

    def _kept(self, service: _Service) -> _Service:
        with self._lock:
            self._services.add(service)
        return service

    def went_on(self, seconds: float) -> None:
        """See `Edge.went_on`: who was forgotten by others, and has not forgotten them, is never found again."""
        if seconds > _FORGOTTEN and self._listener is not None:
            self._listener.edge_failed(
                f"stood still for {seconds:.0f} s, so that ROS 2 nodes may have given this one up: starting again"
            )

    def warnings(self) -> list[str]:
        """Native subscriptions that do not hear what we publish, and why."""
        offers: dict[str, set[Qos]] = {}
        with self._lock:
            for publisher in self._publishers:
                offers.setdefault(publisher.topic, set()).add(publisher.qos)
        found = []
        for endpoint in self.endpoints():
            if endpoint.kind is Kind.SUBSCRIPTION and endpoint.made_by is MadeBy.NATIVE:
                reasons = {mismatch(qos, endpoint.qos) for qos in offers.get(endpoint.topic, ())} - {""}
                node = endpoint.node or "a node"
                found += [f"{endpoint.topic}: {node} does not hear us: {why}" for why in sorted(reasons)]
        return found

    def _subscription_closed(self, subscription: Ros2Subscription) -> None:
        with self._lock:
            self._subscriptions.discard(subscription)

    def _service_closed(self, service: _AnyService) -> None:
        with self._lock:
            self._services.discard(service)

    def _publisher_closed(self, publisher: Ros2Publisher) -> None:
        with self._lock:
            self._publishers.discard(publisher)
