"""The ROS 2 edge: rclpy over Fast DDS or Cyclone DDS, with serialized messages both ways and without an executor."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from typing_extensions import override

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.context import Ros2Context
from bridge.adapters.ros2.dds.choice import dds_of
from bridge.adapters.ros2.discovery import ServerWatch, servers
from bridge.adapters.ros2.environment import CYCLONE, domain
from bridge.adapters.ros2.filters import VersionFilter
from bridge.adapters.ros2.graph import middlewares, neighbors, spdp
from bridge.adapters.ros2.graph.announcements import Announcements
from bridge.adapters.ros2.graph.graph import GraphSnapshot, Ros2Graph, is_hidden
from bridge.adapters.ros2.graph.heartbeats import Heartbeats
from bridge.adapters.ros2.graph.interfaces import InterfaceWatch, ipv4_addresses
from bridge.adapters.ros2.graph.names import NamesakeWatch
from bridge.adapters.ros2.graph.neighbors import ProcessWatch
from bridge.adapters.ros2.graph.origins import Origins
from bridge.adapters.ros2.graph.ports import PortWatch
from bridge.adapters.ros2.graph.presence import TYPE, PresenceTopic
from bridge.adapters.ros2.loop import QueueReadLoop, WaitSetReadLoop
from bridge.adapters.ros2.participant import mismatch
from bridge.adapters.ros2.receive_buffers import DropWatch
from bridge.adapters.ros2.releases import current
from bridge.adapters.ros2.services.caller import Ros2Caller
from bridge.adapters.ros2.services.final_state import call_with_final_state, refusal_with_final_state
from bridge.adapters.ros2.services.held import HeldRequests
from bridge.adapters.ros2.services.server import Ros2Server
from bridge.adapters.ros2.topics.publisher import Ros2Publisher
from bridge.adapters.ros2.topics.subscription import Ros2Subscription
from bridge.adapters.ros2.topics.versioned import VersionedPublisher
from bridge.adapters.ros2.versions import EndpointVersions, Notes
from bridge.adapters.side_edge import SideEdge
from bridge.concurrency import DelayedCalls
from bridge.config.model import Config
from bridge.hub.endpoints.calls import Call
from bridge.hub.graph.tokens import Origin
from bridge.hub.wire.qos import Qos, Reliability
from bridge.messages.actions import GET_RESULT, split
from bridge.messages.definitions.hashes import rihs01
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry
from bridge.messages.services import refusal
from bridge.messages.transcode.conversion import Conversion, Convert, ServiceConversion, SideType
from bridge.routing.edge import (
    Deliver,
    EdgeCaller,
    EdgeListener,
    EdgePublisher,
    EdgeServer,
    EdgeSubscription,
    Endpoint,
    Kind,
    MadeBy,
)

if TYPE_CHECKING:
    from bridge.config.sections.routing import ParameterRule
    from bridge.hub.node import Hub

_log = logging.getLogger(__name__)

_End = TypeVar("_End", Ros2Subscription, Ros2Publisher, VersionedPublisher, Ros2Caller, Ros2Server)

_FORGOTTEN_SECONDS = 15.0
"""Seconds of suspension after which others may have dropped this participant; Fast DDS's default lease is 20 s."""


class Ros2Edge(SideEdge):
    """One participant on a ROS 2 (DDS) network. A process can have only one, as the marked prefix is per process."""

    side: ClassVar[str] = "ros2"
    services: ClassVar[bool] = True
    sends_views: ClassVar[bool] = True

    def __init__(self, config: Config, registry: Registry, state: Path) -> None:
        super().__init__(config, registry)
        self._state = state
        self._dds, self._versions = dds_of(config), EndpointVersions(registry)
        self._types = self._dds.types
        self._lock = threading.Lock()
        self._ends: set[Ros2Subscription | Ros2Publisher | VersionedPublisher | Ros2Caller | Ros2Server] = set()
        self._prefix = b""
        self._neighbors: neighbors.MemoryNeighbors | None = None
        self._interfaces: InterfaceWatch | None = None
        self._ports: PortWatch | None = None
        self._servers: ServerWatch | None = None
        self._drops: DropWatch | None = None
        self._namesakes: NamesakeWatch | None = None
        self._context: Ros2Context | None = None
        self._origins: Origins | None = None
        self._presence: PresenceTopic | None = None
        self._announcements: Announcements | None = None

    @override
    def start(self, listener: EdgeListener) -> None:
        """Join the DDS network, which is always available; takes about half a second."""
        self._listener = listener
        removed = neighbors.clean()
        if removed:
            _log.info("removed %d shared-memory segments of dead ROS 2 processes", removed)
        number, later = domain(self._config, os.environ), DelayedCalls("midspan-ros2-later")
        # read before the participant reads them: an address that appears meanwhile counts as new
        addresses = frozenset() if self._localhost_only else ipv4_addresses()
        participant, self._prefix, segment = self._dds.join(self._state, self._config.ros2.node)
        if segment and self._config.ros2.transport == "auto" and self._config.ros2.profile is None:
            major = current().fast_dds_major
            self._neighbors = neighbors.MemoryNeighbors(self._prefix, major, number, self._leave_shared_memory, later)
        self._drops = DropWatch(later)
        self._namesakes = NamesakeWatch(self.endpoints, later)
        if not self._localhost_only:
            self._interfaces = InterfaceWatch(self._use_new_addresses, later, addresses)
        if self._config.ros2.rmw != CYCLONE:
            self._ports = PortWatch(self._replace_lost_port, later)
            self._servers = ServerWatch(servers(os.environ), localhost_only=self._localhost_only)
        try:
            self._types.prepare_services()
        except MessageTypeError as err:
            _log.warning("%s; %s", err, err.cure)
        loop = QueueReadLoop(participant.resolve) if rcl.is_compiled() else WaitSetReadLoop(participant)
        loop.start()
        send_all = partial(spdp.send_all, domain=number, localhost_only=self._localhost_only)
        heartbeats = Heartbeats(send_all, later)
        graph = Ros2Graph(
            participant, self._prefix, self._changed, self._dds.obstacle, self._versions,
            separates_versions=self._dds.separates_versions(), prepare=partial(self._dds.follow, heartbeats),
        )  # fmt: skip
        held = HeldRequests(graph, later, participant.marks.made_by)
        processes = ProcessWatch(self._prefix)
        self._context = Ros2Context(participant, loop, graph, processes, later, heartbeats, self._dds, held)

        def current_participants() -> frozenset[bytes]:
            return graph.snapshot.participants

        self._origins = Origins(self._prefix, self._state / "ros2", current_participants, listener.graph_changed, later)
        self._announcements = Announcements(
            self._prefix, number, current_participants, partial(self._dds.refresh, self._prefix, ()), later,
            localhost_only=self._localhost_only,
        )  # fmt: skip
        self._dds.refresh(self._prefix, self._origins.predecessors, self._announcements.port)
        self._dds.clean(self._prefix, self._origins.past)
        graph.start()
        string = self._types.message_class(TYPE, self._registry.ros2(TYPE).type_id)
        past, changed = self._origins.past, listener.presence_changed
        self._presence = PresenceTopic(participant, loop, string, current_participants, past, changed)

    @property
    def _localhost_only(self) -> bool:
        return self._config.ros2.localhost_only and self._config.ros2.profile is None

    def _use_new_addresses(self, text: str) -> None:
        if self._config.ros2.profile is not None:  # the profile may exclude the new addresses
            _log.warning("%s; to use it, restart the worker; to exclude it, restrict ros2.profile", text)
        elif self._listener is not None:
            self._listener.edge_failed(f"{text}: restarting")

    def _changed(self, snapshot: GraphSnapshot) -> None:
        if self._neighbors is not None:
            self._neighbors.follow(snapshot.participants)
        with self._lock:
            ends = list(self._ends)
        for end in ends:
            try:
                end.refit()
            except Exception:
                _log.exception("%s: handling a change of the ROS 2 graph failed", end)
        self._graph_changed()

    @override
    def carry_parameters(
        self, rules: Sequence[ParameterRule], hub: Hub, active: Callable[[], bool]
    ) -> Callable[[], None]:
        """Create the nodes whose parameters ROS 1 owns; `ros2 param` calls only services of nodes on the graph."""
        del hub, active
        participant = self._started().participant
        names = dict.fromkeys(rule.node for rule in rules if rule.owner == "ros1")
        nodes = [participant.make_node(name) for name in names]

        def destroy_nodes() -> None:
            while nodes:
                participant.destroy(nodes.pop())

        return destroy_nodes

    @override
    def settled(self, since: float) -> bool:
        """Return whether all participants that existed at ``since`` are discovered."""
        presence = self._presence
        return presence is not None and presence.settled(since)

    def _leave_shared_memory(self) -> None:
        neighbors.prefer_udp(self._state / "ros2")
        if self._listener is not None:
            self._listener.edge_failed(
                "shared memory cannot reach ROS 2 nodes of another user or container: restarting with UDP only"
            )

    def _replace_lost_port(self) -> None:
        if self._listener is not None:
            self._listener.edge_failed(
                "ROS 2 nodes on this machine removed this participant's shared memory while it did not run: restarting"
            )

    @override
    def stop(self) -> None:
        context, self._context = self._context, None
        if context is None:
            return
        context.graph.stop()
        presence, self._presence = self._presence, None
        watch, self._neighbors = self._neighbors, None
        announcements, self._announcements = self._announcements, None
        for part in (presence, watch, announcements):
            if part is not None:
                part.close()
        self._origins = None
        with self._lock:
            ends = list(self._ends)
        for end in ends:
            end.close()
        context.later.close()
        if self._servers is not None:
            self._servers.close()
        context.loop.stop()
        context.participant.close()

    @override
    def network(self) -> str | None:
        """Return the participant's GUID prefix in hex; None before `start` and after `stop`."""
        return self._prefix.hex() if self._context is not None else None

    @override
    def is_own_network(self, origin: Origin) -> bool:
        """Return whether a ROS 2 origin is this daemon's, or its participant is on this DDS network."""
        return origin.side == self.side and self._origins is not None and self._origins.is_own(origin.network)

    @override
    def endpoints(self) -> Sequence[Endpoint]:
        context = self._context
        return context.graph.snapshot.endpoints if context is not None else ()

    @override
    def has_subscribers(self, topic: str) -> bool:
        """Return whether a topic has subscribers; True for hidden topics and before the start."""
        context = self._context
        return context is None or is_hidden(topic) or topic in context.graph.snapshot.subscribed

    @override
    def to_hub(self, endpoint: Endpoint) -> Conversion:
        """Return a conversion that validates the bytes, from the version of the type that a publisher has."""
        return self._versions.to_hub(endpoint) or super().to_hub(endpoint)

    @override
    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> EdgeSubscription:
        """Subscribe; ``qos`` is an upper bound, reduced to what the publishers offer."""
        context = self._started()
        self._check_one_type(topic, side_type.name)
        message_class = self._types.message_class(side_type.name, self._announced(side_type))
        accepts = partial(self._versions.is_of, type_id=side_type.type_id)
        subscription = self._register(
            Ros2Subscription(topic, message_class, qos, deliver, context, self._closed, accepts)
        )
        subscription.refit()  # the graph may have changed since the constructor read it
        return subscription

    @override
    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> EdgePublisher:
        """Advertise; the topic is on the graph at once."""
        context = self._started()
        self._check_one_type(topic, side_type.name)
        others = self._versions.others(side_type.name, side_type.type_id)
        if others and self._dds.separates_versions() and qos.reliability is Reliability.RELIABLE:
            versioned = self._register(self._versioned(topic, side_type, qos, others))
            versioned.refit()
            return versioned
        message_class = self._types.message_class(side_type.name, side_type.type_id)
        for_readers = partial(self._converter_for_readers, topic, side_type) if others else None
        has_subscribers = self.has_subscribers
        publisher = self._register(
            Ros2Publisher(topic, message_class, qos, context, self._closed, has_subscribers, for_readers)
        )
        publisher.refit()
        return publisher

    def _versioned(
        self, topic: str, side_type: SideType, qos: Qos, others: Mapping[str, Convert | None]
    ) -> VersionedPublisher:
        context, has_subscribers = self._started(), self.has_subscribers

        def open_publisher(version: str, only: VersionFilter) -> Ros2Publisher:
            announced = self._announced(replace(side_type, type_id=version))
            message_class = self._types.message_class(side_type.name, announced)
            return Ros2Publisher(topic, message_class, qos, context, lambda _: None, has_subscribers, only=only)

        def restricted(*versions: str, only: bool) -> VersionFilter:
            return VersionFilter(context.participant.pointer, topic, versions, only=only)

        return VersionedPublisher(
            open_publisher(side_type.type_id, restricted(*others, only=False)),
            others,
            lambda version: open_publisher(version, restricted(version, only=True)),
            lambda: self._versions.of_readers(self._readers(topic, side_type.name)),
            self._closed,
        )

    def _readers(self, topic: str, type_name: str) -> list[Endpoint]:
        """Return the native subscriptions of a topic with a type; reads the graph."""
        context = self._context
        of_topic = context.graph.readers(topic) if context is not None else ()  # a message may arrive during `stop`
        return [reader for reader in of_topic if reader.type == type_name and reader.made_by is MadeBy.NATIVE]

    def _converter_for_readers(self, topic: str, side_type: SideType) -> Convert | None:
        version = self._versions.for_readers(side_type.type_id, self._readers(topic, side_type.name))
        return self._versions.converter(side_type.name, side_type.type_id, version)

    def _announced(self, side_type: SideType) -> str:
        """Return the hash that an endpoint announces; Humble's version has none, and announces this machine's."""
        return side_type.type_id or self._registry.ros2(side_type.name).type_id

    def _check_one_type(self, topic: str, type_name: str) -> None:
        """Reject a second type for a topic: a DDS participant has only one, and Fast DDS's error omits the reason."""
        with self._lock:
            topic_ends = [end for end in self._ends if not isinstance(end, Ros2Caller | Ros2Server)]
        other = next((e.type_name for e in topic_ends if e.topic == topic and e.type_name != type_name), None)
        if other is not None:
            raise MessageTypeError(
                f"{topic} is already bridged to ROS 2 as {other}, so it cannot also be {type_name}",
                f"rename one of the two with a rule for 'type: {type_name}': a ROS 2 program has one type per topic",
            )

    @override
    def service_to_hub(self, endpoint: Endpoint) -> ServiceConversion:
        conversion = self.service_from_hub(endpoint.type, "")
        other = self._versions.service_to_hub(endpoint, conversion)
        if other is not None:
            return other
        request, _ = self._part_hashes(conversion.side)
        self._versions.check_server(endpoint, conversion.hub.type_id, request)
        return conversion

    @override
    def service_from_hub(self, type_name: str, type_hash: str) -> ServiceConversion:
        self._types.prepare_services()
        return super().service_from_hub(type_name, type_hash)

    def _part_hashes(self, service: SideType) -> tuple[str, str]:
        request, response = self._registry.service_schemas(service.name, service.type_id)
        return rihs01(request), rihs01(response)

    def _service_class(self, service: SideType) -> Any:
        if not service.type_id:  # Humble's version, which has no hash
            service = self._registry.service_ros2(service.name)
        return self._types.service_class(service.name, service.type_id, self._part_hashes(service))

    @override
    def caller(self, name: str, side_type: SideType) -> EdgeCaller:
        version = side_type.type_id if self._versions.varies(side_type.name) else None
        service_class = self._service_class(side_type)
        caller = self._register(Ros2Caller(name, service_class, self._started(), self._closed, version))
        caller.refit()
        return caller

    @override
    def serve(self, name: str, side_type: SideType, call: Call) -> EdgeServer:
        """Serve a service; after a failed call, a client of an action gets a rejection, any other client no reply."""
        service_class = self._service_class(side_type)
        refuse = refusal(self._registry, side_type.name, side_type.type_id)
        if split(name)[1] == GET_RESULT:
            call, refuse = partial(call_with_final_state, call), refusal_with_final_state(refuse)
        replaced, (request, _) = partial(self._is_served, name), self._part_hashes(side_type)
        converters = partial(self._versions.of_client, side_type.name, side_type.type_id, request)
        context = self._started()
        return self._register(
            Ros2Server(name, service_class, call, refuse, replaced, context, self._closed, converters)
        )

    def _is_served(self, name: str) -> bool:
        """Return whether this edge or another participant has an open server of a service; reads the graph."""
        with self._lock:
            if any(isinstance(end, Ros2Server) and end.name == name for end in self._ends):
                return True
        context = self._context
        return context is not None and bool(context.graph.servers(name))

    def _started(self) -> Ros2Context:
        if self._context is None:
            raise RuntimeError("the ROS 2 edge is not started")
        return self._context

    def _register(self, end: _End) -> _End:
        with self._lock:
            self._ends.add(end)
        return end

    def _closed(self, end: _End) -> None:
        with self._lock:
            self._ends.discard(end)

    @override
    def resumed(self, seconds: float) -> None:
        """Restart after a long suspension: others that dropped this participant never rediscover it."""
        if self._ports is not None:
            self._ports.check()
        reason = f"suspended for {seconds:.0f} s, ROS 2 nodes may have dropped this participant: restarting"
        if seconds > _FORGOTTEN_SECONDS and self._listener is not None:
            self._listener.edge_failed(reason)

    @override
    def details(self) -> dict[str, Any]:
        context, announcements = self._context, self._announcements
        if context is None or announcements is None:
            return {}
        snapshot = context.graph.snapshot
        groups = middlewares.groups(snapshot.endpoints, snapshot.participants, announcements.versions())
        return self._dds.details(snapshot.endpoints) | {"middlewares": groups}

    @override
    def version_notes(self) -> Notes:
        with self._lock:
            separated = {end.topic for end in self._ends if isinstance(end, VersionedPublisher)}
        endpoints = self.endpoints()
        notes = {key: list(texts) for key, texts in self._versions.notes(endpoints, separated).items()}
        for name, texts in self._dds.notes(endpoints).items():
            notes.setdefault(("service", "in", name), []).extend(texts)
        return notes

    @override
    def programs(self) -> Mapping[str, str]:
        context, announcements = self._context, self._announcements
        if context is None or announcements is None:
            return {}
        snapshot = context.graph.snapshot
        by_prefix = middlewares.programs(snapshot.endpoints, snapshot.participants, announcements.versions())
        return {end.id: str(program) for program, ends in by_prefix.values() for end in ends}

    @override
    def warnings(self) -> list[str]:
        """Return warnings about QoS, names, versions, other DDS, new addresses, drops and discovery servers."""
        offers: dict[str, set[Qos]] = {}
        advertised: dict[str, str] = {}
        separated, served = set[str](), set[str]()
        with self._lock:
            for end in self._ends:
                if isinstance(end, Ros2Publisher | VersionedPublisher):
                    offers.setdefault(end.topic, set()).add(end.qos)
                    advertised[end.topic] = end.type_name
                if isinstance(end, VersionedPublisher):
                    separated.add(end.topic)
                if isinstance(end, Ros2Server):
                    served.add(end.name)
        warnings = self._dds.warnings(self.endpoints(), served)
        warnings += self._namesakes.texts if self._namesakes is not None else []
        warnings += self._over_udp() + self._versions.warnings(self.endpoints(), advertised, separated)
        warnings += [self._interfaces.text] if self._interfaces is not None and self._interfaces.text else []
        warnings += [self._drops.text] if self._drops is not None and self._drops.text else []
        warnings += self._servers.texts if self._servers is not None else []
        for endpoint in self.endpoints():
            if endpoint.kind is Kind.SUBSCRIPTION and endpoint.made_by is MadeBy.NATIVE:
                reasons = {mismatch(qos, endpoint.qos) for qos in offers.get(endpoint.topic, ())} - {""}
                node = endpoint.node or "a node"
                warnings += [f"{endpoint.topic}: {node} does not receive it: {reason}" for reason in sorted(reasons)]
        return warnings

    def _over_udp(self) -> list[str]:
        """Return a warning if participants on this machine have another major version of Fast DDS."""
        watch = self._neighbors
        count = 0 if watch is None else watch.on_other_major()
        if not count:
            return []
        programs, release = "program uses" if count == 1 else "programs use", current()
        text = (
            f"{count} ROS 2 {programs} another major version of Fast DDS on this machine than Midspan,"
            f" which uses {release.fast_dds} ({release.name}): their messages use UDP, not shared memory"
        )
        return [text]
